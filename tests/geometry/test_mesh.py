"""Areas, normals, input checks, connected components, solids and loose components of meshes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.mesh import (
    TriangleMesh,
    check_points,
    concatenate,
    connected_components,
    drop_degenerate,
    face_areas_and_normals,
    fingerprint,
    longest_side,
    loose_components,
    solid_components,
)
from shapes import box, cylinder, leaf_cards, random_rotation, sheet, soup, sphere

TRIANGLE = np.array([[0, 1, 2]], np.int32)


def volume(mesh: TriangleMesh) -> float:
    return float(np.linalg.det(mesh.corners).sum() / 6.0)


def components_of(mesh: TriangleMesh) -> np.ndarray:
    return connected_components(mesh.vertices, mesh.triangles)


def is_solid(mesh: TriangleMesh) -> np.ndarray:
    return solid_components(mesh.vertices, mesh.triangles, components_of(mesh))


def flip(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1].copy())


class TestMeasures:
    """Areas, normals, sides."""

    def test_right_triangle(self):
        areas, normals = face_areas_and_normals(np.array([[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]]]))
        np.testing.assert_array_equal(areas, [6.0])
        np.testing.assert_array_equal(normals, [[0.0, 0.0, 1.0]])

    def test_zero_area_gives_a_zero_normal(self):
        areas, normals = face_areas_and_normals(np.zeros((1, 3, 3)))
        assert areas == [0.0] and not normals.any()

    @settings(max_examples=30)
    @given(st.integers(0, 2**32 - 1))
    def test_rotation_rotates_normals_and_keeps_areas(self, seed):
        corners, rotation = soup(20, seed=seed).corners, random_rotation(seed)
        areas, normals = face_areas_and_normals(corners)
        rotated_areas, rotated_normals = face_areas_and_normals(corners @ rotation.T)
        np.testing.assert_allclose(rotated_areas, areas)
        np.testing.assert_allclose(rotated_normals, normals @ rotation.T, atol=1e-12)

    def test_area_vectors_of_a_closed_mesh_cancel(self):
        for closed in (sphere(), box((1.0, 2.0, 3.0))):
            areas, normals = face_areas_and_normals(closed.corners)
            np.testing.assert_allclose(areas @ normals, 0.0, atol=1e-12)
            assert volume(closed) > 0.0

    def test_longest_side(self):
        assert longest_side(box((1.0, 5.0, 3.0)).vertices) == 5.0


class TestInputChecks:
    """Every error message names the object."""

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_coordinates_that_are_not_finite(self, bad):
        mesh = sheet(2)
        mesh.vertices[4, 1] = bad
        with pytest.raises(GeometryError, match=r'"Sail" has 1 vertex .* not finite'):
            drop_degenerate(mesh, "Sail")

    def test_an_invalid_unused_vertex_is_ignored(self):
        mesh = sheet(2)
        mesh_with_unused = TriangleMesh(np.vstack([mesh.vertices, [np.nan, 0.0, 0.0]]), mesh.triangles)
        assert len(drop_degenerate(mesh_with_unused)[1]) == len(mesh.triangles)

    def test_no_faces(self):
        with pytest.raises(GeometryError, match='"Bare" has no faces'):
            drop_degenerate(TriangleMesh(np.eye(3), np.empty((0, 3), np.int32)), "Bare")

    def test_no_points(self):
        with pytest.raises(GeometryError, match='"None" has no vertices'):
            check_points(np.empty((0, 3)), "None")

    def test_all_at_the_same_position(self):
        with pytest.raises(GeometryError, match='"Dot"'):
            drop_degenerate(TriangleMesh(np.ones((3, 3)), TRIANGLE), "Dot")

    def test_all_faces_without_area(self):
        line = TriangleMesh(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]), TRIANGLE)
        with pytest.raises(GeometryError, match='Every face of "Line" has zero area'):
            drop_degenerate(line, "Line")

    def test_coordinates_near_the_end_of_single_precision(self):
        vertices = box().vertices.copy()
        drop_degenerate(TriangleMesh(1e36 * vertices, box().triangles))
        vertices[0] = [-3e38, 0.0, 0.0]
        with pytest.raises(GeometryError, match=r'"Far" has 1 vertex with coordinates above 1e\+37; move them closer'):
            drop_degenerate(TriangleMesh(vertices, box().triangles), "Far")


class TestZeroArea:
    """Faces without area are dropped, in any unit of length; the others stay."""

    @pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
    def test_they_are_dropped_and_the_kept_indices_returned(self, unit):
        good = sheet(3)
        bad = np.array([[0, 0, 5], [0, 4, 8]], np.int32)  # a repeated corner, three collinear corners
        mixed = TriangleMesh(
            unit * good.vertices, np.concatenate([good.triangles[:7], bad, good.triangles[7:]]), np.arange(20, dtype=np.int32)
        )
        mesh, kept = drop_degenerate(mixed)
        np.testing.assert_array_equal(kept, np.delete(np.arange(20), [7, 8]))
        np.testing.assert_array_equal(mesh.triangles, good.triangles)
        np.testing.assert_array_equal(mesh.materials, kept)

    @pytest.mark.parametrize("distance", [1e7, 1e12])
    def test_small_faces_at_large_distances_stay(self, distance):
        far = TriangleMesh(box().vertices + [distance, 0.0, 0.0], box().triangles)
        both = concatenate([box(), far])
        assert len(drop_degenerate(both)[1]) == len(both.triangles)

    def test_a_height_from_rounding_does_not_count_as_area(self):
        line = np.array([[0.1, 0.1, 0.1], [0.4, 0.4, 0.4], [0.7, 0.7, 0.7]]) + 1e6  # collinear before rounding
        mixed = concatenate([box(), TriangleMesh(line, TRIANGLE)])
        assert len(drop_degenerate(mixed)[1]) == len(box().triangles)

    @pytest.mark.filterwarnings("error::RuntimeWarning")
    def test_parts_without_area_are_not_solid(self):
        mixed = concatenate([box(), TriangleMesh(np.array([[9.0, 0.0, 0.0], [9.5, 0.0, 0.0], [10.0, 0.0, 0.0]]), TRIANGLE)])
        np.testing.assert_array_equal(is_solid(mixed), np.arange(len(mixed.triangles)) < len(box().triangles))

    def test_meshes_without_them_are_unchanged(self):
        mesh, kept = drop_degenerate(soup(30))
        assert len(kept) == len(mesh.triangles) == 30


class TestComponents:
    """Connected components."""

    def test_points_at_the_same_position_connect_faces(self):
        assert len(np.unique(components_of(box()))) == 1  # its six faces share no vertex, only positions

    def test_separate_meshes_are_separate_components(self):
        components = components_of(concatenate([sphere(4), leaf_cards(10), cylinder()]))
        assert len(np.unique(components)) == 12
        np.testing.assert_array_equal(np.unique(components), np.arange(12))

    def test_one_shared_corner_connects(self):
        flat = sheet(1)
        touching = concatenate([flat, TriangleMesh(flat.vertices + [1.0, 1.0, 0.0], flat.triangles)])
        separate = concatenate([flat, TriangleMesh(flat.vertices + [1.0, 1.1, 0.0], flat.triangles)])
        assert len(np.unique(components_of(touching))) == 1
        assert len(np.unique(components_of(separate))) == 2

    def test_concatenation_keeps_corners_and_materials(self):
        first, second = sheet(2), TriangleMesh(soup(3).vertices, soup(3).triangles, np.array([4, 5, 6], np.int32))
        both = concatenate([first, second])
        np.testing.assert_array_equal(both.corners, np.concatenate([first.corners, second.corners]))
        np.testing.assert_array_equal(both.materials, [-1] * 8 + [4, 5, 6])
        assert both.triangles.dtype == np.int32


class TestSolids:
    """A solid is closed, or nearly so, and faces outwards."""

    @pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
    @pytest.mark.parametrize("closed", [box(), sphere(), box((1.0, 1.0, 0.1))], ids=["cube", "sphere", "tile"])
    def test_closed_shapes(self, closed, unit):
        assert is_solid(TriangleMesh(unit * closed.vertices + unit, closed.triangles)).all()

    @pytest.mark.parametrize("closed", [box(), sphere()], ids=["cube", "sphere"])
    def test_inside_out_shapes_are_not_solid(self, closed):
        assert not is_solid(flip(closed)).any()

    def test_a_small_hole_is_ignored(self):
        ball = sphere()
        assert is_solid(TriangleMesh(ball.vertices, ball.triangles[1:])).all()

    def test_a_cup_a_tube_a_sheet_and_leaves_are_not_solid(self):
        ball = sphere()
        cup = TriangleMesh(ball.vertices, ball.triangles[ball.corners[:, :, 2].mean(axis=1) < 0.0])
        for open_shape in (cup, cylinder(), sheet(), leaf_cards(20)):
            assert not is_solid(open_shape).any()

    def test_a_folded_sheet_is_not_solid(self):
        """Both sides of one sheet form a closed surface without volume."""
        flat = sheet(4)
        assert not is_solid(concatenate([flat, flip(flat)])).any()

    def test_components_are_classified_separately(self):
        ball, leaves = sphere(4), leaf_cards(9)
        np.testing.assert_array_equal(is_solid(concatenate([ball, leaves])), np.arange(len(ball.triangles) + 18) < len(ball.triangles))


class TestLooseComponents:
    """Leaves are loose, the trunk is not."""

    def test_leaf_cards_around_a_trunk(self):
        trunk, leaves = cylinder(radius=0.1), leaf_cards(150)
        tree = concatenate([trunk, leaves])
        loose = loose_components(tree.vertices, tree.triangles, components_of(tree))
        np.testing.assert_array_equal(loose, np.arange(len(tree.triangles)) >= len(trunk.triangles))

    def test_one_surface_is_never_loose(self):
        for mesh in (sphere(), sheet(2), sheet(1)):
            assert not loose_components(mesh.vertices, mesh.triangles, components_of(mesh)).any()

    def test_a_large_component_of_few_triangles_is_not_loose(self):
        board = TriangleMesh(4.0 * sheet(1).vertices, sheet(1).triangles)
        both = concatenate([board, leaf_cards(50)])
        loose = loose_components(both.vertices, both.triangles, components_of(both))
        np.testing.assert_array_equal(loose, np.arange(len(both.triangles)) >= 2)


class TestFingerprint:
    """It tells whether a geometry was edited or moved."""

    def test_it_changes_with_a_move_and_with_an_edit(self):
        ball = sphere(4)
        edited = ball.vertices.copy()
        edited[3] += 1e-3
        variants = [ball.vertices, ball.vertices + [0.01, 0.0, 0.0], ball.vertices + 5.0, edited]
        assert len({fingerprint(vertices, ball.triangles) for vertices in variants}) == 4
        assert fingerprint(ball.vertices, ball.triangles) == fingerprint(ball.vertices.copy(), ball.triangles)

    @pytest.mark.filterwarnings("error::RuntimeWarning")
    def test_far_from_the_origin(self):
        side = 1e15  # some units of the last place of a coordinate of 1e30
        points = 1e30 + side * sphere(2).vertices
        edited = points.copy()
        edited[0] += side
        assert fingerprint(points, sphere(2).triangles) != fingerprint(edited, sphere(2).triangles)
