"""Ground that the curvature of the Earth lowers: positions, normals, bounds, and cuts without cracks within the tolerance."""

import numpy as np
import pytest

from farfield.addon.core.bdam.ground.heights import HeightQuery
from farfield.addon.core.bdam.ground.surfaces import StoreSurface
from farfield.addon.core.bdam.settings import ViewSettings
from farfield.addon.core.bdam.store import curvature
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view.caches import PatchCache
from farfield.addon.core.bdam.view.engine import BdamEngine
from farfield.addon.core.bdam.view.extraction import CutSettings, ProjectedErrors, extract_cut, extract_uniform_cut
from farfield.addon.core.geometry.viewers import Projection, Viewer, look_at
from farfield.addon.core.jobs.progress import run_to_end
from small_terrain_stores import CELL_SIZE, build_cut_mesh, build_store, hills

SIZE = 129
RADIUS = 4000.0  # meters, so that 1.3 km of ground are as curved as a continent
STEP = 0.01
Y, X = (CELL_SIZE * (axis.ravel() - (SIZE - 1) // 2) for axis in np.mgrid[0:SIZE, 0:SIZE])
DROP = (X**2 + Y**2) / (2.0 * RADIUS)


@pytest.fixture(scope="module", autouse=True)
def small_earth():
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(curvature, "EARTH_RADIUS", RADIUS)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return build_store(tmp_path_factory.mktemp("curved") / "terrain", hills(SIZE, SIZE), height_step=STEP)


@pytest.fixture(scope="module")
def store(folder, small_earth):
    with TerrainStore(folder, is_curved=True) as store:
        yield store


def viewer_at(random, bounds):
    low, high = bounds
    position = random.uniform(low, high + [0.0, 0.0, 300.0])
    window = (-0.6, 0.6, -0.4, 0.4)
    return Viewer(look_at(position, random.uniform(low, high)), Projection("perspective", window, (600, 400), 0.1, 1e6))


def test_samples_are_lower_by_the_square_of_the_distance_over_twice_the_radius(folder, store):
    with TerrainStore(folder) as flat:
        expected, before = HeightQuery(flat).find(np.stack([X, Y], axis=1))
    found, normals = HeightQuery(store).find(np.stack([X, Y], axis=1))
    assert np.abs(found - (expected - DROP)).max() < 1e-9 and DROP.max() > 100.0
    assert np.abs(normals - before).max() > 0.1
    for exaggeration in (1.0, 3.0):
        heights, _ = StoreSurface(store, exaggeration).find(np.stack([X, Y], axis=1))
        assert np.abs(heights - exaggeration * (expected - DROP)).max() < 1e-6


def test_normals_of_flat_ground_point_away_from_the_center_of_the_earth(tmp_path):
    with TerrainStore(build_store(tmp_path / "flat", np.zeros((65, 65))), is_curved=True) as store:
        mesh = build_cut_mesh(store, extract_uniform_cut(store, 0.0))
        assert len(mesh.triangles) == 2 * 64 * 64, "flat ground is not flat any more"
        expected = mesh.positions * [1.0, 1.0, 0.0] + [0.0, 0.0, RADIUS]
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        boundary = np.abs(mesh.normals - expected).max(axis=1)
        assert boundary.max() < 0.01  # triangles at corners of the field have only one side


def test_boxes_contain_their_patches_and_those_of_their_children(store):
    cache = PatchCache(store)
    for level, patches in enumerate(store.levels):
        for row in range(len(patches.indices)):
            positions = cache.read((level, row, False)).positions
            assert (positions >= patches.low[row]).all() and (positions <= patches.high[row]).all()
    children = np.flatnonzero(store.links.parents >= 0)
    parents = store.links.parents[children]
    assert (store.bounds[children, :3] >= store.bounds[parents, :3]).all()
    assert (store.bounds[children, 3:6] <= store.bounds[parents, 3:6]).all()
    assert (store.bounds[children, 6] <= store.bounds[parents, 6]).all()


@pytest.mark.slow
def test_no_visible_sample_moves_farther_than_the_tolerance(store):
    random = np.random.default_rng(2)
    points = np.stack([X, Y], axis=1)
    finest, _ = HeightQuery(store).find(points)
    bounds = store.levels[0].low.min(axis=0).astype(float), store.levels[0].high.max(axis=0).astype(float)
    largest = []
    for _ in range(6):
        viewer, tolerance = viewer_at(random, bounds), 10.0 ** random.uniform(-0.3, 1.0)
        cut = extract_cut(store, viewer, CutSettings(tolerance))
        shown, _ = HeightQuery(store, cut).find(points)
        before, depths = viewer.project(np.column_stack([points, finest]))
        after, after_depths = viewer.project(np.column_stack([points, shown]))
        is_visible = (depths > 0.1) & (after_depths > 0.1) & (before >= 0.0).all(axis=1) & (before <= viewer.projection.size).all(axis=1)
        largest.append((np.linalg.norm(after - before, axis=1)[is_visible] / tolerance).max(initial=0.0))
        errors = ProjectedErrors(store, viewer, CutSettings(1.0))(np.arange(len(store.bounds)))
        children = np.flatnonzero(store.links.parents >= 0)
        assert (errors[children] <= errors[store.links.parents[children]] * (1.0 + 1e-9)).all()
    assert max(largest) <= 1.0


def test_tiles_meet_exactly_at_any_levels(folder):
    """Vertices of the same sample have the same position and normal in all tiles that have them."""
    engine = BdamEngine(folder, ViewSettings(tolerance=0.5, shading="slope", curvature=True, exaggeration=2.0))
    viewer = Viewer(
        look_at(np.array([-600.0, -600.0, 300.0]), np.zeros(3)), Projection("perspective", (-0.6, 0.6, -0.4, 0.4), (900, 600), 0.1, 1e6)
    )
    run_to_end(engine.move(viewer))
    meshes = []
    while not engine.finished_blocks.empty():
        meshes.append(engine.finished_blocks.get()[1].mesh)
    assert len(meshes) > 4
    seen = {}
    shared = 0
    for mesh in meshes:
        values = np.concatenate([mesh.vertices + mesh.location, mesh.normals], axis=1)
        for number, value in zip(mesh.ids.tolist(), values, strict=True):
            shared += number in seen
            assert np.array_equal(seen.setdefault(number, value), value)
    assert shared > 100
    height = {number: value[2] for number, value in seen.items()}
    corner = height[0]
    with TerrainStore(folder) as flat:
        expected = HeightQuery(flat).find(np.array([[X[0], Y[0]]]))[0][0]
    assert corner == pytest.approx(2.0 * (expected - DROP[0]), abs=0.01)
    engine.store.close()
