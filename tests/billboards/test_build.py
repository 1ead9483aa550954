"""A cloud keeps its bounds whatever the method, and shapes with a known answer get it."""

import numpy as np
import pytest

from farfield.addon.core.billboards.build import build
from farfield.addon.core.billboards.cloud import Cloud, Level
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.errors import GeometryError, SettingsError
from farfield.addon.core.mesh import PointCloud, TriangleMesh, face_areas_and_normals, merge
from farfield.addon.core.points import splat_radii
from farfield.addon.core.progress import finish
from shapes import box, bumpy_sphere, cards, cylinder, sheet, soup, sphere

METHODS = ("clusters", "hough", "decimate")
UP = [0.0, 0.0, 1.0]


def cloud_of(source: TriangleMesh | PointCloud, **how) -> Cloud:
    return finish(build(source, BillboardSettings(**({"levels": 1, "error": 0.04} | how)), "Shape"))


def drawn_pairs(level: Level) -> tuple[np.ndarray, np.ndarray]:
    """The primitive and the quad (K,) of every drawing."""
    return level.quads.drawn, np.repeat(np.arange(len(level.quads)), np.diff(level.quads.drawn_offsets))


def heights(level: Level, corners: np.ndarray, quad: np.ndarray) -> np.ndarray:
    """Heights (K, C) of `corners` (K, C, 3) over the planes of the quads (K,)."""
    quads = level.quads
    return np.einsum("kci,ki->kc", corners - quads.centers[quad][:, None], quads.frames[quad, 2])


def ball_of_points(count: int = 400) -> PointCloud:
    height = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    turn = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    flat = np.sqrt(1.0 - height**2)
    points = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    return PointCloud(points, points, splat_radii(points))


class TestBounds:
    """What holds for every face of every mesh."""

    @pytest.mark.parametrize(
        ("mesh", "method"),
        [
            (sphere(8), "clusters"),
            (sphere(8), "hough"),
            (box(cuts=2), "decimate"),
            (soup(40), "clusters"),
            (soup(40), "hough"),
            (soup(8), "decimate"),
        ],
        ids=lambda value: value if isinstance(value, str) else f"{len(value.triangles)} triangles",
    )
    def test_every_drawn_corner_is_within_the_error_of_the_plane(self, mesh, method):
        cloud = cloud_of(mesh, method=method, error=0.08)
        (level,) = cloud.levels
        drawn, quad = drawn_pairs(level)
        distance = np.abs(heights(level, mesh.corners[drawn], quad)).max()
        assert distance <= level.error == pytest.approx(0.08 * cloud.longest_side)
        assert cloud.max_plane_distance == pytest.approx(distance / level.error, abs=1e-9)
        assert set(drawn) == set(range(len(mesh.triangles)))
        assert cloud.uncovered_faces == 0

    @pytest.mark.parametrize("degrees", [20.0, 60.0])
    @pytest.mark.parametrize("mesh", [sphere(8), bumpy_sphere(), soup(50), cards(50)], ids=["sphere", "bumpy", "soup", "cards"])
    def test_clusters_keep_the_normal_bound_on_every_quad_that_draws_a_face(self, mesh, degrees):
        cloud = cloud_of(mesh, max_normal_deviation=np.radians(degrees), levels=2)
        _, normals = face_areas_and_normals(mesh.corners)
        for level in cloud.levels:
            drawn, quad = drawn_pairs(level)
            facing = np.einsum("ki,ki->k", normals[drawn], level.quads.frames[quad, 2])
            assert facing.min() >= np.cos(np.radians(degrees)) - 1e-9
        assert cloud.faces_beyond_normal_bound == 0

    @pytest.mark.parametrize("method", ["clusters", "hough"])
    def test_how_many_owned_faces_break_it_is_told(self, method):
        mesh = sphere(6)
        cloud = cloud_of(mesh, method=method, error=0.1)
        _, normals = face_areas_and_normals(mesh.corners)
        quads = cloud.levels[0].quads
        facing = np.einsum("ti,ti->t", normals, quads.frames[quads.owner, 2])
        facing = np.abs(facing) if method == "hough" else facing  # a Hough plane serves both of its sides
        assert cloud.faces_beyond_normal_bound == (facing < 0.5).sum()

    @pytest.mark.parametrize("method", METHODS)
    def test_an_owner_draws_what_it_owns_inside_its_rectangle_and_cutout(self, method):
        mesh = box(cuts=2) if method == "decimate" else bumpy_sphere(8)  # decimate takes long over what is not flat
        (level,) = cloud_of(mesh, method=method, error=0.08).levels
        quads = level.quads
        for number, (first, last) in enumerate(zip(quads.drawn_offsets[:-1], quads.drawn_offsets[1:], strict=True)):
            drawn, owned = quads.drawn[first:last], np.flatnonzero(quads.owner == number)
            assert (np.diff(drawn) > 0).all()
            assert np.isin(owned, drawn).all()
            if method == "decimate" and len(level.cutouts[number]) == 3:
                continue  # what reaches over the sides of a triangle is drawn beside it
            local = ((mesh.corners[owned] - quads.centers[number]) @ quads.frames[number, :2].T / quads.half_sizes[number]).reshape(-1, 2)
            polygon = level.cutouts[number]
            sides = np.roll(polygon, -1, axis=0) - polygon
            away = local[:, None] - polygon
            assert (sides[:, 0] * away[:, :, 1] - sides[:, 1] * away[:, :, 0]).min(initial=0.0) >= -1e-5

    @pytest.mark.parametrize("method", METHODS)
    def test_equal_seeds_give_equal_bytes(self, method):
        mesh = box(cuts=2) if method == "decimate" else bumpy_sphere(8)
        first, second = (cloud_of(mesh, method=method, seed=3).levels[0] for _ in range(2))
        for name in ("centers", "frames", "half_sizes", "drawn_offsets", "drawn", "owner"):
            assert getattr(first.quads, name).tobytes() == getattr(second.quads, name).tobytes()
        assert first.atlas.rectangles.tobytes() == second.atlas.rectangles.tobytes()


