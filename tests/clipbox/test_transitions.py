"""Transitions between boxes: what only a finer box resolves ends before its border, and densities near it are those of both."""

import numpy as np
import pytest

from clipbox_borders import count_walls
from farfield.addon.core.clipbox.clearings import find_clearing
from farfield.addon.core.clipbox.engine import TerrainEngine, weld
from farfield.addon.core.clipbox.morphing import morph_vertices
from farfield.addon.core.clipbox.nested import NestedBoxes
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.generators import Sampler, build_sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.clipbox.toroidal_grid import ToroidalGrid
from farfield.addon.core.jobs.progress import run_to_end

TUNNEL_RADIUS = 4.0


def tunnel_in_fine_boxes(grid: Grid) -> np.ndarray:
    """Solid ground with a tunnel along x, which only boxes with voxels of 1 show."""
    _, y, z = grid.coordinates()
    return np.where(grid.voxel_size < 1.5, np.hypot(y, z) - TUNNEL_RADIUS, 50.0)


def settings(**changes) -> ClipboxSettings:
    return ClipboxSettings(**({"terrain": "cascades", "resolution": 64, "boxes": 3} | changes))


def moved_boxes(sampler: Sampler, **changes) -> NestedBoxes:
    boxes = NestedBoxes(sampler, settings(**changes))
    run_to_end(boxes.move(np.zeros(3)))
    return boxes


