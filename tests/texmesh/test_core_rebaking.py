"""Rebaked textures: known answers, sizes, sides of thin parts, and what cannot be rebaked."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.rebaking import image_sizes
from farfield.addon.core.texmesh.rebaking.level_texture import BLANK_WEIGHT, build_weighted_mipmaps
from farfield.addon.core.texmesh.rebaking.rebake import rebake_textures
from farfield.addon.core.texmesh.rebaking.surface_descent import SurfaceDescent
from farfield.addon.core.texmesh.rebaking.uv_layout import repeats_texture, wrap_triangles
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh

SIDE = 256
PIXEL = image_sizes.TEXELS_PER_PIXEL / SIDE  # where a texture on a unit square is not too small


def grid(cells: int, low: float = 0.0, high: float = 1.0, height=lambda x, y: 0.0 * (x + y)) -> TexturedMesh:
    """A square of cells whose texture coordinates cover `low` to `high` along both axes."""
    ticks = np.linspace(0.0, 1.0, cells + 1)
    x, y = (values.ravel() for values in np.meshgrid(ticks, ticks, indexing="ij"))
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    a, b, c, d = first, first + cells + 1, first + cells + 2, first + 1
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    uvs = low + (high - low) * np.stack([x, y], axis=1)
    return build_textured_mesh(TriangleMesh(np.stack([x, y, height(x, y)], axis=1), triangles), uvs[triangles])


def noise(side: int = SIDE, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(5).random((side, side, channels)).astype(np.float32)


def rebake(fine, textures, level, pixel_size):
    return run_to_end(rebake_textures(fine, textures, [level], [pixel_size])).levels[0]


@pytest.mark.parametrize("channels", [3, 4])
def test_a_level_equal_to_the_original_gives_back_its_texture(channels):
    mesh, texture = grid(6, height=lambda x, y: 0.2 * np.sin(3.0 * x) * y), noise(channels=channels)
    (image,) = rebake(mesh, [texture], mesh, 0.0)
    np.testing.assert_allclose(image, texture, atol=1e-4)


@pytest.mark.parametrize("low", [0.0, 0.25, -0.3, 3.0])
def test_a_smaller_texture_is_the_mean_of_its_texels_also_where_it_repeats(low):
    mesh, texture = grid(6, low, low + 1.0), noise()
    (image,) = rebake(mesh, [texture], mesh, 2.0 * PIXEL)
    means = texture.reshape(SIDE // 2, 2, SIDE // 2, 2, 3).mean(axis=(1, 3))
    assert image.shape == means.shape
    assert np.abs(image - means).max(axis=2).mean() < 1e-3, "but for texels that the border divides"


def test_a_texture_is_corrected_where_texture_coordinates_have_slid():
    fine = grid(16)
    texture = np.repeat(np.linspace(0.0, 1.0, SIDE, dtype=np.float32)[None, :, None], SIDE, axis=0).repeat(3, axis=2)
    level = replace(fine, uvs=fine.uvs + 0.03 * np.sin(np.pi * fine.uvs) * [1.0, 0.0])
    (image,) = rebake(fine, [texture], level, PIXEL)
    u = (np.arange(SIDE) + 0.5) / SIDE
    x = np.interp(u, np.linspace(0.0, 1.0, 17) + 0.03 * np.sin(np.pi * np.linspace(0.0, 1.0, 17)), np.linspace(0.0, 1.0, 17))
    np.testing.assert_allclose(image[SIDE // 2, 1:-1, 0], x[1:-1], atol=0.01)


def test_thin_parts_have_the_colors_of_their_own_side():
    """Two sides of a plate in two islands, with a level whose sides have changed places."""
    lower, upper = grid(4, 0.02, 0.45), grid(4, 0.55, 0.98)
    turned = lower.triangles[:, ::-1]
    vertices = np.concatenate([lower.vertices, upper.vertices + [0.0, 0.0, 0.01]])
    triangles = np.concatenate([turned, upper.triangles + len(lower.vertices)]).astype(np.int32)
    uvs = np.concatenate([lower.corner_uvs[:, ::-1], upper.corner_uvs])
    fine = build_textured_mesh(TriangleMesh(vertices, triangles), uvs)
    texture = np.zeros((SIDE, SIDE, 3), np.float32)
    texture[: SIDE // 2, : SIDE // 2] = 1.0
    level = replace(fine, vertices=fine.vertices * [1.0, 1.0, -1.0] + [0.0, 0.0, 0.01])
    (image,) = rebake(fine, [texture], level, 0.02)
    size = len(image)
    assert np.abs(image[: size * 9 // 20, : size * 9 // 20] - 1.0).max() < 1e-5 and image[size * 11 // 20 :, size * 11 // 20 :].max() < 1e-5


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.2, 0.7), st.floats(0.5, 12.0))
def test_islands_are_continued_without_the_background(seed, side, texels):
    """The texture has one color within the island and another around it: only the first is in the result, in every texel."""
    generator = np.random.default_rng(seed)
    low = generator.uniform(0.05, 0.95 - side)
    fine = grid(5, low, low + side, lambda x, y: 0.1 * x * y)
    level = grid(2, low, low + side, lambda x, y: 0.1 * x * y)
    inside, outside = generator.random((2, 3)).astype(np.float32)
    centers = (np.arange(SIDE) + 0.5) / SIDE
    within = (centers > low) & (centers < low + side)
    texture = np.where((within[:, None] & within)[..., None], inside, outside).astype(np.float32)
    (image,) = rebake(fine, [texture], level, texels / (SIDE * side))
    assert np.abs(image - inside).max() < 0.02


def test_coarser_levels_have_smaller_textures_but_never_larger_ones_than_the_original():
    mesh, texture = grid(4), noise()
    sizes = [len(rebake(mesh, [texture], mesh, size)[0]) for size in (1e-6, PIXEL, 1.99 * PIXEL, 2.0 * PIXEL, 1.0)]
    assert sizes == [SIDE, SIDE, SIDE, SIDE // 2, image_sizes.MIN_SIDE]


def test_sides_that_are_no_powers_of_two_are_rounded_up():
    assert image_sizes.halve_size((1000, 333), 2) == (250, 84)
    assert image_sizes.choose_supersampling((4096, 4096), 0) == 1
    assert image_sizes.choose_supersampling((4096, 4096), 1) == 2
    assert image_sizes.choose_supersampling((4096, 4096), 5) == 8


def test_only_materials_with_a_texture_of_their_own_are_rebaked():
    mesh, texture = grid(4, 0.1, 0.9), noise()
    materials = (np.arange(len(mesh.triangles)) % 3).astype(np.int32)
    mesh = build_textured_mesh(TriangleMesh(mesh.vertices, mesh.triangles, materials), mesh.corner_uvs)
    first, second, third = rebake(mesh, [texture, None, texture], mesh, 0.0)
    assert first is third and second is None


def test_parts_of_a_texture_that_are_used_twice_are_not_rebaked():
    once = grid(4, 0.1, 0.6).corner_uvs
    assert not repeats_texture(once, (SIDE, SIDE)) and not repeats_texture(once + 2.7, (SIDE, SIDE))
    assert not repeats_texture(np.concatenate([once, once + [0.5, 0.0]]), (SIDE, SIDE)), "islands may touch"
    assert repeats_texture(np.concatenate([once, once + [0.25, 0.0]]), (SIDE, SIDE))
    assert repeats_texture(np.concatenate([once, once + [1.0, 0.0]]), (SIDE, SIDE))
    assert repeats_texture(grid(4, 0.0, 2.0).corner_uvs, (SIDE, SIDE)) and repeats_texture(grid(1, 0.0, 1e6).corner_uvs, (SIDE, SIDE))
    mesh = grid(4, 0.0, 3.0)
    result = run_to_end(rebake_textures(mesh, [noise()], [mesh], [0.0]))
    assert result.repeated == (0,) and result.levels == ((None,),)


def test_triangles_are_moved_to_every_repetition_that_they_meet():
    copies, owners = wrap_triangles(np.array([[[0.9, 0.1], [1.2, 0.1], [0.9, 0.5]], [[-1.0, 2.0], [0.0, 2.0], [0.0, 3.0]]]))
    assert owners.tolist() == [0, 0, 1]
    np.testing.assert_allclose(copies[:, 0], [[0.9, 0.1], [-0.1, 0.1], [0.0, 0.0]], atol=1e-12)


def test_mipmaps_weight_texels_that_triangles_cover():
    mipmaps = build_weighted_mipmaps(noise(8), grid(1, 0.0, 0.5).corner_uvs)
    weights = mipmaps.level(0)[..., -1]
    assert (weights[:4, :4] == 1.0).all() and weights[4:].max() == pytest.approx(BLANK_WEIGHT) == weights[:, 4:].max()


def test_descent_ends_at_the_nearest_point():
    mesh = grid(12, height=lambda x, y: 0.1 * x * x + 0.05 * y)
    descent = SurfaceDescent(mesh.vertices, mesh.triangles, np.zeros(len(mesh.triangles), np.int64))
    generator = np.random.default_rng(2)
    points = generator.uniform(0.1, 0.9, (200, 3)) * [1.0, 1.0, 0.1] + [0.0, 0.0, 0.2]
    up = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    triangles, barycentric = descent.find_nearest(points, up, generator.integers(0, len(mesh.triangles), len(points)))
    found = np.einsum("ni,nic->nc", barycentric, mesh.vertices[mesh.triangles[triangles]])
    nearest, _ = cKDTree(grid(200, height=lambda x, y: 0.1 * x * x + 0.05 * y).vertices).query(points)
    np.testing.assert_allclose(np.linalg.norm(found - points, axis=1), nearest, atol=2e-3)
    triangles, _ = descent.find_nearest(points, -up, np.zeros(len(points), np.int64))
    assert (triangles == 0).all(), "no triangle faces that side"
