"""Coverage before a merge: green, blue and red triangles of Figure 7, against shapes with a known answer."""

import numpy as np
import pytest

from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.photographs.photograph import Photograph
from farfield.addon.core.photos.previews import INTERPOLATED, PHOTOGRAPHED, UNBOUND, classify_triangles, measure_classes
from photo_scenes import box, camera_at, grid

SIZE = (300, 240)


def blank(camera, mask=None):
    return Photograph(camera, np.zeros((SIZE[1], SIZE[0], 3), np.uint8), mask)


def halves(overlap):
    """Two photographs of the square from above; the first shows its left part up to x = overlap, the second its right part from -overlap.

    300 pixels per unit of depth, 3 units away: 100 pixels per unit.
    """
    photographs = []
    for index, sign in enumerate((-1.0, 1.0)):
        mask = np.zeros((SIZE[1], SIZE[0]), bool)
        limit = 150 + round(100 * overlap * -sign)
        mask[:, slice(None, limit) if sign < 0 else slice(limit, None)] = True
        photographs.append(blank(camera_at((0.0, 0.0, 3.0), name=f"{index}.png"), mask))
    return photographs


def classes_of(mesh, photographs):
    return run_to_end(classify_triangles(mesh, photographs, len(photographs)))


def test_a_plane_that_one_photograph_shows_is_green():
    mesh, _ = grid(6)
    classes = classes_of(mesh, [blank(camera_at((0.0, 0.0, 3.5)))])
    assert (classes == PHOTOGRAPHED).all()
    assert measure_classes(mesh, classes) == {PHOTOGRAPHED: pytest.approx(1.0), INTERPOLATED: 0.0, UNBOUND: 0.0}


def test_triangles_between_two_photographs_are_blue():
    """Vertices lie at multiples of 0.4 from -1; masks divide the square at x = 0, so the triangles from -0.2 to 0.2 have no common one."""
    mesh, _ = grid(5)
    classes = classes_of(mesh, halves(0.0))
    is_between = (np.abs(mesh.corners[..., 0]) < 0.3).all(axis=1)
    assert (classes[is_between] == INTERPOLATED).all() and (classes[~is_between] == PHOTOGRAPHED).all()
    assert measure_classes(mesh, classes)[INTERPOLATED] == pytest.approx(0.2)


def test_photographs_that_overlap_by_a_triangle_leave_nothing_blue():
    mesh, _ = grid(5)
    assert (classes_of(mesh, halves(0.3)) == PHOTOGRAPHED).all()


def test_triangles_with_a_hidden_vertex_are_red():
    mesh, _ = grid(5)
    classes = classes_of(mesh, halves(0.0)[:1])
    is_red = (mesh.corners[..., 0] > 0.1).any(axis=1)
    assert (classes[is_red] == UNBOUND).all() and (classes[~is_red] == PHOTOGRAPHED).all()


def test_the_back_of_a_box_is_red():
    mesh, _ = box()
    classes = classes_of(mesh, [blank(camera_at((0.0, 0.0, 6.0)))])
    assert (classes[mesh.corners[..., 2].max(axis=1) < 0.0] == UNBOUND).all()


def test_a_mesh_far_from_the_origin_has_the_same_classes():
    mesh, _ = grid(5)
    offset = np.array([3e5, -4e5, 5e3])
    moved = TriangleMesh(mesh.vertices + offset, mesh.triangles)
    photographs = [Photograph(each.camera.relative_to(-offset), each.pixels, each.mask) for each in halves(0.0)]
    assert np.array_equal(classes_of(moved, photographs), classes_of(mesh, halves(0.0)))


def test_the_order_of_photographs_does_not_matter():
    mesh, _ = grid(5)
    assert np.array_equal(classes_of(mesh, halves(0.0)), classes_of(mesh, halves(0.0)[::-1]))


def test_no_area_and_coordinates_that_are_not_finite():
    mesh = TriangleMesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))
    assert sum(measure_classes(mesh, np.array([UNBOUND])).values()) == 0.0
    with pytest.raises(GeometryError):
        run_to_end(classify_triangles(TriangleMesh(np.full((3, 3), np.nan), mesh.triangles), [], 1))
