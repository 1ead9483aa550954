"""Rays hit the first triangle on their way, as if all of them were tested, never pass between two, and never hit holes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.bdam import ray_casting
from farfield.addon.core.bdam.building.terrain_build import build_terrain
from farfield.addon.core.bdam.cut_meshes import PatchCache, build_cut_mesh
from farfield.addon.core.bdam.extraction import extract_uniform_cut
from farfield.addon.core.bdam.fields.placements import GeographicFrame
from farfield.addon.core.bdam.heights import height_at
from farfield.addon.core.bdam.ray_casting import RayCaster, cast_rays
from farfield.addon.core.bdam.settings import BdamSettings
from farfield.addon.core.bdam.store.terrain_store import GEOMETRY_FILE, TerrainStore
from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.jobs.progress import run_to_end
from small_terrain_stores import CELL_SIZE, ArrayField, build_store, hills

pytest.importorskip("zstandard")
ROWS, COLUMNS = 99, 71
HOLE = slice(40, 53), slice(20, 37)  # of samples, rows and columns
NAMES = ["whole", "hole", "geographic"]


class GeographicField(ArrayField):
    """Heights in a grid of degrees far in the north, where meridians converge."""

    crs = "degrees"

    @property
    def frame(self) -> GeographicFrame:
        return GeographicFrame((9.0, 69.0), (3e-4, 1e-4), (9.01, 69.005))


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    """Stores of the same hills: "whole", with a "hole", and "geographic"."""
    folder = tmp_path_factory.mktemp("stores")
    heights = hills(ROWS, COLUMNS)
    with_hole = heights.copy()
    with_hole[HOLE] = np.nan
    build_store(folder / "whole", heights)
    build_store(folder / "hole", with_hole)
    build_settings = BdamSettings(leaf="16", height_step=0.01, executor="serial")
    run_to_end(build_terrain(GeographicField(heights), [], folder / "geographic", build_settings))
    opened = {name: TerrainStore(folder / name) for name in NAMES}
    yield opened
    for store in opened.values():
        store.close()


def corners_of(store: TerrainStore, max_error: float = 0.0, exaggeration: float = 1.0) -> np.ndarray:
    """The triangles (T, 3, 3) of the whole terrain."""
    cut = extract_uniform_cut(store, max_error if max_error else -1.0)
    mesh = build_cut_mesh(PatchCache(store), cut)
    return mesh.positions[mesh.triangles] * [1.0, 1.0, exaggeration]


def moeller_trumbore(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[float, np.ndarray]:
    """The distance along a unit `direction` to the first of all triangles (T, 3, 3), and its normal upwards."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, second)
    determinant = (first * p).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = origin - corners[:, 0]
        u = (offset * p).sum(axis=1) / determinant
        q = np.cross(offset, first)
        v = q @ direction / determinant
        distances = (second * q).sum(axis=1) / determinant
    is_hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distances >= 0.0)
    distances = np.where(is_hit, distances, np.inf)
    nearest = distances.argmin()
    normal = np.cross(first[nearest], second[nearest])
    return distances[nearest], normal / np.linalg.norm(normal)


