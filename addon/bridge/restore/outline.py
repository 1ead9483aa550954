"""Outline of the missing pixels in Image Editors, and the image itself over a mask that is being painted.

Draw handlers may not change data, so a timer finds the missing pixels. It pauses longer than it works, however large the image is: what
is drawn may be older than the last stroke for a moment.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from ..blender import redraw_areas
from ..objects import find_by_uid
from .image_users import MASKED_PROPERTY, read_image_property

MIN_PAUSE = 0.2  # seconds between two updates
PAUSE_FACTOR = 6.0  # pause after an update, relative to its duration
MAX_OUTLINES = 16  # kept for images that are not shown at the moment
OPACITY = 0.7  # An image is drawn over its mask with this opacity.
MAX_EDGES = 1_000_000  # between pixels; masks with more, such as noise, get a coarser outline
LINES = ((4.0, (0.0, 0.0, 0.0, 1.0)), (1.8, (1.0, 0.85, 0.1, 1.0)))  # widths in pixels and colors, which are seen on every background

FindMasks = Callable[[bpy.types.Image, bpy.types.Scene], dict[int, np.ndarray]]


@dataclass
class _Outline:
    """Line segments (N, 2, 2) of one image in UV space, and the batch that draws them."""

    segments: np.ndarray
    batch: Any = None


class MaskOutline:
    """The draw handler, the timer and the outlines of the images that editors have shown.

    is_hidden: whether the user has switched the outline off. outlines: by the session UID of the image.
    """

    def __init__(self) -> None:
        self.is_hidden = False
        self._handler: Any = None
        self._find_masks: FindMasks | None = None
        self.outlines: dict[int, _Outline] = {}
        self._requested: dict[int, str] = {}
        self._next_update = 0.0

    def start(self, find_masks: FindMasks) -> None:
        """Draw in all Image Editors from now on.

        find_masks: returns the missing pixels (H, W) bool of an image by tile number, 0 for an image without tiles; none for any error.
        """
        self._find_masks = find_masks
        self._handler = bpy.types.SpaceImageEditor.draw_handler_add(self._draw, (), "WINDOW", "POST_VIEW")
        bpy.app.handlers.load_pre.append(_clear)

    def stop(self) -> None:
        """Stop drawing and release all memory."""
        self.clear()
        if self._handler is not None:
            bpy.types.SpaceImageEditor.draw_handler_remove(self._handler, "WINDOW")
        self._handler = self._find_masks = None
        if _clear in bpy.app.handlers.load_pre:  # another add-on may have cleared the list
            bpy.app.handlers.load_pre.remove(_clear)

    def clear(self) -> None:
        """Forget all outlines."""
        self.outlines.clear()
        self._requested.clear()
        if bpy.app.timers.is_registered(_update):
            bpy.app.timers.unregister(_update)

    def update(self) -> None:
        """Find the missing pixels of the images that were drawn since the last update, and redraw where they have changed."""
        start, has_changed = time.monotonic(), False
        for uid, scene_name in list(self._requested.items()):
            image, scene = find_by_uid(bpy.data.images, uid), bpy.data.scenes.get(scene_name)
            masks = {} if image is None or scene is None else self._find_masks(image, scene)
            parts = [find_segments(mask) + _tile_offset(number) for number, mask in masks.items()]
            segments = np.concatenate(parts) if parts else np.zeros((0, 2, 2), np.float32)
            if uid not in self.outlines or not np.array_equal(self.outlines[uid].segments, segments):
                self.outlines.pop(uid, None)
                self.outlines[uid] = _Outline(segments)
                has_changed = True
        self._requested.clear()
        while len(self.outlines) > MAX_OUTLINES:
            del self.outlines[next(iter(self.outlines))]
        end = time.monotonic()
        self._next_update = end + max(MIN_PAUSE, PAUSE_FACTOR * (end - start))
        if has_changed:
            redraw_areas("IMAGE_EDITOR")

    def _request(self, image: bpy.types.Image, scene: bpy.types.Scene) -> None:
        self._requested[image.session_uid] = scene.name
        if not bpy.app.timers.is_registered(_update):
            bpy.app.timers.register(_update, first_interval=max(self._next_update - time.monotonic(), 0.01))

    def _draw(self) -> None:
        context = bpy.context
        shown = context.space_data.image
        if self.is_hidden or shown is None:
            return
        masked = read_image_property(shown, MASKED_PROPERTY)
        image = masked or shown
        self._request(image, context.scene)
        gpu.state.blend_set("ALPHA")
        if masked is not None and 0 not in masked.size:
            _draw_image(masked)
        found = self.outlines.get(image.session_uid)
        if found is not None and len(found.segments):
            if found.batch is None:
                found.batch = build_lines(found.segments.reshape(-1, 2))
            draw_lines(found.batch, LINES)
        gpu.state.blend_set("NONE")


outline = MaskOutline()


def _update() -> None:
    outline.update()


@bpy.app.handlers.persistent
def _clear(*_: Any) -> None:
    outline.clear()


def find_segments(mask: np.ndarray) -> np.ndarray:
    """Return the outline of `mask` (H, W) bool as line segments (N, 2, 2) float32 with ends x, y, where the image is the unit square.

    Edges of pixels along one line are one segment. The outline runs along the border of the image where masked pixels touch it.
    """
    height, width = mask.shape
    padded = np.pad(mask, 1)
    rows, columns = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])  # horizontal edges
    edge_rows, edge_columns = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])  # vertical edges
    if len(rows) + len(edge_rows) > MAX_EDGES:
        even = np.pad(mask, ((0, height % 2), (0, width % 2)))
        halved = even[0::2, 0::2] | even[1::2, 0::2] | even[0::2, 1::2] | even[1::2, 1::2]
        return np.minimum(find_segments(halved) * np.float32([even.shape[1] / width, even.shape[0] / height]), np.float32(1.0))
    segments = np.concatenate([_join(rows, columns), _join(edge_columns, edge_rows)[:, :, ::-1]])
    return (segments / [width, height]).astype(np.float32)


def _join(lines: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Join edges from `positions` to `positions` + 1 on `lines` (N,) where they touch: segments (R, 2, 2) with ends position, line."""
    order = np.lexsort((positions, lines))
    lines, positions = lines[order], positions[order]
    is_start = np.ones(len(lines), bool)
    is_start[1:] = (np.diff(lines) != 0) | (np.diff(positions) != 1)
    is_end = np.append(is_start[1:], True)[: len(lines)]
    starts = np.column_stack([positions[is_start], lines[is_start]])
    return np.stack([starts, np.column_stack([positions[is_end] + 1, lines[is_end]])], axis=1)