class TestKnownShapes:
    """Box, plane, cylinder, leaves."""

    @pytest.mark.parametrize("method", ["clusters", "hough"])
    @pytest.mark.parametrize("sides", [(1.0, 1.0, 1.0), (1.0, 2.0, 3.0)])
    def test_a_box_gives_its_six_faces(self, sides, method):
        (level,) = cloud_of(box(sides), method=method, error=0.02).levels
        outwards = level.quads.frames[:, 2] * (-1.0 if method == "hough" else 1.0)  # a plane of hough serves both sides
        assert len(level.quads) == 6
        expected = np.concatenate([np.eye(3), -np.eye(3)])
        found = level.quads.centers / (0.5 * np.array(sides))
        np.testing.assert_allclose(found[np.lexsort(found.T.round(6))], expected[np.lexsort(expected.T)], atol=1e-9)
        np.testing.assert_allclose(np.abs(np.einsum("qi,qi->q", outwards, found)), 1.0)
        if method == "clusters":
            np.testing.assert_allclose(outwards, found, atol=1e-9)
            assert level.solid.all()

    @pytest.mark.parametrize("method", ["clusters", "hough"])
    def test_a_flat_sheet_is_one_quad_of_exactly_its_texels(self, method):
        (level,) = cloud_of(sheet(7), method=method, error=0.02).levels
        assert len(level.quads) == 1
        assert level.texels == level.atlas.texels == 100**2  # texels of 0.01 on a side of 1
        np.testing.assert_allclose(np.abs(level.quads.frames[0, 2]), UP, atol=1e-9)

    def test_a_decimated_flat_sheet_is_one_quad_that_takes_its_area_in_texels(self):
        (level,) = cloud_of(sheet(3), method="decimate", error=0.02).levels
        assert len(level.quads) == 1
        np.testing.assert_allclose(level.quads.frames[:, 2], [UP], atol=1e-9)
        assert level.texels == pytest.approx(100**2, rel=0.05)

    @pytest.mark.parametrize("error", [0.02, 0.05])
    def test_texels_are_area_over_texel_squared_and_waste(self, error):
        mesh = sphere(12)
        (level,) = cloud_of(mesh, error=error).levels
        assert level.atlas.texels == pytest.approx(level.quads.areas.sum() / level.texel**2, rel=0.02)
        area = face_areas_and_normals(mesh.corners)[0].sum()
        assert 0.75 <= level.texels * level.texel**2 / area <= 2.0  # a quad is a little smaller than the curved piece it stands for

    @pytest.mark.parametrize("degrees", [15.0, 30.0, 45.0, 60.0, 80.0])
    def test_a_cylinder_is_cut_where_the_angle_bound_says(self, degrees):
        """With no error to heed, a quad shows the sides whose normals lie within twice the bound."""
        sides = 72
        cloud = cloud_of(cylinder(sides=sides, cuts=2, length=1.0), error=0.25, max_normal_deviation=np.radians(degrees))
        shown_at_most = int(2.0 * degrees / (360.0 / sides) + 1e-9) + 1
        least = int(np.ceil(sides / shown_at_most))
        assert least <= len(cloud.levels[0].quads) <= 1.5 * least + 1.0

    @pytest.mark.parametrize("method", METHODS)
    def test_two_far_parallel_planes_stay_two(self, method):
        low = sheet(2)
        both = merge([low, TriangleMesh(low.vertices + [0.0, 0.0, 0.5], low.triangles)])
        (level,) = cloud_of(both, method=method).levels
        assert len(level.quads) == 2 or (method == "decimate" and len(level.quads) >= 4)
        off_plane = np.abs(level.quads.centers[:, 2, None] - [0.0, 0.5])
        assert off_plane.min(axis=1).max() <= (1e-9 if method != "decimate" else level.error)
        assert (off_plane.min(axis=0) <= level.error).all()
        assert not set(level.quads.owner[:8]) & set(level.quads.owner[8:])

    def test_leaves_and_trunk_never_meet_on_one_quad(self):
        trunk, leaves = cylinder(radius=0.1, sides=12, cuts=4), cards(100, spread=0.3)
        (level,) = cloud_of(merge([trunk, leaves])).levels
        drawn, quad = drawn_pairs(level)
        wooden = drawn < len(trunk.triangles)
        assert not set(quad[wooden]) & set(quad[~wooden])
        assert np.bincount(drawn)[len(trunk.triangles) :].max() == 1  # no leaf twice


