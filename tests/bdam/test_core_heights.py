"""Heights at any position are those of the triangles: exact at samples, interpolated between them, unknown outside and in holes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.bdam.building.terrain_build import build_terrain
from farfield.addon.core.bdam.ground.heights import HeightQuery
from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.bdam.store.terrain_store import GEOMETRY_FILE, TerrainStore
from farfield.addon.core.bdam.view.cut_meshes import CutMesh
from farfield.addon.core.bdam.view.extraction import extract_uniform_cut
from farfield.addon.core.geometry.placements import GeographicFrame
from farfield.addon.core.geometry.triangle_search import TriangleSearch
from farfield.addon.core.jobs.progress import run_to_end
from small_terrain_stores import ArrayField, build_cut_mesh, build_store, hills

pytest.importorskip("zstandard")
ROWS, COLUMNS, STEP = 99, 71, 0.01
HOLE = slice(40, 53), slice(20, 37)  # Rows and columns of samples.


class GeographicField(ArrayField):
    """Heights in a grid of degrees far in the north, where meridians converge."""

    crs = "degrees"

    @property
    def frame(self) -> GeographicFrame:
        return GeographicFrame((9.0, 69.0), (3e-4, 1e-4), (9.01, 69.005))


class WideField(GeographicField):
    """Heights in a grid of many degrees far in the north."""

    @property
    def frame(self) -> GeographicFrame:
        return GeographicFrame((7.0, 68.0), (0.03, 0.01), (9.0, 68.6))


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    """Stores of the same hills: "whole", with a "hole", and "geographic"."""
    folder = tmp_path_factory.mktemp("stores")
    heights = hills(ROWS, COLUMNS)
    with_hole = heights.copy()
    with_hole[HOLE] = np.nan
    build_store(folder / "whole", heights, height_step=STEP)
    build_store(folder / "hole", with_hole, height_step=STEP)
    build_settings = BdamSettings(patch_size="16", height_step=STEP, executor="serial")
    run_to_end(build_terrain(GeographicField(heights), [], folder / "geographic", build_settings))
    opened = {name: TerrainStore(folder / name) for name in ("whole", "hole", "geographic")}
    yield opened
    for store in opened.values():
        store.close()


def stored(heights: np.ndarray) -> np.ndarray:
    """Heights as a store has them: single precision, as fields are read, then whole steps."""
    return np.rint(heights.astype(np.float32).astype(np.float64) / STEP) * STEP


def corners_at(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The samples (N, 3, 2) around points in grid coordinates. Diagonals meet at samples with an even sum of coordinates."""
    corners = []
    for px, py in zip(x, y, strict=True):
        cx, cy = min(int(px), COLUMNS - 2), min(int(py), ROWS - 2)
        fx, fy = px - cx, py - cy
        if (cx + cy) % 2 == 0:
            offsets = [(0, 0), (1, 0), (1, 1)] if fx > fy else [(0, 0), (1, 1), (0, 1)]
        else:
            offsets = [(0, 0), (1, 0), (0, 1)] if fx + fy < 1.0 else [(1, 0), (1, 1), (0, 1)]
        corners.append([(cx + dx, cy + dy) for dx, dy in offsets])
    return np.array(corners)


