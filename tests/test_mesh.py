"""Meshes are measured and told apart as geometry says: areas, zero-area faces, connected parts, solids, leaves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.errors import GeometryError
from farfield.addon.core.mesh import (
    TriangleMesh,
    check_points,
    connected_parts,
    face_areas_and_normals,
    longest_side,
    loose_parts,
    merge,
    solid_parts,
    without_zero_area,
)
from shapes import box, cards, cylinder, rotation, sheet, soup, sphere

TRIANGLE = np.array([[0, 1, 2]], np.int32)


def volume(mesh: TriangleMesh) -> float:
    return float(np.linalg.det(mesh.corners).sum() / 6.0)


def parts_of(mesh: TriangleMesh) -> np.ndarray:
    return connected_parts(mesh.vertices, mesh.triangles)


def is_solid(mesh: TriangleMesh) -> np.ndarray:
    return solid_parts(mesh.vertices, mesh.triangles, parts_of(mesh))


def turned_inside_out(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1].copy())


class TestMeasures:
    """Areas, normals, sides."""

    def test_a_right_triangle(self):
        areas, normals = face_areas_and_normals(np.array([[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]]]))
        np.testing.assert_array_equal(areas, [6.0])
        np.testing.assert_array_equal(normals, [[0.0, 0.0, 1.0]])

    def test_no_area_has_no_normal(self):
        areas, normals = face_areas_and_normals(np.zeros((1, 3, 3)))
        assert areas == [0.0] and not normals.any()

    @given(st.integers(0, 2**32 - 1))
    def test_turning_turns_normals_and_keeps_areas(self, seed):
        corners, turn = soup(20, seed=seed).corners, rotation(seed)
        areas, normals = face_areas_and_normals(corners)
        turned_areas, turned_normals = face_areas_and_normals(corners @ turn.T)
        np.testing.assert_allclose(turned_areas, areas)
        np.testing.assert_allclose(turned_normals, normals @ turn.T, atol=1e-12)

    def test_the_area_vectors_of_a_closed_mesh_cancel(self):
        for closed in (sphere(), box((1.0, 2.0, 3.0))):
            areas, normals = face_areas_and_normals(closed.corners)
            np.testing.assert_allclose(areas @ normals, 0.0, atol=1e-12)
            assert volume(closed) > 0.0

    def test_the_longest_side(self):
        assert longest_side(box((1.0, 5.0, 3.0)).vertices) == 5.0


class TestRefusals:
    """Each sentence names whose geometry it is."""

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_coordinates_that_are_no_numbers(self, bad):
        mesh = sheet(2)
        mesh.vertices[4, 1] = bad
        with pytest.raises(GeometryError, match=r'"Sail" has 1 vertices .* not finite'):
            without_zero_area(mesh, "Sail")

    def test_a_bad_vertex_that_no_face_uses_is_no_harm(self):
        mesh = sheet(2)
        stray = TriangleMesh(np.vstack([mesh.vertices, [np.nan, 0.0, 0.0]]), mesh.triangles)
        assert len(without_zero_area(stray)[1]) == len(mesh.triangles)

    def test_no_faces(self):
        with pytest.raises(GeometryError, match='"Bare" has no faces'):
            without_zero_area(TriangleMesh(np.eye(3), np.empty((0, 3), np.int32)), "Bare")

    def test_no_points(self):
        with pytest.raises(GeometryError, match='"None" has no vertices'):
            check_points(np.empty((0, 3)), "None")

    def test_all_in_one_place(self):
        with pytest.raises(GeometryError, match='"Dot"'):
            without_zero_area(TriangleMesh(np.ones((3, 3)), TRIANGLE), "Dot")

    def test_all_faces_without_area(self):
        line = TriangleMesh(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]), TRIANGLE)
        with pytest.raises(GeometryError, match='Every face of "Line" has zero area'):
            without_zero_area(line, "Line")


class TestZeroArea:
    """Faces without area go, in any unit of length; the others stay."""

    @pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
    def test_they_are_dropped_and_the_rest_is_numbered(self, unit):
        good = sheet(3)
        bad = np.array([[0, 0, 5], [0, 4, 8]], np.int32)  # a doubled corner, three corners in a row
        mixed = TriangleMesh(
            unit * good.vertices, np.concatenate([good.triangles[:7], bad, good.triangles[7:]]), np.arange(20, dtype=np.int32)
        )
        mesh, kept = without_zero_area(mixed)
        np.testing.assert_array_equal(kept, np.delete(np.arange(20), [7, 8]))
        np.testing.assert_array_equal(mesh.triangles, good.triangles)
        np.testing.assert_array_equal(mesh.materials, kept)

    def test_nothing_to_drop(self):
        mesh, kept = without_zero_area(soup(30))
        assert len(kept) == len(mesh.triangles) == 30


class TestParts:
    """What hangs together."""

    def test_points_at_one_place_join_faces(self):
        assert len(np.unique(parts_of(box()))) == 1  # its six faces share no vertex, only places

    def test_pieces_keep_apart(self):
        parts = parts_of(merge([sphere(4), cards(10), cylinder()]))
        assert len(np.unique(parts)) == 12
        np.testing.assert_array_equal(np.unique(parts), np.arange(12))

    def test_touching_at_one_corner_is_enough(self):
        flat = sheet(1)
        touching = merge([flat, TriangleMesh(flat.vertices + [1.0, 1.0, 0.0], flat.triangles)])
        beside = merge([flat, TriangleMesh(flat.vertices + [1.0, 1.1, 0.0], flat.triangles)])
        assert len(np.unique(parts_of(touching))) == 1
        assert len(np.unique(parts_of(beside))) == 2

    def test_merged_meshes_keep_their_corners_and_materials(self):
        first, second = sheet(2), TriangleMesh(soup(3).vertices, soup(3).triangles, np.array([4, 5, 6], np.int32))
        both = merge([first, second])
        np.testing.assert_array_equal(both.corners, np.concatenate([first.corners, second.corners]))
        np.testing.assert_array_equal(both.materials, [-1] * 8 + [4, 5, 6])
        assert both.triangles.dtype == np.int32


class TestSolids:
    """A solid is closed, or nearly, and looks outwards."""

    @pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
    @pytest.mark.parametrize("closed", [box(), sphere(), box((1.0, 1.0, 0.1))], ids=["cube", "sphere", "tile"])
    def test_closed_shapes(self, closed, unit):
        assert is_solid(TriangleMesh(unit * closed.vertices + unit, closed.triangles)).all()

    @pytest.mark.parametrize("closed", [box(), sphere()], ids=["cube", "sphere"])
    def test_inside_out_they_are_none(self, closed):
        assert not is_solid(turned_inside_out(closed)).any()

    def test_a_small_hole_is_overlooked(self):
        ball = sphere()
        assert is_solid(TriangleMesh(ball.vertices, ball.triangles[1:])).all()

    def test_a_cup_a_tube_a_sheet_and_leaves_are_none(self):
        ball = sphere()
        cup = TriangleMesh(ball.vertices, ball.triangles[ball.corners[:, :, 2].mean(axis=1) < 0.0])
        for open_shape in (cup, cylinder(), sheet(), cards(20)):
            assert not is_solid(open_shape).any()

    def test_a_folded_sheet_is_none(self):
        """Two sides of one sheet close each other, and hold no volume."""
        flat = sheet(4)
        assert not is_solid(merge([flat, turned_inside_out(flat)])).any()

    def test_each_part_is_judged_by_itself(self):
        ball, leaves = sphere(4), cards(9)
        np.testing.assert_array_equal(is_solid(merge([ball, leaves])), np.arange(len(ball.triangles) + 18) < len(ball.triangles))


class TestLooseParts:
    """Leaves are told from the trunk."""

    def test_cards_around_a_trunk(self):
        trunk, leaves = cylinder(radius=0.1), cards(150)
        tree = merge([trunk, leaves])
        loose = loose_parts(tree.vertices, tree.triangles, parts_of(tree))
        np.testing.assert_array_equal(loose, np.arange(len(tree.triangles)) >= len(trunk.triangles))

    def test_one_surface_is_never_loose(self):
        for whole in (sphere(), sheet(2), sheet(1)):
            assert not loose_parts(whole.vertices, whole.triangles, parts_of(whole)).any()

    def test_a_large_part_of_few_triangles_is_not_loose(self):
        board = TriangleMesh(4.0 * sheet(1).vertices, sheet(1).triangles)
        both = merge([board, cards(50)])
        loose = loose_parts(both.vertices, both.triangles, parts_of(both))
        np.testing.assert_array_equal(loose, np.arange(len(both.triangles)) >= 2)
