"""Overlay that colors faces by UV stretch in 3D Viewports and UV Editors."""

from typing import Any

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from ...core.unwrap.stretch_colors import stretch_colors
from ..mesh_arrays import read_loop_vertices, read_positions, read_values
from .uv_maps import read_uv_stretch

OPACITY = 0.85
SURFACE_OFFSET = 2e-3  # of the longest bounding-box side: distance of the overlay from the faces


class StretchOverlay:
    """The draw handlers of the overlay, and a cache of GPU batches per mesh that is cleared whenever data changes."""

    def __init__(self) -> None:
        self._handlers: list[tuple[type, Any]] = []
        self._batches: dict[str, dict[str, Any]] = {}

    @property
    def is_shown(self) -> bool:
        """Whether the overlay is drawn."""
        return bool(self._handlers)

    def show(self) -> None:
        """Start drawing the overlay."""
        if self.is_shown:
            return
        self.clear_cache()
        for space, draw in ((bpy.types.SpaceView3D, self._draw_surfaces), (bpy.types.SpaceImageEditor, self._draw_uv_map)):
            self._handlers.append((space, space.draw_handler_add(draw, (), "WINDOW", "POST_VIEW")))
        bpy.app.handlers.depsgraph_update_post.append(_clear_cache)
        bpy.app.handlers.load_pre.append(_clear_cache)

    def hide(self) -> None:
        """Stop drawing the overlay and release its memory."""
        if not self.is_shown:
            return
        self.clear_cache()
        while self._handlers:
            space, handler = self._handlers.pop()
            space.draw_handler_remove(handler, "WINDOW")
        for handlers in (bpy.app.handlers.depsgraph_update_post, bpy.app.handlers.load_pre):
            if _clear_cache in handlers:  # another add-on may have cleared the list
                handlers.remove(_clear_cache)

    def clear_cache(self) -> None:
        """Forget the batches of all meshes."""
        self._batches.clear()

    def _draw_surfaces(self) -> None:
        gpu.state.depth_test_set("LESS_EQUAL")
        gpu.state.blend_set("ALPHA")
        for item in bpy.context.visible_objects:
            batch = self._batch(item, "surface")
            if batch is not None:
                with gpu.matrix.push_pop():
                    gpu.matrix.multiply_matrix(item.matrix_world)
                    batch.draw(gpu.shader.from_builtin("FLAT_COLOR"))
        gpu.state.depth_test_set("NONE")
        gpu.state.blend_set("NONE")

    def _draw_uv_map(self) -> None:
        item = bpy.context.active_object
        batch = None if item is None else self._batch(item, "uv_map")
        if batch is not None:
            gpu.state.blend_set("ALPHA")
            batch.draw(gpu.shader.from_builtin("FLAT_COLOR"))
            gpu.state.blend_set("NONE")

    def _batch(self, item: bpy.types.Object, name: str) -> Any:
        """Return the batch "surface" or "uv_map" of an object's mesh; None if it has not been unwrapped."""
        if item.type != "MESH":
            return None
        mesh = item.data
        if mesh.name_full not in self._batches:
            self._batches[mesh.name_full] = _build_batches(mesh)
        return self._batches[mesh.name_full].get(name)


overlay = StretchOverlay()


@bpy.app.handlers.persistent
def _clear_cache(*_: Any) -> None:
    overlay.clear_cache()


def _build_batches(mesh: bpy.types.Mesh) -> dict[str, Any]:
    uv_stretch = read_uv_stretch(mesh)
    if uv_stretch is None:
        return {}
    positions, normals, loop_vertices = read_positions(mesh), read_values(mesh.vertex_normals, "vector", 3), read_loop_vertices(mesh)
    offset_positions = positions + SURFACE_OFFSET * float(np.ptp(positions, axis=0).max(initial=0.0)) * normals
    colors = np.column_stack([stretch_colors(uv_stretch.stretches), np.full(len(uv_stretch.stretches), OPACITY, np.float32)])
    colors = np.repeat(colors, 3, axis=0)
    loops = uv_stretch.loops.ravel()
    return {
        "surface": _build_batch(offset_positions[loop_vertices[loops]], colors),
        "uv_map": _build_batch(uv_stretch.uvs[loops], colors),
    }


def _build_batch(positions: np.ndarray, colors: np.ndarray) -> Any:
    """Return a batch of triangles with corners `positions` (N, 2 or 3) and `colors` (N, 4)."""
    positions = np.column_stack([positions, np.zeros((len(positions), 3 - positions.shape[1]), np.float32)])
    content = {"pos": np.ascontiguousarray(positions, np.float32), "color": colors}
    return batch_for_shader(gpu.shader.from_builtin("FLAT_COLOR"), "TRIS", content)
