"""Reading the source objects of a cloud again, also while they are hidden."""

from collections.abc import Sequence

import bpy

from ...core.errors import FarfieldError, GeometryError
from ..geometry import meshes
from ..objects import temporarily_visible


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
