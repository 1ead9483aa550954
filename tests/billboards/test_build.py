"""Tests of the construction: every method keeps its bounds, and shapes with a known result give it."""

import threading

import numpy as np
import pytest

from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.cloud import Cloud, Level
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.errors import GeometryError, SettingsError
from farfield.addon.core.geometry.directions import fibonacci_sphere
from farfield.addon.core.geometry.mesh import PointCloud, TriangleMesh, concatenate, face_areas_and_normals
from farfield.addon.core.geometry.points import splat_radii
from farfield.addon.core.jobs import parallel_steps
from farfield.addon.core.jobs.progress import run_to_end
from shapes import box, bumpy_sphere, cylinder, leaf_cards, sheet, soup, sphere

METHODS = ("clusters", "hough", "decimate")
UP = [0.0, 0.0, 1.0]


def build_test_cloud(source: TriangleMesh | PointCloud, **settings) -> Cloud:
    return run_to_end(build_cloud(source, BillboardSettings(**({"levels": 1, "error": 0.04, "solid_parts": "quads"} | settings)), "Shape"))


def drawn_pairs(level: Level) -> tuple[np.ndarray, np.ndarray]:
    """Return the primitive and the quad (K,) of every pair of which the quad draws the primitive."""
    return level.quads.drawn, np.repeat(np.arange(len(level.quads)), np.diff(level.quads.drawn_offsets))


def heights(level: Level, corners: np.ndarray, quad: np.ndarray) -> np.ndarray:
    """Return the heights (K, C) of `corners` (K, C, 3) over the planes of the quads (K,)."""
    quads = level.quads
    return np.einsum("kci,ki->kc", corners - quads.centers[quad][:, None], quads.frames[quad, 2])


def ball_of_points(count: int = 400) -> PointCloud:
    points = fibonacci_sphere(count)
    return PointCloud(points, points, splat_radii(points))


