"""Nested boxes: closed across levels, the same wherever the viewer came from, and only what is new is worked out."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from closed import directed_edges, open_edges, uses_of_directed_edges
from farfield.addon.core.clipbox import terrains
from farfield.addon.core.clipbox.grids import Grid
from farfield.addon.core.clipbox.layout import blocks_of, layout_about
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrain import BLOCK, Terrain, welded
from farfield.addon.core.clipbox.volumes import Volume
from farfield.addon.core.errors import GeometryError, SettingsError, Stopped
from farfield.addon.core.progress import finish

KINDS = [
    {"terrain": "cascades"},
    {"terrain": "spheres"},
    {"terrain": "islands", "surface": "blocky"},
    {"terrain": "sine", "surface": "blocky", "smoothing": 3, "threshold": 3},
    {"terrain": "cascades", "smoothing": 2},
    {"terrain": "cascades", "subdivided": 1, "threshold": 4},
    {"terrain": "spheres", "subdivided": 2, "surface": "blocky", "smoothing": 1},
]


def small(**given):
    return ClipboxSettings(**({"boxes": 3, "resolution": 32, "threshold": 1} | given))


def built(kind, place):
    engine = Terrain(small(**kind))
    return engine, finish(engine.move(np.array(place, np.float64)))


def flight(seed, steps):
    """Places of a viewer who walks, runs and jumps."""
    random, place = np.random.default_rng(seed), np.array([3.0, -5.0, 12.0])
    for _ in range(steps):
        place = place + random.normal(size=3) * random.choice([0.7, 3.0, 25.0]) * [1.0, 1.0, 0.3]
        place[2] = np.clip(place[2], -40.0, 60.0)
        yield place


def check_closed(engine, meshes):
    """Each edge has two faces, but for those on the border of the outermost box, which have one."""
    made = welded(meshes)
    assert (uses_of_directed_edges(made.triangles) == 1).all()
    shown = engine.boxes.layout.shown[-1]
    low, high = (each * engine.boxes.volume(engine.boxes.coarsest).voxel for each in (shown.low, shown.high))
    ends = made.vertices[open_edges(made.triangles)]
    assert (np.isclose(ends, low) | np.isclose(ends, high)).any(axis=2).all()


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_a_flight_leaves_no_crack_and_equals_builds_from_scratch(kind):
    engine, shown = Terrain(small(**kind)), {}
    for place in flight(7, 12):
        update = finish(engine.move(place))
        shown = {key: mesh for key, mesh in shown.items() if key not in update.gone and not update.whole} | update.meshes
        _, fresh = built(kind, place)
        assert set(shown) == set(fresh.meshes)
        for key, mesh in fresh.meshes.items():
            for name in ("corners", "rings", "vertices", "normals", "triangles"):
                assert getattr(mesh, name).tobytes() == getattr(shown[key], name).tobytes(), (key, name)
        check_closed(engine, list(shown.values()))


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_the_same_vertex_lies_at_the_same_place_in_every_block(kind):
    _, update = built(kind, (1.0, 2.0, 3.0))
    places = {}
    for mesh in update.meshes.values():
        for corner, ring, vertex, normal in zip(mesh.corners.tolist(), mesh.rings.tolist(), mesh.vertices, mesh.normals, strict=True):
            known = places.setdefault((*corner, ring), (vertex, normal))
            assert np.array_equal(known[0], vertex)
            if not kind.get("subdivided"):
                assert np.array_equal(known[1], normal)


def test_far_from_the_origin_all_is_as_near_it():
    formula = "9*sin(x*pi/512) + 7*sin(y*pi/256) - z"
    near, far = (built({"terrain": "formula", "formula": formula}, (at, 0.0, 5.0))[1] for at in (0.0, 1024.0 * 2**20))
    near, far = (welded(list(update.meshes.values())) for update in (near, far))
    assert np.array_equal(near.triangles, far.triangles)
    assert np.allclose(near.vertices, far.vertices - [1024.0 * 2**20, 0.0, 0.0], atol=2e-3)


def test_what_does_not_reach_the_surface_is_left_out():
    for formula in ("1", "-1", "0/0"):
        engine, update = built({"terrain": "formula", "formula": formula}, (0.0, 0.0, 0.0))
        assert not update.meshes and not update.gone
        with pytest.raises(GeometryError, match="no surface"):
            welded(list(engine.all_meshes()))


def test_a_surface_has_its_true_place_in_every_level():
    _, update = built({"terrain": "formula", "formula": "0.37*x - 0.2*y + 3.1 - z"}, (0.0, 0.0, 0.0))
    made = welded(list(update.meshes.values()))
    distance = np.abs(made.vertices @ [0.37, -0.2, -1.0] + 3.1)
    inner = np.abs(made.vertices).max(axis=1) < 64.0  # beyond the outermost box nothing is known
    assert distance[inner].max() < 0.2 and np.median(distance) < 1e-3  # where levels meet, points between voxels of two sizes are aslant
    assert np.allclose(made.normals[inner], np.array([-0.37, 0.2, 1.0]) / np.linalg.norm([0.37, 0.2, 1.0]), atol=0.35)


@pytest.mark.parametrize("threshold", [1, 2, 3, 4])
def test_levels_grow_by_two_and_hide_nothing_by_half(threshold):
    layout = layout_about(np.array([1e7 + 0.3, -17.2, 4.0]), small(voxel=0.5, resolution=33, boxes=5, threshold=threshold))
    for level, (inner, outer) in enumerate(pairwise(layout.shown)):
        assert (inner.low % 4 == 0).all() and (inner.high % 4 == 0).all()
        assert (inner.high - inner.low >= 33 - 6).all()
        hole = layout.hole(level + 1)
        assert ((hole.low - outer.low >= 3) & (outer.high - hole.high >= 3)).all()
        middle = (inner.low + inner.high) / 2 * 0.5 * 2**level
        assert (np.abs(middle - [1e7 + 0.3, -17.2, 4.0]) <= (3.5 + threshold / 2) * 0.5 * 2**level).all()


def test_blocks_cover_what_is_shown():
    layout = layout_about(np.array([5.0, -9.0, 33.0]), small(resolution=64))
    for level in range(3):
        blocks = set(blocks_of(layout, level, BLOCK))
        shown, hole = layout.shown[level], layout.hole(level)
        random = np.random.default_rng(level).integers(shown.low, shown.high, (500, 3))
        for voxel in random if hole is None else random[~hole.contains(random)]:
            assert tuple((voxel // BLOCK).tolist()) in blocks


class TestVolume:
    """Voxels that wrap around."""

    @staticmethod
    def numbers(grid: Grid):
        x, y, z = (np.arange(low, low + count) for low, count in zip(grid.origin, grid.shape, strict=True))
        return (x[:, None, None] * 10007 + y[:, None] * 101 + z).astype(np.int64)

    @settings(max_examples=40)
    @given(st.lists(st.tuples(*[st.integers(-20, 20)] * 3), min_size=1, max_size=6))
    def test_it_holds_what_it_should_and_computes_only_what_is_new(self, places):
        volume, seen, last = Volume(8, 1.0, self.numbers), 0, None
        for place in places:
            finish(volume.move(np.array(place)))
            window = volume.window(np.array(place), np.array(place) + 8)
            assert np.array_equal(window, self.numbers(Grid(place, (8, 8, 8), 1.0)))
            kept = 0 if last is None else int(np.prod(np.maximum(8 - np.abs(np.subtract(place, last)), 0)))
            seen += 512 - kept
            last = place
            assert volume.computed == seen

    def test_what_fails_has_not_moved(self):
        def fails_beyond(grid):
            if max(grid.origin) > 3:
                raise GeometryError("too far")
            return self.numbers(grid)

        volume = Volume(8, 1.0, fails_beyond)
        finish(volume.move(np.array([0, 0, 0])))
        with pytest.raises(GeometryError):
            finish(volume.move(np.array([0, 5, 0])))
        assert np.array_equal(volume.window(np.zeros(3, int), np.full(3, 8)), self.numbers(Grid((0, 0, 0), (8, 8, 8), 1.0)))


class TestMoves:
    """What moves tell, and what stops them."""

    def test_small_steps_keep_most_voxels(self):
        engine = Terrain(small(terrain="sine"))
        for step in range(30):
            finish(engine.move(np.array([0.7 * step, 0.4 * step, 5.0])))
        figures = engine.figures()
        assert all(box["reused_share"] >= 0.9 for box in figures if box["reused_share"] is not None)
        assert figures[0]["computed"] > figures[-1]["computed"]

    def test_a_place_where_it_is_already_changes_nothing(self):
        engine, _ = built({}, (0.0, 0.0, 9.0))
        update = finish(engine.move(np.array([0.2, 0.1, 9.3])))
        assert not update.meshes and not update.gone and not update.whole
        assert engine.lies_about(np.array([0.4, 0.0, 9.9])) and not engine.lies_about(np.array([1.4, 0.0, 9.0]))

    def test_stopped_half_way_it_goes_on_later(self):
        engine, first = built({}, (0.0, 0.0, 9.0))
        for steps in range(1, 6):
            going = engine.move(np.array([40.0 + steps, 3.0, 9.0]))
            for _ in range(steps):
                next(going)
            going.close()
        update = finish(engine.move(np.array([40.0, 3.0, 9.0])))
        shown = {key: mesh for key, mesh in first.meshes.items() if key not in update.gone} | update.meshes
        assert set(shown) == set(built({}, (40.0, 3.0, 9.0))[1].meshes)
        check_closed(engine, list(shown.values()))

    def test_what_was_forgotten_is_shown_again_from_the_same_voxels(self):
        engine, first = built({}, (0.0, 0.0, 9.0))
        computed = engine.figures()[0]["computed"]
        engine.forget()
        update = finish(engine.move(np.array([0.0, 0.0, 9.0])))
        assert update.whole and set(update.meshes) == set(first.meshes) and engine.figures()[0]["computed"] == computed

    def test_a_slow_terrain_can_be_stopped_between_slices(self):
        terrains.register("slow", "Counts what it is asked", lambda _settings: lambda grid: asked.append(grid) or 1.0)
        asked, limit = [], 3

        def stop(_):
            if len(asked) >= limit:
                raise Stopped("Enough.")

        try:
            with pytest.raises(Stopped):
                finish(Terrain(ClipboxSettings(terrain="slow", resolution=128, boxes=2)).move(np.zeros(3)), stop)
        finally:
            terrains.NAMES.pop("slow")
        assert len(asked) == limit

    @pytest.mark.parametrize("place", [(np.nan, 0.0, 0.0), (0.0, np.inf, 0.0), (1e300, 0.0, 0.0)])
    def test_nowhere_is_refused(self, place):
        with pytest.raises(GeometryError, match="farthest"):
            finish(Terrain(small()).move(np.array(place)))

    @pytest.mark.parametrize(
        "given",
        [{"resolution": 8}, {"resolution": 257}, {"voxel": 0.0}, {"voxel": float("nan")}, {"boxes": 0}, {"boxes": 11}, {"subdivided": 3},
         {"smoothing": -1}, {"terrain": "moon"}, {"scale": 0.0}, {"threshold": 5}, {"threshold": 0}],
    )  # fmt: skip
    def test_settings_of_nonsense_are_refused(self, given):
        with pytest.raises(SettingsError):
            small(**given)


def test_subdivided_boxes_have_finer_faces_and_only_move_new_vertices():
    plain, _ = built({"boxes": 3}, (0.0, 0.0, 5.0))
    _, flat = built({"boxes": 3, "subdivided": 1, "roughness": 0.0}, (0.0, 0.0, 5.0))
    _, rough = built({"boxes": 3, "subdivided": 1, "roughness": 0.5}, (0.0, 0.0, 5.0))
    flat, rough = (welded(list(update.meshes.values())) for update in (flat, rough))
    assert np.array_equal(flat.triangles.shape, rough.triangles.shape)
    moved = np.linalg.norm(flat.vertices - rough.vertices, axis=1)
    assert moved.max() <= 0.5 + 1e-9 and (moved == 0.0).mean() > 0.3 and (moved > 0.0).mean() > 0.1
    lengths = np.linalg.norm(np.diff(flat.vertices[directed_edges(flat.triangles)], axis=1)[:, 0], axis=1)
    assert lengths.min() < 1.5 and len(plain.boxes.volumes) == 3
