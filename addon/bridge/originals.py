"""The objects that a cloud was built from, read again."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy

from ..core.errors import FarfieldError, GeometryError
from . import meshes


def read_original(context: bpy.types.Context, sources: Sequence[bpy.types.Object]) -> meshes.Source:
    """The geometry of the `sources` in the scene of `context`, also of those that are hidden because their cloud is shown instead.

    Raises:
        GeometryError: when it cannot be read.
    """
    with shown(context, sources) as depsgraph:
        first = sources[0].evaluated_get(depsgraph).data
        try:
            if len(sources) == 1 and isinstance(first, bpy.types.Mesh) and len(first.vertices) and not len(first.polygons):
                return meshes.take_points(sources[0])
            return meshes.take(list(sources), depsgraph)
        except FarfieldError as error:
            raise GeometryError(f"The original cannot be read: {error}") from error


@contextmanager
def shown(context: bpy.types.Context, items: Sequence[bpy.types.Object]) -> Iterator[bpy.types.Depsgraph]:
    """The evaluated scene of `context` with `items` visible in the viewport; afterwards they are as they were."""
    hidden = [(item, item.hide_viewport, item.hide_get()) for item in items]
    try:
        for item in items:
            item.hide_viewport = False
            item.hide_set(False)
        context.view_layer.update()
        yield context.evaluated_depsgraph_get()
    finally:
        for item, viewport, here in hidden:
            item.hide_viewport = viewport
            item.hide_set(here)
        context.view_layer.update()