class TestBounds:
    """Properties of every face of every mesh."""

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
    def test_drawn_corners_are_within_the_error_of_the_plane(self, mesh, method):
        cloud = build_test_cloud(mesh, method=method, error=0.08)
        (level,) = cloud.levels
        drawn, quad = drawn_pairs(level)
        distance = np.abs(heights(level, mesh.corners[drawn], quad)).max()
        assert distance <= level.error == pytest.approx(0.08 * cloud.longest_side)
        assert cloud.max_plane_distance == pytest.approx(distance / level.error, abs=1e-9)
        assert set(drawn) == set(range(len(mesh.triangles)))
        assert cloud.uncovered_faces == 0

    @pytest.mark.slow
    @pytest.mark.parametrize("degrees", [20.0, pytest.param(60.0, marks=pytest.mark.exhaustive)])
    @pytest.mark.parametrize("mesh", [sphere(6), bumpy_sphere(7), soup(40), leaf_cards(40)], ids=["sphere", "bumpy", "soup", "cards"])
    def test_clusters_keep_the_normal_bound_on_every_quad(self, mesh, degrees):
        cloud = build_test_cloud(mesh, max_normal_deviation=np.radians(degrees), normal_scale=0.0, levels=2)
        _, normals = face_areas_and_normals(mesh.corners)
        for level in cloud.levels:
            drawn, quad = drawn_pairs(level)
            facing = np.einsum("ki,ki->k", normals[drawn], level.quads.frames[quad, 2])
            assert facing.min() >= np.cos(np.radians(degrees)) - 1e-9
        assert cloud.faces_beyond_normal_bound == 0

    @pytest.mark.parametrize("method", ["clusters", "hough"])
    def test_violations_of_the_normal_bound_are_counted(self, method):
        mesh = sphere(6)
        cloud = build_test_cloud(mesh, method=method, error=0.1)
        _, normals = face_areas_and_normals(mesh.corners)
        quads = cloud.levels[0].quads
        facing = np.einsum("ti,ti->t", normals, quads.frames[quads.owner, 2])
        facing = np.abs(facing) if method == "hough" else facing  # Hough planes are two-sided
        assert cloud.faces_beyond_normal_bound == (facing < 0.5).sum()

    @pytest.mark.parametrize("method", METHODS)
    def test_owners_draw_their_faces_inside_rectangle_and_cutout(self, method):
        mesh = box(cuts=2) if method == "decimate" else bumpy_sphere(6)  # decimate is slow on curved surfaces
        (level,) = build_test_cloud(mesh, method=method, error=0.08).levels
        quads = level.quads
        for index, (first, last) in enumerate(zip(quads.drawn_offsets[:-1], quads.drawn_offsets[1:], strict=True)):
            drawn, owned = quads.drawn[first:last], np.flatnonzero(quads.owner == index)
            assert (np.diff(drawn) > 0).all()
            assert np.isin(owned, drawn).all()
            if method == "decimate" and len(level.cutouts[index]) == 3:
                continue  # other quads draw the parts outside the triangle
            local = ((mesh.corners[owned] - quads.centers[index]) @ quads.frames[index, :2].T / quads.half_sizes[index]).reshape(-1, 2)
            polygon = level.cutouts[index]
            edges = np.roll(polygon, -1, axis=0) - polygon
            offsets = local[:, None] - polygon
            assert (edges[:, 0] * offsets[:, :, 1] - edges[:, 1] * offsets[:, :, 0]).min(initial=0.0) >= -1e-5

    @pytest.mark.slow
    @pytest.mark.parametrize("method", METHODS)
    def test_equal_seeds_give_equal_bytes(self, method):
        mesh = box(cuts=2) if method == "decimate" else bumpy_sphere(6)
        first, second = (build_test_cloud(mesh, method=method, seed=3).levels[0] for _ in range(2))
        assert level_bytes(first) == level_bytes(second)

    @pytest.mark.slow
    def test_levels_side_by_side_equal_levels_one_after_the_other(self, monkeypatch):
        """And those of builds of their own, so that no level depends on what another thread does."""
        mesh, settings = bumpy_sphere(5), {"error": 0.04, "levels": 3}
        together = [level_bytes(level) for level in build_test_cloud(mesh, **settings).levels]
        monkeypatch.setattr(parallel_steps, "MAX_THREADS", 1)
        monkeypatch.setattr("os.cpu_count", lambda: 1)
        assert len(together) > 1
        assert [level_bytes(level) for level in build_test_cloud(mesh, **settings).levels] == together

    def test_a_cancelled_build_ends_the_threads_of_all_levels(self):
        steps = build_cloud(bumpy_sphere(12), BillboardSettings(error=0.02, levels=3))
        while not next(steps).label.startswith("Clustering"):
            pass
        steps.close()
        assert not [thread for thread in threading.enumerate() if thread.name.startswith("farfield-steps")]


def level_bytes(level: Level) -> list[bytes]:
    """Return the arrays of a level as bytes."""
    names = ("centers", "frames", "half_sizes", "drawn_offsets", "drawn", "owner")
    charts = [chart.vertices.tobytes() for chart in level.charts if chart is not None]
    quads = [getattr(level.quads, name).tobytes() for name in names]
    return [*quads, level.atlas.rectangles.tobytes(), *map(bytes, level.cutouts), *charts]


