"""What worker processes bake from: the original in a .blend file, the levels as arrays, settings, and the scene's time."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..core.btf.orders import LevelOrder, load_order
from ..core.btf.settings import BtfSettings
from ..core.errors import FileError, GeometryError
from .images import images_of, pixels_of
from .meshes import Source
from .originals import read_original

BLEND, WORDS = "snapshot.blend", "snapshot.json"
SCENE_VALUES = ("frame_subframe", "use_gravity")
RENDER_VALUES = ("fps", "fps_base", "use_simplify", "simplify_subdivision", "simplify_child_particles")  # they shape evaluated meshes
UNIT_VALUES = ("scale_length",)


@dataclass(frozen=True)
class Snapshot:
    """A snapshot that was opened: the original in the current scene, and what is to be done with it."""

    objects: list[bpy.types.Object]
    source: Source
    settings: BtfSettings
    orders: list[LevelOrder]


def store_folder(folder: Path, level: int) -> Path:
    """Where the finished views of a level lie."""
    return folder / f"level-{level}"


def write_snapshot(
    folder: Path,
    scene: bpy.types.Scene,
    objects: Sequence[bpy.types.Object],
    source: Source,
    orders: Sequence[LevelOrder],
    settings: BtfSettings,
) -> None:
    """Write into `folder` all that workers need to capture the levels `orders` of a cloud of `objects`, from which `source` was read.

    The user's data stay as they are; images with strokes that were never saved come along too.

    Raises:
        FileError: when the disk does not take it.
    """
    words = {
        "objects": [item.name for item in objects],
        "fingerprint": source.fingerprint,
        "settings": asdict(settings),
        "levels": len(orders),
        "frame": scene.frame_current,
        "values": {name: _values(owner, names) for name, owner, names in _owners(scene)},
        "runs_scripts": bpy.context.preferences.filepaths.use_scripts_auto_execute,
        "images": {},
    }
    try:
        for number, image in enumerate(_unsaved(source)):
            words["images"][image.name] = f"image-{number}.npy"
            np.save(folder / f"image-{number}.npy", pixels_of(image), allow_pickle=False)
        words["collection"] = _write_blend(folder / BLEND, objects)
        for number, order in enumerate(orders):
            order.save(_order_path(folder, number))
        (folder / WORDS).write_text(json.dumps(words), encoding="utf-8")
    except (OSError, RuntimeError) as error:
        raise FileError(f'The snapshot for the workers cannot be written to "{folder}": {error}. Free some space there.') from error


def open_snapshot(folder: Path) -> Snapshot:
    """Open the snapshot in `folder` in place of all that is open in this Blender.

    Raises:
        FileError: when it cannot be read.
        GeometryError: when the original has another geometry here than where the snapshot was written.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    try:
        words = json.loads((folder / WORDS).read_text(encoding="utf-8"))
        bpy.context.preferences.filepaths.use_scripts_auto_execute = words["runs_scripts"]
        for name, owner, _ in _owners(scene):
            for key, value in words["values"][name].items():
                setattr(owner, key, value)
        scene.frame_set(words["frame"], subframe=words["values"]["scene"]["frame_subframe"])
        with bpy.data.libraries.load(str(folder / BLEND)) as (_, appended):
            appended.collections = [words["collection"]]
        held = {item.name: item for item in appended.collections[0].objects}
        objects = [held[name] for name in words["objects"]]
        for name, file in words["images"].items():
            bpy.data.images[name].pixels.foreach_set(np.load(folder / file, allow_pickle=False).ravel())
        orders = [load_order(_order_path(folder, number)) for number in range(words["levels"])]
    except (OSError, AttributeError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise FileError(f'The snapshot in "{folder}" cannot be read: {error}. Bake again; views that stand are kept.') from error
    for item in objects:
        scene.collection.objects.link(item)
    source = read_original(bpy.context, objects)
    if source.fingerprint != words["fingerprint"]:
        raise GeometryError(
            f'"{source.name}" has another shape in a worker process than in its file: it depends on something outside itself, such as a '
            "simulation or a script. Apply its modifiers, build the cloud anew and bake again."
        )
    return Snapshot(objects, source, BtfSettings(**words["settings"]), orders)


def _write_blend(path: Path, objects: Sequence[bpy.types.Object]) -> str:
    """Write `objects` in a collection that is there for the file alone, since linked ones are only written where something holds them;
    its name."""
    collection = bpy.data.collections.new("Farfield Snapshot")
    try:
        for item in objects:
            collection.objects.link(item)
        bpy.data.libraries.write(str(path), {collection}, path_remap="ABSOLUTE")
        return collection.name
    finally:
        bpy.data.collections.remove(collection)


def _order_path(folder: Path, number: int) -> Path:
    return folder / f"order-{number}.npz"


def _owners(scene: bpy.types.Scene) -> Iterator[tuple[str, Any, tuple[str, ...]]]:
    """What of a scene the shape of its objects can depend on: owners with the names of their values."""
    yield "scene", scene, SCENE_VALUES
    yield "render", scene.render, RENDER_VALUES
    yield "units", scene.unit_settings, UNIT_VALUES


def _values(owner: Any, names: Sequence[str]) -> dict[str, Any]:
    return {name: getattr(owner, name) for name in names}


def _unsaved(source: Source) -> list[bpy.types.Image]:
    """Images of the materials of `source` whose pixels stand in no file.

    Raises:
        FileError: when tiles were painted, which only their own files can hold.
    """
    found = []
    for image in images_of(source):
        if image.is_dirty and image.source == "TILED":
            raise FileError(f'The tiles of the image "{image.name}" were painted and never saved; save them and bake again.')
        if image.is_dirty and image.has_data:
            found.append(image)
    return found
