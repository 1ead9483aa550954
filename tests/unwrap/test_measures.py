"""What UV maps are worth, on maps whose worth is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.mesh import TriangleMesh
from farfield.addon.core.progress import finish
from farfield.addon.core.unwrap.measures import Measures, measured, stretches_of
from farfield.addon.core.unwrap.overlaps import overlap_count
from farfield.addon.core.unwrap.packing import packed
from shapes import sheet


def plane(side=6):
    mesh = sheet(side)
    return mesh, mesh.corners[:, :, :2]


def figures_of(mesh, corners, importance=None) -> Measures:
    importance = np.zeros(len(corners)) if importance is None else importance
    return finish(measured(mesh, corners, finish(stretches_of(mesh, corners)), importance))


def counted(corners):
    """Pairs that overlap, the slow way: by points well within both."""
    total = 0
    for one in range(len(corners)):
        for other in range(one):
            total += finish(overlap_count(corners[[one, other]]))
    return total


@given(size=st.floats(0.01, 50.0), turn=st.floats(0.0, 6.0))
def test_an_isometry_has_no_stretch_whatever_its_size(size, turn):
    mesh, corners = plane()
    turned = size * corners @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    figures = figures_of(mesh, turned)
    assert (figures.l2, figures.linf, figures.p95) == pytest.approx((1.0, 1.0, 1.0))
    assert figures.symmetric_dirichlet == pytest.approx(4.0)
    assert (figures.flips, figures.overlaps, figures.density_ratio) == (0, 0, 0.0)
    assert figures.fill == pytest.approx(size**2 * np.ptp(mesh.vertices[:, 0]) * np.ptp(mesh.vertices[:, 1]), rel=1e-6)


def test_a_map_twice_as_wide_as_it_should_be():
    mesh, corners = plane()
    figures = figures_of(mesh, corners * [2.0, 1.0])
    assert figures.linf == pytest.approx(np.sqrt(2.0))  # across, lengths are a root of two longer than in a map of the same area
    assert figures.l2 == pytest.approx(np.sqrt(0.5 * (2.0 + 0.5)))
    assert figures.symmetric_dirichlet == pytest.approx(2.0 * 2.5)


def test_flips_are_counted_and_texels_compared():
    mesh, corners = plane()
    corners = corners.copy()
    corners[5] = corners[5, ::-1]
    importance = (np.arange(len(corners)) % 2).astype(float)
    corners[importance > 0.5] *= 2.0
    figures = figures_of(mesh, corners, importance)
    assert figures.flips == 1
    assert figures.density_ratio == pytest.approx(4.0)
    assert figures.densities == pytest.approx((0.4, 0.0, 0.0, 1.6), rel=0.1)


def test_a_collapsed_triangle_is_stretched_without_end():
    mesh, corners = plane()
    corners = corners.copy()
    corners[0] = corners[0, :1]
    figures = figures_of(mesh, corners)
    assert np.isinf(figures.linf) and figures.flips == 0


def test_a_triangle_without_area_on_the_surface_does_not_count():
    mesh, corners = plane()
    vertices = np.concatenate([mesh.vertices, mesh.vertices[:1]])
    triangles = np.concatenate([mesh.triangles, [[0, 1, len(mesh.vertices)]]]).astype(np.int32)
    grown = np.concatenate([corners, corners[:1]])
    assert figures_of(TriangleMesh(vertices, triangles), grown).l2 == pytest.approx(1.0, rel=0.05)


@given(seed=st.integers(0, 1000))
def test_overlaps_are_those_of_every_pair(seed):
    random = np.random.default_rng(seed)
    corners = random.uniform(0.0, 1.0, (8, 1, 2)) + random.uniform(-1.0, 1.0, (8, 3, 2)) * random.choice([0.02, 0.2, 0.6], (8, 1, 1))
    assert finish(overlap_count(corners)) == counted(corners)


def test_neighbours_do_not_overlap_and_a_second_sheet_does():
    _, corners = plane(9)
    assert finish(overlap_count(corners)) == 0
    assert finish(overlap_count(np.concatenate([corners, corners[:1]]))) >= 1
    assert finish(overlap_count(corners[:, ::-1])) == 0  # mirrored as a whole


def test_charts_are_packed_apart_within_the_square():
    random = np.random.default_rng(0)
    layouts, triangles = [], []
    for _ in range(12):
        mesh = sheet(int(random.integers(2, 6)))
        layouts.append(mesh.vertices[:, :2] * random.uniform(0.3, 3.0, 2))
        triangles.append(mesh.triangles)
    placed = packed(layouts, triangles, 0.01)
    corners = np.concatenate([layout[drawn] for layout, drawn in zip(placed, triangles, strict=True)])
    assert corners.min() >= 0.01 - 1e-9 and corners.max() <= 0.99 + 1e-9
    assert finish(overlap_count(corners)) == 0
    scales = [np.sqrt(np.ptp(new, axis=0).prod() / np.ptp(old, axis=0).prod()) for new, old in zip(placed, layouts, strict=True)]
    assert scales == pytest.approx([scales[0]] * len(scales))  # none has grown beside the others
    assert measured_fill(corners) > 0.5


def measured_fill(corners):
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return float(np.abs(0.5 * (ax * by - ay * bx)).sum())
