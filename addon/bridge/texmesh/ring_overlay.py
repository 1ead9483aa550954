"""Overlay of switch rings: where in the horizontal plane a 3D Viewport would have to be for a level to switch."""

import math
from collections.abc import Sequence
from typing import Any

import blf
import bpy
import gpu
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.batch import batch_for_shader

from ...core.geometry.cameras import Camera
from ..viewers import viewport_camera
from .level_sets import LevelSet, level_sets_in

MAX_LABELED = 4  # Of levels of more objects, only those of the active object have rings.
LINE_WIDTH, FONT_SIZE = 2.0, 12.0  # pixels
LabelBox = tuple[float, float, float, float]  # left, bottom, right and top, in pixels
COLORS = ((0.95, 0.75, 0.15, 0.9), (0.35, 0.75, 0.95, 0.9), (0.60, 0.90, 0.40, 0.9), (0.95, 0.50, 0.45, 0.9), (0.80, 0.60, 0.95, 0.9))


class RingOverlay:
    """The switch rings of all levels in the scene, drawn while `is_shown`."""

    def __init__(self) -> None:
        self._handlers: list[Any] = []

    @property
    def is_shown(self) -> bool:
        """Whether the rings are drawn."""
        return bool(self._handlers)

    def show(self) -> None:
        """Start to draw the rings in all 3D Viewports."""
        if not self.is_shown:
            add = bpy.types.SpaceView3D.draw_handler_add
            self._handlers = [add(self._draw_lines, (), "WINDOW", "POST_VIEW"), add(self._draw_labels, (), "WINDOW", "POST_PIXEL")]

    def hide(self) -> None:
        """Stop drawing."""
        while self._handlers:
            bpy.types.SpaceView3D.draw_handler_remove(self._handlers.pop(), "WINDOW")

    def _draw_lines(self) -> None:
        gpu.state.blend_set("ALPHA")
        gpu.state.depth_test_set("LESS_EQUAL")
        shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
        shader.bind()
        shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
        shader.uniform_float("lineWidth", LINE_WIDTH)
        for number, _, ring in _find_context_rings():
            shader.uniform_float("color", COLORS[(number - 1) % len(COLORS)])
            batch_for_shader(shader, "LINE_STRIP", {"pos": np.concatenate([ring, ring[:1]]).astype(np.float32)}).draw(shader)
        gpu.state.depth_test_set("NONE")
        gpu.state.blend_set("NONE")

    def _draw_labels(self) -> None:
        region, view = bpy.context.region, bpy.context.region_data
        blf.size(0, FONT_SIZE * bpy.context.preferences.system.ui_scale)
        taken: list[LabelBox] = []
        for number, label, ring in _find_context_rings():
            projected = (location_3d_to_region_2d(region, view, point) for point in ring)
            inside = [xy for xy in projected if xy is not None and 0 <= xy[0] < region.width and 0 <= xy[1] < region.height]
            place = min(inside, key=lambda xy: abs(xy[0] - 0.5 * region.width) + 0.1 * xy[1], default=None)
            if place is not None:
                blf.color(0, *COLORS[(number - 1) % len(COLORS)])
                taken.append(find_free_box(taken, place[0], place[1] + 4.0, blf.dimensions(0, label)))
                blf.position(0, *taken[-1][:2], 0.0)
                blf.draw(0, label)


def find_free_box(taken: Sequence[LabelBox], x: float, y: float, size: tuple[float, float]) -> LabelBox:
    """Return the box of a label of this width and height at (x, y), or as far above as it takes not to overlap one of `taken`."""
    width, height = size
    for left, bottom, right, top in sorted(taken, key=lambda box: box[1]):
        if left < x + width and x < right and bottom < y + height and y < top:
            y = top
    return x, y, x + width, y + height


def find_rings(levels: LevelSet, camera: Camera) -> list[tuple[int, np.ndarray]]:
    """Return the numbers of levels, and the rings (N, 3) in world space where `camera` would switch to them; none if it is orthographic.
    Of levels with the same error only the coarsest ever shows."""
    low, high, scale = levels.bounds()
    errors = dict(zip(levels.errors, range(len(levels.levels)), strict=True)) if camera.field_of_view else {}
    return [(number, ring_around_box(low, high, camera.switch_distance(error * scale))) for error, number in errors.items() if error > 0.0]


def find_labeled_rings(scene: bpy.types.Scene, active: bpy.types.Object | None, camera: Camera) -> list[tuple[int, str, np.ndarray]]:
    """Return the rings of all levels in a scene, with their numbers and labels: if several objects have levels, the labels name them. Of
    more than MAX_LABELED, only the `active` one has rings."""
    found = level_sets_in(scene)
    shown = found if len(found) <= MAX_LABELED else [levels for levels in found if active in (levels.source, *levels.levels)]
    names = [f"{levels.label} " if len(found) > 1 else "" for levels in shown]
    return [
        (number, f"{name}L{number}", ring) for levels, name in zip(shown, names, strict=True) for number, ring in find_rings(levels, camera)
    ]


def _find_context_rings() -> list[tuple[int, str, np.ndarray]]:
    context = bpy.context
    if context.region_data is None:
        return []
    return find_labeled_rings(context.scene, context.active_object, viewport_camera(context.region_data, context.region.width))


def ring_around_box(low: np.ndarray, high: np.ndarray, distance: float, corner_segments: int = 16) -> np.ndarray:
    """Return a closed line (4 (S + 1), 3) float64 at `distance` from the box from `low` (3,) to `high` (3,), at half its height.

    Levels switch by the distance to the box, so the line is a rectangle with rounded corners, of S `corner_segments` each. It starts at the
    corner with the largest x and y, and runs counterclockwise seen from above.
    """
    angles = np.linspace(0.0, 0.5 * math.pi, corner_segments + 1)
    corners = [(high[0], high[1]), (low[0], high[1]), (low[0], low[1]), (high[0], low[1])]
    arcs = []
    for quarter, (x, y) in enumerate(corners):
        turned = angles + 0.5 * math.pi * quarter
        arcs.append(np.column_stack([x + distance * np.cos(turned), y + distance * np.sin(turned)]))
    ring = np.concatenate(arcs)
    return np.column_stack([ring, np.full(len(ring), 0.5 * (low[2] + high[2]))])


overlay = RingOverlay()