@pytest.mark.parametrize("is_smooth", [True, False])
def test_a_tunnel_narrows_and_closes_before_the_border(is_smooth):
    boxes = moved_boxes(Sampler("tunnel", tunnel_in_fine_boxes), smooth_moves=is_smooth)
    visible = boxes.layout.visible[0]
    air = (boxes.window(0, visible.low, visible.high) <= 0).sum(axis=(1, 2))
    half = air[len(air) // 2 :]
    assert half[0] == pytest.approx(np.pi * TUNNEL_RADIUS**2, rel=0.1) and half[-1] == 0
    assert (np.diff(half) <= 0).all() and len(np.unique(half)) >= 4, "a rounded end, not a wall"


@pytest.mark.parametrize(
    ("terrain", "is_smooth"),
    [("tunnel", True), ("tunnel", False), ("cascades", True)]
    + [pytest.param(*case, marks=pytest.mark.slow) for case in (("spheres", True), ("cascades", False), ("spheres", False))],
)
def test_no_box_ends_in_a_wall(terrain, is_smooth, monkeypatch):
    source = settings(terrain="spheres" if terrain == "spheres" else "cascades", boxes=4, resolution=48, smooth_moves=is_smooth)
    sampler = Sampler("tunnel", tunnel_in_fine_boxes) if terrain == "tunnel" else build_sampler(source)
    viewers = [np.zeros(3) if terrain == "tunnel" else find_clearing(sampler, np.array([180.0, 40.0, -40.0]), 1.0)]
    assert sum(box["walls"] for box in count_walls(sampler, source, viewers)) == 0
    monkeypatch.setattr(NestedBoxes, "transition", lambda *_: None)
    assert sum(box["walls"] for box in count_walls(sampler, source, viewers)) > 10


def test_densities_of_voxels_are_those_of_windows():
    boxes = moved_boxes(build_sampler(settings()))
    for level in range(2):
        visible = boxes.layout.visible[level]
        low, high = visible.low, visible.low + [40, 30, 64]
        corners = np.stack(np.meshgrid(*(np.arange(a + 1, b, 7) for a, b in zip(low, high, strict=True)), indexing="ij"), axis=-1)
        corners = corners.reshape(-1, 3)
        window = boxes.window(level, low, high)
        x, y, z = (corners - low - 1).T
        outside_hole = (
            np.ones(len(corners), bool) if level == 0 else ~boxes.hole(level).contains(corners) & ~boxes.hole(level).contains(corners - 1)
        )
        octants = boxes.gather_octants(level, corners).values[0]
        assert octants[outside_hole].tobytes() == window[x, y, z][outside_hole].tobytes()


def test_a_plane_stays_a_plane():
    boxes = moved_boxes(Sampler("slope", lambda grid: 0.5 * grid.coordinates()[0] + 0.25 * grid.coordinates()[1] - grid.coordinates()[2]))
    visible = boxes.layout.visible[0]
    window, grid = (
        boxes.window(0, visible.low, visible.high),
        Grid(tuple(visible.low.tolist()), tuple((visible.high - visible.low).tolist()), 1.0),
    )
    exact = 0.5 * grid.coordinates()[0] + 0.25 * grid.coordinates()[1] - grid.coordinates()[2]
    near = np.abs(exact) < 1.5
    assert np.abs(window.astype(np.float32) - exact)[near].max() < 2e-3


DETAIL_HEIGHT = 2.0


def plain_with_detail(grid: Grid) -> np.ndarray:
    """Level ground, which boxes with voxels of 1 show higher."""
    return (DETAIL_HEIGHT if grid.voxel_size < 1.5 else 0.0) - grid.coordinates()[2]


def shown_heights(place: float, viewers: np.ndarray, **changes) -> np.ndarray:
    """Return how high the ground is shown at x = `place` around each of the viewers at x = `viewers` (N,), as sampled densities say."""
    boxes, heights = NestedBoxes(Sampler("plain", plain_with_detail), settings(boxes=2, **changes)), []
    for viewer in viewers:
        run_to_end(boxes.move(np.array([viewer, 0.0, 0.0])))
        level = 0 if boxes.layout.visible[0].contains(np.array([place, 0, 0])) else 1
        low = np.array([place // 2**level, 0, -8])
        column = boxes.window(level, low, low + [1, 1, 16])[0, 0].astype(np.float64)
        last = int(np.flatnonzero(column > 0)[-1])
        heights.append((low[2] + last + 0.5 + column[last] / (column[last] - column[last + 1])) * 2**level)
    return np.array(heights)


@pytest.mark.parametrize("threshold", [1, 4])
def test_ground_changes_little_by_little_while_the_viewer_comes_nearer(threshold):
    viewers = np.arange(0.0, 40.0, 0.25)
    smooth, stepped = (shown_heights(40, viewers, threshold=threshold, smooth_moves=is_smooth) for is_smooth in (True, False))
    for heights in (smooth, stepped):
        assert heights[0] == pytest.approx(0.0, abs=1e-2) and heights[-1] == pytest.approx(DETAIL_HEIGHT, abs=1e-2)
    assert (np.diff(smooth) >= -1e-2).all() and np.diff(smooth).max() < 0.06 * DETAIL_HEIGHT
    assert np.diff(stepped).max() > 0.9 * DETAIL_HEIGHT


@pytest.mark.parametrize(("resolution", "threshold"), [(32, 4), (33, 1), (64, 1), (64, 8)])
def test_a_transition_ends_before_the_border_wherever_the_viewer_is(resolution, threshold):
    source = settings(boxes=2, resolution=resolution, threshold=threshold, smooth_moves=True)
    boxes = NestedBoxes(Sampler("plain", plain_with_detail), source)
    for viewer in np.random.default_rng(1).uniform(-20.0, 20.0, (10, 3)) * [1.0, 1.0, 0.1]:
        run_to_end(boxes.move(viewer))
        low, high = boxes.layout.visible[0].low, boxes.layout.visible[0].high
        window = boxes.window(0, low, high).astype(np.float64)
        heights = np.broadcast_to((np.arange(low[2], high[2]) + 0.5)[None, None], window.shape)
        coarse, fine = (np.isclose(window, height - heights, atol=1e-2) for height in (0.0, DETAIL_HEIGHT))
        inner = np.zeros(window.shape, bool)
        inner[2:-2, 2:-2, 2:-2] = True
        assert coarse[~inner].all(), "the two outermost voxels on each side"
        assert fine[tuple(slice(side // 2 - 3, side // 2 + 3) for side in window.shape)].all()


def test_steep_densities_are_as_accurate_as_others():
    formula = "40*(0.37*x - 0.2*y + 3.1 - z)"
    mesh = weld(list(run_to_end(TerrainEngine(settings(terrain="formula", formula=formula)).move(np.zeros(3))).meshes.values()))
    distance = np.abs(mesh.vertices @ [0.37, -0.2, -1.0] + 3.1)
    assert distance[np.abs(mesh.vertices).max(axis=1) < 100.0].max() < 0.25 and np.median(distance) < 5e-3


def test_windows_without_a_surface_are_known_to_have_none(monkeypatch):
    engine, other = TerrainEngine(settings()), TerrainEngine(settings())
    monkeypatch.setattr(other.boxes, "has_one_sign", lambda *_: False)
    for x in (0.0, 0.5, 1.0, 9.0):
        meshes, expected = (run_to_end(moved.move(np.array([x, 0.0, 0.0]))).meshes for moved in (engine, other))
        assert set(meshes) == set(expected) and all(
            mesh.vertices.tobytes() == expected[key].vertices.tobytes() for key, mesh in meshes.items()
        )


def test_vertices_at_the_border_are_on_the_surface_of_the_coarser_box():
    """Where the coarser box takes the place of the finer one, its vertices are in the planes of those at the same corners already."""
    source = settings(terrain="formula", formula="6*sin(x/9)*sin(y/7) - z", boxes=2)
    before, after = (run_to_end(TerrainEngine(source).move(np.array([x, 0.0, 0.0]))).meshes for x in (0.3, 1.5))
    fine, coarse = (
        {
            tuple(corner): (vertex, normal)
            for mesh in meshes
            for corner, vertex, normal in zip(mesh.corners.tolist(), mesh.vertices, mesh.normals, strict=True)
        }
        for meshes in (
            [mesh for (level, _), mesh in before.items() if level == 0],
            [mesh for (level, _), mesh in after.items() if level == 1],
        )
    )
    left = min(corner[0] for corner in fine)
    border = [corner for corner in coarse if corner in fine and left <= corner[0] < left + 2 and abs(corner[1]) < 20]
    assert len(border) > 15
    for corner in border:
        (fine_vertex, fine_normal), (coarse_vertex, coarse_normal) = fine[corner], coarse[corner]
        assert abs((fine_vertex - coarse_vertex) @ coarse_normal) < 1e-5 and np.allclose(fine_normal, coarse_normal, atol=1e-5)


def test_a_vertex_without_a_coarser_one_stays():
    grid = ToroidalGrid(8, 2.0, lambda grid: np.ones(grid.shape, np.float16))
    run_to_end(grid.move(np.full(3, -4)))
    offsets, normals = np.full((1, 3), 0.25, np.float32), np.array([[0.0, 0.0, 1.0]], np.float32)
    moved = morph_vertices(np.array([[1, 2, 1]]), np.ones(1, np.float32), grid, offsets, normals)
    assert np.array_equal(moved[0], offsets) and np.array_equal(moved[1], normals)


def test_vertices_go_to_the_plane_of_the_coarser_ones_around_them():
    """The coarser voxels are solid below z = 1, in units of the finer ones, so that their vertices lie there."""
    grid = ToroidalGrid(8, 2.0, lambda grid: np.broadcast_to(1.0 - grid.coordinates()[2], grid.shape).astype(np.float16))
    run_to_end(grid.move(np.full(3, -4)))
    corners, offsets = np.array([[0, 0, 0], [1, 2, 0], [1, 1, 1]]), np.full((3, 3), 0.25, np.float32)
    for weight in (0.5, 1.0):
        weights = np.full(3, weight, np.float32)
        moved, normals = morph_vertices(corners, weights, grid, offsets, np.tile(np.float32([0.0, 0.0, 1.0]), (3, 1)))
        targets = np.array([[0.25, 0.25, 1.0], [0.25, 0.25, 1.0], [0.25, 0.25, 0.0]])
        assert np.allclose(moved, offsets + weight * (targets - offsets), atol=1e-6) and np.allclose(normals, [0.0, 0.0, 1.0])


@pytest.mark.parametrize("resolution", [32, 64])
def test_no_triangle_is_turned_over(resolution):
    source = settings(terrain="hills", boxes=4, resolution=resolution)
    mesh = weld(list(run_to_end(TerrainEngine(source).move(np.array([300.0, -150.0, 40.0]))).meshes.values()))
    corners = mesh.vertices[mesh.triangles]
    directions = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((directions * mesh.normals[mesh.triangles].mean(axis=1)).sum(axis=1) > -1e-9).all()
