"""Faces coloured by stretch, drawn over 3D views and UV editors."""

from typing import Any

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from ..core.unwrap.stretch_colors import stretch_colors
from .uv_maps import stretched_map

OPACITY = 0.85
ABOVE = 2e-3  # of the longest side of a mesh: how far its colours lie above its faces

_handlers: list[tuple[type, Any]] = []
_batches: dict[str, dict[str, Any]] = {}  # what is drawn of each mesh, until something changes


def shown() -> bool:
    """Whether stretch is drawn."""
    return bool(_handlers)


def switch(on: bool) -> None:
    """Draw stretch from now on, or no more."""
    if on == shown():
        return
    _batches.clear()
    if on:
        for space, draw in ((bpy.types.SpaceView3D, _draw_view), (bpy.types.SpaceImageEditor, _draw_uvs)):
            _handlers.append((space, space.draw_handler_add(draw, (), "WINDOW", "POST_VIEW")))
        bpy.app.handlers.depsgraph_update_post.append(_forget)
        bpy.app.handlers.load_pre.append(_forget)
        return
    while _handlers:
        space, handler = _handlers.pop()
        space.draw_handler_remove(handler, "WINDOW")
    bpy.app.handlers.depsgraph_update_post.remove(_forget)
    bpy.app.handlers.load_pre.remove(_forget)


@bpy.app.handlers.persistent
def _forget(*_: Any) -> None:
    _batches.clear()


def _draw_view() -> None:
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.blend_set("ALPHA")
    for item in bpy.context.visible_objects:
        batch = _batch(item, "surface")
        if batch is not None:
            with gpu.matrix.push_pop():
                gpu.matrix.multiply_matrix(item.matrix_world)
                batch.draw(gpu.shader.from_builtin("FLAT_COLOR"))
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


def _draw_uvs() -> None:
    item = bpy.context.active_object
    batch = None if item is None else _batch(item, "map")
    if batch is not None:
        gpu.state.blend_set("ALPHA")
        batch.draw(gpu.shader.from_builtin("FLAT_COLOR"))
        gpu.state.blend_set("NONE")


def _batch(item: bpy.types.Object, kind: str) -> Any:
    """What is drawn of an object's mesh on its "surface" or in its "map"; None where it has not been unwrapped."""
    if item.type != "MESH":
        return None
    mesh = item.data
    if mesh.name_full not in _batches:
        _batches[mesh.name_full] = _batches_of(mesh)
    return _batches[mesh.name_full].get(kind)


def _batches_of(mesh: bpy.types.Mesh) -> dict[str, Any]:
    found = stretched_map(mesh)
    if found is None:
        return {}
    places, normals, corners = (np.empty(count, kind) for count, kind in _sizes(mesh))
    mesh.vertices.foreach_get("co", places)
    mesh.vertex_normals.foreach_get("vector", normals)
    mesh.loops.foreach_get("vertex_index", corners)
    places, normals = places.reshape(-1, 3), normals.reshape(-1, 3)
    raised = places + ABOVE * float(np.ptp(places, axis=0).max(initial=0.0)) * normals
    colors = np.column_stack([stretch_colors(found.stretches), np.full(len(found.stretches), OPACITY, np.float32)])
    colors = np.repeat(colors, 3, axis=0)
    return {
        "surface": _made(raised[corners[found.loops.ravel()]], colors),
        "map": _made(found.uvs[found.loops.ravel()], colors),
    }


def _sizes(mesh: bpy.types.Mesh) -> list[tuple[int, type]]:
    return [(3 * len(mesh.vertices), np.float32), (3 * len(mesh.vertices), np.float32), (len(mesh.loops), np.int32)]


def _made(places: np.ndarray, colors: np.ndarray) -> Any:
    flat = np.column_stack([places, np.zeros((len(places), 3 - places.shape[1]), np.float32)])
    return batch_for_shader(gpu.shader.from_builtin("FLAT_COLOR"), "TRIS", {"pos": np.ascontiguousarray(flat, np.float32), "color": colors})