def random_rays(store: TerrainStore, seed: int, count: int, exaggeration: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Rays from around the terrain and from inside of its box, steep and flat ones."""
    random = np.random.default_rng(seed)
    low, high = store.bounds[:, :3].min(axis=0), store.bounds[:, 3:6].max(axis=0)
    center, half = 0.5 * (low + high), 0.5 * (high - low)
    scale = half * [1.0, 1.0, exaggeration]
    origins = center * [1.0, 1.0, exaggeration] + random.uniform(-1.0, 1.0, (count, 3)) * scale * random.choice([0.9, 3.0], (count, 1))
    targets = center * [1.0, 1.0, exaggeration] + random.uniform(-1.1, 1.1, (count, 3)) * scale
    return origins, targets - origins


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=5)
@given(
    seed=st.integers(0, 2**32 - 1),
    exaggeration=st.sampled_from([1.0, 0.2, 3.0]),
    max_error=st.sampled_from([0.0, 0.5, 10.0]),
)
def test_rays_hit_what_they_hit_first_of_all_triangles(stores, name, seed, exaggeration, max_error):
    store = stores[name]
    corners = corners_of(store, max_error, exaggeration)
    origins, directions = random_rays(store, seed, 60, exaggeration)
    hits = cast_rays(store, origins, directions, max_error=max_error, exaggeration=exaggeration)
    units = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    expected = [moeller_trumbore(corners, origin, unit) for origin, unit in zip(origins, units, strict=True)]
    distances, normals = np.array([distance for distance, _ in expected]), np.array([normal for _, normal in expected])
    assert np.allclose(hits.distances, distances, rtol=1e-9, atol=1e-6)
    is_hit = np.isfinite(distances)
    assert np.allclose(hits.normals[is_hit], normals[is_hit], atol=1e-9) and (hits.normals[is_hit, 2] > 0.0).all()
    assert np.allclose(hits.positions[is_hit], (origins + units * distances[:, None])[is_hit], atol=1e-6)
    missed = hits.positions[~is_hit], hits.normals[~is_hit]
    assert np.isnan(missed).all() and (hits.levels[~is_hit] == -1).all() and (hits.rows[~is_hit] == -1).all()
    for level, row, position in zip(hits.levels[is_hit], hits.rows[is_hit], hits.positions[is_hit], strict=True):
        low, high = store.levels[level].low[row], store.levels[level].high[row]
        assert (position / [1.0, 1.0, exaggeration] >= low - 0.1).all() and (position / [1.0, 1.0, exaggeration] <= high + 0.1).all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_vertical_rays_hit_at_the_height_from_above_and_from_below(stores, name, side):
    store = stores[name]
    random = np.random.default_rng(4)
    low, high = store.bounds[:, :2].min(axis=0) - 50.0, store.bounds[:, 3:5].max(axis=0) + 50.0
    points = random.uniform(low, high, (2000, 2))
    origins = np.concatenate([points, np.full((2000, 1), 900.0 * side)], axis=1)
    hits = cast_rays(store, origins, np.array([[0.0, 0.0, -side]]).repeat(2000, axis=0))
    heights, normals = height_at(store, points)
    assert 100 < np.isnan(heights).sum() < 1500
    assert np.allclose(hits.positions[:, 2], heights, atol=2e-3 if name == "geographic" else 1e-9, equal_nan=True)
    assert name == "geographic" or np.allclose(hits.normals, normals, atol=1e-9, equal_nan=True)
    assert (hits.levels[np.isfinite(heights)] == store.tree.leaf_level).all()


@pytest.mark.parametrize("name", ["whole", "geographic"])
@pytest.mark.parametrize("max_error", [0.0, 2.0])
@settings(max_examples=6)
@given(seed=st.integers(0, 2**32 - 1), distance=st.sampled_from([1.0, 300.0, 1e5]))
def test_rays_through_edges_and_vertices_hit(stores, name, max_error, seed, distance):
    """Positions are rounded, so that a ray passes any side of its edge."""
    store = stores[name]
    random = np.random.default_rng(seed)
    corners = corners_of(store, max_error)
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    is_inner = ((edges[..., :2] > low[:2] + 30.0) & (edges[..., :2] < high[:2] - 30.0)).all(axis=(1, 2))
    edges = edges[is_inner][random.integers(0, is_inner.sum(), 400)]
    weights = random.choice([0.0, 0.5, 1.0, random.uniform()], (400, 1))
    targets = edges[:, 0] * (1.0 - weights) + edges[:, 1] * weights
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    directions = random.normal(size=(400, 3))
    directions[:, 2] = -np.hypot(*directions[:, :2].T) * 1.2 * (np.hypot(*normals[:, :2].T) / normals[:, 2]).max()  # steeper than the hills
    directions[::4] = [0.0, 0.0, -1.0]
    directions[1::4, random.integers(0, 2)] = 0.0
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions *= random.choice([1.0, -1.0], (400, 1))
    hits = cast_rays(store, targets - distance * directions, directions, 2.0 * distance, max_error=max_error)
    assert np.allclose(hits.distances, distance, rtol=0.0, atol=1e-6)


def test_rays_through_all_samples_and_cell_centers_hit(stores):
    """All borders of patches run along them."""
    store = stores["whole"]
    y, x = np.mgrid[0 : ROWS - 0.5 : 0.5, 0 : COLUMNS - 0.5 : 0.5]
    points = np.stack([*store.frame.to_local(x.ravel(), y.ravel()), np.full(x.size, 500.0)], axis=1)
    for max_error in (0.0, 20.0):
        for direction in ([0.0, 0.0, -1.0], [-1e-17, 0.0, -1.0], [0.0, 1e-20, -3.0]):
            hits = cast_rays(store, points, np.broadcast_to(direction, points.shape), max_error=max_error)
            may_leave = ((x.ravel() == 0.0) & (direction[0] != 0.0)) | ((y.ravel() == ROWS - 1.0) & (direction[1] != 0.0))
            assert np.isfinite(hits.distances[~may_leave]).all()


def test_holes_are_not_hit(stores):
    store = stores["hole"]
    x, y = store.frame.to_local(np.arange(HOLE[1].start, HOLE[1].stop - 1) + 0.4, np.full(16, 45.3))
    origins = np.stack([x, y, np.full(16, 500.0)], axis=1)
    down = np.array([[0.0, 0.0, -1.0]]).repeat(16, axis=0)
    assert np.isinf(cast_rays(store, origins, down).distances).all()
    assert np.isfinite(cast_rays(stores["whole"], origins, down).distances).all()


def test_rays_that_leave_end_early_or_are_not_valid_miss(stores):
    store = stores["whole"]
    origins = np.array([[0.0, 0.0, 500.0]] * 8)
    directions = np.array(
        [[0, 0, 1], [1, 0, 0], [0, 0, 0], [np.nan, 0, -1], [0, 0, -np.inf], [0, 0, -1], [0, 0, -1], [0, 0, -1e-300]], float
    )
    height = height_at(store, np.zeros((1, 2)))[0][0]
    limits = np.array([np.inf] * 5 + [500.0 - height - 0.01, 500.0 - height + 0.01, np.inf])
    hits = cast_rays(store, origins, directions, limits)
    assert np.isfinite(hits.distances).tolist() == [False] * 6 + [True] * 2
    assert hits.distances[6:] == pytest.approx(500.0 - height)
    assert np.isinf(cast_rays(store, [[0.0, 0.0, np.nan], [5000.0, 0.0, 0.0]], [[0.0, 0.0, -1.0]] * 2).distances).all()
    assert np.isinf(cast_rays(store, origins, directions, -1.0).distances).all()
    assert len(cast_rays(store, np.zeros((0, 3)), np.zeros((0, 3))).distances) == 0


def test_results_do_not_depend_on_chunks_nor_on_the_cache(stores, monkeypatch):
    store = stores["hole"]
    origins, directions = random_rays(store, 5, 500)
    expected = cast_rays(store, origins, directions)
    monkeypatch.setattr(ray_casting, "MAX_RAYS", 37)
    monkeypatch.setattr(ray_casting, "MAX_VISITS", 60)
    monkeypatch.setattr("farfield.addon.core.bdam.ray_triangles.MAX_BLOCK_TESTS", 5)
    monkeypatch.setattr("farfield.addon.core.bdam.ray_triangles.MAX_BOX_TESTS", 50)
    hits = RayCaster(store, max_bytes=30_000).cast(origins, directions)
    assert np.array_equal(hits.distances, expected.distances) and 50 < np.isfinite(hits.distances).sum() < 450
    assert np.array_equal(hits.rows, expected.rows)


def test_a_flat_terrain_is_hit_by_slanted_rays_and_missed_by_those_within_it(tmp_path):
    with TerrainStore(build_store(tmp_path / "flat", np.full((40, 40), 7.0))) as store:
        origins = np.array([[0.0, 0.0, 9.0], [-500.0, 3.0, 7.0], [-500.0, 3.0, 6.0]])
        hits = cast_rays(store, origins, [[3.0, 0.0, -4.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.002]])
        assert hits.distances[[0, 2]] == pytest.approx([2.5, 500.0 * np.hypot(1.0, 0.002)])
        assert np.isinf(hits.distances[1]) and np.allclose(hits.normals[[0, 2]], [0.0, 0.0, 1.0])
        assert np.allclose(hits.positions[0], [1.5, 0.0, 7.0]) and CELL_SIZE == 10.0


def test_wrong_settings_are_refused(stores):
    ray = np.zeros((1, 3)), np.ones((1, 3))
    for values in ({"exaggeration": 0.0}, {"exaggeration": np.nan}, {"max_error": -1.0}, {"max_error": np.nan}):
        with pytest.raises(SettingsError):
            cast_rays(stores["whole"], *ray, **values)


def test_damaged_patches_are_named_and_the_others_hit(tmp_path):
    folder = build_store(tmp_path / "terrain", hills(ROWS, COLUMNS))
    content = bytearray((folder / GEOMETRY_FILE).read_bytes())
    content[int(0.9 * len(content))] ^= 0x10
    (folder / GEOMETRY_FILE).write_bytes(content)
    with TerrainStore(folder) as store:
        y, x = np.mgrid[0 : ROWS - 1, 0 : COLUMNS - 1] + 0.3
        origins = np.stack([*store.frame.to_local(x.ravel(), y.ravel()), np.full(x.size, 500.0)], axis=1)
        down = np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
        caster = RayCaster(store)
        hits = caster.cast(origins, down)
        assert 0 < np.isinf(hits.distances).sum() < 400 and len(caster.damages) == 1 and next(store.verify()) in caster.damages[0]
        with pytest.raises(FileError, match="patch"):
            cast_rays(store, origins, down)
