"""Temporary visibility of objects."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy

from . import meshes


@contextmanager
def temporarily_visible(context: bpy.types.Context, objects: Sequence[bpy.types.Object]) -> Iterator[bpy.types.Depsgraph]:
    """Show `objects` in the viewport and yield the evaluated scene of `context`; restore their visibility afterwards.

    Objects that are not in the view layer stay as they are.
    """
    present = [item for item in objects if meshes.is_in_view_layer(item, context.view_layer)]
    visibility = [(item, item.hide_viewport, item.hide_get()) for item in present]
    try:
        for item in present:
            item.hide_viewport = False
            item.hide_set(False)
        context.view_layer.update()
        yield context.evaluated_depsgraph_get()
    finally:
        for item, hide_viewport, hidden in visibility:
            item.hide_viewport = hide_viewport
            item.hide_set(hidden)
        context.view_layer.update()
