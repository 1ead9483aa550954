"""Seams between photographs, and detail that resampling has blurred."""

import numpy as np
import pytest

from farfield.addon.core.errors import GeometryError
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.settings import PhotosSettings
from farfield.addon.core.photos.texels.blending import shrink_masks
from photo_scenes import SIZE, box, camera_at, grid, photograph, ring, smooth_texture

pytestmark = pytest.mark.usefixtures("quick_merges")


def rough_texture(period=6, seed=0):
    """Stripes of `period` texels in two directions."""
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    phases = np.random.default_rng(seed).uniform(0, 6, 3)
    waves = [np.sin(2 * np.pi * x / period + phase) + np.sin(2 * np.pi * y / period - phase) for phase in phases]
    return (0.5 + 0.15 * np.stack(waves, axis=-1)).astype(np.float32)


def largest_step(values):
    """The largest difference between neighbors in a row of texels."""
    return np.abs(np.diff(values[:, 8:-8].mean(axis=2), axis=1)).max()


def merge_best(mesh, uvs, photographs, blending):
    """The colors of a merge without anything else that changes the brightness."""
    settings = PhotosSettings(size=SIZE, method="best", blending=blending, exposure=False, sharpen=False)
    return run_to_end(merge(mesh, uvs, photographs, settings)).colors


@pytest.fixture(scope="module")
def two_photographs(quick_merges):
    """A gray square, a dark photograph of its left half and a bright one of its right half, and the step between them in a texture."""
    mesh, uvs = grid(40)
    gray = np.full((SIZE, SIZE, 3), 0.5, np.float32)
    cameras = [camera_at((x, 0.0, 3.0), (x, 0.0, 0.0), name=f"{x}.png") for x in (-0.7, 0.7)]
    photographs = [photograph(mesh, uvs, gray, camera, gain) for camera, gain in zip(cameras, (0.8, 1.25), strict=True)]
    return mesh, uvs, photographs, largest_step(merge_best(mesh, uvs, photographs, "none"))


class TestSeams:
    """Photographs of different brightness on one surface."""

    @pytest.mark.slow
    @pytest.mark.parametrize("blending", ["level", "spline", "poisson", pytest.param("none", marks=pytest.mark.exhaustive)])
    def test_a_texture_that_fits_stays(self, blending):
        mesh, uvs = grid(12, lambda x, y: 0.1 * np.sin(2 * x) * np.cos(3 * y))
        texture = smooth_texture()
        photographs = [photograph(mesh, uvs, texture, camera) for camera in ring(4)]
        settings = PhotosSettings(size=SIZE, method="best", blending=blending, sharpen=False)
        result = run_to_end(merge(mesh, uvs, photographs, settings))
        assert np.sqrt(np.mean((result.colors - texture)[result.source >= 0] ** 2)) < 0.01

    @pytest.mark.slow
    @pytest.mark.parametrize("blending", ["level", "spline", "poisson"])
    def test_steps_are_spread(self, blending, two_photographs):
        mesh, uvs, photographs, step = two_photographs
        assert largest_step(merge_best(mesh, uvs, photographs, blending)) < 0.5 * step

    @pytest.mark.slow
    @pytest.mark.parametrize("blending", ["spline", pytest.param("poisson", marks=pytest.mark.exhaustive)])
    def test_steps_are_spread_across_uv_seams(self, blending, two_photographs):
        """The border between the photographs is a seam of the UV map: colors meet there as they do without it."""
        mesh, uvs, photographs, _ = two_photographs
        is_right = mesh.corners[..., 0].mean(axis=1) > 0
        separated = np.where(is_right[:, None, None], uvs * [0.8, 0.8] + [0.18, 0.1], uvs * [0.8, 0.8] + [0.02, 0.1]).astype(np.float32)
        colors = merge_best(mesh, separated, photographs, blending)
        center = SIZE // 2
        left, right = (int((0.5 * 0.8 + offset) * SIZE) for offset in (0.02, 0.18))
        jump = abs(float(colors[center, left - 2].mean()) - float(colors[center, right + 2].mean()))
        assert jump < 0.03 < abs(float(colors[center, 20].mean()) - float(colors[center, -20].mean()))


class TestMasks:
    """Masks of whole triangles."""

    def test_shrinking_removes_a_ring(self):
        mesh, _ = grid(10)
        mask = np.ones(len(mesh.triangles), bool)
        column = np.floor((mesh.corners[..., 0].mean(axis=1) + 1) * 5).astype(int)
        mask[column >= 6] = False
        shrunken = shrink_masks(mask[None], mesh.triangles, len(mesh.vertices))[0]
        assert not shrunken[column >= 5].any()
        assert shrunken[column <= 4].all()

    def test_a_mask_of_everything_stays(self):
        mesh, _ = box()
        masks = np.ones((2, len(mesh.triangles)), bool)
        assert shrink_masks(masks, mesh.triangles, len(mesh.vertices)).all()

    def test_a_box_of_twelve_triangles_is_refused(self):
        """Each of its vertices lies on a silhouette."""
        mesh, uvs = box()
        photographs = [photograph(mesh, uvs, smooth_texture(), camera) for camera in ring(4)]
        with pytest.raises(GeometryError, match="subdivide"):
            run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=SIZE, method="paper")))


class TestSharpening:
    """Back-projection."""

    @pytest.mark.slow
    def test_detail_comes_back(self):
        mesh, uvs = grid(12)
        texture = rough_texture()
        photographs = [photograph(mesh, uvs, texture, camera) for camera in ring(4)]
        errors = []
        for sharpen in (False, True):
            result = run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=SIZE, exposure=False, sharpen=sharpen)))
            seen = result.source >= 0
            errors.append(np.sqrt(np.mean((result.colors - texture)[seen] ** 2)))
        assert errors[1] < 0.6 * errors[0]

    @pytest.mark.slow
    @pytest.mark.parametrize("method", ["average", pytest.param("best", marks=pytest.mark.exhaustive)])
    def test_smooth_textures_stay(self, method):
        mesh, uvs = grid(12, lambda x, y: 0.1 * np.sin(2 * x) * np.cos(3 * y))
        photographs = [photograph(mesh, uvs, smooth_texture(), camera) for camera in ring(4)]
        results = [
            run_to_end(merge(mesh, uvs, photographs, PhotosSettings(size=SIZE, method=method, sharpen=sharpen)))
            for sharpen in (False, True)
        ]
        seen = results[0].source >= 0
        assert np.abs(results[1].colors - results[0].colors)[seen].mean() < 0.003
