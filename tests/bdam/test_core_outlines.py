"""Outlines: the boundaries of patches, triangulated without the vertices inside."""

import numpy as np
import pytest

from farfield.addon.core.bdam.store.patch_outlines import triangulate_outline
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view.caches import PatchCache
from farfield.addon.core.bdam.view.extraction import CutSettings, extract_cut
from farfield.addon.core.geometry.viewers import Projection, Viewer, look_at
from small_terrain_stores import build_store, hills

ROWS, COLUMNS = 100, 129


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    heights = hills(ROWS, COLUMNS) + np.random.default_rng(1).normal(scale=2.0, size=(ROWS, COLUMNS))
    heights[40:46, 20:23] = np.nan
    with TerrainStore(build_store(tmp_path_factory.mktemp("outlines") / "terrain", heights)) as store:
        yield store


def all_patches(store):
    for level, patches in enumerate(store.levels):
        for row in range(len(patches.indices)):
            yield level, row, store.read(level, row), store.corners_of(level, row)


def double_areas(x: np.ndarray, y: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    (x0, x1, x2), (y0, y1, y2) = x[triangles].T.astype(int), y[triangles].T.astype(int)
    return (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)


def test_outlines_cover_their_triangles_with_all_boundary_vertices(store):
    count = 0
    for level, row, patch, corners in all_patches(store):
        triangles = triangulate_outline(patch, corners)
        shown = len(patch.triangles) if triangles is None else len(triangles)
        assert store.levels[level].counts[row].tolist() == [len(patch.x), len(patch.triangles), shown]
        if triangles is not None:
            areas = double_areas(patch.x[patch.boundary], patch.y[patch.boundary], triangles)
            assert (areas > 0).all() and areas.sum() == double_areas(*corners.T, np.array([[0, 1, 2]]))[0]
            assert np.array_equal(np.unique(triangles), np.arange(len(patch.boundary)))
            count += 1
    assert count > 20


@pytest.mark.slow
def test_patches_with_holes_or_beyond_the_field_have_no_outline_but_themselves(store):
    cache, count = PatchCache(store), 0
    for level, row, patch, corners in all_patches(store):
        is_cut = (corners > [COLUMNS - 1, ROWS - 1]).any()
        if is_cut or patch.is_hole.any():
            count += 1
            assert triangulate_outline(patch, corners) is None
            assert np.array_equal(cache.read((level, row, True)).triangles, cache.read((level, row, False)).triangles)
    assert count > 4


def test_outlines_have_the_vertices_and_normals_of_their_patches(store):
    cache = PatchCache(store)
    for level, row, patch, _ in all_patches(store):
        full, outline = cache.read((level, row, False)), cache.read((level, row, True))
        if len(outline.ids) < len(full.ids):
            for name in ("ids", "positions", "normals"):
                assert np.array_equal(getattr(outline, name), getattr(full, name)[patch.boundary])


@pytest.mark.slow
def test_views_see_no_outlines(store):
    low, high = store.levels[0].low.min(axis=0).astype(float), store.levels[0].high.max(axis=0).astype(float)
    random, cache, outlines = np.random.default_rng(2), PatchCache(store), 0
    for _ in range(20):
        matrix = look_at(random.uniform(low, high + [0.0, 0.0, 200.0]), random.uniform(low, high))
        viewer = Viewer(matrix, Projection("perspective", (-0.4, 0.4, -0.3, 0.3), (320, 240), 0.1, 1e6))
        cut = extract_cut(store, viewer, CutSettings(0.5, culls=True))
        for level, row, is_outline in cut.list_patches():
            if is_outline:
                mesh = cache.read((level, row, True))
                centers = mesh.positions[mesh.triangles].mean(axis=1)
                pixels, depths = viewer.project(np.concatenate([mesh.positions, centers]))
                assert not ((depths > 0.1) & (pixels >= 0.0).all(axis=1) & (pixels <= [320, 240]).all(axis=1)).any()
                outlines += 1
        assert cut.count_triangles(store).sum() <= sum(store.levels[level].counts[row, 1] for level, row, _ in cut.list_patches())
    assert outlines > 100
