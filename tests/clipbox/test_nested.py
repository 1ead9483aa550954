"""Nested boxes: closed across levels, independent of the viewer's path, and computing only new voxels."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.clipbox import engine as engine_module
from farfield.addon.core.clipbox.engine import BLOCK_SIZE, TerrainEngine, weld
from farfield.addon.core.clipbox.layout import layout_around, visible_blocks
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.generators import Sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.clipbox.toroidal_grid import ToroidalGrid
from farfield.addon.core.errors import Cancelled, GeometryError, SettingsError
from farfield.addon.core.jobs.progress import run_to_end
from watertight import directed_edge_counts, directed_edges, open_edges

VARIANTS = [
    {"terrain": "cascades", "smooth_moves": True},
    pytest.param({"terrain": "mesas", "threshold": 2}, marks=pytest.mark.exhaustive),
    pytest.param({"terrain": "spheres"}, marks=pytest.mark.exhaustive),
    {"terrain": "islands", "surface": "blocky"},
    pytest.param({"terrain": "sine", "surface": "blocky", "smoothing": 3, "threshold": 3}, marks=pytest.mark.exhaustive),
    pytest.param({"terrain": "cascades", "smoothing": 2}, marks=pytest.mark.exhaustive),
    {"terrain": "cascades", "subdivided_boxes": 1, "threshold": 4, "smooth_moves": True},
    pytest.param({"terrain": "spheres", "subdivided_boxes": 2, "surface": "blocky", "smoothing": 1}, marks=pytest.mark.exhaustive),
]


def small(**changes):
    return ClipboxSettings(**({"boxes": 3, "resolution": 32, "threshold": 1} | changes))


def build(variant, position):
    engine = TerrainEngine(small(**variant))
    return engine, run_to_end(engine.move(np.array(position, np.float64)))


def flight(seed, steps):
    """Positions of a viewer who walks, runs and jumps."""
    random, position = np.random.default_rng(seed), np.array([3.0, -5.0, 12.0])
    for _ in range(steps):
        position = position + random.normal(size=3) * random.choice([0.7, 3.0, 25.0]) * [1.0, 1.0, 0.3]
        position[2] = np.clip(position[2], -40.0, 60.0)
        yield position


def check_closed(engine, meshes):
    """Each edge has two faces, except those on the boundary of the outermost box, which have one."""
    mesh = weld(meshes)
    assert (directed_edge_counts(mesh.triangles) == 1).all()
    visible = engine.boxes.layout.visible[-1]
    voxel_size = engine.boxes.grid(engine.boxes.coarsest_level).voxel_size
    low, high = visible.low * voxel_size, visible.high * voxel_size
    ends = mesh.vertices[open_edges(mesh.triangles)]
    assert (np.isclose(ends, low) | np.isclose(ends, high)).any(axis=2).all()


@pytest.mark.parametrize("variant", VARIANTS, ids=str)
def test_a_flight_has_no_cracks_and_equals_builds_from_scratch(variant):
    engine, shown = TerrainEngine(small(**variant)), {}
    for position in flight(7, 4):
        update = run_to_end(engine.move(position))
        shown = {key: mesh for key, mesh in shown.items() if key not in update.removed and not update.is_complete} | update.meshes
        _, fresh = build(variant, position)
        assert set(shown) == set(fresh.meshes)
        for key, mesh in fresh.meshes.items():
            for name in ("corners", "cycles", "vertices", "normals", "triangles"):
                assert getattr(mesh, name).tobytes() == getattr(shown[key], name).tobytes(), (key, name)
        check_closed(engine, list(shown.values()))


@pytest.mark.parametrize("variant", VARIANTS, ids=str)
def test_shared_vertices_are_identical_in_every_block(variant):
    _, update = build(variant, (1.0, 2.0, 3.0))
    first_seen = {}
    for mesh in update.meshes.values():
        for corner, cycle, vertex, normal in zip(mesh.corners.tolist(), mesh.cycles.tolist(), mesh.vertices, mesh.normals, strict=True):
            known = first_seen.setdefault((*corner, cycle), (vertex, normal))
            assert np.array_equal(known[0], vertex)
            if not variant.get("subdivided_boxes"):
                assert np.array_equal(known[1], normal)


def test_terrain_far_from_the_origin_is_as_accurate_as_near_it():
    formula = "9*sin(x*pi/512) + 7*sin(y*pi/256) - z"
    near, far = (build({"terrain": "formula", "formula": formula}, (x, 0.0, 5.0))[1] for x in (0.0, 1024.0 * 2**20))
    near, far = (weld(list(update.meshes.values())) for update in (near, far))
    assert np.array_equal(near.triangles, far.triangles)
    assert np.allclose(near.vertices, far.vertices - [1024.0 * 2**20, 0.0, 0.0], atol=2e-3)


def test_uniform_densities_have_no_surface():
    for formula in ("1", "-1", "0/0"):
        engine, update = build({"terrain": "formula", "formula": formula}, (0.0, 0.0, 0.0))
        assert not update.meshes and not update.removed
        with pytest.raises(GeometryError, match="no surface"):
            weld(list(engine.extract_all()))


def test_the_surface_is_accurate_in_every_level():
    _, update = build({"terrain": "formula", "formula": "0.37*x - 0.2*y + 3.1 - z"}, (0.0, 0.0, 0.0))
    mesh = weld(list(update.meshes.values()))
    distance = np.abs(mesh.vertices @ [0.37, -0.2, -1.0] + 3.1)
    inner = np.abs(mesh.vertices).max(axis=1) < 64.0  # densities outside the outermost box are unknown
    assert distance[inner].max() < 0.2 and np.median(distance) < 1e-3  # less accurate between voxels of two sizes
    assert np.allclose(mesh.normals[inner], np.array([-0.37, 0.2, 1.0]) / np.linalg.norm([0.37, 0.2, 1.0]), atol=0.35)


@pytest.mark.parametrize("is_smooth", [True, False])
@pytest.mark.parametrize("threshold", [1, 2, 3, 4])
def test_levels_are_nested_and_aligned(threshold, is_smooth):
    viewer = np.array([1e7 + 0.3, -17.2, 4.0])
    layout = layout_around(viewer, small(voxel_size=0.5, resolution=33, boxes=5, threshold=threshold, smooth_moves=is_smooth))
    alignment = 2 if is_smooth else 4
    for level, (inner, outer) in enumerate(pairwise(layout.visible)):
        assert (inner.low % alignment == 0).all() and (inner.high % alignment == 0).all()
        assert (inner.high - inner.low >= 33 - (10 if is_smooth else 6)).all()
        hole = layout.hole(level + 1)
        assert ((hole.low - outer.low >= 3) & (outer.high - hole.high >= 3)).all()
        center = (inner.low + inner.high) / 2 * 0.5 * 2**level
        assert (np.abs(center - viewer) <= (1.5 if is_smooth else 3.5 + threshold / 2) * 0.5 * 2**level).all()


@pytest.mark.parametrize("resolution", [32, 33, 64, 65])
@pytest.mark.parametrize("threshold", [1, 2, 3, 4])
def test_visible_voxels_are_those_that_boxes_have(threshold, resolution):
    source = small(resolution=resolution, threshold=threshold, boxes=2)
    for viewer in np.random.default_rng(threshold).uniform(-40.0, 40.0, (300, 3)):
        layout = layout_around(viewer, source)
        assert (layout.visible[0].low >= layout.origins[0]).all() and (layout.visible[0].high <= layout.origins[0] + resolution).all()


def test_blocks_cover_the_visible_part():
    layout = layout_around(np.array([5.0, -9.0, 33.0]), small(resolution=64))
    for level in range(3):
        blocks = set(visible_blocks(layout, level, BLOCK_SIZE))
        visible, hole = layout.visible[level], layout.hole(level)
        voxels = np.random.default_rng(level).integers(visible.low, visible.high, (500, 3))
        for voxel in voxels if hole is None else voxels[~hole.contains(voxels)]:
            assert tuple((voxel // BLOCK_SIZE).tolist()) in blocks


class TestToroidalGrid:
    """Voxels in a wrap-around array."""

    @staticmethod
    def unique_values(grid: Grid):
        x, y, z = (np.arange(low, low + count) for low, count in zip(grid.origin, grid.shape, strict=True))
        return (x[:, None, None] * 10007 + y[:, None] * 101 + z).astype(np.int64)

    @settings(max_examples=40)
    @given(st.lists(st.tuples(*[st.integers(-20, 20)] * 3), min_size=1, max_size=6))
    def test_moves_compute_only_new_voxels(self, origins):
        toroidal_grid, computed, last = ToroidalGrid(8, 1.0, self.unique_values), 0, None
        for origin in origins:
            run_to_end(toroidal_grid.move(np.array(origin)))
            window = toroidal_grid.window(np.array(origin), np.array(origin) + 8)
            assert np.array_equal(window, self.unique_values(Grid(origin, (8, 8, 8), 1.0)))
            kept = 0 if last is None else int(np.prod(np.maximum(8 - np.abs(np.subtract(origin, last)), 0)))
            computed += 512 - kept
            last = origin
            assert toroidal_grid.computed == computed

    def test_failed_moves_change_nothing(self):
        def sample(grid):
            if max(grid.origin) > 3:
                raise GeometryError("too far")
            return self.unique_values(grid)

        toroidal_grid = ToroidalGrid(8, 1.0, sample)
        run_to_end(toroidal_grid.move(np.array([0, 0, 0])))
        with pytest.raises(GeometryError):
            run_to_end(toroidal_grid.move(np.array([0, 5, 0])))
        assert np.array_equal(toroidal_grid.window(np.zeros(3, int), np.full(3, 8)), self.unique_values(Grid((0, 0, 0), (8, 8, 8), 1.0)))


class TestMoves:
    """Updates and cancelling."""

    def test_small_steps_reuse_most_voxels(self):
        engine = TerrainEngine(small(terrain="sine"))
        for step in range(30):
            run_to_end(engine.move(np.array([0.7 * step, 0.4 * step, 5.0])))
        boxes = engine.statistics()
        assert all(box["reused_fraction"] >= 0.9 for box in boxes if box["reused_fraction"] is not None)
        assert boxes[0]["computed"] > boxes[-1]["computed"]

    @pytest.mark.parametrize("is_smooth", [True, False])
    def test_a_move_within_the_same_voxel_changes_nothing(self, is_smooth):
        engine, _ = build({"smooth_moves": is_smooth}, (0.0, 0.0, 9.0))
        update = run_to_end(engine.move(np.array([0.1, 0.1, 9.1])))
        assert not update.meshes and not update.removed and not update.is_complete
        assert engine.is_settled_at(np.array([0.1, 0.0, 9.1])) and not engine.is_settled_at(np.array([1.4, 0.0, 9.0]))
        assert engine.is_settled_at(np.array([0.6, 0.0, 9.0])) != is_smooth

    def test_a_move_can_be_repeated_after_cancelling(self):
        engine, first = build({}, (0.0, 0.0, 9.0))
        for steps in range(1, 6):
            move = engine.move(np.array([40.0 + steps, 3.0, 9.0]))
            for _ in range(steps):
                next(move)
            move.close()
        update = run_to_end(engine.move(np.array([40.0, 3.0, 9.0])))
        shown = {key: mesh for key, mesh in first.meshes.items() if key not in update.removed} | update.meshes
        assert set(shown) == set(build({}, (40.0, 3.0, 9.0))[1].meshes)
        check_closed(engine, list(shown.values()))

    def test_an_invalidated_engine_shows_all_blocks_without_new_voxels(self):
        engine, first = build({}, (0.0, 0.0, 9.0))
        computed = engine.statistics()[0]["computed"]
        engine.invalidate()
        update = run_to_end(engine.move(np.array([0.0, 0.0, 9.0])))
        assert update.is_complete and set(update.meshes) == set(first.meshes) and engine.statistics()[0]["computed"] == computed

    def test_a_slow_terrain_can_be_cancelled_between_slabs(self, monkeypatch):
        sampled, limit = [], 3
        sampler = Sampler("slow", lambda grid: sampled.append(grid) or 1.0)
        monkeypatch.setattr(engine_module, "build_sampler", lambda *_: sampler)

        def cancel(_):
            if len(sampled) >= limit:
                raise Cancelled("Cancelled.")

        with pytest.raises(Cancelled):
            run_to_end(TerrainEngine(ClipboxSettings(resolution=128, boxes=2)).move(np.zeros(3)), cancel)
        assert len(sampled) == limit

    @pytest.mark.parametrize("position", [(np.nan, 0.0, 0.0), (0.0, np.inf, 0.0), (1e300, 0.0, 0.0)])
    def test_invalid_positions_are_rejected(self, position):
        with pytest.raises(GeometryError, match="too far from the origin"):
            run_to_end(TerrainEngine(small()).move(np.array(position)))

    @pytest.mark.parametrize(
        "changes",
        [{"resolution": 8}, {"resolution": 257}, {"voxel_size": 0.0}, {"voxel_size": float("nan")}, {"boxes": 0}, {"boxes": 11},
         {"subdivided_boxes": 3},
         {"smoothing": -1}, {"terrain": "moon"}, {"scale": 0.0}, {"threshold": 5}, {"threshold": 0}],
    )  # fmt: skip
    def test_invalid_settings_are_rejected(self, changes):
        with pytest.raises(SettingsError):
            small(**changes)


def test_subdivided_boxes_have_finer_faces_and_only_new_vertices_are_displaced():
    sampled, _ = build({"boxes": 3}, (0.0, 0.0, 5.0))
    _, flat = build({"boxes": 3, "subdivided_boxes": 1, "roughness": 0.0}, (0.0, 0.0, 5.0))
    _, rough = build({"boxes": 3, "subdivided_boxes": 1, "roughness": 0.5}, (0.0, 0.0, 5.0))
    flat, rough = (weld(list(update.meshes.values())) for update in (flat, rough))
    assert np.array_equal(flat.triangles.shape, rough.triangles.shape)
    distances = np.linalg.norm(flat.vertices - rough.vertices, axis=1)
    assert distances.max() <= 0.5 + 1e-9 and (distances == 0.0).mean() > 0.3 and (distances > 0.0).mean() > 0.1
    lengths = np.linalg.norm(np.diff(flat.vertices[directed_edges(flat.triangles)], axis=1)[:, 0], axis=1)
    assert lengths.min() < 1.5 and len(sampled.boxes.grids) == 3


def test_ground_next_to_the_viewer_is_subdivided_in_large_boxes():
    """Boxes are so large that whole blocks lie in the subdivided one."""
    source = ClipboxSettings(terrain="formula", formula="-z", resolution=128, boxes=2, subdivided_boxes=1)
    mesh = weld(list(run_to_end(TerrainEngine(source).move(np.zeros(3))).meshes.values()))
    ends = mesh.vertices[open_edges(mesh.triangles)]
    assert (np.abs(ends).max(axis=2) == 128.0).all()


class TestQuickMoves:
    """Boxes that a fast viewer leaves are not shown."""

    @pytest.mark.parametrize(("travel", "left_out"), [(0.0, 0), (15.9, 0), (16.1, 1), (33.0, 2), (1e9, 2)])
    def test_boxes_that_the_viewer_leaves_are_left_out(self, travel, left_out):
        engine = TerrainEngine(small())
        update = run_to_end(engine.move_quickly(np.array([1.0, 2.0, 3.0]), travel))
        assert update.left_out == left_out and min(level for level, _ in update.meshes) == left_out
        assert engine.is_settled_at(np.array([1.0, 2.0, 3.0])) == (left_out == 0)
        check_closed(engine, list(update.meshes.values()))

    @pytest.mark.parametrize("is_smooth", [True, False])
    def test_they_come_back_as_if_they_had_never_been_left_out(self, is_smooth):
        variant = {"smooth_moves": is_smooth}
        engine, first = build(variant, (0.0, 0.0, 5.0))
        shown = dict(first.meshes)
        for position, travel in (((9.0, 0.0, 5.0), 20.0), ((30.0, 4.0, 5.0), 40.0), ((41.0, 4.0, 5.0), 20.0), ((41.0, 4.0, 5.0), 0.0)):
            update = run_to_end(engine.move_quickly(np.array(position), travel))
            shown = {key: mesh for key, mesh in shown.items() if key not in update.removed} | update.meshes
            check_closed(engine, list(shown.values()))
        _, fresh = build(variant, (41.0, 4.0, 5.0))
        assert set(shown) == set(fresh.meshes)
        assert all(shown[key].vertices.tobytes() == mesh.vertices.tobytes() for key, mesh in fresh.meshes.items())

    def test_subdivided_boxes_are_never_left_out(self):
        assert run_to_end(TerrainEngine(small(subdivided_boxes=1)).move_quickly(np.zeros(3), 1e9)).left_out == 0
