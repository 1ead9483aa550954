"""What is seen aslant lies beside the texel: known moves, their limits, and a curved surface that flat quads stand for."""

import numpy as np
import pytest

from farfield.addon.core.btf.relief import MOST, Relief, axes_of
from farfield.addon.core.btf.texels import Quads, texels_of

SIDE, TEXEL, ERROR = 16, 0.5, 1.0
VIEW = np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)


def sheet():
    """One level quad of 16 x 16 texels, half a unit each, whose texture lies a quarter turn round: its x runs along -y."""
    corners = np.array([[0, 0], [0, -8], [8, -8], [8, 0]], float)
    return texels_of(
        Quads([np.column_stack([corners, np.zeros(4)])], [np.array([[0, 0], [16, 0], [16, 16], [0, 16]], float)]), (SIDE, SIDE)
    )


def relief(depths: np.ndarray, normals: np.ndarray | None = None) -> Relief:
    texels = sheet()
    normals = np.tile(np.float32([0.0, 0.0, 1.0]), (SIDE, SIDE, 1)) if normals is None else normals
    return Relief(texels.pixels, texels.quads, axes_of(texels, ERROR), depths, normals)


@pytest.mark.parametrize(("depth", "moved"), [(0.0, 0.0), (0.25, 0.5), (-0.5, -1.0), (1.0, MOST), (-1.0, -MOST)])
def test_a_look_up_moves_towards_the_viewer_by_the_height_it_meets(depth, moved):
    """From 45 degrees by as much as the surface stands out, from a quarter of an error half a texel."""
    found = relief(np.full(SIDE**2, depth)).moved(VIEW)
    np.testing.assert_allclose(found, np.tile([0.0, moved], (SIDE**2, 1)), atol=1e-9)


def test_from_straight_above_and_from_the_edge_nothing_moves():
    raised = relief(np.full(SIDE**2, 0.5))
    np.testing.assert_allclose(raised.moved(np.array([0.0, 0.0, 1.0])), 0.0, atol=1e-12)
    np.testing.assert_allclose(raised.moved(np.array([1.0, 0.0, 0.0])), 0.0, atol=1e-12)


def test_from_below_it_moves_to_the_other_side():
    raised = relief(np.full(SIDE**2, 0.25))
    np.testing.assert_allclose(raised.moved(-VIEW), raised.moved(VIEW), atol=1e-12)
    np.testing.assert_allclose(raised.moved(VIEW * [1, 1, -1]), -raised.moved(VIEW), atol=1e-12)


def test_normals_of_a_ball_are_found_from_aslant():
    """A cap whose heights stay within the error: what a ray meets there, and the normal where it does."""
    texels, radius = sheet(), 20.0
    center = np.array([4.0, -4.0, -radius + 0.3])
    apart = texels.positions[:, :2] - center[:2]
    heights = np.sqrt(radius**2 - (apart**2).sum(axis=1)) + center[2]
    assert np.abs(heights).max() < ERROR
    unit = (np.column_stack([texels.positions[:, :2], heights]) - center) / radius
    made = relief(heights / ERROR, texels.image(unit.astype(np.float32)))
    for view in (VIEW, np.array([-0.5, 0.4, 0.9]) / np.linalg.norm([-0.5, 0.4, 0.9])):
        offset = texels.positions - center
        along = -offset @ view + np.sqrt((offset @ view) ** 2 - (offset**2).sum(axis=1) + radius**2)
        met = texels.positions + along[:, None] * view
        inside = ((met[:, 0] > 0.5) & (met[:, 0] < 7.5) & (met[:, 1] < -0.5) & (met[:, 1] > -7.5)).nonzero()[0]
        truth = (met[inside] - center) / radius
        moved = np.degrees(np.arccos(np.clip((made.seen(view, inside) * truth).sum(axis=1), -1.0, 1.0)))
        straight = np.degrees(np.arccos(np.clip((unit[inside] * truth).sum(axis=1), -1.0, 1.0)))
        assert moved.mean() < 0.2 * straight.mean()
