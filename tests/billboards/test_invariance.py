"""Tests of invariance: translating, scaling and rotating the input translates, scales and rotates the output."""

from functools import cache

import numpy as np
import pytest

from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.cloud import Cloud
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate, longest_side
from farfield.addon.core.jobs.progress import run_to_end
from shapes import box, bumpy_sphere, leaf_cards, random_rotation

EXACT = ("clusters", "hough")  # decimate uses single precision in places, so its choices may differ
BUMPY = bumpy_sphere(5)
EXHAUSTIVE = pytest.mark.exhaustive


def build_test_cloud(mesh: TriangleMesh, **settings) -> Cloud:
    return run_to_end(build_cloud(mesh, BillboardSettings(**({"error": 0.05, "levels": 2} | settings))))


@cache
def bumpy_cloud(method: str = "clusters") -> Cloud:
    """The cloud that tests compare with."""
    return build_test_cloud(BUMPY, method=method)


def transform(mesh: TriangleMesh, scale: float = 1.0, rotation: np.ndarray | None = None, offset=0.0) -> TriangleMesh:
    vertices = scale * mesh.vertices
    return TriangleMesh((vertices if rotation is None else vertices @ rotation.T) + offset, mesh.triangles)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "power"), [("clusters", -20), ("hough", 20)])
def test_scaling_by_powers_of_two_is_exact(method, power):
    """Rounding does not change, so any difference would reveal an absolute length in the code."""
    scale = 2.0**power
    before, after = bumpy_cloud(method), build_test_cloud(transform(BUMPY, scale), method=method)
    for small, large in zip(before.levels, after.levels, strict=True):
        assert large.error == scale * small.error and large.texel_size == scale * small.texel_size
        np.testing.assert_array_equal(large.quads.centers, scale * small.quads.centers)
        np.testing.assert_array_equal(large.quads.half_sizes, scale * small.quads.half_sizes)
        for name in ("frames", "drawn_offsets", "drawn", "owner"):
            np.testing.assert_array_equal(getattr(large.quads, name), getattr(small.quads, name))
        np.testing.assert_array_equal(large.atlas.rectangles, small.atlas.rectangles)
    assert after.max_plane_distance == before.max_plane_distance


@pytest.mark.slow
@pytest.mark.parametrize("method", EXACT)
def test_translation_by_integers_is_exact(method):
    offset = np.array([1000.0, -7.0, 64.0])
    before, after = bumpy_cloud(method), build_test_cloud(transform(BUMPY, offset=offset), method=method)
    for level, moved in zip(before.levels, after.levels, strict=True):
        np.testing.assert_allclose(moved.quads.centers, level.quads.centers + offset, atol=1e-12)
        for name in ("frames", "half_sizes", "drawn", "owner"):
            np.testing.assert_array_equal(getattr(moved.quads, name), getattr(level.quads, name))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "unit"),
    [
        ("clusters", 1e-6),
        pytest.param("clusters", 1e6, marks=EXHAUSTIVE),
        pytest.param("hough", 1e-6, marks=EXHAUSTIVE),
        ("decimate", 1e-6),
    ],
)
def test_scale_of_units_changes_little(method, unit):
    settings, offset = {"method": method, "error": 0.1, "levels": 1}, unit * np.array([3.0, -2.0, 1.0])
    mesh = box(cuts=1) if method == "decimate" else BUMPY  # decimate is slow on curved surfaces
    before, after = build_test_cloud(mesh, **settings), build_test_cloud(transform(mesh, unit, offset=offset), **settings)
    assert after.longest_side == pytest.approx(unit * before.longest_side)
    assert len(after.levels[0].quads) == pytest.approx(len(before.levels[0].quads), rel=0.15)
    assert after.levels[0].texel_count == pytest.approx(before.levels[0].texel_count, rel=0.1)
    assert after.max_plane_distance <= 1.0 and after.uncovered_faces == 0


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=EXHAUSTIVE)])
def test_rotated_box_has_rotated_faces(seed):
    rotation = random_rotation(seed)
    mesh = transform(box((1.0, 2.0, 3.0)), rotation=rotation, offset=[4.0, 5.0, 6.0])
    quads = build_test_cloud(mesh, error=0.02, levels=1).levels[0].quads
    assert len(quads) == 6
    local = (quads.centers - [4.0, 5.0, 6.0]) @ rotation / [0.5, 1.0, 1.5]
    np.testing.assert_allclose(local, quads.frames[:, 2] @ rotation, atol=1e-9)
    np.testing.assert_allclose(np.sort(np.abs(local), axis=1), np.tile([0.0, 0.0, 1.0], (6, 1)), atol=1e-9)


@pytest.mark.slow
def test_rotation_changes_little():
    """The error is the same length for both, although the bounding boxes differ."""
    mesh = concatenate([BUMPY, transform(leaf_cards(40), 1.5)])
    rotated = transform(mesh, rotation=random_rotation(1))
    error = 0.05 * longest_side(mesh.vertices) / longest_side(rotated.vertices)
    before, after = build_test_cloud(mesh, levels=1), build_test_cloud(rotated, error=error, levels=1)
    for level, moved in zip(before.levels, after.levels, strict=True):
        assert moved.error == pytest.approx(level.error)
        assert len(moved.quads) == pytest.approx(len(level.quads), rel=0.25)
        assert moved.texel_count == pytest.approx(level.texel_count, rel=0.1)


@pytest.mark.slow
def test_order_of_faces_changes_little():
    order = np.random.default_rng(0).permutation(len(BUMPY.triangles))
    before, after = bumpy_cloud(), build_test_cloud(TriangleMesh(BUMPY.vertices, BUMPY.triangles[order]), levels=1)
    assert len(after.levels[0].quads) == pytest.approx(len(before.levels[0].quads), rel=0.15)
    assert after.levels[0].texel_count == pytest.approx(before.levels[0].texel_count, rel=0.1)
