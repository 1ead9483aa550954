"""What worker processes with Blender get of the open file: data in a .blend file, unsaved pixels, and whether drivers may run Python."""

import errno
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import bpy
import numpy as np

from ..core.errors import FileError
from ..core.files.complete_files import is_complete_blend
from ..core.files.file_access import error_reason
from .imaging.images import read_pixels

PROBE = "farfield_driver_probe"


def write_blend(path: Path, data: bpy.types.ID) -> None:
    """Write `data` and all that it uses to a .blend file, with absolute paths. Raises OSError or RuntimeError, see `explain`."""
    bpy.data.libraries.write(str(path), {data}, path_remap="ABSOLUTE")
    if not is_complete_blend(path):  # Blender does not always notice a full disk.
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def write_unsaved_images(folder: Path, images: Iterable[bpy.types.Image]) -> dict[str, str]:
    """Write the pixels of those of `images` that have unsaved changes to files in `folder`; return the name of the file of each image.

    Raises:
        FileError: a tiled image has unsaved changes, which only its own files can store.
        OSError: a file cannot be written.
    """
    files = {}
    for image in images:
        if image.is_dirty and image.source == "TILED":
            raise FileError(f'The tiles of the image "{image.name}" have unsaved changes; save them and start again.')
        if image.is_dirty and image.has_data:
            files[image.name] = f"image-{len(files)}.npy"
            np.save(folder / files[image.name], read_pixels(image), allow_pickle=False)
    return files


def read_unsaved_images(folder: Path, files: Mapping[str, str]) -> None:
    """Give the images of this file the pixels that `write_unsaved_images` has written. Raises OSError or ValueError."""
    for name in files.keys() & bpy.data.images.keys():
        bpy.data.images[name].pixels.foreach_set(np.load(folder / files[name], allow_pickle=False).ravel())


def explain(error: Exception) -> str:
    """Return the reason of an error on one line, without the lines before it that messages of Blender have."""
    if isinstance(error, OSError):
        return error_reason(error)
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return lines[-1].removeprefix("Error: ").rstrip(". ")


def may_run_python_drivers() -> bool:
    """Return whether drivers of the open file run any Python. False without asking Blender if none of them needs that permission.

    Blender does not tell. It evaluates a driver of a temporary scene, which calls a method: restricted drivers may not.
    """
    # Some drivers that run the full interpreter do not need the permission; Blender decides when it runs them.
    if not any(driver.type == "SCRIPTED" and not driver.is_simple_expression for driver in _drivers()):
        return False
    calls: list[int] = []
    scene = bpy.data.scenes.new("Farfield Driver Probe")
    try:
        bpy.app.driver_namespace[PROBE] = calls
        scene[PROBE] = 0.0
        driver = scene.driver_add(f'["{PROBE}"]').driver
        driver.type, driver.expression = "SCRIPTED", f"{PROBE}.append(1) or 0.0"
        scene.view_layers[0].update()
    finally:
        bpy.app.driver_namespace.pop(PROBE, None)
        bpy.data.scenes.remove(scene)
    return bool(calls)


def _drivers() -> Iterator[bpy.types.Driver]:
    """Yield all drivers of the open file, those of linked data and of node trees in other data included."""
    for member in bpy.data.bl_rna.properties:
        if member.type != "COLLECTION":
            continue
        for data in getattr(bpy.data, member.identifier):
            for owner in (data, getattr(data, "node_tree", None)):
                animation = getattr(owner, "animation_data", None)
                if animation is not None:
                    yield from (curve.driver for curve in animation.drivers)
