"""Highlights: what only some photographs show brightly loses weight, and matte surfaces stay as they are."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.addon.core.imaging.colors import decode_signed_srgb, encode_signed_srgb
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.settings import PhotosSettings
from photo_scenes import SIZE, grid, photograph, ring, smooth_texture

pytestmark = pytest.mark.usefixtures("quick_merges")


def add_highlight(photo, center, radius=0.6, strength=0.06):
    """The photograph with a round highlight around a point of the plane z = 0."""
    camera = photo.camera
    position = camera.project(np.array([[*center, 0.0]]))[0][0]
    y, x = np.mgrid[: camera.lens.size[1], : camera.lens.size[0]] + 0.5
    distance = np.hypot(x - position[0], y - position[1]) / (300.0 / 3.2 * radius)
    linear = decode_signed_srgb(photo.pixels.astype(np.float32) / 255.0) + np.float32(strength) * np.exp(-(distance**2))[..., None]
    return replace(photo, pixels=np.rint(255.0 * np.clip(encode_signed_srgb(linear.astype(np.float32)), 0, 1)).astype(np.uint8))


def error(photographs, texture, *, highlights):
    mesh, uvs = grid(12)
    settings = PhotosSettings(size=SIZE, reduce_highlights=highlights, exposure=False, sharpen=False)
    result = run_to_end(merge(mesh, uvs, photographs, settings))
    return np.sqrt(np.mean((result.colors - texture)[result.source >= 0] ** 2))


@pytest.mark.slow
def test_highlights_that_move_with_the_camera_fade():
    mesh, uvs = grid(12)
    texture = 0.5 * smooth_texture()
    photographs = [add_highlight(photograph(mesh, uvs, texture, camera), 0.5 * camera.position[:2]) for camera in ring(4)]
    errors = [error(photographs, texture, highlights=highlights) for highlights in (False, True)]
    assert errors[1] < 0.7 * errors[0]


@pytest.mark.slow
def test_matte_surfaces_stay():
    mesh, uvs = grid(12)
    texture = smooth_texture()
    photographs = [photograph(mesh, uvs, texture, camera) for camera in ring(4)]
    errors = [error(photographs, texture, highlights=highlights) for highlights in (False, True)]
    assert errors[1] < 1.02 * errors[0]


def test_two_photographs_do_not_judge_each_other():
    mesh, uvs = grid(12)
    texture = 0.5 * smooth_texture()
    photographs = [add_highlight(photograph(mesh, uvs, texture, camera), (0.2, 0.2)) for camera in ring(2)]
    assert error(photographs, texture, highlights=True) == error(photographs, texture, highlights=False)
