"""Fragments as in the paper: known answers of its formulas, and its figures."""

import numpy as np
import pytest
from sending.fragments import (
    CodedFragments,
    assign_qualities,
    count_features,
    make_fragment_grid,
    measure_fragmentation,
    measure_quality_sizes,
    normalize_counts,
    quality_of_scale,
    tabulate_sizes,
)

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.texmesh.scale_space.features import SCALES
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh


def make_quads() -> TexturedMesh:
    """Two triangles whose texture coordinates are the corners of the square."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return build_textured_mesh(TriangleMesh(points, triangles), points[triangles][..., :2])


def make_image(side: int = 64) -> np.ndarray:
    y, x = np.mgrid[:side, :side]
    noise = np.random.default_rng(2).normal(scale=12.0, size=(side, side, 3))
    return np.clip(128 + 90 * np.sin(0.3 * x * (1 + y / side))[..., None] + noise, 0, 255).astype(np.uint8)


def test_distribution_is_normalized():
    np.testing.assert_allclose(normalize_counts(np.array([[2, 4], [6, 10]])), [[0.0, 0.25], [0.5, 1.0]])
    assert not normalize_counts(np.full((2, 2), 7)).any()


def test_quality_falls_linearly_with_the_scale():
    assert [quality_of_scale(scale) for scale in (0, 5, 10, 20)] == [100.0, 75.0, 50.0, 0.0]


def test_qualities_follow_the_distribution_within_the_tolerance():
    distribution = np.array([0.0, 0.5, 1.0])
    np.testing.assert_allclose(assign_qualities(distribution, 50.0, None, 20.0), [40.0, 50.0, 60.0])
    np.testing.assert_allclose(assign_qualities(distribution, 50.0, 1.0, 20.0), [30.0, 40.0, 50.0])
    np.testing.assert_allclose(assign_qualities(distribution, 50.0, -1.0, 20.0), [70.0, 70.0, 70.0])
    np.testing.assert_allclose(assign_qualities(distribution, 95.0, 0.0, 20.0), [95.0, 100.0, 100.0])


def test_features_are_counted_where_their_texels_are():
    mesh = make_quads()
    order = np.lexsort((mesh.vertices[:, 0], mesh.vertices[:, 1]))  # (0, 0), (1, 0), (0, 1), (1, 1)
    last = np.zeros(4, np.int8)
    last[order] = [0, 3, 20, 1]
    counts = count_features(mesh, (0,), last, make_fragment_grid(64, 64)).counts
    assert counts.shape == (SCALES, 2, 2)
    assert counts[0].tolist() == [[1, 1], [1, 1]]
    assert counts[2].tolist() == [[1, 0], [0, 1]]  # rows from the top: v of 1 comes first
    assert counts[20].tolist() == [[1, 0], [0, 0]]


def test_size_of_fragments_is_checked():
    for side in (0, 8, 24):
        with pytest.raises(SettingsError):
            make_fragment_grid(64, 64, side)


def test_larger_threshold_gives_fewer_bytes():
    grid = make_fragment_grid(70, 64)
    fragments = CodedFragments(make_image()[:, :64].repeat(2, axis=1)[:, :70], grid)
    feature_map = count_features(make_quads(), (0,), np.array([20, 20, 3, 0], np.int8), grid)
    table = tabulate_sizes(fragments, feature_map, 10, np.linspace(0.0, 1.0, 5), 40.0)
    assert (np.diff(table.byte_counts) < 0).all()
    assert table.qualities.shape == (5, grid.rows, grid.columns)
    assert fragments.decode(fragments.code(table.qualities[0])).shape == (64, 70, 3)


def test_figures():
    rows = measure_fragmentation(make_image(), (20, 60))
    assert [row.quality for row in rows] == [20, 60]
    assert rows[0].fragmented < rows[1].fragmented and rows[0].single < rows[0].fragmented
    sizes = measure_quality_sizes(make_image(), (10, 50, 90))
    assert (np.diff(sizes) > 0).all()
