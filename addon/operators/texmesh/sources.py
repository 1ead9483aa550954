"""Which objects levels are made from."""

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import bpy

from ...bridge.geometry.meshes import describe_type, is_in_view_layer, may_have_surface
from ...bridge.objects import temporarily_visible
from ...bridge.texmesh.level_sets import find_level_set
from ...bridge.texmesh.sources import read_source_at_rest
from ...core.errors import FarfieldError, GeometryError
from ...core.messages import format_count
from ...core.texmesh.level_candidates import MIN_TRIANGLES, min_triangles
from ...core.texmesh.settings import TexmeshSettings
from ...core.texmesh.textured_mesh import TexturedMesh

Source = TypeVar("Source")


class MeshSource(Protocol):
    """A named mesh."""

    name: str
    mesh: TexturedMesh


def source_objects(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the selected objects, levels replaced by the object that they were made from, each once."""
    found = []
    for item in context.selected_objects:
        levels = find_level_set(context.scene, item)
        source = levels.source if levels is not None and item in levels.levels else item
        if source is not None and source not in found:
            found.append(source)
    return found


def refusal(item: bpy.types.Object, view_layer: bpy.types.ViewLayer) -> str:
    """Return why no levels can be made from an object, or an empty string."""
    if not may_have_surface(item):
        return f"{describe_type(item)} has no surface"
    if not is_in_view_layer(item, view_layer):
        return "its collection is excluded from the view layer"
    if item.mode == "EDIT":
        return "it is in Edit Mode; switch to Object Mode"
    return ""


def read_sources(
    context: bpy.types.Context,
    objects: Sequence[bpy.types.Object],
    read: Callable[[bpy.types.Object, bpy.types.Depsgraph], Source] = read_source_at_rest,
) -> tuple[list[Source], list[str]]:
    """Return what `read` returns of `objects`, and the names of the others with the reason.

    Raises:
        FarfieldError: none can be read.
    """
    sources, skipped, errors = [], [], []
    for item in objects:
        reason = refusal(item, context.view_layer)
        if reason:
            skipped.append(f"{item.name} ({reason})")
            continue
        try:
            with temporarily_visible(context, [item]) as depsgraph:  # originals are hidden while their levels are shown
                sources.append(read(item, depsgraph))
        except FarfieldError as error:
            errors.append(error)
    if not sources:
        if len(errors) == 1 and not skipped:
            raise errors[0]
        reasons = "; ".join([*skipped, *(str(error).removesuffix(".") for error in errors)])
        raise GeometryError(f"Nothing to make levels from: {reasons or 'no object is selected'}. Select a mesh with a texture.")
    return sources, [*skipped, *(str(error).removesuffix(".") for error in errors)]


def check_sizes(sources: Sequence[MeshSource]) -> None:
    """Raise GeometryError if none of the meshes has enough triangles for levels."""
    if all(len(source.mesh.triangles) < MIN_TRIANGLES for source in sources):
        source = max(sources, key=lambda source: len(source.mesh.triangles))
        count = format_count(len(source.mesh.triangles), "triangle")
        raise GeometryError(f'"{source.name}" has only {count}; levels need at least {MIN_TRIANGLES}.')


def describe_small(source: MeshSource, settings: TexmeshSettings) -> str:
    """Return a sentence about a mesh that is its only level, "" for others."""
    count = len(source.mesh.triangles)
    return f'"{source.name}" has only {format_count(count, "triangle")} and stays as it is.' if count < min_triangles(settings) else ""
