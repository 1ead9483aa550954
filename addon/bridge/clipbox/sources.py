"""Readers of terrain files that need Blender: images and OpenVDB volumes."""

import importlib.machinery
import importlib.util
import math
import sys
from pathlib import Path
from types import ModuleType

import bpy
import numpy as np

from ...core.clipbox.files import readers
from ...core.clipbox.files.file_data import HeightMap, Voxels, check_size
from ...core.clipbox.files.readers import Readers
from ...core.errors import FileError

IMAGE_EXTENSIONS = (".png", ".jpg", ".jpeg", ".exr", ".hdr", ".webp", ".bmp")
VOLUME_EXTENSION = ".vdb"


def read_image(path: Path) -> HeightMap:
    """Read the mean of the first three channels as stored, without color management. Call it on Blender's main thread.

    Raises:
        FileError: Blender cannot read it.
    """
    try:
        image = bpy.data.images.load(str(path))
    except RuntimeError as error:
        raise FileError(f'"{path}" cannot be read: {str(error).strip().rstrip(".")}.') from error
    try:
        image.colorspace_settings.name = "Non-Color"
        image.alpha_mode = "CHANNEL_PACKED"  # other modes lose colors under zero alpha
        (width, height), channels = image.size, image.channels
        if width * height * channels == 0:
            raise FileError(f'"{path}" cannot be read as an image; Blender finds no pixels in it.')
        check_size(path, width * height * channels, 4)
        pixels = np.empty(width * height * channels, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    pixels = pixels.reshape(height, width, channels)
    return HeightMap(pixels[..., 0].copy() if channels < 3 else pixels[..., :3].mean(axis=2))


def read_vdb(path: Path) -> Voxels:
    """Read the first grid of numbers or booleans. The inside of a level set is solid.

    Raises:
        FileError: there is no such grid, or this Python has no module openvdb.
    """
    openvdb = _import_openvdb(path)
    names = [grid.name for grid in openvdb.readAllGridMetadata(str(path)) if isinstance(grid, _scalar_grids(openvdb))]
    if not names:
        raise FileError(f'"{path}" contains no grid of numbers.')
    grid = openvdb.read(str(path), names[0])
    if grid.activeVoxelCount() == 0:
        raise FileError(f'"{path}" contains no voxels; its grid "{names[0]}" is empty.')
    low, high = (np.array(corner) for corner in grid.evalActiveVoxelBoundingBox())
    shape = tuple((high - low + 1).tolist())
    check_size(path, math.prod(shape), 4)
    values = np.empty(shape, np.float32)
    grid.copyToArray(values, ijk=tuple(low.tolist()))
    if grid.gridClass != openvdb.GridClass.LEVEL_SET:
        return Voxels(values, outside=float(grid.background))
    np.negative(values, out=values)
    max_depth = float(values.max())  # a symmetric range of values puts the threshold at 0, where the surface is
    return Voxels(np.maximum(values, -max_depth), outside=-max_depth)


def _scalar_grids(openvdb: ModuleType) -> tuple[type, ...]:
    return openvdb.FloatGrid, openvdb.DoubleGrid, openvdb.Int32Grid, openvdb.Int64Grid, openvdb.BoolGrid


def _import_openvdb(path: Path) -> ModuleType:
    """Import Blender's own module, which pip's bpy does not keep on Python's search path."""
    if "openvdb" in sys.modules or importlib.util.find_spec("openvdb") is not None:
        return importlib.import_module("openvdb")
    folders = [str(folder) for folder in (Path(bpy.utils.resource_path("LOCAL")) / "python").rglob("site-packages")]
    spec = importlib.machinery.PathFinder.find_spec("openvdb", folders)
    if spec is None:
        raise FileError(f'"{path}" needs the module openvdb, which this Blender lacks; save the volume as .npy or .nii.')
    module = sys.modules["openvdb"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


READERS: Readers = {**readers.READERS, **dict.fromkeys(IMAGE_EXTENSIONS, read_image), VOLUME_EXTENSION: read_vdb}
