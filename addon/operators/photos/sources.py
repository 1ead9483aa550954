"""The objects that get a texture, and the cameras with their photographs."""

import bpy

from ...bridge.geometry.meshes import SourceInstance, describe_type, is_collection_instance, read_instances
from ...bridge.photos.photo_images import PhotoSource, open_background
from ...bridge.photos.scene_cameras import find_background, has_photograph, read_photo_camera
from ...core.errors import GeometryError, SettingsError
from ...core.files.scratch import Scratch
from ...core.jobs.progress import Progress, Steps
from ...core.photos.photographs.photograph import Photograph

NO_CAMERAS = "Import cameras, or give cameras background images"
NO_MESH = "Select a mesh object"


def find_cameras(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the cameras whose photographs are used: the selected ones and those below selected Empties, otherwise all visible ones. A
    camera without a background image does not count."""
    parents = [item for item in context.selected_objects if item.type == "EMPTY"]
    selected = {*context.selected_objects, *(child for parent in parents for child in parent.children_recursive)}
    objects = [item for item in context.view_layer.objects if has_photograph(item)]
    return [item for item in objects if item in selected] or [item for item in objects if item.visible_get()]


def selected_meshes(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the selected mesh objects."""
    return [item for item in context.selected_objects if item.type == "MESH"]


def disabled_reason(context: bpy.types.Context) -> str:
    """Return why there is nothing to merge, or an empty string."""
    if context.mode != "OBJECT":
        return "Switch to Object Mode"
    if not find_cameras(context):
        return NO_CAMERAS
    return "" if selected_meshes(context) else NO_MESH


def open_photographs(context: bpy.types.Context, cameras: list[bpy.types.Object] | None = None) -> list[PhotoSource]:
    """Return the photographs of `cameras`, by default of all that `find_cameras` finds. Raises SettingsError if there is none, or a camera
    cannot be used, and FileError or ImageError if a photograph cannot be used."""
    cameras = find_cameras(context) if cameras is None else cameras
    if not cameras:
        raise SettingsError(f"There is no camera with a photograph; {NO_CAMERAS.lower()}.")
    depsgraph = context.evaluated_depsgraph_get()
    return [
        open_background(read_photo_camera(item, context.scene, depsgraph), find_background(item.evaluated_get(depsgraph).data))
        for item in cameras
    ]


def read_photographs(sources: list[PhotoSource], scratch: Scratch) -> Steps[list[Photograph]]:
    """Read photographs, which `scratch` keeps, each in the group of its index. Raises FileError or ImageError."""
    photographs = []
    for index, source in enumerate(sources):
        yield Progress(index / len(sources), "Reading photographs")
        photographs.append(source.read().keep_in(scratch, index))
    return photographs


def read_targets(context: bpy.types.Context) -> tuple[list[bpy.types.Object], list[SourceInstance], list[str]]:
    """Return the selected meshes that can get a texture, their surfaces, and the other selected objects with the reason: all but cameras
    and plain Empties. Raises GeometryError if there is no such mesh, or it has no faces."""
    targets, skipped = [], []
    for item in context.selected_objects:
        if item.type in {"CAMERA", "EMPTY"} and not is_collection_instance(item):
            continue
        reason = _skip_reason(item)
        if reason:
            skipped.append(f"{item.name} ({reason})")
        else:
            targets.append(item)
    if not targets:
        raise GeometryError(f"There is nothing to texture: {'; '.join(skipped) or 'no object is selected'}. Select a local mesh object.")
    instances = read_instances(targets, context.evaluated_depsgraph_get())
    if not instances:
        raise GeometryError(f'"{targets[0].name}" has no faces after its modifiers; select another object.')
    return targets, instances, skipped


def _skip_reason(item: bpy.types.Object) -> str:
    if is_collection_instance(item):
        return "an instance of a collection; make it real"
    if item.type != "MESH":
        return f"{describe_type(item)} cannot be textured; convert it to a mesh"
    if not item.data.is_editable or not item.is_editable:
        return "linked from a library; make it local"
    if not item.visible_get():
        return "hidden"
    return "" if len(item.data.polygons) else "no faces"
