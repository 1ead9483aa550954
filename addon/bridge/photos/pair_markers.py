"""Markers of pairs of points in editors: numbered crosses, and arrows to where the registered camera projects the points."""

from typing import Any

import blf
import bpy
import gpu
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d

from ..blender import redraw_areas
from ..restore.outline import build_lines, draw_lines
from .point_pairs import PROPERTY

ARROW_SCALE = 10.0  # arrows are longer than the residuals
CROSS = 7.0  # pixels from the center to the ends
HEAD = 4.0  # pixels
WIDTH, SHADOW_WIDTH = 1.8, 4.0
COLOR, WRONG_COLOR, ARROW_COLOR, SHADOW = (1.0, 0.85, 0.1, 1.0), (1.0, 0.2, 0.1, 1.0), (0.2, 0.9, 1.0, 1.0), (0.0, 0.0, 0.0, 0.8)
FONT_SIZE = 13.0


class PairMarkers:
    """The draw handlers."""

    def __init__(self) -> None:
        self._handlers: list[tuple[type, Any]] = []

    def start(self) -> None:
        """Draw in all editors from now on."""
        for space, draw in ((bpy.types.SpaceImageEditor, _draw_in_image), (bpy.types.SpaceView3D, _draw_in_view)):
            self._handlers.append((space, space.draw_handler_add(draw, (), "WINDOW", "POST_PIXEL")))

    def stop(self) -> None:
        """Stop drawing."""
        for space, handler in self._handlers:
            space.draw_handler_remove(handler, "WINDOW")
        self._handlers.clear()


markers = PairMarkers()


def redraw_editors() -> None:
    """Redraw all editors with markers."""
    redraw_areas("IMAGE_EDITOR", "VIEW_3D")


def _draw_in_image() -> None:
    context = bpy.context
    image = context.space_data.image
    if image is None or 0 in image.size or not len(getattr(image, PROPERTY).pairs):
        return
    group, view, size = getattr(image, PROPERTY), context.region.view2d, np.array(image.size)
    for index, pair in enumerate(group.pairs):
        if not pair.has_position:
            continue
        position = np.array(pair.position)
        center = np.array(view.view_to_region(*(position / size), clip=False))
        _draw_marker(center, index, is_wrong=group.is_registered and pair.is_wrong)
        if group.is_registered and pair.has_point:
            end = np.array(view.view_to_region(*((position + ARROW_SCALE * np.array(pair.residual)) / size), clip=False))
            _draw_arrow(center, end)


def _draw_in_view() -> None:
    context = bpy.context
    for image in _shown_images(context):
        group = getattr(image, PROPERTY)
        for index, pair in enumerate(group.pairs):
            center = location_3d_to_region_2d(context.region, context.region_data, pair.point) if pair.has_point else None
            if center is not None:
                _draw_marker(np.array(center), index, is_wrong=group.is_registered and pair.is_wrong)


def _shown_images(context: bpy.types.Context) -> list[bpy.types.Image]:
    """Return the images with pairs that the Image Editors of the same window show."""
    spaces = [area.spaces.active for area in context.screen.areas if area.type == "IMAGE_EDITOR"]
    return list(dict.fromkeys(space.image for space in spaces if space.image is not None and len(getattr(space.image, PROPERTY).pairs)))


def _draw_marker(center: np.ndarray, index: int, *, is_wrong: bool) -> None:
    color = WRONG_COLOR if is_wrong else COLOR
    scale = bpy.context.preferences.system.ui_scale
    ends = scale * CROSS * np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
    _draw_lines(center + ends, color)
    blf.size(0, FONT_SIZE * scale)
    blf.color(0, *color)
    blf.enable(0, blf.SHADOW)
    blf.shadow(0, 3, *SHADOW)
    blf.position(0, *(center + scale * CROSS), 0.0)
    blf.draw(0, str(index + 1))
    blf.disable(0, blf.SHADOW)


def _draw_arrow(start: np.ndarray, end: np.ndarray) -> None:
    length = float(np.linalg.norm(end - start))
    if length < 1.0:
        return
    along = (end - start) / length
    side, size = np.array([-along[1], along[0]]), HEAD * bpy.context.preferences.system.ui_scale
    _draw_lines(np.array([start, end, end, end - size * (along + side), end, end - size * (along - side)]), ARROW_COLOR)


def _draw_lines(ends: np.ndarray, color: tuple[float, float, float, float]) -> None:
    """Draw lines between pairs of `ends` (N, 2) in pixels of the region, with a shadow."""
    gpu.state.blend_set("ALPHA")
    draw_lines(build_lines(ends), ((SHADOW_WIDTH, SHADOW), (WIDTH, color)))
    gpu.state.blend_set("NONE")
