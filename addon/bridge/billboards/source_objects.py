"""Reading the source objects of a cloud again, also while they are hidden."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy

from ...core.errors import FarfieldError, GeometryError
from .. import meshes


def read_source_objects(context: bpy.types.Context, sources: Sequence[bpy.types.Object]) -> meshes.Source:
    """Read the geometry of `sources` in the scene of `context`, also of those that are hidden because their cloud is shown instead.

    Raises:
        GeometryError: it cannot be read, or an object is not in the view layer.
    """
    absent = [item.name for item in sources if not meshes.is_in_view_layer(item, context.view_layer)]
    if absent:
        names = ", ".join(absent)
        raise GeometryError(f"The original of the cloud cannot be read: {names} is not in the view layer; include its collection there.")
    with temporarily_visible(context, sources) as depsgraph:
        first = sources[0].evaluated_get(depsgraph).data
        try:
            if len(sources) == 1 and isinstance(first, bpy.types.Mesh) and len(first.vertices) and not len(first.polygons):
                return meshes.read_point_cloud(sources[0])
            return meshes.read_source(list(sources), depsgraph)
        except FarfieldError as error:
            raise GeometryError(f"The original of the cloud cannot be read: {error}") from error


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
