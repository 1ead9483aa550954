"""Windows over a texture: each texel belongs to one, and behind seams they show how the surface continues."""

import numpy as np
import pytest

from farfield.addon.core.photos.photographs.surface import Surface
from farfield.addon.core.photos.texels.surface_windows import SurfaceWindows
from farfield.addon.core.photos.texels.texel_map import TexelMap
from photo_scenes import box, grid


def turned_halves(size, angle=2.3, scale=1.0):
    """A flat square of two UV islands: its left half, and its right half turned and scaled."""
    mesh, uvs = grid(16)
    is_right = mesh.corners[..., 0].mean(axis=1) > 0
    rotation = 0.45 * scale * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    right = (uvs - [0.75, 0.5]) @ rotation + [0.72, 0.6]
    left = (uvs - [0.25, 0.5]) * 0.45 + [0.2, 0.4]
    return mesh, TexelMap(np.where(is_right[:, None, None], right, left).astype(np.float32), size)


@pytest.mark.parametrize(("size", "margin"), [(16, 8), (50, 20), (500, 12)])
def test_each_texel_is_the_own_one_of_one_window(size, margin):
    mesh, uvs = box()
    texels = TexelMap(uvs, 128)
    counts = np.zeros(128 * 128, int)
    for window in SurfaceWindows(texels, Surface.around_origin(mesh), size, margin):
        counts[window.tile.texels[window.is_own]] += 1
        assert len(np.unique(window.pixels)) == len(window.pixels)
    assert np.array_equal(counts, (texels.triangles >= 0).astype(int))


def test_own_pixels_show_their_texels():
    mesh, uvs = box()
    texels = TexelMap(uvs, 96)
    expected = np.zeros((96 * 96, 3))
    for tile in texels.tiles():
        expected[tile.texels] = tile.interpolate(mesh.corners)
    for window in SurfaceWindows(texels, Surface.around_origin(mesh), 40, 10):
        points = window.tile.interpolate(mesh.corners)
        assert points[window.is_own] == pytest.approx(expected[window.tile.texels[window.is_own]], abs=1e-5)


@pytest.mark.parametrize("scale", [1.0, 0.7])
def test_a_plane_continues_behind_a_seam(scale):
    """All pixels of a window, on the island and behind its seam, lie where the island's own affine map puts them."""
    mesh, texels = turned_halves(256, scale=scale)
    for window in SurfaceWindows(texels, Surface.around_origin(mesh), 1000, 30):
        points = window.tile.interpolate(mesh.corners)[:, :2]
        rows, columns = np.divmod(window.pixels, window.shape[1])
        design = np.column_stack([columns, rows, np.ones(len(rows))])
        affine = np.linalg.lstsq(design[window.is_own], points[window.is_own], rcond=None)[0]
        behind = ~window.is_own
        assert np.count_nonzero(behind) > 1000
        assert points == pytest.approx(design @ affine, abs=1e-3)


def test_the_surface_of_a_box_continues_over_its_edges():
    """Neighbors in a window are neighbors on the surface, apart from corners of the box, where three sides meet."""
    mesh, uvs = box()
    texels = TexelMap(uvs, 128)
    for window in SurfaceWindows(texels, Surface.around_origin(mesh), 1000, 12):
        shown = window.to_image(np.ones(len(window.pixels), bool))
        points = window.to_image(window.tile.interpolate(mesh.corners))
        both = shown[:, 1:] & shown[:, :-1]
        distances = np.linalg.norm(points[:, 1:] - points[:, :-1], axis=2)[both]
        texel = np.median(distances)
        assert (distances > 3.0 * texel).mean() < 0.02
        assert np.count_nonzero(shown) > 1.3 * np.count_nonzero(window.is_own)


def test_mesh_boundaries_have_nothing_behind():
    mesh, uvs = grid(5)
    for window in SurfaceWindows(TexelMap(uvs * 0.5 + 0.25, 64), Surface.around_origin(mesh), 100, 10):
        assert window.is_own.all()
