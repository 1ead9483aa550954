"""Frames of an octahedral impostor surround every direction, and agree about what a ray between them sees."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.btf.octahedral import Atlas, FrameGrid, frame_pixels, look_up, uniform_surface
from farfield.addon.core.directions import fibonacci_sphere, held_out_views
from farfield.addon.core.errors import SettingsError

BALL = 0.8  # of half a frame
grids = st.builds(FrameGrid, st.integers(2, 16), st.booleans())


def ball_atlas(frames=12, pixels=48, center=(3.0, -2.0, 1.0), half_side=5.0):
    """A ball whose colour is its normal moved to 0..1, computed pixel by pixel."""
    grid, side = FrameGrid(frames), frames * pixels
    maps = np.zeros((side, side, 4)), np.zeros((side, side, 3)), np.zeros((side, side)), np.zeros((side, side, 2))
    atlas = Atlas(grid, np.array(center), half_side, pixels, *maps)
    x, y = np.meshgrid(*[(2.0 * np.arange(pixels) + 1.0) / pixels - 1.0] * 2)
    height = np.sqrt(np.maximum(BALL**2 - x**2 - y**2, 0.0))
    for number in range(len(grid)):
        view, tile = atlas.view(number), atlas.tile(number)
        normal = x[..., None] * view.right + y[..., None] * view.up + height[..., None] * view.direction
        normal /= np.linalg.norm(normal, axis=2, keepdims=True)
        atlas.normal[tile], atlas.height[tile] = normal, height
        atlas.colour[tile] = np.concatenate([0.5 + 0.5 * normal, (height > 0.0)[..., None]], axis=2)
    return atlas


def rays(atlas, direction, reach):
    """Points (M, 3) of rays within `reach` half sides of the centre of `atlas`, in the plane across `direction`."""
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    x, y = np.meshgrid(np.linspace(-reach, reach, 31), np.linspace(-reach, reach, 31))
    inside = np.hypot(x, y) < reach
    offsets = x[inside][:, None] * right + y[inside][:, None] * np.cross(direction, right)
    return atlas.center + atlas.half_side * offsets


@given(grids, st.integers(0, 2**31))
def test_weights_are_shares_of_three_frames_near_by(grid, seed):
    directions = fibonacci_sphere(64) @ np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    if grid.upper:
        directions = directions[directions[:, 2] > 0.0]
    numbers, weights = grid.around(directions)
    assert ((numbers >= 0) & (numbers < len(grid))).all()
    assert (weights >= 0.0).all() and weights.sum(axis=1) == pytest.approx(1.0)
    means = np.einsum("mk,mki->mi", weights, grid.directions[numbers])
    if grid.frames > 10:
        assert (np.einsum("mi,mi->m", means, directions) / np.linalg.norm(means, axis=1)).min() > np.cos(np.radians(8.0))


@given(grids)
def test_a_frame_has_its_own_direction_to_itself(grid):
    numbers, weights = grid.around(grid.directions)
    chosen = numbers[np.arange(len(grid)), weights.argmax(axis=1)]
    assert weights.max(axis=1) == pytest.approx(1.0, abs=1e-9)
    assert grid.directions[chosen] == pytest.approx(grid.directions, abs=1e-9)


@pytest.mark.parametrize("grid", [FrameGrid(12), FrameGrid(7), FrameGrid(12, upper=True)], ids=["even", "odd", "upper"])
def test_what_is_blended_is_continuous_everywhere(grid):
    """Also across the cuts of cells, the folds of the map and its border."""
    random = np.random.default_rng(5)
    crossings = np.concatenate([grid.directions, fibonacci_sphere(500), [[1.0, 0.0, -1.0], [0.0, 1.0, -0.5], [-1.0, 1e-12, -0.1]]])
    if grid.upper:
        crossings = crossings[crossings[:, 2] > 0.1]
    steps = 1e-7 * random.normal(size=(8, *crossings.shape))
    blends = []
    for step in steps:
        numbers, weights = grid.around(crossings + step)
        blends.append(np.einsum("mk,mki->mi", weights, grid.directions[numbers]))
    assert np.ptp(blends, axis=0).max() < 1e-4


def test_cells_are_cut_so_that_no_frame_is_taken_from_far_away():
    """A cut that crosses the folds of the map would take frames from up to 40 degrees."""
    grid, directions = FrameGrid(12), fibonacci_sphere(2000)
    numbers, weights = grid.around(directions)
    angles = np.degrees(np.arccos(np.clip(np.einsum("mki,mi->mk", grid.directions[numbers], directions), -1.0, 1.0)))
    assert angles[weights > 1e-6].max() < 28.0
    assert (weights * angles).sum(axis=1).max() < 15.0


@pytest.mark.parametrize("frames", [0, 1, 65])
def test_too_few_and_too_many_frames_are_refused(frames):
    with pytest.raises(SettingsError, match="12 is the usual number"):
        FrameGrid(frames)


@given(st.integers(300_000, 10**9), st.integers(2, 16), st.integers(2, 3))
def test_frames_are_the_largest_that_the_bytes_hold(total, frames, images):
    pixels = frame_pixels(total, frames, images)
    assert 4 * images * (frames * pixels) ** 2 <= total < 4 * images * (frames * (pixels + 1)) ** 2


def test_too_few_bytes_are_refused_with_the_number_that_would_do():
    with pytest.raises(SettingsError, match="73,728 bytes are the fewest"):
        frame_pixels(73_727, 12, 2)
    assert frame_pixels(73_728, 12, 2) == 8


@pytest.mark.parametrize("direction", held_out_views(4), ids=str)
def test_a_ball_is_seen_as_a_ball_between_the_frames(direction):
    atlas = ball_atlas()
    points = rays(atlas, direction, 0.5)
    seen = look_up(atlas, points, direction)
    places = points + seen.along[:, None] * direction - atlas.center
    assert seen.colour[:, 3] == pytest.approx(1.0, abs=1e-6)
    assert np.linalg.norm(places, axis=1) / atlas.half_side == pytest.approx(BALL, abs=0.03)
    outwards = places / np.linalg.norm(places, axis=1, keepdims=True)
    assert np.einsum("mi,mi->m", seen.normal, outwards).min() > np.cos(np.radians(4.0))
    assert seen.colour[:, :3] == pytest.approx(0.5 + 0.5 * outwards, abs=0.04)
    beside = np.cross([0.0, 0.0, 1.0], direction) / np.linalg.norm(direction[:2])
    assert look_up(atlas, atlas.center + 0.95 * atlas.half_side * beside[None], direction).colour[0, 3] == 0.0


def test_a_frame_seen_from_its_own_side_is_that_frame():
    atlas = ball_atlas()
    number = 40
    view = atlas.view(number)
    row, column = np.mgrid[: atlas.pixels, : atlas.pixels]
    across = (column.ravel()[:, None] + 0.5 - 0.5 * view.side) * view.right + (row.ravel()[:, None] + 0.5 - 0.5 * view.side) * view.up
    seen = look_up(atlas, atlas.center + view.pixel * across, view.direction)
    stored = atlas.colour[atlas.tile(number)].reshape(-1, 4)
    assert seen.colour == pytest.approx(stored * stored[:, 3:], abs=1e-6)


def test_normals_that_differ_within_a_pixel_make_it_darker():
    atlas = ball_atlas()
    atlas.normal[:] *= 0.5
    seen = look_up(atlas, atlas.center[None], np.array([0.6, 0.0, 0.8]))
    plain = look_up(ball_atlas(), atlas.center[None], np.array([0.6, 0.0, 0.8]))
    assert seen.colour[0, :3] == pytest.approx(0.5 * plain.colour[0, :3], rel=1e-6)
    assert seen.normal == pytest.approx(plain.normal)


def test_roughness_needs_an_image_only_where_it_differs():
    atlas = ball_atlas(4, 16)
    atlas.surface[:] = [0.4, 0.0]
    assert atlas.plain_surface == pytest.approx([0.4, 0.0])
    assert set(atlas.encoded()) == {"colour", "normal_height"}
    atlas.surface[:32, :, 0] = 0.5
    assert atlas.plain_surface is None
    encoded = atlas.encoded()
    assert encoded["surface"][..., :2] == pytest.approx(atlas.surface)
    assert 2.0 * encoded["normal_height"][..., 3] - 1.0 == pytest.approx(atlas.height)
    assert all(image.min() >= 0.0 and image.max() <= 1.0 and image.shape == (64, 64, 4) for image in encoded.values())
    assert uniform_surface(atlas.surface, np.zeros((64, 64))) == pytest.approx([0.0, 0.0])
