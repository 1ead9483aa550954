"""Background: its color is not used where a photograph does not fit to the mesh, and the rest of the photograph is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import binary_erosion, median_filter

from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.photographs.background import _median_3x3, find_background, find_covered, find_surface
from farfield.addon.core.photos.photographs.photograph import Photograph
from farfield.addon.core.photos.settings import PhotosSettings
from photo_scenes import SIZE, camera_at, grid, photograph, smooth_texture

COLOR = (0.9, 0.85, 0.3)
pytestmark = pytest.mark.usefixtures("quick_merges")
DOME = 0.7


def dome():
    """A bump whose silhouette is seen from the side."""
    return grid(40, lambda x, y: DOME * np.exp(-3.0 * (x**2 + y**2)))


def backdrop(kind, shape, seed=0):
    """A background (H, W, 3)."""
    random, (height, width) = np.random.default_rng(seed), shape
    y, x = (np.mgrid[:height, :width] / max(shape))[..., None]
    image = np.broadcast_to(np.array(COLOR), (height, width, 3)).copy()
    if kind == "gradient":
        image += 0.15 * (x - 0.5) - np.array([0.1, 0.0, -0.1]) * y - 0.1 * (x - 0.5) ** 2
    elif kind == "textured":
        image = random.uniform(0.0, 1.0, (height // 8 + 1, width // 8 + 1, 3)).repeat(8, axis=0).repeat(8, axis=1)[:height, :width]
    return np.clip(image + random.normal(scale=0.005, size=image.shape), 0.0, 1.0)


@cache
def take_photograph(index):
    """A photograph of the dome from one of two sides, and the pixels that show it."""
    mesh, uvs = dome()
    camera = camera_at((3.0 - 6.0 * index, 0.0, 1.5), name=f"{index}.png", focal=320.0)
    return photograph(mesh, uvs, smooth_texture(), camera), find_covered(mesh, camera)


def shoot(kind, shift=4.0, texture=None):
    """Two photographs in front of a background, with cameras that are wrong by `shift` pixels, and the pixels that show the mesh."""
    mesh, uvs = dome()
    photographs, shown = [], []
    for index in range(2):
        taken, covered = take_photograph(index)
        camera = taken.camera
        if texture is not None:
            taken = photograph(mesh, uvs, texture, camera)
        image = np.where(covered[..., None], taken.pixels / 255.0, backdrop(kind, covered.shape, index))
        lens = replace(camera.lens, center=(camera.lens.center[0] + shift, camera.lens.center[1] - shift))
        photographs.append(Photograph(replace(camera, lens=lens), np.rint(255.0 * image).astype(np.uint8)))
        shown.append(covered)
    return mesh, uvs, photographs, shown


def is_rare(pixels):
    """Whether single pixels remain, where the surface meets the frame."""
    return np.count_nonzero(pixels) < 0.0005 * pixels.size


def test_medians_are_those_of_scipy():
    image = np.random.default_rng(0).integers(0, 256, (17, 23)).astype(np.uint8)
    assert np.array_equal(_median_3x3(image), median_filter(image, 3, mode="nearest"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["uniform", "gradient"])
@pytest.mark.parametrize("mode", ["auto", "border"])
@pytest.mark.parametrize("shift", [0.0, pytest.param(2.0, marks=pytest.mark.exhaustive), 5.0])
def test_the_background_is_found_and_nothing_else(kind, mode, shift):
    mesh, _, photographs, shown = shoot(kind, shift=shift)
    for taken, covered in zip(photographs, shown, strict=True):
        used = find_surface(taken, mesh, PhotosSettings(background=mode))
        in_mesh = find_covered(mesh, taken.camera)
        assert is_rare(used & ~covered & in_mesh)
        assert used[binary_erosion(covered, iterations=4)].all()


def test_a_color_is_found_and_others_are_not():
    mesh, _, [taken, _], [covered, _] = shoot("uniform")
    used = find_surface(taken, mesh, PhotosSettings(background="color", background_color=COLOR))
    assert is_rare(used & ~covered) and used[binary_erosion(covered, iterations=4)].all()
    assert find_surface(taken, mesh, PhotosSettings(background="color", background_color=(0.0, 0.0, 1.0))) is None


def test_a_background_without_a_uniform_color_changes_nothing():
    mesh, _, photographs, _ = shoot("textured")
    assert all(find_surface(taken, mesh, PhotosSettings(background="auto")) is None for taken in photographs)
    assert find_surface(photographs[0], mesh, PhotosSettings()) is None


def test_parts_of_the_object_in_the_color_of_the_background_stay():
    texture = smooth_texture()
    texture[40:88, 40:88] = COLOR
    _, _, [taken, _], [covered, _] = shoot("uniform", shift=0.0, texture=texture)
    background = find_background(taken, covered, PhotosSettings(background="border"))
    assert not (background & binary_erosion(covered, iterations=8)).any(), "only a rim is in reach"


def test_masked_pixels_do_not_say_what_the_background_is():
    mesh, _, [taken, _], [covered, _] = shoot("uniform")
    taken.pixels[:, :40] = (0, 255, 0)
    mask = np.ones(covered.shape, bool)
    mask[:, :40] = False
    used = find_surface(replace(taken, mask=mask), mesh, PhotosSettings(background="auto"))
    assert is_rare(used & ~covered & mask)


@pytest.mark.parametrize("method", ["average", pytest.param("best", marks=pytest.mark.exhaustive)])
def test_no_background_in_the_texture(method):
    texture = np.full((SIZE, SIZE, 3), 0.2, np.float32)
    mesh, uvs, photographs, _ = shoot("uniform", shift=4.0, texture=texture)
    settings = PhotosSettings(size=SIZE, method=method, exposure=False, blending="none")
    wrong = []
    for background in ("none", "auto"):
        result = run_to_end(merge(mesh, uvs, photographs, replace(settings, background=background)))
        wrong.append(np.count_nonzero(np.abs(result.colors - 0.2).max(axis=2)[result.source >= 0] > 0.05))
    assert wrong[0] > 500 and wrong[1] < 5
