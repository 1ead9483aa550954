"""The objects that a cloud was built from, read again."""

from collections.abc import Sequence

import bpy

from ..core.errors import FarfieldError, GeometryError
from . import meshes


def read_original(context: bpy.types.Context, sources: Sequence[bpy.types.Object]) -> meshes.Source:
    """The geometry of the `sources` in the scene of `context`, also of those that are hidden because their cloud is shown instead.

    Raises:
        GeometryError: when it cannot be read.
    """
    hidden = [(item, item.hide_viewport, item.hide_get()) for item in sources]
    try:
        for item in sources:
            item.hide_viewport = False
            item.hide_set(False)
        context.view_layer.update()
        depsgraph = context.evaluated_depsgraph_get()
        first = sources[0].evaluated_get(depsgraph).data
        if len(sources) == 1 and isinstance(first, bpy.types.Mesh) and len(first.vertices) and not len(first.polygons):
            return meshes.take_points(sources[0])
        return meshes.take(list(sources), depsgraph)
    except FarfieldError as error:
        raise GeometryError(f"The original cannot be read: {error}") from error
    finally:
        for item, viewport, here in hidden:
            item.hide_viewport = viewport
            item.hide_set(here)
        context.view_layer.update()
