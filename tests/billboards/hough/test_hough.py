"""Tests of the greedy Hough planes: they cover every primitive within the error, with no more planes than the shape needs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.billboards.hough.hough import HoughPlanes, find_planes
from farfield.addon.core.billboards.hough.regions import split_into_regions
from farfield.addon.core.geometry.mesh import face_areas_and_normals
from farfield.addon.core.jobs.progress import run_to_end


def find_mesh_planes(corners: np.ndarray, error: float, seed: int = 0) -> HoughPlanes:
    return run_to_end(find_planes(corners, *face_areas_and_normals(corners), error, seed))


def grid(side: int, height=lambda x, y: 0.0 * (x + y)) -> np.ndarray:
    """Return the corners (2 side^2, 3, 3) of a unit square on the surface z = height(x, y)."""
    x, y = np.meshgrid(np.linspace(0.0, 1.0, side + 1), np.linspace(0.0, 1.0, side + 1), indexing="ij")
    points = np.stack([x, y, height(x, y)], axis=2)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.concatenate([np.stack([a, b, c], axis=2).reshape(-1, 3, 3), np.stack([a, c, d], axis=2).reshape(-1, 3, 3)])


def box(side: int = 6) -> np.ndarray:
    """Return a unit box of six grids."""
    bottom = grid(side)
    top = bottom[:, ::-1] + [0.0, 0.0, 1.0]
    return np.concatenate([np.roll(sheet, axis, axis=2) for axis in range(3) for sheet in (bottom, top)])


def check_bounds(planes: HoughPlanes, corners: np.ndarray, error: float) -> None:
    """Check that every primitive is drawn within the error on the region that owns it."""
    max_distance = error * (1.0 + 1e-9)
    np.testing.assert_allclose(np.linalg.norm(planes.normals, axis=1), 1.0)
    for normal, offset, drawn in zip(planes.normals, planes.offsets, planes.drawn, strict=True):
        assert np.abs(corners[drawn] @ normal - offset).max() <= max_distance
        assert (np.diff(drawn) > 0).all()
    assert planes.owner.shape == (len(corners),)
    for primitive, region in enumerate(planes.owner):
        assert primitive in planes.drawn[region]
    assert set(planes.owner) == set(range(len(planes.drawn)))


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(1, 80), st.floats(0.005, 0.3), st.sampled_from([1e-6, 1.0, 1e6]))
def test_every_corner_is_within_the_error_of_its_plane(seed, count, error, unit):
    random = np.random.default_rng(seed)
    corners = unit * (random.normal(size=(count, 1, 3)) + random.uniform(0.01, 1.0) * random.normal(size=(count, 3, 3)))
    check_bounds(find_mesh_planes(corners, error * unit), corners, error * unit)


def test_box_gives_six_planes():
    planes = find_mesh_planes(box(), 0.01)
    assert len(planes.drawn) == 6
    np.testing.assert_allclose(np.abs(planes.normals).max(axis=1), 1.0, atol=0.02)
    check_bounds(planes, box(), 0.01)


def test_large_oblique_triangles_get_their_own_planes():
    corners = np.array([[[0.0, 0.0, 0.0], [3.0, 0.2, 0.1], [0.3, 2.0, 0.9]], [[0.0, 0.0, 5.0], [-0.2, 3.0, 6.1], [2.0, 0.4, 7.7]]])
    planes = find_mesh_planes(corners, 1e-4)
    assert len(planes.drawn) == 2
    check_bounds(planes, corners, 1e-4)


def test_distant_parallel_sheets_stay_separate_and_close_ones_merge():
    sheet = grid(8)
    both = np.concatenate([sheet, sheet + np.array([0.0, 0.0, 0.5])])
    assert len(find_mesh_planes(both, 0.02).drawn) == 2
    assert len(find_mesh_planes(both, 0.3).drawn) == 1


def test_planes_are_two_sided():
    sheet = grid(4)
    planes = find_mesh_planes(np.concatenate([sheet, sheet[:, ::-1]]), 0.01)
    assert len(planes.drawn) == 1
    assert len(planes.drawn[0]) == 2 * len(sheet)


def test_distant_parts_of_one_plane_are_separate_regions():
    sheet = grid(8)
    planes = find_mesh_planes(np.concatenate([sheet, sheet + np.array([9.0, 0.0, 0.0])]), 0.05)
    assert len(planes.drawn) == 2
    np.testing.assert_allclose(planes.normals[0], planes.normals[1])
    assert planes.offsets[0] == planes.offsets[1]
    assert sorted(len(drawn) for drawn in planes.drawn) == [len(sheet), len(sheet)]


def test_faces_close_to_a_plane_are_drawn_on_it():
    """This closes gaps: next to a ridge, faces of one side that are within the error of the other side's plane are drawn on both."""
    ridge = grid(20, lambda x, y: np.abs(x - 0.5) + 0.0 * y)
    planes = find_mesh_planes(ridge, 0.05)
    assert sum(len(drawn) for drawn in planes.drawn) > len(ridge)
    check_bounds(planes, ridge, 0.05)


def test_points_are_covered():
    random = np.random.default_rng(3)
    points = random.normal(size=(400, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    planes = run_to_end(find_planes(points[:, None], np.full(400, 0.03), points, 0.1, 0))
    check_bounds(planes, points[:, None], 0.1)
    assert len(planes.drawn) < 60


def test_equal_seeds_give_equal_bytes():
    wave = grid(12, lambda x, y: 0.2 * np.sin(5.0 * x) * np.cos(4.0 * y))
    first, second = find_mesh_planes(wave, 0.02, seed=5), find_mesh_planes(wave, 0.02, seed=5)
    assert first.normals.tobytes() == second.normals.tobytes()
    assert first.owner.tobytes() == second.owner.tobytes()


@pytest.mark.slow
def test_larger_error_needs_fewer_planes():
    wave = grid(16, lambda x, y: 0.2 * np.sin(5.0 * x) * np.cos(4.0 * y))
    counts = [len(find_mesh_planes(wave, error).drawn) for error in (0.01, 0.03, 0.1)]
    assert counts[0] > counts[1] > counts[2]


@pytest.mark.parametrize(("gap", "regions"), [(0.2, 1), (6.0, 2)])
def test_regions_are_split_only_if_that_saves_half_the_rectangle(gap, regions):
    sheet = grid(6)
    corners = np.concatenate([sheet, sheet + np.array([1.0 + gap, 0.0, 0.0])])
    masks = split_into_regions(corners, np.ones(len(corners), bool), np.array([0.0, 0.0, 1.0]), 0.02)
    assert len(masks) == regions
    assert np.logical_or.reduce(masks).all()


def test_component_that_owns_nothing_gets_no_region():
    sheet = grid(6)
    corners = np.concatenate([sheet, sheet + np.array([7.0, 0.0, 0.0])])
    owned = np.arange(len(corners)) < len(sheet)
    masks = split_into_regions(corners, owned, np.array([0.0, 0.0, 1.0]), 0.02)
    assert len(masks) == 1
    np.testing.assert_array_equal(masks[0], owned)
