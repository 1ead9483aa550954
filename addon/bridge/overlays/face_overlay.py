"""Overlays that color the faces or vertices of meshes in 3D Viewports and UV Editors. One of them is shown at a time."""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from ..blender import redraw_areas

OPACITY = 0.85
SURFACE_OFFSET = 2e-3  # Distance from the faces, as a fraction of the longest bounding-box side.
CHANGES = ("undo_post", "redo_post", "load_pre")  # Handlers that replace data, in addition to `depsgraph_update_post`.


@dataclass(frozen=True)
class FaceColors:
    """Triangles to draw over the faces of an object.

    corners: (T, 3, 3), a little above the faces, see `offset_from_faces`; in the object's space or, if `is_world`, in world space. colors:
    (T, 3) of faces, or (T, 3, 4) of corners with their opacity, between which they are interpolated; sRGB. uvs: (T, 3, 2) to draw them in
    UV Editors, too, or None.
    """

    corners: np.ndarray
    colors: np.ndarray
    uvs: np.ndarray | None = None
    is_world: bool = False


class FaceOverlay:
    """Colors of faces, drawn while `is_shown`, with a cache of GPU batches that is cleared whenever data changes."""

    def __init__(self) -> None:
        self._handlers: list[tuple[type, Any]] = []
        self._batches: dict[Hashable, dict[str, Any]] = {}

    def find_key(self, item: bpy.types.Object) -> Hashable:
        """Return what identifies the colors of an object; objects with the same key share them. None if it has none."""
        raise NotImplementedError

    def read_colors(self, item: bpy.types.Object) -> FaceColors | None:
        """Return the colors of an object with a key; None if it has none."""
        raise NotImplementedError

    @property
    def is_shown(self) -> bool:
        """Whether the overlay is drawn."""
        return bool(self._handlers)

    def show(self) -> None:
        """Start drawing the overlay, in place of any other."""
        global _shown
        if self.is_shown:
            return
        if _shown is not None:
            _shown.hide()
        _shown = self
        for space, draw in ((bpy.types.SpaceView3D, self._draw_surfaces), (bpy.types.SpaceImageEditor, self._draw_uv_map)):
            self._handlers.append((space, space.draw_handler_add(draw, (), "WINDOW", "POST_VIEW")))
        bpy.app.handlers.depsgraph_update_post.append(_report_update)
        for name in CHANGES:
            getattr(bpy.app.handlers, name).append(_report_change)
        redraw_areas()

    def hide(self) -> None:
        """Stop drawing the overlay and release its memory."""
        global _shown
        if not self.is_shown:
            return
        _shown = None
        self.clear_cache()
        while self._handlers:
            space, handler = self._handlers.pop()
            space.draw_handler_remove(handler, "WINDOW")
        lists = [(bpy.app.handlers.depsgraph_update_post, _report_update)]
        lists += [(getattr(bpy.app.handlers, name), _report_change) for name in CHANGES]
        for handlers, handler in lists:
            if handler in handlers:  # another add-on may have cleared the list
                handlers.remove(handler)
        redraw_areas()

    def clear_cache(self) -> None:
        """Forget the batches of all objects."""
        self._batches.clear()

    def update(self, depsgraph: bpy.types.Depsgraph | None) -> None:
        """Respond to a change of data: an update of `depsgraph`, or, if it is None, undo, redo or another file."""
        self.clear_cache()

    def _draw_surfaces(self) -> None:
        gpu.state.depth_test_set("LESS_EQUAL")
        gpu.state.blend_set("ALPHA")
        for item in bpy.context.visible_objects:
            batches = self._find_batches(item)
            if "surface" in batches:
                with gpu.matrix.push_pop():
                    if not batches["is_world"]:
                        gpu.matrix.multiply_matrix(item.matrix_world)
                    batches["surface"].draw(gpu.shader.from_builtin(batches["shader"]))
        gpu.state.depth_test_set("NONE")
        gpu.state.blend_set("NONE")

    def _draw_uv_map(self) -> None:
        item = bpy.context.active_object
        batches = {} if item is None else self._find_batches(item)
        if "uv_map" in batches:
            gpu.state.blend_set("ALPHA")
            batches["uv_map"].draw(gpu.shader.from_builtin(batches["shader"]))
            gpu.state.blend_set("NONE")

    def _find_batches(self, item: bpy.types.Object) -> dict[str, Any]:
        """Return the batches "surface" and "uv_map" of an object, their "shader", and "is_world"; those that it has."""
        key = self.find_key(item)
        if key is None:
            return {}
        if key not in self._batches:
            found = self.read_colors(item)
            self._batches[key] = {} if found is None else _build_batches(found)
        return self._batches[key]


_shown: FaceOverlay | None = None  # draw handlers belong to all of Blender


def offset_from_faces(positions: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return `positions` (N, 3) moved along `normals` (N, 3) so far that triangles there are drawn over the faces."""
    return positions + SURFACE_OFFSET * float(np.ptp(positions, axis=0).max(initial=0.0)) * normals


@bpy.app.handlers.persistent
def _report_update(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if _shown is not None:
        _shown.update(depsgraph)


@bpy.app.handlers.persistent
def _report_change(*_: Any) -> None:
    if _shown is not None:
        _shown.update(None)


def _build_batches(found: FaceColors) -> dict[str, Any]:
    shader = "FLAT_COLOR" if found.colors.ndim == 2 else "SMOOTH_COLOR"
    colors = spread_colors(found.colors)
    batches = {"is_world": found.is_world, "shader": shader, "surface": _build_batch(shader, found.corners.reshape(-1, 3), colors)}
    if found.uvs is not None:
        batches["uv_map"] = _build_batch(shader, found.uvs.reshape(-1, 2), colors)
    return batches


def spread_colors(colors: np.ndarray) -> np.ndarray:
    """Return the color with opacity (3 T, 4) float32 of each corner, from those of faces (T, 3) or corners (T, 3, 4)."""
    if colors.ndim == 2:
        colors = np.repeat(np.column_stack([colors, np.full(len(colors), OPACITY, np.float32)]), 3, axis=0)
    return np.ascontiguousarray(colors.reshape(-1, 4), np.float32)


def _build_batch(shader: str, positions: np.ndarray, colors: np.ndarray) -> Any:
    """Return a batch of triangles with corners `positions` (N, 2 or 3) and `colors` (N, 4)."""
    positions = np.column_stack([positions, np.zeros((len(positions), 3 - positions.shape[1]), np.float32)])
    content = {"pos": np.ascontiguousarray(positions, np.float32), "color": colors}
    return batch_for_shader(gpu.shader.from_builtin(shader), "TRIS", content)