def _tile_offset(number: int) -> np.ndarray:
    """Return the position (2,) of a UDIM tile in UV space; that of an image without tiles, with the number 0, is the origin."""
    row, column = divmod(number - 1001, 10) if number else (0, 0)
    return np.float32([column, row])


def build_lines(ends: np.ndarray) -> Any:
    """Return a batch of lines between pairs of `ends` (N, 2)."""
    content = {"pos": np.ascontiguousarray(np.pad(ends, ((0, 0), (0, 1))), np.float32)}
    return batch_for_shader(gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR"), "LINES", content)


def draw_lines(batch: Any, lines: tuple[tuple[float, tuple[float, float, float, float]], ...]) -> None:
    """Draw a batch of lines several times, with widths in pixels and colors: the first ones are the shadows of the others."""
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    shader.bind()
    shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
    for width, color in lines:
        shader.uniform_float("lineWidth", width * bpy.context.preferences.system.pixel_size)
        shader.uniform_float("color", color)
        batch.draw(shader)


def _draw_image(image: bpy.types.Image) -> None:
    """Draw an image, or its first tile, over the one that the editor shows."""
    shader = gpu.shader.from_builtin("IMAGE_COLOR_SCENE_LINEAR_TO_REC709_SRGB")
    corners = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    offset = _tile_offset(image.tiles[0].number) if image.source == "TILED" else np.float32([0.0, 0.0])
    positions = [(x + offset[0], y + offset[1], 0.0) for x, y in corners]
    batch = batch_for_shader(shader, "TRI_FAN", {"pos": positions, "texCoord": corners})
    shader.bind()
    shader.uniform_sampler("image", gpu.texture.from_image(image))
    shader.uniform_float("color", (1.0, 1.0, 1.0, OPACITY))
    batch.draw(shader)
