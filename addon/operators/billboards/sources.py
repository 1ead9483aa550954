"""The source geometry of clouds, read from selected objects, and sentences about clouds and originals that could not be changed.

A selected cloud represents its original, which is built again.
"""

from collections.abc import Iterable, Sequence

import bpy

from ...bridge.billboards import clouds
from ...bridge.billboards.scene_clouds import SceneCloud, clouds_of_levels
from ...bridge.billboards.source_objects import read_combined, read_source_objects
from ...bridge.geometry import meshes
from ...bridge.objects import temporarily_visible
from ...core.errors import GeometryError
from ...core.messages import format_count, join_sentences, quote_names


def read_sources(context: bpy.types.Context, objects: Sequence[bpy.types.Object], combine: bool) -> tuple[list[meshes.Source], list[str]]:
    """Read the sources of clouds from `objects`. Returns them and the skipped objects: names with reasons.

    A mesh with only vertices is a point cloud, which is always a source of its own, also with `combine`. The levels of a cloud represent
    the objects that it was built from, which may be hidden; they become one source. With `combine` the active object comes first, as in
    Blender's Join, because others give name and origin only in its absence, see `read_combined`. Without it, objects that are parented to
    each other or to the same armature are one source.

    Raises:
        GeometryError: there is no source.
    """
    ordinary = [item for item in objects if clouds.KIND not in item]
    rebuilt, skipped, selected_clouds = [], [], clouds_of_levels(context.scene, objects)
    for cloud in selected_clouds:
        if cloud.missing_source_names or not cloud.sources:
            skipped.append(f"{cloud.collection.name} ({missing_original_message(cloud)})")
        elif not set(cloud.sources) <= set(ordinary):
            rebuilt.append(cloud)
    levels = {level for cloud in selected_clouds for level in cloud.levels}
    skipped += [f"{item.name} (made by Farfield)" for item in objects if clouds.KIND in item and item not in levels]
    if combine:
        originals = [source for cloud in rebuilt for source in cloud.sources]
        with temporarily_visible(context, originals) as depsgraph:
            active = [item for item in ordinary if item == context.view_layer.objects.active]
            return _read_selected(list(dict.fromkeys([*active, *ordinary, *originals])), depsgraph, True, skipped), skipped
    sources = _read_clouds(context, rebuilt, skipped)
    if ordinary or not sources:
        try:
            sources = _read_selected(ordinary, context.evaluated_depsgraph_get(), False, skipped) + sources
        except GeometryError as error:
            if not sources:
                raise
            skipped.append(str(error).removesuffix("."))
    return sources, skipped


def describe_selection(context: bpy.types.Context, combine: bool) -> str:
    """Return sentences about what a build makes of the selection; "" for a single object or cloud. Cheap enough for every redraw."""
    selected = context.selected_objects
    surfaces = [item for item in selected if meshes.may_have_surface(item) and clouds.KIND not in item]
    others = sum(not meshes.may_have_surface(item) for item in selected)
    selected_clouds = clouds_of_levels(context.scene, selected) if len(surfaces) + others < len(selected) else []
    objects, groups = len(surfaces) + len(selected_clouds), len(group_by_parents(surfaces)) + len(selected_clouds)
    if objects < 2:
        return ""
    if combine or groups == 1:
        outcome = f"One cloud of {objects} objects{'' if combine else ', which are parented'}."
    else:
        outcome = f"{groups} clouds, one per object{' with its children' if groups < objects else ''}."
    return join_sentences([outcome, f"{format_count(others, 'object')} without a surface." if others else ""])


def group_by_parents(objects: Sequence[bpy.types.Object]) -> list[list[bpy.types.Object]]:
    """Return `objects` in the groups that become a cloud each by default: those that are parented to each other or to the same armature."""
    groups: dict[bpy.types.Object, list[bpy.types.Object]] = {}
    chosen = set(objects)
    for item in objects:
        root = item
        while root.parent is not None and (root.parent in chosen or root.parent.type == "ARMATURE"):
            root = root.parent
        groups.setdefault(root, []).append(item)
    return list(groups.values())