def interpolate(store: TerrainStore, heights: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights and normals of planes through three samples each, solved directly."""
    grid = corners_at(*store.frame.to_grid(*points.T))
    x, y = store.frame.to_local(grid[..., 0], grid[..., 1])
    z = heights[grid[..., 1], grid[..., 0]]
    planes = np.linalg.solve(np.stack([x, y, np.ones_like(x)], axis=-1), z[..., None])[..., 0]
    normals = np.stack([-planes[:, 0], -planes[:, 1], np.ones(len(planes))], axis=1)
    return (planes[:, :2] * points).sum(axis=1) + planes[:, 2], normals / np.linalg.norm(normals, axis=1, keepdims=True)


def random_points(store: TerrainStore, seed: int, count: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    x, y = store.frame.to_local(random.uniform(0.0, COLUMNS - 1.0, count), random.uniform(0.0, ROWS - 1.0, count))
    return np.stack([x, y], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["whole", "geographic"])
@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 60))
def test_heights_are_interpolated_in_the_triangles_of_the_samples(stores, name, seed, count):
    points = random_points(stores[name], seed, count)
    heights, normals = HeightQuery(stores[name]).find(points)
    expected, expected_normals = interpolate(stores[name], stored(hills(ROWS, COLUMNS)), points) if count else (heights, normals)
    assert np.allclose(heights, expected, rtol=0.0, atol=1e-7) and np.allclose(normals, expected_normals, rtol=0.0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["whole", "hole", "geographic"])
def test_heights_at_samples_are_the_samples(stores, name):
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    points = np.stack(stores[name].frame.to_local(x.ravel(), y.ravel()), axis=1)
    heights = HeightQuery(stores[name]).find(points)[0].reshape(ROWS, COLUMNS)
    known = np.ones((ROWS, COLUMNS), bool)
    if name == "hole":
        known[HOLE] = False
    assert np.allclose(heights[known], stored(hills(ROWS, COLUMNS))[known], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["whole", "geographic"])
def test_heights_are_unknown_outside(stores, name):
    margin = 1e-3
    x, y = np.meshgrid(
        [-1e9, -1.0, -margin, 0.0, COLUMNS - 1.0, COLUMNS - 1.0 + margin, 1e9], [-1e5, -margin, ROWS / 2, ROWS - 1.0 + margin]
    )
    is_inside = (x >= 0.0) & (x <= COLUMNS - 1.0) & (y >= 0.0) & (y <= ROWS - 1.0)
    frame = stores[name].frame
    x, y = (x, y) if name == "whole" else (np.clip(x, -100.0, 1000.0), np.clip(y, -100.0, 1000.0))
    heights, normals = HeightQuery(stores[name]).find(np.stack(frame.to_local(x.ravel(), y.ravel()), axis=1))
    assert np.array_equal(np.isfinite(heights), is_inside.ravel()) and np.array_equal(np.isfinite(normals).all(axis=1), is_inside.ravel())


def test_points_that_are_not_finite_have_no_height(stores):
    heights, normals = HeightQuery(stores["whole"]).find(np.array([[np.nan, 0.0], [0.0, np.inf], [-np.inf, np.nan], [0.0, 0.0]]))
    assert np.isfinite(heights).tolist() == [False, False, False, True] and np.isnan(normals[:3]).all()
    assert HeightQuery(stores["whole"]).find(np.zeros((0, 2)))[0].shape == (0,)


def test_triangles_without_a_known_sample_are_holes(stores):
    store = stores["hole"]
    points = random_points(store, 7, 4000)
    heights = HeightQuery(store).find(points)[0]
    known = np.ones((ROWS, COLUMNS), bool)
    known[HOLE] = False
    corners = corners_at(*store.frame.to_grid(*points.T))
    is_known = known[corners[..., 1], corners[..., 0]]
    assert np.array_equal(np.isnan(heights), ~is_known.any(axis=1)) and np.isnan(heights).sum() > 50
    complete = is_known.all(axis=1)
    assert np.allclose(heights[complete], interpolate(store, stored(hills(ROWS, COLUMNS)), points[complete])[0], rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("name", ["whole", "hole", "geographic"])
@pytest.mark.parametrize("max_error", [pytest.param(0.5, marks=pytest.mark.exhaustive), 5.0, 50.0])
def test_heights_of_a_cut_are_those_of_its_mesh(stores, name, max_error):
    store = stores[name]
    cut = extract_uniform_cut(store, max_error)
    mesh = build_cut_mesh(store, cut)
    points = random_points(store, 3, 200)
    heights, normals = HeightQuery(store, cut).find(points)
    corners = mesh.positions[mesh.triangles]
    for point, height, normal in zip(points, heights, normals, strict=True):
        edges = np.roll(corners[..., :2], -1, axis=1) - corners[..., :2]
        offsets = point - corners[..., :2]
        inside = np.flatnonzero((edges[..., 0] * offsets[..., 1] - edges[..., 1] * offsets[..., 0] >= 0.0).all(axis=1))
        if not len(inside):
            assert np.isnan(height)
            continue
        a, b, c = corners[inside[0]]
        plane = np.cross(b - a, c - a)
        assert height == pytest.approx(a[2] - (plane[:2] @ (point - a[:2])) / plane[2], abs=1e-2 if name == "geographic" else 1e-6)
        assert name == "geographic" or np.allclose(normal, plane / np.linalg.norm(plane), atol=1e-6)


@settings(max_examples=10)
@given(max_error=st.floats(0.02, 60.0))
def test_a_cut_is_within_its_error_of_the_samples(stores, max_error):
    store = stores["whole"]
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    points = np.stack(store.frame.to_local(x.ravel(), y.ravel()), axis=1)
    heights = HeightQuery(store, extract_uniform_cut(store, max_error)).find(points)[0].reshape(ROWS, COLUMNS)
    assert np.abs(heights - stored(hills(ROWS, COLUMNS))).max() <= max_error + 1e-6


def measure_in_meters(mesh: CutMesh, positions: np.ndarray) -> np.ndarray:
    """The vertical distances (N,) of positions (N, 3) in the local frame to a mesh, infinite outside of it."""
    distances = np.full(len(positions), np.inf)
    for corners in mesh.positions[mesh.triangles]:
        low, high = corners.min(axis=0)[:2], corners.max(axis=0)[:2]
        candidates = np.flatnonzero(((positions[:, :2] >= low) & (positions[:, :2] <= high)).all(axis=1))
        edges = corners[1:] - corners[0]
        weights = (positions[candidates, :2] - corners[0, :2]) @ np.linalg.inv(edges[:, :2])
        is_inside = (weights.min(axis=1) >= -1e-9) & (weights.sum(axis=1) <= 1.0 + 1e-9)
        inside, surface = candidates[is_inside], corners[0, 2] + weights[is_inside] @ edges[:, 2]
        distances[inside] = np.minimum(distances[inside], np.abs(surface - positions[inside, 2]))
    return distances


@pytest.mark.slow
def test_cuts_of_a_geographic_grid_are_within_their_errors_in_meters(tmp_path):
    y, x = np.mgrid[0:65, 0:65]
    heights = 30.0 * x + 20.0 * y  # a plane in the grid, so that all errors come from the curvature of its lines
    settings = BdamSettings(patch_size="16", height_step=STEP, executor="serial")
    run_to_end(build_terrain(WideField(heights), [], tmp_path / "store", settings))
    with TerrainStore(tmp_path / "store") as store:
        positions = np.stack([*store.frame.to_local(x, y), stored(heights)], axis=2).reshape(-1, 3)
        assert all((level.errors > 0.0).all() for level in store.levels[:-1])
        for max_error in (0.5, 20.0):
            mesh = build_cut_mesh(store, extract_uniform_cut(store, max_error))
            distances = measure_in_meters(mesh, positions)
            is_inside = np.isfinite(distances)
            assert is_inside.mean() > 0.95, "the borders of the field are curved, so that a few samples are outside of the mesh"
            assert distances[is_inside].max() <= max_error * (1.0 + 1e-6)


@pytest.mark.slow
def test_a_cut_is_within_its_error_where_the_finest_one_is_shown_beside_holes(tmp_path):
    random = np.random.default_rng(7)
    heights = hills(65, 65) + random.normal(0.0, 10.0, (65, 65))
    is_known = random.random((65, 65)) < 0.6
    is_known[20:50, 10:40] = False
    with TerrainStore(build_store(tmp_path / "store", np.where(is_known, heights, np.nan), height_step=STEP)) as store:
        y, x = np.mgrid[0:65, 0:65]
        points = np.stack(store.frame.to_local(x.ravel(), y.ravel()), axis=1)
        finest = HeightQuery(store).find(points)[0]
        assert np.isfinite(finest[is_known.ravel()]).all() and np.isfinite(finest[~is_known.ravel()]).any()
        for max_error in (5.0, 20.0, 50.0):
            coarse = HeightQuery(store, extract_uniform_cut(store, max_error)).find(points)[0]
            assert np.isfinite(coarse[is_known.ravel()]).all()
            assert np.nanmax(np.abs(coarse - finest)) <= max_error + 1e-6


def test_a_small_cache_gives_the_same_heights(stores):
    points = random_points(stores["hole"], 5, 300)
    query = HeightQuery(stores["hole"], max_bytes=10_000)
    first, second = query.find(points), query.find(points)
    expected = HeightQuery(stores["hole"]).find(points)
    for result in (first, second):
        assert all(np.array_equal(found, wanted, equal_nan=True) for found, wanted in zip(result, expected, strict=True))


def test_damaged_patches_are_named_and_the_others_usable(tmp_path):
    folder = build_store(tmp_path / "terrain", hills(ROWS, COLUMNS))
    content = bytearray((folder / GEOMETRY_FILE).read_bytes())
    content[int(0.9 * len(content))] ^= 0x10
    (folder / GEOMETRY_FILE).write_bytes(content)
    with TerrainStore(folder) as store:
        points = random_points(store, 1, 2000)
        query = HeightQuery(store)
        heights, _ = query.find(points)
        assert 0 < np.isnan(heights).sum() < 200 and len(query.damages) == 1 and next(store.verify()) in query.damages[0]


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_triangle_search_finds_the_triangle_that_contains_a_point(seed):
    random = np.random.default_rng(seed)
    positions, triangles = random.uniform(-5.0, 5.0, (40, 2)), random.integers(0, 40, (25, 3))
    edges = positions[triangles[:, 1:]] - positions[triangles[:, :1]]
    is_clockwise = edges[:, 0, 0] * edges[:, 1, 1] < edges[:, 0, 1] * edges[:, 1, 0]
    triangles[is_clockwise] = triangles[is_clockwise][:, ::-1]
    points = random.uniform(-7.0, 7.0, (200, 2))
    found = TriangleSearch(positions, triangles).find(points)
    corners = positions[triangles]
    edges = np.roll(corners, -1, axis=1) - corners
    offsets = points[:, None, None] - corners
    turns = edges[..., 0] * offsets[..., 1] - edges[..., 1] * offsets[..., 0]
    has_area = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) > 1e-9
    is_inside = (turns > 1e-7).all(axis=2) & has_area
    hits = found >= 0
    assert not is_inside[~hits].any() and (turns[hits, found[hits]] > -1e-6).all()