class TestKnownShapes:
    """Box, plane, cylinder, leaves."""

    @pytest.mark.parametrize("method", ["clusters", "hough"])
    @pytest.mark.parametrize("sides", [(1.0, 1.0, 1.0), (1.0, 2.0, 3.0)])
    def test_box_gives_six_quads(self, sides, method):
        (level,) = build_test_cloud(box(sides), method=method, error=0.02).levels
        outward = level.quads.frames[:, 2] * (-1.0 if method == "hough" else 1.0)  # Hough planes are two-sided
        assert len(level.quads) == 6
        expected = np.concatenate([np.eye(3), -np.eye(3)])
        relative_centers = level.quads.centers / (0.5 * np.array(sides))
        np.testing.assert_allclose(relative_centers[np.lexsort(relative_centers.T.round(6))], expected[np.lexsort(expected.T)], atol=1e-9)
        np.testing.assert_allclose(np.abs(np.einsum("qi,qi->q", outward, relative_centers)), 1.0)
        if method == "clusters":
            np.testing.assert_allclose(outward, relative_centers, atol=1e-9)
            assert level.solid.all()

    @pytest.mark.parametrize("method", ["clusters", "hough"])
    def test_flat_sheet_is_one_quad_with_exact_texel_count(self, method):
        (level,) = build_test_cloud(sheet(7), method=method, error=0.02).levels
        assert len(level.quads) == 1
        assert level.texel_count == level.atlas.texel_count == 100**2  # texels of 0.01 on a side of 1
        np.testing.assert_allclose(np.abs(level.quads.frames[0, 2]), UP, atol=1e-9)

    def test_decimated_flat_sheet_is_one_quad_with_its_area_in_texels(self):
        (level,) = build_test_cloud(sheet(3), method="decimate", error=0.02).levels
        assert len(level.quads) == 1
        np.testing.assert_allclose(level.quads.frames[:, 2], [UP], atol=1e-9)
        assert level.texel_count == pytest.approx(100**2, rel=0.05)

    @pytest.mark.parametrize("error", [pytest.param(0.02, marks=pytest.mark.exhaustive), 0.05])
    def test_texel_count_is_area_over_texel_area_and_waste(self, error):
        mesh = sphere(12)
        (level,) = build_test_cloud(mesh, error=error).levels
        assert level.atlas.texel_count == pytest.approx(level.quads.areas.sum() / level.texel_size**2, rel=0.02)
        area = face_areas_and_normals(mesh.corners)[0].sum()
        assert 0.75 <= level.texel_count * level.texel_size**2 / area <= 2.0  # quads are slightly smaller than a curved surface

    @pytest.mark.parametrize("degrees", [15.0, 30.0, 45.0, 60.0, 80.0])
    def test_cylinder_is_split_at_the_normal_bound(self, degrees):
        """If neither the error nor the scale matters, a quad shows the sides whose normals are within twice the bound."""
        sides = 72
        mesh = cylinder(sides=sides, cuts=2, length=1.0)
        cloud = build_test_cloud(mesh, error=0.25, max_normal_deviation=np.radians(degrees), normal_scale=0.0)
        max_shown = int(2.0 * degrees / (360.0 / sides) + 1e-9) + 1
        min_count = int(np.ceil(sides / max_shown))
        assert min_count <= len(cloud.levels[0].quads) <= 1.5 * min_count + 1.0

    @pytest.mark.parametrize("method", METHODS)
    def test_distant_parallel_planes_stay_separate(self, method):
        low = sheet(2)
        both = concatenate([low, TriangleMesh(low.vertices + [0.0, 0.0, 0.5], low.triangles)])
        (level,) = build_test_cloud(both, method=method).levels
        assert len(level.quads) == 2 or (method == "decimate" and len(level.quads) >= 4)
        off_plane = np.abs(level.quads.centers[:, 2, None] - [0.0, 0.5])
        assert off_plane.min(axis=1).max() <= (1e-9 if method != "decimate" else level.error)
        assert (off_plane.min(axis=0) <= level.error).all()
        assert not set(level.quads.owner[:8]) & set(level.quads.owner[8:])

    def test_no_quad_shows_both_leaves_and_trunk(self):
        trunk, leaves = cylinder(radius=0.1, sides=12, cuts=4), leaf_cards(100, spread=0.3)
        (level,) = build_test_cloud(concatenate([trunk, leaves])).levels
        drawn, quad = drawn_pairs(level)
        is_trunk = drawn < len(trunk.triangles)
        assert not set(quad[is_trunk]) & set(quad[~is_trunk])
        assert np.bincount(drawn)[len(trunk.triangles) :].max() == 1  # no leaf is drawn twice