class TestOddInput:
    """What looks odd is built, what cannot be is refused by name."""

    @pytest.mark.parametrize("method", METHODS)
    def test_zero_area_faces_are_dropped_and_counted(self, method):
        good = box(cuts=2)
        bad = np.array([[0, 0, 1], [3, 3, 3]], np.int32)
        mixed = TriangleMesh(good.vertices, np.concatenate([good.triangles[:5], bad, good.triangles[5:]]))
        cloud = cloud_of(mixed, method=method)
        quads = cloud.levels[0].quads
        assert (cloud.source_triangles, cloud.dropped_triangles) == (len(good.triangles) + 2, 2)
        np.testing.assert_array_equal(np.flatnonzero(quads.owner < 0), [5, 6])
        assert sorted(set(quads.drawn)) == sorted(set(range(len(mixed.triangles))) - {5, 6})
        without = cloud_of(good, method=method).levels[0].quads
        np.testing.assert_array_equal(without.owner, np.delete(quads.owner, [5, 6]))

    @pytest.mark.parametrize("method", METHODS)
    def test_duplicate_and_non_manifold_faces_are_fine(self, method):
        cube = box(cuts=1)
        fin = TriangleMesh(np.array([[0.5, 0.5, -0.5], [0.5, 0.5, 0.5], [1.0, 1.0, 0.0]]), np.array([[0, 1, 2]], np.int32))
        odd = merge([cube, cube, fin])
        cloud = cloud_of(odd, method=method, error=0.02)
        assert cloud.uncovered_faces == 0 and cloud.max_plane_distance <= 1.0
        if method == "clusters":
            assert len(cloud.levels[0].quads) == 7

    @pytest.mark.parametrize("method", METHODS)
    def test_one_triangle_is_one_quad(self, method):
        cloud = cloud_of(TriangleMesh(np.eye(3), np.array([[0, 1, 2]], np.int32)), method=method)
        assert len(cloud.levels[0].quads) == 1 and cloud.levels[0].quads.owner.tolist() == [0]

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("bad", ["nan", "empty", "flat"])
    def test_refusals_name_the_mesh(self, bad, method):
        mesh = sheet(2)
        if bad == "nan":
            mesh.vertices[0, 0] = np.nan
        elif bad == "empty":
            mesh = TriangleMesh(mesh.vertices, mesh.triangles[:0])
        else:
            mesh = TriangleMesh(mesh.vertices * [1.0, 0.0, 0.0], mesh.triangles)
        with pytest.raises(GeometryError, match='"Shape"'):
            cloud_of(mesh, method=method)


class TestPoints:
    """Clouds of discs."""

    @pytest.mark.parametrize("method", ["clusters", "hough"])
    def test_a_ball_of_points_keeps_the_bounds(self, method):
        ball = ball_of_points()
        cloud = cloud_of(ball, method=method, error=0.08)
        (level,) = cloud.levels
        drawn, quad = drawn_pairs(level)
        assert np.abs(heights(level, ball.points[drawn][:, None], quad)).max() <= level.error
        assert set(drawn) == set(range(len(ball.points)))
        assert cloud.max_plane_distance <= 1.0 and cloud.uncovered_faces == 0
        assert 6 <= len(level.quads) <= 80
        if method == "clusters":
            assert cloud.faces_beyond_normal_bound == 0

    def test_discs_without_radius_or_normal_are_dropped(self):
        ball = ball_of_points(100)
        radii, normals = ball.radii.copy(), ball.normals.copy()
        radii[3], normals[7] = 0.0, 0.0
        cloud = cloud_of(PointCloud(ball.points, normals, radii))
        assert cloud.dropped_triangles == 2
        np.testing.assert_array_equal(np.flatnonzero(cloud.levels[0].quads.owner < 0), [3, 7])

    def test_points_cannot_be_decimated(self):
        with pytest.raises(SettingsError, match='"Shape" is a point cloud'):
            cloud_of(ball_of_points(50), method="decimate")

    def test_points_without_radii_are_refused(self):
        ball = ball_of_points(50)
        with pytest.raises(GeometryError, match='"Shape"'):
            cloud_of(PointCloud(ball.points, ball.normals, np.zeros(50)))
