"""Cuts for a viewer: no cracks, and no sample moves farther in the image than the tolerance."""

import numpy as np
import pytest

from farfield.addon.core.bdam.ground.heights import HeightQuery
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view.caches import PatchCache
from farfield.addon.core.bdam.view.cut_meshes import CutMesh
from farfield.addon.core.bdam.view.extraction import CutSettings, ProjectedErrors, extract_cut, extract_uniform_cut
from farfield.addon.core.geometry.viewers import Projection, Viewer
from small_terrain_stores import build_cut_mesh, build_store, hills
from watertight import undirected_edge_counts

ROWS, COLUMNS = 129, 161
CAMERAS = 15
HEIGHT_STEP = 0.01  # meters


def rough_heights() -> np.ndarray:
    """Hills with noise, a cliff and spikes."""
    random = np.random.default_rng(4)
    heights = hills(ROWS, COLUMNS) + random.normal(scale=2.0, size=(ROWS, COLUMNS))
    heights[:, COLUMNS // 2 :] += 150.0
    heights[random.integers(0, ROWS, 8), random.integers(0, COLUMNS, 8)] += 80.0
    return np.rint(heights / HEIGHT_STEP) * HEIGHT_STEP


@pytest.fixture(scope="module")
def heights() -> np.ndarray:
    return rough_heights()


@pytest.fixture(scope="module")
def store(heights, tmp_path_factory):
    with TerrainStore(build_store(tmp_path_factory.mktemp("rough") / "terrain", heights, height_step=HEIGHT_STEP)) as store:
        yield store


def random_viewer(random: np.random.Generator, store: TerrainStore, kind: str) -> Viewer:
    """A camera anywhere near the terrain that looks anywhere, with any lens."""
    low, high = store.levels[0].low.min(axis=0).astype(float), store.levels[0].high.max(axis=0).astype(float)
    extent = high - low
    position = random.uniform(low - 0.3 * extent, high + [0.3, 0.3, 2.0] * extent)
    target = random.uniform(low, high)
    back = (position - target) / np.linalg.norm(position - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([right, np.cross(back, right), back, position])
    half = random.uniform(0.1, 1.2) * (1.0 if kind == "perspective" else extent[0] / 3.0)
    shift = random.uniform(-0.5, 0.5, 2) * half
    window = (shift[0] - half, shift[0] + half, shift[1] - 0.7 * half, shift[1] + 0.7 * half)
    return Viewer(matrix, Projection(kind, window, (640, 448), 0.1, 1e6))


def count_cracks(mesh: CutMesh) -> int:
    """Return the number of inner edges that have not exactly two triangles; edges on the border of the field have one."""
    unique, counts = undirected_edge_counts(mesh.triangles)
    x, y = (mesh.ids % COLUMNS)[unique], (mesh.ids // COLUMNS)[unique]
    on_border = np.zeros(len(unique), bool)
    for axis, last in ((x, COLUMNS - 1), (y, ROWS - 1)):
        on_border |= (axis[:, 0] == axis[:, 1]) & ((axis[:, 0] == 0) | (axis[:, 0] == last))
    return int((counts != np.where(on_border, 1, 2)).sum())


def covered_cells(mesh: CutMesh) -> float:
    """Return the area of the mesh in the plane in cells; infinite if any triangle is clockwise or empty."""
    (x0, x1, x2), (y0, y1, y2) = (axis[mesh.triangles].T for axis in (mesh.ids % COLUMNS, mesh.ids // COLUMNS))
    areas = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
    return 0.5 * float(areas.sum()) if (areas > 0).all() else np.inf


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
def test_random_cameras_see_no_cracks(store, kind):
    random, cache = np.random.default_rng(7), PatchCache(store)
    sizes = set()
    for _ in range(CAMERAS):
        culls = bool(random.integers(2))
        settings = CutSettings(10.0 ** random.uniform(-0.5, 1.5), 10.0 ** random.uniform(-0.5, 0.5), culls)
        mesh = build_cut_mesh(store, extract_cut(store, random_viewer(random, store, kind), settings), cache)
        assert count_cracks(mesh) == 0
        assert covered_cells(mesh) == (ROWS - 1) * (COLUMNS - 1)
        sizes.add(len(mesh.triangles))
    assert len(sizes) > 5, "the cuts differ"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "culls"),
    [
        ("perspective", True),
        ("orthographic", False),
        *(pytest.param(*values, marks=pytest.mark.exhaustive) for values in (("perspective", False), ("orthographic", True))),
    ],
)
def test_no_visible_sample_moves_farther_than_the_tolerance(store, heights, kind, culls):
    random = np.random.default_rng(9)
    y, x = (axis.ravel() for axis in np.mgrid[0:ROWS, 0:COLUMNS])
    local = np.stack(store.frame.to_local(x, y), axis=1)
    largest = []
    for _ in range(CAMERAS):
        tolerance, exaggeration = 10.0 ** random.uniform(-0.3, 1.0), 10.0 ** random.uniform(-0.3, 0.3)
        viewer = random_viewer(random, store, kind)
        cut = extract_cut(store, viewer, CutSettings(tolerance, exaggeration, culls))
        shown, _ = HeightQuery(store, cut).find(local)
        before, depths = viewer.project(np.column_stack([local, exaggeration * heights.ravel()]))
        after, after_depths = viewer.project(np.column_stack([local, exaggeration * shown]))
        is_visible = (depths > 0.1) & (after_depths > 0.1) & (before >= 0.0).all(axis=1) & (before <= viewer.projection.size).all(axis=1)
        moved = np.linalg.norm(after - before, axis=1)[is_visible] / tolerance
        largest.append(moved.max(initial=0.0))
        assert cut.max_error <= tolerance
    assert max(largest) <= 1.0
    assert max(largest) > 0.2, "the bound is not far from what happens"


@pytest.mark.slow
def test_a_smaller_tolerance_never_takes_fewer_patches(store):
    random = np.random.default_rng(3)
    for _ in range(8):
        viewer = random_viewer(random, store, "perspective")
        counts = [len(extract_cut(store, viewer, CutSettings(tolerance))) for tolerance in (16.0, 8.0, 4.0, 2.0, 1.0, 0.5)]
        assert counts == sorted(counts)


@pytest.mark.parametrize("kind", ["perspective", "orthographic", "panoramic"])
def test_errors_never_grow_from_patches_to_their_children(store, kind):
    random = np.random.default_rng(6)
    children = np.flatnonzero(store.links.parents >= 0)
    for _ in range(CAMERAS):
        viewer = random_viewer(random, store, kind)
        for culls in (False, True):
            errors = ProjectedErrors(store, viewer, CutSettings(1.0, 10.0 ** random.uniform(-0.3, 0.3), culls))(
                np.arange(len(store.bounds))
            )
            assert np.isfinite(errors).all()
            assert (errors[children] <= errors[store.links.parents[children]] * (1.0 + 1e-9)).all()


def test_culling_needs_fewer_patches(store):
    random = np.random.default_rng(5)
    fewer = 0
    for _ in range(CAMERAS):
        viewer = random_viewer(random, store, "perspective")
        full, culled = (extract_cut(store, viewer, CutSettings(2.0, culls=culls)) for culls in (False, True))
        assert len(culled) <= len(full)
        fewer += len(culled) < len(full)
    assert fewer > CAMERAS // 2


def test_uniform_cuts_are_consistent_and_within_their_error(store):
    for max_error in (0.0, 0.5, 3.0, 20.0, 1e9):
        cut = extract_uniform_cut(store, max_error)
        assert cut.max_error <= max_error
        assert count_cracks(build_cut_mesh(store, cut)) == 0
    assert len(cut) == 2


@pytest.mark.slow
def test_a_cliff_needs_few_triangles(tmp_path):
    """Errors of coarse patches do not reach its height, although its samples are far from any triangle that leaves its edge."""
    size, cliff = 257, 400.0
    y, x = np.mgrid[:size, :size]
    heights = 0.05 * hills(size, size) + cliff * (x + 0.4 * y + 6.0 * np.sin(0.11 * y) + 3.0 * np.sin(0.37 * y) > 0.7 * size)
    with TerrainStore(build_store(tmp_path / "cliff", heights)) as store:
        assert store.levels[0].errors.max() < 0.1 * cliff
        cut = extract_uniform_cut(store, 0.1 * cliff)
        assert cut.count_triangles(store).sum() < 700, "the edges of the cliff have about 500 samples"
