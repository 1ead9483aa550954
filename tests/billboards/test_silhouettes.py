"""Silhouettes grow only where a surface continues past its quad: no crack opens, and no trunk becomes thicker."""

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes
from farfield.addon.bridge.billboards.silhouettes import SurfaceContinuation
from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.jobs.progress import run_to_end


@pytest.fixture(autouse=True)
def fresh_scene():
    blender_scenes.reset_scene()


def build_level(source, error: float):
    return run_to_end(build_cloud(source.mesh, BillboardSettings(error=error, levels=1, solid_parts="quads"))).levels[0]


def fill_rectangles(level, inset: int) -> np.ndarray:
    """Return an alpha that fills every rectangle except `inset` texels on each side."""
    alpha = np.zeros((level.atlas.size[1], level.atlas.size[0]), np.float32)
    for x, y, width, height in level.atlas.rectangles:
        alpha[y + inset : y + height - inset, x + inset : x + width - inset] = 1.0
    return alpha


def adjacent_texels(alpha: np.ndarray) -> np.ndarray:
    padded = np.pad(alpha, 1)
    return (alpha == 0.0) & (np.max([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]], axis=0) > 0.0)


def test_closed_surface_continues_everywhere():
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    source = blender_scenes.read_objects(bpy.context.object)
    level = build_level(source, 0.02)
    assert level.joined.all()
    alpha = fill_rectangles(level, 6)
    np.testing.assert_array_equal(SurfaceContinuation(source).find_texels(level, [alpha]), adjacent_texels(alpha))


def test_trunk_does_not_continue_past_its_sides():
    bpy.ops.mesh.primitive_cylinder_add(vertices=48, radius=0.1, depth=3.0)
    source = blender_scenes.read_objects(bpy.context.object)
    level = build_level(source, 0.01)
    alpha = np.zeros((level.atlas.size[1], level.atlas.size[0]), np.float32)
    alpha[::2] = 1.0  # every other row, so that all texels are candidates
    continuation = SurfaceContinuation(source).find_texels(level, [alpha, 1.0 - alpha])
    sides = np.flatnonzero(np.abs(level.quads.frames[:, 2, 2]) < 0.5)
    assert len(sides)
    for quad in sides:
        x, y, width, height = level.atlas.rectangles[quad]
        lengthwise = abs(level.quads.frames[quad, 0, 2]) > 0.5
        across = continuation[y - 2 : y + height + 2, x - 2 : x + width + 2].any(axis=1 if lengthwise else 0)
        assert across.sum() <= np.ceil(2.0 * 0.1 / level.texel_size) + 1
    assert continuation.any()


def test_level_without_joined_quads_has_no_continuation():
    bpy.ops.mesh.primitive_plane_add()
    source = blender_scenes.read_objects(bpy.context.object)
    level = build_level(source, 0.02)
    assert not SurfaceContinuation(source).find_texels(level, [fill_rectangles(level, 2)]).any()
