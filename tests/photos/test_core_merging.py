"""Textures from photographs: known colors come back, exposure differences vanish, and what is hidden is not used."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import GeometryError, ImageError
from farfield.addon.core.files.scratch import Scratch
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.imaging.colors import decode_signed_srgb, encode_signed_srgb
from farfield.addon.core.imaging.raster import draw_ids
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.photographs.color_correction import estimate_gains
from farfield.addon.core.photos.photographs.photograph import Photograph, apply_gain
from farfield.addon.core.photos.photographs.surface import Surface
from farfield.addon.core.photos.photographs.views import View
from farfield.addon.core.photos.settings import PhotosSettings
from farfield.addon.core.photos.texels.face_visibility import HIDDEN, MIXED, VISIBLE, FaceVisibility, ShownSurface
from farfield.addon.core.photos.texels.hole_interpolation import interpolate_colors
from farfield.addon.core.photos.texels.regions import choose_labels, find_vertex_labels, solve_corrections
from farfield.addon.core.photos.texels.texel_map import TexelMap
from photo_scenes import SIZE, box, camera_at, grid, observations, photograph, ring, smooth_texture

pytestmark = pytest.mark.usefixtures("quick_merges")


class TestMerge:
    """Whole merges."""

    @pytest.mark.slow
    @pytest.mark.parametrize("method", ["average", "paper"])  # test_core_blending has Best Photograph
    def test_the_texture_comes_back(self, method):
        mesh, uvs = grid(12, lambda x, y: 0.1 * np.sin(2 * x) * np.cos(3 * y))
        texture = smooth_texture()
        photographs = [photograph(mesh, uvs, texture, camera) for camera in ring(4)]
        result = run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=SIZE, method=method)))
        seen = result.source >= 0
        margin = SIZE // 12 + 3 if method == "paper" else 3  # The silhouette costs whole triangles, or texels.
        assert seen[margin:-margin, margin:-margin].all() and not (result.holes & seen).any()
        assert np.sqrt(np.mean((result.colors - texture)[seen] ** 2)) < 0.01

    @pytest.mark.slow
    @pytest.mark.parametrize("method", ["average", "best"])
    def test_progress_grows_with_each_photograph_and_in_every_stage(self, method):
        mesh, uvs = grid(4)
        photographs = [photograph(mesh, uvs, smooth_texture(), camera) for camera in ring(6)]
        steps = []
        run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=SIZE, method=method)), steps.append)
        fractions = [step.fraction for step in steps]
        assert fractions == sorted(fractions) and fractions[-1] <= 1.0
        labels = ["Finding visible faces", "Comparing photographs", "Computing texels", "Comparing texture and photographs", "Sharpening"]
        for label in labels + ["Choosing photographs"] * (method == "best"):
            count = len({step.fraction for step in steps if step.label == label})
            assert count >= (1 if label in ("Computing texels", "Sharpening") else 6), label

    @pytest.mark.slow
    @pytest.mark.parametrize(
        "method", ["best", pytest.param("average", marks=pytest.mark.exhaustive), pytest.param("paper", marks=pytest.mark.exhaustive)]
    )
    def test_images_in_temporary_files_change_nothing(self, method):
        mesh, uvs = grid(12, lambda x, y: 0.1 * np.sin(2 * x) * np.cos(3 * y))
        photographs = [photograph(mesh, uvs, smooth_texture(), camera) for camera in ring(4)]
        settings = PhotosSettings(size=SIZE, method=method)
        expected = run_to_end(merge(mesh, uvs, photographs, settings))
        with Scratch(max_memory=0) as scratch:
            kept = [each.keep_in(scratch, index) for index, each in enumerate(photographs)]
            assert all(isinstance(each.pixels, np.memmap) for each in kept)
            found = run_to_end(merge(mesh, uvs, kept, settings, scratch))
        assert [each.gain.tolist() for each in found.color_corrections] == [each.gain.tolist() for each in expected.color_corrections]
        for name in ("colors", "confidence", "source", "holes", "labels"):
            assert np.array_equal(getattr(found, name), getattr(expected, name)), name

    @pytest.mark.slow
    def test_confidence_is_the_resolution_of_the_photographs(self):
        """A texel is 2 / 128 units wide; photographs have 300 pixels per unit of depth, 3 units away: 1.6 pixels per texel, or 0.8 for a
        texture that is twice as fine."""
        mesh, uvs = grid(4)
        photographs = [photograph(mesh, uvs, smooth_texture(), camera_at((0.0, 0.0, 3.0)))]
        for size, expected in ((SIZE, 1.0), (2 * SIZE, 0.78)):
            result = run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=size)))
            assert result.confidence[size // 2, size // 2] == pytest.approx(expected, rel=0.02)
            assert (result.confidence[result.holes] == 0.0).all()

    def test_exposures_are_adjusted(self):
        mesh, uvs = grid(12)
        texture, gains = smooth_texture(2), np.array([1.4, 0.8, 1.0, 0.7])
        photographs = [photograph(mesh, uvs, texture, camera, gain) for camera, gain in zip(ring(4), gains, strict=True)]
        result = run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=SIZE)))
        product = np.array([correction.gain for correction in result.color_corrections]) * gains[:, None]
        assert product == pytest.approx(np.broadcast_to(product.mean(axis=0), product.shape), rel=0.03)
        expected = encode_signed_srgb(decode_signed_srgb(texture) * product.mean(axis=0).astype(np.float32))
        seen = result.source >= 0
        assert np.sqrt(np.mean((result.colors - expected)[seen] ** 2)) < 0.03

    @pytest.mark.slow
    @pytest.mark.parametrize("method", ["best", pytest.param("average", marks=pytest.mark.exhaustive)])
    def test_a_box_of_twelve_triangles_gets_a_texture(self, method):
        mesh, uvs = box()
        texture = smooth_texture(7)
        corners = [(x, y, z) for x in (-3.0, 3.0) for y in (-3.0, 3.0) for z in (-3.0, 3.0)]
        photographs = [photograph(mesh, uvs, texture, camera_at(corner, name=str(corner))) for corner in corners]
        result = run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=SIZE, method=method)))
        covered = result.holes | (result.source >= 0)
        assert np.count_nonzero(result.holes) < 0.12 * np.count_nonzero(covered)
        assert np.sqrt(np.mean((result.colors - texture)[result.source >= 0] ** 2)) < 0.02

    def test_what_is_hidden_is_not_used(self):
        """A small square floats above the ground: the ground gets none of its color, and has a hole under it."""
        ground, ground_uvs = grid(10)
        lid, lid_uvs = grid(2)
        vertices = np.concatenate([ground.vertices, lid.vertices * 0.3 + [0.0, 0.0, 0.1]])
        mesh = TriangleMesh(vertices, np.concatenate([ground.triangles, lid.triangles + len(ground.vertices)]).astype(np.int32))
        uvs = np.concatenate([ground_uvs * [0.5, 1.0], lid_uvs * [0.5, 1.0] + [0.5, 0.0]]).astype(np.float32)
        texture = np.zeros((SIZE, SIZE, 3), np.float32)
        texture[:, : SIZE // 2], texture[:, SIZE // 2 :] = (0.2, 0.7, 0.3), (0.9, 0.1, 0.1)
        photographs = [photograph(mesh, uvs, texture, camera) for camera in ring(3)]
        result = run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=SIZE)))
        ground_part = result.colors[:, : SIZE // 2 - 1]
        assert np.abs(ground_part - [0.2, 0.7, 0.3]).max() < 0.03
        assert result.holes[SIZE // 2, SIZE // 4] and not result.holes[4, 4]

    def test_a_mask_is_respected(self):
        mesh, uvs = grid(8)
        texture = smooth_texture(3)
        camera = camera_at((0.0, 0.0, 3.0))
        photo = photograph(mesh, uvs, texture, camera)
        mask = np.ones(photo.pixels.shape[:2], bool)
        mask[:, :150] = False
        result = run_to_end(merge(mesh, uvs, [Photograph(camera, photo.pixels, mask)], PhotosSettings(size=SIZE, fill="none")))
        positions, _, _ = camera.project(np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]))
        left_is_masked = positions[0, 0] < 150
        holes = result.holes[SIZE // 2, [SIZE // 4, 3 * SIZE // 4]]
        assert holes.tolist() == [left_is_masked, not left_is_masked]

    def test_photographs_that_show_nothing_are_one_sentence(self):
        mesh, uvs = grid(3)
        away = camera_at((0.0, 0.0, 3.0), target=(0.0, 0.0, 9.0))
        blank = np.zeros((240, 300, 3), np.uint8)
        with pytest.raises(GeometryError, match="No vertex of the mesh lies in the frame"):
            run_to_end(merge(mesh, uvs, [Photograph(away, blank)], PhotosSettings(size=SIZE)))
        behind = camera_at((0.0, 0.0, -3.0))
        with pytest.raises(GeometryError, match="flip the normals"):
            run_to_end(merge(mesh, uvs, [Photograph(behind, blank)], PhotosSettings(size=SIZE)))
        with pytest.raises(ImageError, match="has 300 x 100 pixels, but its camera 300 x 240"):
            run_to_end(merge(mesh, uvs, [Photograph(away, blank[:100])], PhotosSettings(size=SIZE)))
        with pytest.raises(ImageError, match="There are no photographs"):
            run_to_end(merge(mesh, uvs, [], PhotosSettings(size=SIZE)))
        with pytest.raises(GeometryError, match="covers no pixel"):
            run_to_end(merge(mesh, uvs + 3.0, [Photograph(behind, blank)], PhotosSettings(size=SIZE)))
        with pytest.raises(GeometryError, match="not finite"):
            run_to_end(merge(mesh, uvs * np.float32(np.nan), [Photograph(behind, blank)], PhotosSettings(size=SIZE)))
        with pytest.raises(GeometryError, match="no area"):
            run_to_end(
                merge(
                    TriangleMesh(mesh.vertices * [1.0, 0.0, 0.0], mesh.triangles),
                    uvs,
                    [Photograph(behind, blank)],
                    PhotosSettings(size=SIZE),
                )
            )


class TestViews:
    """Visibility of points."""

    def test_points_are_seen_from_their_front_only(self):
        mesh, _ = grid(4)
        view = View(camera_at((0.0, 0.0, 4.0)), mesh)
        points = np.array([[0.1, 0.2, 0.0], [0.1, 0.2, 0.0], [0.1, 0.2, -0.5], [9.0, 0.0, 0.0]])
        normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
        seen = view.see(points, normals)
        assert seen.indices.tolist() == [0]
        assert seen.positions == pytest.approx(view.locate(points[:1])) and seen.positions == pytest.approx(
            view.camera.project(points[:1])[0]
        )
        assert seen.cosines == pytest.approx(4.0 / np.sqrt(16.05)) and seen.resolution == pytest.approx(300.0**2 / 16.0 * seen.cosines)

    @settings(max_examples=25, deadline=None)
    @given(st.integers(0, 2**31))
    def test_a_convex_surface_hides_nothing_that_faces_the_camera(self, seed):
        random = np.random.default_rng(seed)
        mesh, _ = grid(24, lambda x, y: np.sqrt(9.0 - x**2 - y**2) - 3.0)
        camera = camera_at((*random.uniform(-1.5, 1.5, 2), 4.0))
        points = np.column_stack([random.uniform(-0.7, 0.7, (200, 2)), np.zeros(200)])
        points[:, 2] = np.sqrt(9.0 - points[:, 0] ** 2 - points[:, 1] ** 2) - 3.0
        normals = points + [0.0, 0.0, 3.0]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        assert len(View(camera, mesh).see(points, normals).indices) == 200


class TestIds:
    """The nearest triangle of every pixel."""

    def test_the_nearest_triangle_wins(self):
        square = np.array([[[2, 2], [9, 2], [9, 9]], [[2, 2], [9, 9], [2, 9]]], float)
        corners = np.concatenate([square, square * 0.5])
        owners, depths = draw_ids(corners, np.array([[2.0] * 3] * 2 + [[1.0] * 3] * 2), (10, 10))
        assert owners[0, 0] == -1 and np.isinf(depths[0, 0])
        assert set(owners[1:4, 1:4].ravel()) == {2, 3} and set(owners[6:9, 2:9].ravel()) == {0, 1}


class TestExposure:
    """Gains."""

    @given(st.integers(0, 2**31), st.sampled_from([2, 3, 6, 24]))
    @settings(max_examples=20, deadline=None)
    def test_gains_are_found_in_spite_of_outliers(self, seed, count):
        random = np.random.default_rng(seed)
        truth = random.uniform(0.05, 0.6, (400, 3))
        gains = random.uniform(0.6, 1.6, (count, 3))
        linear = truth[None] * gains[:, None]
        linear[0, :30] = random.random((30, 3))
        found = estimate_gains(observations(linear, random.random((count, 400)) < 0.8), count) * gains
        assert found == pytest.approx(np.broadcast_to(found.mean(axis=0), found.shape), rel=0.02)

    def test_observations_without_weight_do_not_count(self):
        random = np.random.default_rng(5)
        linear = np.repeat(random.uniform(0.1, 0.5, (1, 200, 3)), 2, axis=0)
        linear[1, 50:] *= 1.5
        observed = observations(linear, np.ones((2, 200), bool))
        assert estimate_gains(observed, 2, (observed.points < 50).astype(float)) == pytest.approx(1.0, rel=1e-4)

    def test_photographs_without_overlap_keep_their_exposure(self):
        linear, visible = np.full((2, 10, 3), 0.3), np.zeros((2, 10), bool)
        visible[0, :5], visible[1, 5:] = True, True
        assert estimate_gains(observations(linear, visible), 2) == pytest.approx(1.0)

    @given(gain=st.floats(0.3, 3.0), seed=st.integers(0, 2**31))
    @settings(max_examples=20, deadline=None)
    def test_gains_multiply_linear_values(self, gain, seed):
        encoded = np.random.default_rng(seed).uniform(-0.1, 1.3, (100, 3)).astype(np.float32)
        expected = encode_signed_srgb(decode_signed_srgb(encoded) * np.float32(gain))
        assert apply_gain(encoded, np.full(3, gain)) == pytest.approx(expected, abs=1e-3)


class TestFaces:
    """Triangles that a photograph shows completely or not at all."""

    @settings(max_examples=3, deadline=None)
    @given(st.integers(0, 2**31))
    def test_decisions_by_triangle_agree_with_those_by_texel(self, seed):
        random = np.random.default_rng(seed)
        mesh, uvs = grid(60, lambda x, y: 0.3 * np.sin(4.0 * x) * np.cos(5.0 * y))
        surface = Surface.around_origin(mesh)
        mesh = surface.mesh
        view = View(camera_at((*random.uniform(-1.5, 1.5, 2), 2.0)), mesh)
        faces = FaceVisibility(view, ShownSurface(surface), is_cosine=False)
        assert {HIDDEN, VISIBLE, MIXED} >= set(faces.status.tolist()) and (faces.status != MIXED).mean() > 0.5
        for tile in TexelMap(uvs, 256).tiles():
            points, directions = tile.interpolate(mesh.corners), tile.interpolate(surface.corner_normals)
            each = view.see(points, directions / np.linalg.norm(directions, axis=1, keepdims=True))
            seen = faces.see(tile, points, np.arange(len(points)))
            both, first, second = np.intersect1d(each.indices, seen.indices, return_indices=True)
            assert len(both) > 0.98 * max(len(each.indices), len(seen.indices))
            assert np.allclose(seen.positions[second], each.positions[first], rtol=1e-6, atol=1e-2)
            assert np.median(np.abs(seen.weights[second] / each.weights[first] - 1.0)) < 0.03


class TestLabels:
    """The photograph of each triangle."""

    def test_small_advantages_do_not_scatter_labels(self):
        mesh, _ = grid(20)
        random = np.random.default_rng(1)
        qualities = 1.0 + 0.1 * random.random((len(mesh.triangles), 3))
        edges = find_edges(mesh.triangles)
        first, second = (edges.interior_halfedges // 3).T
        labels, best = run_to_end(choose_labels(qualities, edges)), qualities.argmax(axis=1)
        assert (labels[first] != labels[second]).mean() < 0.1 < 0.5 < (best[first] != best[second]).mean()

    def test_large_advantages_win_and_unseen_triangles_have_none(self):
        mesh, _ = grid(20)
        left = mesh.corners[..., 0].mean(axis=1) < 0
        qualities = np.where(left[:, None], [8.0, 1.0], [1.0, 8.0])
        qualities[:3] = 0.0
        labels = run_to_end(choose_labels(qualities, find_edges(mesh.triangles)))
        assert (labels[:3] == -1).all()
        assert (labels[3:] == np.where(left[3:], 0, 1)).mean() > 0.97

    def test_a_photograph_that_does_not_show_a_triangle_is_not_chosen(self):
        mesh, _ = grid(10)
        random = np.random.default_rng(2)
        qualities = random.random((len(mesh.triangles), 4)) * (random.random((len(mesh.triangles), 4)) < 0.4)
        labels = run_to_end(choose_labels(qualities, find_edges(mesh.triangles)))
        seen = qualities.max(axis=1) > 0
        assert (qualities[np.flatnonzero(seen), labels[seen]] > 0).all()


class TestLeveling:
    """Corrections at vertices."""

    def test_a_constant_difference_vanishes(self):
        mesh, _ = grid(16)
        labels = (mesh.corners[..., 0].mean(axis=1) > 0).astype(np.int32)
        pairs = find_vertex_labels(mesh.triangles, labels, np.ones(len(labels)), 2)
        colors = np.where(pairs.photographs[:, None] == 0, 0.4, 0.5) * np.ones((1, 3))
        corrections = solve_corrections(pairs, colors, np.ones(len(pairs.keys), bool), find_edges(mesh.triangles))
        leveled = colors + corrections
        seam = np.flatnonzero((pairs.weights > 0) & (pairs.weights < 1))
        assert len(seam) > 20
        assert np.ptp(leveled[seam]) < 0.02 < 0.09 < np.ptp(colors[seam])

    def test_weights_of_a_vertex_sum_to_one(self):
        mesh, _ = grid(9)
        labels = np.random.default_rng(3).integers(-1, 3, len(mesh.triangles)).astype(np.int32)
        pairs = find_vertex_labels(mesh.triangles, labels, np.random.default_rng(4).random(len(labels)), 3)
        sums = np.bincount(pairs.vertices, pairs.weights, len(mesh.vertices))
        touched = np.zeros(len(mesh.vertices), bool)
        touched[mesh.triangles[labels >= 0]] = True
        assert sums[touched] == pytest.approx(1.0, abs=1e-5) and (sums[~touched] == 0).all()
        assert (np.diff(pairs.keys) > 0).all()


class TestInterpolation:
    """Colors of vertices without photographs."""

    def test_constant_colors_stay_and_islands_without_colors_are_named(self):
        mesh, _ = grid(6)
        count = len(mesh.vertices)
        edges = find_edges(np.concatenate([mesh.triangles, mesh.triangles + count]), 2 * count)
        known = np.zeros(2 * count, bool)
        known[:4] = True
        colors, found = interpolate_colors(np.full((2 * count, 3), 0.7) * known[:, None], known, edges)
        assert found[:count].all() and not found[count:].any()
        assert colors[:count] == pytest.approx(0.7)
