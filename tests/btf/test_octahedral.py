"""The frames of an octahedral impostor surround every direction, and they agree about rays between them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.btf.octahedral import FrameGrid, OctahedralAtlas
from farfield.addon.core.errors import SettingsError
from farfield.addon.core.geometry.directions import fibonacci_sphere, held_out_views
from impostor_sampling import sample_rays, surrounding_frames

SPHERE_RADIUS = 0.8  # in half sides of a frame
grids = st.builds(FrameGrid, st.integers(2, 16), st.booleans())


def sphere_atlas(frames=12, resolution=48, center=(3.0, -2.0, 1.0), half_side=5.0):
    """Return the analytic atlas of a sphere whose color is its normal mapped to 0..1."""
    grid, side = FrameGrid(frames), frames * resolution
    maps = np.zeros((side, side, 4)), np.zeros((side, side, 3)), np.zeros((side, side)), np.zeros((side, side, 2))
    atlas = OctahedralAtlas(grid, np.array(center), half_side, resolution, *maps)
    x, y = np.meshgrid(*[(2.0 * np.arange(resolution) + 1.0) / resolution - 1.0] * 2)
    height = np.sqrt(np.maximum(SPHERE_RADIUS**2 - x**2 - y**2, 0.0))
    for index in range(len(grid)):
        view, tile = atlas.view(index), atlas.tile(index)
        normal = x[..., None] * view.right + y[..., None] * view.up + height[..., None] * view.direction
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        atlas.normal[tile], atlas.height[tile] = normal, height
        atlas.color[tile] = np.concatenate([0.5 + 0.5 * normal, (height > 0.0)[..., None]], axis=2)
    return atlas


def ray_points(atlas, direction, radius):
    """Return points (M, 3) of rays within `radius` half sides of the center of `atlas`, in the plane perpendicular to `direction`."""
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    x, y = np.meshgrid(np.linspace(-radius, radius, 31), np.linspace(-radius, radius, 31))
    inside = np.hypot(x, y) < radius
    offsets = x[inside][:, None] * right + y[inside][:, None] * np.cross(direction, right)
    return atlas.center + atlas.half_side * offsets


@given(grids, st.integers(0, 2**31))
def test_weights_are_a_partition_of_unity_over_three_near_frames(grid, seed):
    directions = fibonacci_sphere(64) @ np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    if grid.upper:
        directions = directions[directions[:, 2] > 0.0]
    indices, weights = surrounding_frames(grid, directions)
    assert ((indices >= 0) & (indices < len(grid))).all()
    assert (weights >= 0.0).all() and weights.sum(axis=1) == pytest.approx(1.0)
    means = np.einsum("mk,mki->mi", weights, grid.directions[indices])
    if grid.frames_per_side > 10:
        assert (np.einsum("mi,mi->m", means, directions) / np.linalg.norm(means, axis=1)).min() > np.cos(np.radians(8.0))


@given(grids)
def test_the_direction_of_a_frame_uses_this_frame_alone(grid):
    indices, weights = surrounding_frames(grid, grid.directions)
    nearest = indices[np.arange(len(grid)), weights.argmax(axis=1)]
    assert weights.max(axis=1) == pytest.approx(1.0, abs=1e-9)
    assert grid.directions[nearest] == pytest.approx(grid.directions, abs=1e-9)


@pytest.mark.parametrize("grid", [FrameGrid(12), FrameGrid(7), FrameGrid(12, upper=True)], ids=["even", "odd", "upper"])
def test_blending_is_continuous_everywhere(grid):
    """Also across cell diagonals, the folds of the map and its boundary."""
    random = np.random.default_rng(5)
    directions = np.concatenate([grid.directions, fibonacci_sphere(500), [[1.0, 0.0, -1.0], [0.0, 1.0, -0.5], [-1.0, 1e-12, -0.1]]])
    if grid.upper:
        directions = directions[directions[:, 2] > 0.1]
    steps = 1e-7 * random.normal(size=(8, *directions.shape))
    blends = []
    for step in steps:
        indices, weights = surrounding_frames(grid, directions + step)
        blends.append(np.einsum("mk,mki->mi", weights, grid.directions[indices]))
    assert np.ptp(blends, axis=0).max() < 1e-4


def test_cell_diagonals_avoid_frames_far_from_the_direction():
    """Diagonals across the folds of the map would use frames up to 40 degrees away."""
    grid, directions = FrameGrid(12), fibonacci_sphere(2000)
    indices, weights = surrounding_frames(grid, directions)
    angles = np.degrees(np.arccos(np.clip(np.einsum("mki,mi->mk", grid.directions[indices], directions), -1.0, 1.0)))
    assert angles[weights > 1e-6].max() < 28.0
    assert (weights * angles).sum(axis=1).max() < 15.0


@pytest.mark.parametrize("frames", [0, 1, 65])
def test_too_few_and_too_many_frames_are_rejected(frames):
    with pytest.raises(SettingsError, match="12 is the usual number"):
        FrameGrid(frames)


@pytest.mark.parametrize("direction", held_out_views(4), ids=str)
def test_rays_between_the_frames_hit_the_sphere(direction):
    atlas = sphere_atlas()
    points = ray_points(atlas, direction, 0.5)
    sample = sample_rays(atlas, points, direction)
    hits = points + sample.distances[:, None] * direction - atlas.center
    assert sample.color[:, 3] == pytest.approx(1.0, abs=1e-6)
    assert np.linalg.norm(hits, axis=1) / atlas.half_side == pytest.approx(SPHERE_RADIUS, abs=0.03)
    normals = hits / np.linalg.norm(hits, axis=1, keepdims=True)
    assert np.einsum("mi,mi->m", sample.normal, normals).min() > np.cos(np.radians(4.0))
    assert sample.color[:, :3] == pytest.approx(0.5 + 0.5 * normals, abs=0.04)
    right = np.cross([0.0, 0.0, 1.0], direction) / np.linalg.norm(direction[:2])
    assert sample_rays(atlas, atlas.center + 0.95 * atlas.half_side * right[None], direction).color[0, 3] == 0.0


def test_rays_in_the_direction_of_a_frame_sample_this_frame():
    atlas = sphere_atlas()
    index = 40
    view = atlas.view(index)
    row, column = np.mgrid[: atlas.frame_resolution, : atlas.frame_resolution]
    x, y = (pixels.ravel()[:, None] + 0.5 - 0.5 * view.resolution for pixels in (column, row))
    sample = sample_rays(atlas, atlas.center + view.pixel_size * (x * view.right + y * view.up), view.direction)
    stored = atlas.color[atlas.tile(index)].reshape(-1, 4)
    assert sample.color == pytest.approx(stored * stored[:, 3:], abs=1e-6)


def test_varying_normals_within_a_pixel_make_it_darker():
    atlas, direction = sphere_atlas(), np.array([0.6, 0.0, 0.8])
    atlas.normal[:] *= 0.5
    sample = sample_rays(atlas, atlas.center[None], direction)
    uniform = sample_rays(sphere_atlas(), atlas.center[None], direction)
    assert sample.color[0, :3] == pytest.approx(0.5 * uniform.color[0, :3], rel=1e-6)
    assert sample.normal == pytest.approx(uniform.normal)


def test_roughness_and_metallic_need_an_image_only_where_they_vary():
    atlas = sphere_atlas(4, 16)
    atlas.roughness_metallic[:] = [0.4, 0.0]
    assert atlas.uniform_roughness_metallic == pytest.approx([0.4, 0.0])
    assert set(atlas.encode()) == {"color", "normal_height"}
    atlas.roughness_metallic[:32, :, 0] = 0.5
    assert atlas.uniform_roughness_metallic is None
    images = atlas.encode()
    assert images["roughness_metallic"][..., :2] == pytest.approx(atlas.roughness_metallic)
    assert 2.0 * images["normal_height"][..., 3] - 1.0 == pytest.approx(atlas.height)
    assert all(image.min() >= 0.0 and image.max() <= 1.0 and image.shape == (64, 64, 4) for image in images.values())
    atlas.color[..., 3] = 0.0
    assert atlas.uniform_roughness_metallic == pytest.approx([0.0, 0.0])