class TestUnusualInput:
    """Unusual input is accepted, unusable input is rejected with its name."""

    @pytest.mark.parametrize("method", METHODS)
    def test_zero_area_faces_are_dropped_and_counted(self, method):
        good = box(cuts=2)
        bad = np.array([[0, 0, 1], [3, 3, 3]], np.int32)
        mixed = TriangleMesh(good.vertices, np.concatenate([good.triangles[:5], bad, good.triangles[5:]]))
        cloud = build_test_cloud(mixed, method=method)
        quads = cloud.levels[0].quads
        assert (cloud.source_triangles, cloud.dropped_triangles) == (len(good.triangles) + 2, 2)
        np.testing.assert_array_equal(np.flatnonzero(quads.owner < 0), [5, 6])
        assert sorted(set(quads.drawn)) == sorted(set(range(len(mixed.triangles))) - {5, 6})
        without = build_test_cloud(good, method=method).levels[0].quads
        np.testing.assert_array_equal(without.owner, np.delete(quads.owner, [5, 6]))

    @pytest.mark.parametrize("method", METHODS)
    def test_duplicate_and_non_manifold_faces_are_allowed(self, method):
        cube = box(cuts=1)
        fin = TriangleMesh(np.array([[0.5, 0.5, -0.5], [0.5, 0.5, 0.5], [1.0, 1.0, 0.0]]), np.array([[0, 1, 2]], np.int32))
        odd = concatenate([cube, cube, fin])
        cloud = build_test_cloud(odd, method=method, error=0.02)
        assert cloud.uncovered_faces == 0 and cloud.max_plane_distance <= 1.0
        if method == "clusters":
            assert len(cloud.levels[0].quads) == 7

    @pytest.mark.parametrize("method", METHODS)
    def test_single_triangle_is_one_quad(self, method):
        cloud = build_test_cloud(TriangleMesh(np.eye(3), np.array([[0, 1, 2]], np.int32)), method=method)
        assert len(cloud.levels[0].quads) == 1 and cloud.levels[0].quads.owner.tolist() == [0]

    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("bad", ["nan", "empty", "flat"])
    def test_error_messages_name_the_mesh(self, bad, method):
        mesh = sheet(2)
        if bad == "nan":
            mesh.vertices[0, 0] = np.nan
        elif bad == "empty":
            mesh = TriangleMesh(mesh.vertices, mesh.triangles[:0])
        else:
            mesh = TriangleMesh(mesh.vertices * [1.0, 0.0, 0.0], mesh.triangles)
        with pytest.raises(GeometryError, match='"Shape"'):
            build_test_cloud(mesh, method=method)


class TestPoints:
    """Point clouds."""

    @pytest.mark.parametrize("method", ["clusters", "hough"])
    def test_ball_of_points_keeps_the_bounds(self, method):
        ball = ball_of_points()
        cloud = build_test_cloud(ball, method=method, error=0.08)
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
        cloud = build_test_cloud(PointCloud(ball.points, normals, radii))
        assert cloud.dropped_triangles == 2
        np.testing.assert_array_equal(np.flatnonzero(cloud.levels[0].quads.owner < 0), [3, 7])

    def test_points_cannot_be_decimated(self):
        with pytest.raises(SettingsError, match='"Shape" is a point cloud'):
            build_test_cloud(ball_of_points(50), method="decimate")

    def test_points_without_radii_are_rejected(self):
        ball = ball_of_points(50)
        with pytest.raises(GeometryError, match='"Shape"'):
            build_test_cloud(PointCloud(ball.points, ball.normals, np.zeros(50)))
