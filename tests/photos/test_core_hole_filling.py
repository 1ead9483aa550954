"""Holes of textures from photographs are restored with the texture around them."""

import numpy as np
import pytest

from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.photographs.surface import Surface
from farfield.addon.core.photos.texels.hole_filling import MIN_TEXELS, HoleFiller
from farfield.addon.core.photos.texels.texel_map import TexelMap

SIZE = 256


def make_plane(count=24, split=False):
    """A unit square of count^2 quads, with UVs that fill most of the texture; `split` tears the UV map along the middle and turns half."""
    x, y = np.meshgrid(np.linspace(0.0, 1.0, count + 1), np.linspace(0.0, 1.0, count + 1))
    vertices = np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
    first = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    quads = np.stack([first, first + 1, first + count + 2, first + count + 1], axis=1)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    corners = vertices[triangles, :2]
    uvs = 0.02 + 0.96 * corners
    if split:
        right = corners.mean(axis=1)[:, 0] > 0.5
        uvs = 0.02 + 0.9 * corners * [0.5, 1.0]
        local = corners[right] - [0.5, 0.0]
        uvs[right] = np.array([0.53, 0.02]) + 0.9 * (np.array([0.5, 1.0]) - local) * [0.5, 1.0]
    return TriangleMesh(vertices, triangles), uvs


def fill(mesh, uvs, paint, is_missing):
    """Colors and truth (N, 3) of the texels, and which were missing; `paint` and `is_missing` take positions (N, 3)."""
    texel_map = TexelMap(uvs, SIZE)
    truth, found = np.zeros((SIZE * SIZE, 3), np.float32), np.zeros(SIZE * SIZE, bool)
    for tile in texel_map.tiles():
        points = tile.interpolate(mesh.corners)
        truth[tile.texels] = paint(points)
        found[tile.texels] = ~is_missing(points)
    missing = ~found & (texel_map.triangles >= 0)
    colors = np.where(found[:, None], truth, np.float32(0.5))
    counts = run_to_end(HoleFiller(Surface.around_origin(mesh), texel_map, colors, found).fill())
    return colors, truth, missing, counts


def stripes(points):
    values = 0.5 + 0.3 * np.sin(2.0 * np.pi * 14.0 * points[:, 0])
    return np.repeat(values[:, None], 3, axis=1).astype(np.float32)


def disc(x, y, radius):
    return lambda points: np.hypot(points[:, 0] - x, points[:, 1] - y) < radius


@pytest.mark.slow
@pytest.mark.parametrize("split", [False, True])
def test_stripes_continue_through_a_hole(split):
    mesh, uvs = make_plane(split=split)
    colors, truth, missing, counts = fill(mesh, uvs, stripes, disc(0.5, 0.5, 0.09))
    assert counts == (1, 1)
    rms = np.sqrt(np.mean((colors - truth)[missing] ** 2))
    assert rms < 0.5 * np.sqrt(np.mean((truth - truth[missing].mean(axis=0))[missing] ** 2)), rms
    assert np.array_equal(colors[~missing & (truth[:, 0] > 0)], truth[~missing & (truth[:, 0] > 0)])


def test_small_and_overly_large_holes_keep_the_first_guess():
    mesh, uvs = make_plane()
    small, _, missing, counts = fill(mesh, uvs, stripes, disc(0.5, 0.5, 0.01))
    assert 0 < missing.sum() < MIN_TEXELS
    assert counts == (0, 0)
    assert (small[missing] == 0.5).all()
    large, _, missing, counts = fill(mesh, uvs, stripes, disc(0.5, 0.5, 0.6))
    assert counts == (1, 0)
    assert (large[missing] == 0.5).all()


@pytest.mark.slow
def test_several_holes_are_restored_one_by_one():
    mesh, uvs = make_plane()
    holes = [disc(x, y, 0.05) for x in (0.2, 0.8) for y in (0.2, 0.8)]
    _, _, _, counts = fill(mesh, uvs, stripes, lambda points: np.any([hole(points) for hole in holes], axis=0))
    assert counts == (4, 4)


def test_no_hole_is_no_work():
    mesh, uvs = make_plane()
    _, _, missing, counts = fill(mesh, uvs, stripes, lambda points: np.zeros(len(points), bool))
    assert not missing.any()
    assert counts == (0, 0)
