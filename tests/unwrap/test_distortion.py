"""Metrics of UV maps with known answers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.geometry.transforms import signed_areas
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.distortion import DistortionMetrics, Stretches, compute_stretches, measure_distortion
from farfield.addon.core.unwrap.overlaps import count_overlaps
from farfield.addon.core.unwrap.packing import pack_charts
from farfield.addon.core.unwrap.texture import Texture
from shapes import sheet


def flat_sheet(side=6):
    mesh = sheet(side)
    return mesh, mesh.corners[:, :, :2]


def measure(mesh, corner_uvs, importance=None) -> DistortionMetrics:
    importance = np.zeros(len(corner_uvs)) if importance is None else importance
    return run_to_end(measure_distortion(mesh, corner_uvs, run_to_end(compute_stretches(mesh, corner_uvs)), importance))


def count_overlaps_by_pairs(corner_uvs):
    total = 0
    for first in range(len(corner_uvs)):
        for second in range(first):
            total += run_to_end(count_overlaps(corner_uvs[[first, second]]))
    return total


@given(size=st.floats(0.01, 50.0), angle=st.floats(0.0, 6.0))
def test_an_isometry_of_any_size_has_no_stretch(size, angle):
    mesh, corner_uvs = flat_sheet()
    rotated = size * corner_uvs @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    metrics = measure(mesh, rotated)
    assert (metrics.l2, metrics.linf, metrics.p95) == pytest.approx((1.0, 1.0, 1.0))
    assert metrics.symmetric_dirichlet == pytest.approx(4.0)
    assert (metrics.max_expansion, metrics.anisotropy_p99) == pytest.approx((1.0, 1.0))
    assert (metrics.flips, metrics.overlaps, metrics.density_ratio, metrics.needles, metrics.anisotropic_fraction) == (0, 0, 0.0, 0.0, 0.0)
    assert metrics.fill == pytest.approx(size**2 * np.ptp(mesh.vertices[:, 0]) * np.ptp(mesh.vertices[:, 1]), rel=1e-6)


def test_a_map_of_twice_the_width():
    mesh, corner_uvs = flat_sheet()
    metrics = measure(mesh, corner_uvs * [2.0, 1.0])
    assert metrics.linf == pytest.approx(np.sqrt(2.0))  # Lengths along v are this much larger, relative to a map of the same area.
    assert metrics.l2 == pytest.approx(np.sqrt(0.5 * (2.0 + 0.5)))
    assert metrics.max_expansion == pytest.approx(np.sqrt(2.0))
    assert metrics.anisotropy_p99 == pytest.approx(2.0)
    assert metrics.symmetric_dirichlet == pytest.approx(2.0 * 2.5)


@pytest.mark.slow
@given(size=st.floats(0.01, 50.0))
def test_symmetric_dirichlet_is_that_of_the_best_scale(size):
    mesh, corner_uvs = flat_sheet()
    uneven = corner_uvs * np.where(np.arange(len(corner_uvs)) % 2, 3.0, 1.0)[:, None, None]
    areas = face_areas_and_normals(mesh.corners)[0] / face_areas_and_normals(mesh.corners)[0].sum()
    squares = np.where(np.arange(len(areas)) % 2, 9.0, 1.0)
    best = min(areas @ (2.0 * scale * squares + 2.0 / (scale * squares)) for scale in np.geomspace(0.05, 2.0, 4000))
    assert measure(mesh, size * uneven).symmetric_dirichlet == pytest.approx(best, rel=1e-5)


@pytest.mark.parametrize(("width", "height", "is_anisotropic", "is_needle"), [(30, 0.5, 1, 1), (3, 0.5, 1, 0), (30, 15, 0, 0)])
def test_needles_are_anisotropic_triangles_that_are_much_larger_in_the_map(width, height, is_anisotropic, is_needle):
    mesh, corner_uvs = flat_sheet(30)
    corner_uvs = corner_uvs.copy()
    corner_uvs[7] *= [width, height]
    metrics = measure(mesh, corner_uvs)
    areas = np.abs(signed_areas(corner_uvs))
    fraction = areas[7] / areas.sum()
    assert (metrics.anisotropic_fraction, metrics.needles) == pytest.approx((is_anisotropic * fraction, is_needle * fraction), rel=1e-6)
    scale = np.sqrt(face_areas_and_normals(mesh.corners)[0].sum() / areas.sum())
    assert metrics.max_expansion == pytest.approx(scale * max(width, height), rel=0.03)


def test_the_dominant_stretch_is_the_one_farther_from_1():
    assert Stretches(np.array([2.0, 1.2, np.inf]), np.array([0.9, 0.5, 0.3]), np.zeros(3, bool)).dominant.tolist() == [2.0, 0.5, np.inf]


def test_flips_are_counted_and_densities_compared():
    mesh, corner_uvs = flat_sheet()
    corner_uvs = corner_uvs.copy()
    corner_uvs[5] = corner_uvs[5, ::-1]
    importance = (np.arange(len(corner_uvs)) % 2).astype(float)
    corner_uvs[importance > 0.5] *= 2.0
    metrics = measure(mesh, corner_uvs, importance)
    assert metrics.flips == 1
    assert metrics.density_ratio == pytest.approx(4.0)
    assert metrics.densities == pytest.approx((0.4, 0.0, 0.0, 1.6), rel=0.1)


def test_a_collapsed_triangle_has_infinite_stretch():
    mesh, corner_uvs = flat_sheet()
    corner_uvs = corner_uvs.copy()
    corner_uvs[0] = corner_uvs[0, :1]
    metrics = measure(mesh, corner_uvs)
    assert np.isinf(metrics.linf) and metrics.flips == 0


def test_a_triangle_without_surface_area_is_ignored():
    mesh, corner_uvs = flat_sheet()
    vertices = np.concatenate([mesh.vertices, mesh.vertices[:1]])
    triangles = np.concatenate([mesh.triangles, [[0, 1, len(mesh.vertices)]]]).astype(np.int32)
    extended_uvs = np.concatenate([corner_uvs, corner_uvs[:1]])
    assert measure(TriangleMesh(vertices, triangles), extended_uvs).l2 == pytest.approx(1.0, rel=0.05)


@given(seed=st.integers(0, 1000))
def test_overlaps_equal_the_test_of_every_pair(seed):
    random = np.random.default_rng(seed)
    sizes = random.uniform(0.0, 1.0, (8, 1, 2)), random.uniform(-1.0, 1.0, (8, 3, 2)), random.choice([0.02, 0.2, 0.6], (8, 1, 1))
    corner_uvs = sizes[0] + sizes[1] * sizes[2]
    assert run_to_end(count_overlaps(corner_uvs)) == count_overlaps_by_pairs(corner_uvs)


def test_neighbors_do_not_overlap_but_duplicates_do():
    _, corner_uvs = flat_sheet(9)
    assert run_to_end(count_overlaps(corner_uvs)) == 0
    assert run_to_end(count_overlaps(np.concatenate([corner_uvs, corner_uvs[:1]]))) >= 1
    assert run_to_end(count_overlaps(corner_uvs[:, ::-1])) == 0  # the whole map mirrored


def test_charts_are_packed_without_overlaps_and_keep_their_relative_scale():
    random = np.random.default_rng(0)
    uvs, triangles = [], []
    for _ in range(12):
        mesh = sheet(int(random.integers(2, 6)))
        uvs.append(mesh.vertices[:, :2] * random.uniform(0.3, 3.0, 2))
        triangles.append(mesh.triangles)
    packed = run_to_end(pack_charts(uvs, triangles, Texture(margin=20.48))).uvs
    corner_uvs = np.concatenate([uv[faces] for uv, faces in zip(packed, triangles, strict=True)])
    assert corner_uvs.min() >= 0.01 - 1e-9 and corner_uvs.max() <= 0.99 + 1e-9
    assert run_to_end(count_overlaps(corner_uvs)) == 0
    scales = [np.sqrt(np.ptp(new, axis=0).prod() / np.ptp(old, axis=0).prod()) for new, old in zip(packed, uvs, strict=True)]
    assert scales == pytest.approx([scales[0]] * len(scales))
    assert np.abs(signed_areas(corner_uvs)).sum() > 0.5