def is_point_cloud(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> bool:
    """Return whether the evaluated `item` is a mesh with only vertices."""
    if item.type != "MESH" or item.mode == "EDIT":
        return False
    mesh = item.evaluated_get(depsgraph).data
    return len(mesh.vertices) > 0 and len(mesh.edges) == 0 and len(mesh.polygons) == 0


def _read_clouds(context: bpy.types.Context, rebuilt: Iterable[SceneCloud], skipped: list[str]) -> list[meshes.Source]:
    """Return the source of each of the clouds `rebuilt`; add those that cannot be read to `skipped`."""
    sources = []
    for cloud in rebuilt:
        try:
            sources.append(read_source_objects(context, cloud.sources))
        except GeometryError as error:
            skipped.append(f"{cloud.collection.name} ({str(error).removesuffix('.')})")
    return sources


def _read_selected(
    objects: Sequence[bpy.types.Object], depsgraph: bpy.types.Depsgraph, combine: bool, skipped: list[str]
) -> list[meshes.Source]:
    """Return the sources of `objects`, which are not clouds; add those without a surface to `skipped`."""
    point_clouds = [item for item in objects if is_point_cloud(item, depsgraph)]
    sources = [meshes.read_point_cloud(item) for item in point_clouds]
    surfaces = [item for item in objects if item not in point_clouds]
    return sources + _read_surfaces(surfaces, depsgraph, combine, skipped) if surfaces or not sources else sources


def _read_surfaces(
    objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph, combine: bool, skipped: list[str]
) -> list[meshes.Source]:
    """Return one source of all `objects`, or one per group of objects with faces; add the other objects to `skipped`."""
    if not objects:
        raise GeometryError(f"Nothing to build a cloud from: {'; '.join(skipped) or 'no object is selected'}. Select an object with faces.")
    combined = read_combined(objects, depsgraph)
    skipped += combined.skipped
    names = {instance.name for instance in combined.instances}
    if combine or len(names) == 1:
        return [combined]
    return [read_combined(group, depsgraph) for group in group_by_parents([item for item in objects if item.name in names])]


def quote_clouds(scene_clouds: Sequence[SceneCloud]) -> str:
    """Return the names of the clouds in quotation marks, separated by commas."""
    return quote_names(cloud.collection.name for cloud in scene_clouds)


def linked_sources_message(names: Sequence[str]) -> str:
    """Return the sentence for source objects whose visibility cannot be changed."""
    return f"Visibility unchanged, linked from a library: {', '.join(dict.fromkeys(names))}."


def missing_original_message(cloud: SceneCloud) -> str:
    """Return that the original of `cloud` is missing, with the names of missing objects, as the end of a sentence."""
    names = quote_names(cloud.missing_source_names)
    return f"its original {names} was not found" if names else "its original was not found"


def describe_exceptions(scene_clouds: Sequence[SceneCloud], refused: Sequence[SceneCloud], view_layer: bpy.types.ViewLayer) -> str:
    """Return sentences about originals of `scene_clouds` that are missing, linked or not in `view_layer`, and about `refused` clouds, which
    are linked themselves. Empty if there is nothing to say."""
    missing = [name for cloud in scene_clouds for name in _missing_names(cloud)]
    linked = [name for cloud in scene_clouds for name in cloud.linked_source_names]
    absent = [source.name for cloud in scene_clouds for source in cloud.sources if source not in cloud.sources_in(view_layer)]
    absent += [f'"{cloud.collection.name}"' for cloud in scene_clouds if not cloud.is_in(view_layer)]
    sentences = [
        linked_sources_message(linked) if linked else "",
        f"Original not found: {', '.join(missing)}." if missing else "",
        f"Not in the view layer: {', '.join(dict.fromkeys(absent))}." if absent else "",
        f"Unchanged, linked from a library: {quote_clouds(refused)}; make local copies first." if refused else "",
    ]
    return join_sentences(sentences)


def _missing_names(cloud: SceneCloud) -> list[str]:
    name = f'"{cloud.collection.name}"'
    return [f'"{source}" of {name}' for source in cloud.missing_source_names] if cloud.source_names else [f"that of {name}"]
