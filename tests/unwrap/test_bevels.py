"""Bevels: bodies with rounded and chamfered edges are cut in the middle of these, one island per face; smooth bodies are not divided."""

import numpy as np
import pytest

from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.cutting.bevels import divide_at_bevels
from farfield.addon.core.unwrap.cutting.chart import Chart
from farfield.addon.core.unwrap.cutting.creases import find_creases
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.core.unwrap.unwrapping import UnwrapResult, unwrap
from shapes import box, cylinder, sheet, sphere

pytestmark = pytest.mark.usefixtures("coarse_packing")
SIDES = 1.0, 0.6, 0.4


def round_box(segments: int, radius: float = 0.05, sides: tuple = SIDES) -> TriangleMesh:
    """A box with rounded edges of so many segments: a grid of each face, whose outermost cells are pulled onto cylinders and spheres."""
    half = 0.5 * np.array(sides)
    turns = np.tan(np.linspace(0.0, 0.25 * np.pi, segments // 2 + 1)) if segments > 1 else np.zeros(1)
    grids = [np.concatenate([-half[axis] - radius * turns[::-1], half[axis] + radius * turns]) for axis in range(3)]
    vertices, triangles, count = [], [], 0
    for axis in range(3):
        u_axis, v_axis = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1.0, 1.0):
            u, v = np.meshgrid(grids[u_axis], grids[v_axis], indexing="ij")
            points = np.zeros((*u.shape, 3))
            points[..., axis], points[..., u_axis], points[..., v_axis] = sign * (half[axis] + radius), u, v
            core = np.clip(points, -half, half)
            away = points - core
            vertices.append((core + radius * away / np.linalg.norm(away, axis=-1, keepdims=True)).reshape(-1, 3))
            index = np.arange(u.size).reshape(u.shape) + count
            a, b, c, d = (
                index[i, j].ravel()
                for i, j in ((np.s_[:-1], np.s_[:-1]), (np.s_[1:], np.s_[:-1]), (np.s_[1:], np.s_[1:]), (np.s_[:-1], np.s_[1:]))
            )
            quads = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
            triangles.append(quads if sign > 0.0 else quads[:, ::-1])
            count += u.size
    points, indices = np.unique(np.round(np.concatenate(vertices), 9), axis=0, return_inverse=True)
    return TriangleMesh(points, indices.reshape(-1)[np.concatenate(triangles)].astype(np.int32))


def label_faces(mesh: TriangleMesh) -> np.ndarray:
    halfedges = find_edges(mesh.triangles).interior_halfedges
    creases = find_creases(mesh.vertices, mesh.triangles, halfedges)
    zeros = np.zeros(len(mesh.triangles), int)
    surface = Chart(mesh.vertices, mesh.triangles, np.ones(len(zeros)), np.arange(len(zeros)) // 2)
    return divide_at_bevels(surface, halfedges, creases, zeros, zeros)


def unwrap_mesh(mesh: TriangleMesh) -> UnwrapResult:
    count = len(mesh.triangles)
    polygon_ids = np.arange(count) // 2
    result = run_to_end(unwrap(mesh, polygon_ids, np.zeros((0, 2), int), np.zeros(count), UnwrapSettings()))
    assert result.metrics.flips == result.metrics.overlaps == 0
    is_common = mesh.triangles[::2, :, None] == mesh.triangles[1::2, None]  # Two corners of both triangles of each quad.
    quad, first, second = np.nonzero(is_common)
    np.testing.assert_allclose(result.corner_uvs[2 * quad, first], result.corner_uvs[2 * quad + 1, second], atol=1e-9)
    return result


@pytest.mark.parametrize("segments", [2, 4, 6, 12])
@pytest.mark.parametrize("sides", [SIDES, (1.0, 1.0, 1.0), (1.0, 0.2, 0.05)])
def test_a_box_with_rounded_edges_has_six_faces(segments, sides):
    mesh = round_box(segments, 0.02 * sides[0], sides)
    areas, normals = face_areas_and_normals(mesh.corners)
    assert len(find_edges(mesh.triangles).ends) == 1.5 * len(mesh.triangles) and areas.min() > 0.0
    labels = label_faces(mesh)
    assert len(np.unique(labels)) == 6
    for label in range(labels.max() + 1):
        members = labels == label
        if members.any():
            mean = (areas[:, None] * normals)[members].sum(axis=0)
            assert (normals[members] @ mean / np.linalg.norm(mean)).min() > 0.45  # Each ends in the middle of its bevels.


@pytest.mark.parametrize("segments", [2, 4, 6])
def test_faces_with_rounded_edges_stay_rectangles(segments):
    result = unwrap_mesh(round_box(segments))
    assert result.chart_count <= 6
    assert result.metrics.symmetric_dirichlet < 4.1 and result.metrics.fill > 0.6


@pytest.mark.parametrize(
    "mesh", [sphere(), cylinder(radius=0.5, length=2.0, sides=32, cuts=4), box(cuts=3)], ids=["sphere", "cylinder", "box"]
)
def test_bodies_without_bevels_are_not_divided(mesh):
    points, indices = np.unique(np.round(mesh.vertices, 9), axis=0, return_inverse=True)
    assert (label_faces(TriangleMesh(points, indices.reshape(-1)[mesh.triangles].astype(np.int32))) == 0).all()


@pytest.mark.parametrize(("height", "is_rough"), [(1e-4, False), (0.02, True)])
def test_a_fine_rough_surface_is_not_divided(height, is_rough):
    """It has more facets than the square root of the largest 32-bit integer, with `is_rough` all of them sharply curved."""
    mesh = sheet(155)
    heights = height * np.random.default_rng(5).uniform(-1.0, 1.0, len(mesh.vertices))
    if not is_rough:
        heights[np.abs(mesh.vertices[:, 0]) < 0.5 * np.abs(mesh.vertices[:, 0]).max()] *= 40.0
    assert (label_faces(TriangleMesh(mesh.vertices + heights[:, None] * [0.0, 0.0, 1.0], mesh.triangles)) == 0).all()
