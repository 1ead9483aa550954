"""Outlines grow where a surface goes on past its quad, and only there: no crack opens, and no trunk becomes thicker."""

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes
from farfield.addon.bridge.outlines import Continuations
from farfield.addon.core.billboards.build import build
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.progress import finish


@pytest.fixture(autouse=True)
def fresh_scene():
    blender_scenes.fresh()


def level_of(source, error: float):
    return finish(build(source.mesh, BillboardSettings(error=error, levels=1))).levels[0]


def filled(level, inset: int) -> np.ndarray:
    """An alpha that fills every rectangle but for `inset` texels on each side."""
    alpha = np.zeros((level.atlas.size[1], level.atlas.size[0]), np.float32)
    for x, y, wide, tall in level.atlas.rectangles:
        alpha[y + inset : y + tall - inset, x + inset : x + wide - inset] = 1.0
    return alpha


def beside(alpha: np.ndarray) -> np.ndarray:
    padded = np.pad(alpha, 1)
    return (alpha == 0.0) & (np.max([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]], axis=0) > 0.0)


def test_a_surface_goes_on_inside_its_own_outline():
    bpy.ops.mesh.primitive_cube_add(size=2.0)
    source = blender_scenes.taken(bpy.context.object)
    level = level_of(source, 0.02)
    assert level.joined.all()
    alpha = filled(level, 3)
    np.testing.assert_array_equal(Continuations(source).texels(level, [alpha]), beside(alpha))


def test_nothing_goes_on_past_the_edges_of_a_trunk():
    bpy.ops.mesh.primitive_cylinder_add(vertices=48, radius=0.1, depth=3.0)
    source = blender_scenes.taken(bpy.context.object)
    level = level_of(source, 0.01)
    everywhere = np.zeros((level.atlas.size[1], level.atlas.size[0]), np.float32)
    everywhere[::2] = 1.0  # every other row, so that all texels are candidates
    goes_on = Continuations(source).texels(level, [everywhere, 1.0 - everywhere])
    sides = np.flatnonzero(np.abs(level.quads.frames[:, 2, 2]) < 0.5)
    assert len(sides)
    for quad in sides:
        x, y, wide, tall = level.atlas.rectangles[quad]
        lengthwise = abs(level.quads.frames[quad, 0, 2]) > 0.5
        across = goes_on[y - 2 : y + tall + 2, x - 2 : x + wide + 2].any(axis=1 if lengthwise else 0)
        assert across.sum() <= np.ceil(2.0 * 0.1 / level.texel) + 1
    assert goes_on.any()


def test_a_level_without_joined_quads_has_nothing_to_grow():
    bpy.ops.mesh.primitive_plane_add()
    source = blender_scenes.taken(bpy.context.object)
    level = level_of(source, 0.02)
    assert not Continuations(source).texels(level, [filled(level, 2)]).any()
