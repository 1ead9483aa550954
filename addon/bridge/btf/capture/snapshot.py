"""Snapshot of a bake for worker processes: source objects in a .blend file, levels as arrays, settings, and the scene's frame."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import bpy

from ....core.btf.capture.capture_spec import LevelCaptureSpec, load_capture_spec
from ....core.btf.settings import BtfSettings
from ....core.errors import FileError, GeometryError
from ...billboards.source_objects import read_source_objects
from ...geometry.meshes import Source
from ...imaging.images import find_images
from ...snapshots import explain, read_unsaved_images, write_blend, write_unsaved_images

BLEND_FILE, METADATA_FILE = "snapshot.blend", "snapshot.json"
SCENE_PROPERTIES = ("frame_subframe", "use_gravity")
RENDER_PROPERTIES = ("fps", "fps_base", "use_simplify", "simplify_subdivision", "simplify_child_particles")  # They affect evaluated meshes.
UNIT_PROPERTIES = ("scale_length",)


@dataclass(frozen=True)
class Snapshot:
    """An open snapshot: the source objects in the current scene, the source read from them, settings, and one spec per level."""

    objects: list[bpy.types.Object]
    source: Source
    settings: BtfSettings
    specs: list[LevelCaptureSpec]


def store_folder(folder: Path, level: int) -> Path:
    """Return the folder of the finished views of a level."""
    return folder / f"level-{level}"


def write_snapshot(
    folder: Path,
    scene: bpy.types.Scene,
    objects: Sequence[bpy.types.Object],
    source: Source,
    specs: Sequence[LevelCaptureSpec],
    settings: BtfSettings,
) -> None:
    """Write into `folder` everything that workers need to capture the levels `specs` of a cloud of `objects`, read as `source`.

    The user's data is unchanged. Unsaved paint strokes on images are included.

    Raises:
        FileError: if a file cannot be written.
    """
    metadata = {
        "objects": [item.name for item in objects],
        "fingerprint": source.fingerprint,
        "settings": asdict(settings),
        "levels": len(specs),
        "frame": scene.frame_current,
        "properties": {key: {name: getattr(owner, name) for name in names} for key, owner, names in _property_owners(scene)},
    }
    try:
        metadata["images"] = write_unsaved_images(folder, find_images(source.materials))
        metadata["collection"] = _write_blend(folder / BLEND_FILE, objects)
        for index, spec in enumerate(specs):
            spec.save(_spec_path(folder, index))
        (folder / METADATA_FILE).write_text(json.dumps(metadata), encoding="utf-8")
    except (OSError, RuntimeError) as error:
        raise FileError(f'The snapshot for the workers cannot be written to "{folder}": {explain(error)}.') from error


def open_snapshot(folder: Path, *, run_drivers: bool) -> Snapshot:
    """Open the snapshot in `folder`. It replaces the file that is open in this Blender.

    run_drivers: whether its drivers may run any Python. The folder does not tell: others may have written to it.

    Raises:
        FileError: if it cannot be read.
        GeometryError: if the source objects evaluate to other geometry here than where the snapshot was written.
    """
    # Not read_factory_settings: it deletes the wheels of all extensions that the factory preferences do not enable, which are in use.
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = run_drivers
    scene = bpy.context.scene
    try:
        metadata = json.loads((folder / METADATA_FILE).read_text(encoding="utf-8"))
        for name, owner, _ in _property_owners(scene):
            for key, value in metadata["properties"][name].items():
                setattr(owner, key, value)
        scene.frame_set(metadata["frame"], subframe=metadata["properties"]["scene"]["frame_subframe"])
        with bpy.data.libraries.load(str(folder / BLEND_FILE)) as (_, appended):
            appended.collections = [metadata["collection"]]
        objects_by_name = {item.name: item for item in appended.collections[0].objects}
        objects = [objects_by_name[name] for name in metadata["objects"]]
        read_unsaved_images(folder, metadata["images"])
        specs = [load_capture_spec(_spec_path(folder, index)) for index in range(metadata["levels"])]
    except (OSError, AttributeError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise FileError(
            f'The snapshot in "{folder}" cannot be read: {explain(error)}. Start the bake again; finished views are reused.'
        ) from error
    for item in objects:
        scene.collection.objects.link(item)
    bpy.context.view_layer.update()
    source = read_source_objects(bpy.context, objects)
    if source.fingerprint != metadata["fingerprint"]:
        raise GeometryError(
            f'"{source.name}" has a different shape in a worker process than in its file. It depends on external data, such as a '
            "simulation or a script. Apply its modifiers, rebuild the cloud and bake again."
        )
    return Snapshot(objects, source, BtfSettings(**metadata["settings"]), specs)


def _write_blend(path: Path, objects: Sequence[bpy.types.Object]) -> str:
    """Write `objects` in a temporary collection and return its name. Blender writes linked objects only if something uses them."""
    collection = bpy.data.collections.new("Farfield Snapshot")
    try:
        for item in objects:
            collection.objects.link(item)
        write_blend(path, collection)
        return collection.name
    finally:
        bpy.data.collections.remove(collection)


def _spec_path(folder: Path, index: int) -> Path:
    return folder / f"spec-{index}.npz"


def _property_owners(scene: bpy.types.Scene) -> Iterator[tuple[str, Any, tuple[str, ...]]]:
    """Yield the settings of a scene that can affect the shape of its objects: key, owner, and property names."""
    yield "scene", scene, SCENE_PROPERTIES
    yield "render", scene.render, RENDER_PROPERTIES
    yield "units", scene.unit_settings, UNIT_PROPERTIES
