"""Reading with Blender the files that terrains come from: pictures and OpenVDB volumes. Importing it makes the core know them."""

import importlib.machinery
import importlib.util
import math
import sys
from pathlib import Path
from types import ModuleType

import bpy
import numpy as np

from ..core.clipbox.samples import HeightMap, Voxels, check_size
from ..core.clipbox.sources import READERS
from ..core.errors import FileError

PICTURES = (".png", ".jpg", ".jpeg", ".exr", ".hdr", ".webp", ".bmp")
VOLUME = ".vdb"


def read_picture(path: Path) -> HeightMap:
    """The mean of the first three channels as they are stored, without any colour space; for Blender's main thread.

    Raises:
        FileError: when Blender cannot read it.
    """
    try:
        image = bpy.data.images.load(str(path))
    except RuntimeError as error:
        raise FileError(f'"{path}" cannot be read: {str(error).strip().rstrip(".")}.') from error
    try:
        image.colorspace_settings.name = "Non-Color"
        image.alpha_mode = "CHANNEL_PACKED"  # else colours under no alpha are lost
        (width, height), channels = image.size, image.channels
        if width * height * channels == 0:
            raise FileError(f'"{path}" cannot be read as a picture; Blender finds no pixels in it.')
        check_size(path, width * height * channels, 4)
        pixels = np.empty(width * height * channels, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    coloured = pixels.reshape(height, width, channels)
    return HeightMap(coloured[..., 0].copy() if channels < 3 else coloured[..., :3].mean(axis=2))


def read_volume(path: Path) -> Voxels:
    """The first grid of real or whole numbers or truths; what a level set encloses is solid.

    Raises:
        FileError: when there is none, or this Python has no module openvdb.
    """
    openvdb = _openvdb(path)
    names = [grid.name for grid in openvdb.readAllGridMetadata(str(path)) if isinstance(grid, _scalar_grids(openvdb))]
    if not names:
        raise FileError(f'"{path}" holds no grid of numbers.')
    grid = openvdb.read(str(path), names[0])
    if grid.activeVoxelCount() == 0:
        raise FileError(f'"{path}" holds no voxels; its grid "{names[0]}" is empty.')
    low, high = (np.array(corner) for corner in grid.evalActiveVoxelBoundingBox())
    shape = tuple((high - low + 1).tolist())
    check_size(path, math.prod(shape), 4)
    values = np.empty(shape, np.float32)
    grid.copyToArray(values, ijk=tuple(low.tolist()))
    if grid.gridClass != openvdb.GridClass.LEVEL_SET:
        return Voxels(values, outside=float(grid.background))
    np.negative(values, out=values)
    deepest = float(values.max())  # values as far below 0 as above: the surface lies where they are 0
    return Voxels(np.maximum(values, -deepest), outside=-deepest)


def _scalar_grids(openvdb: ModuleType) -> tuple[type, ...]:
    return openvdb.FloatGrid, openvdb.DoubleGrid, openvdb.Int32Grid, openvdb.Int64Grid, openvdb.BoolGrid


def _openvdb(path: Path) -> ModuleType:
    """Blender's own module, which pip's bpy keeps where Python does not look for it."""
    if "openvdb" in sys.modules or importlib.util.find_spec("openvdb") is not None:
        return importlib.import_module("openvdb")
    folders = [str(folder) for folder in (Path(bpy.utils.resource_path("LOCAL")) / "python").rglob("site-packages")]
    spec = importlib.machinery.PathFinder.find_spec("openvdb", folders)
    if spec is None:
        raise FileError(f'"{path}" needs the module openvdb, which this Blender lacks; save the volume as .npy or .nii.')
    module = sys.modules["openvdb"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


READERS.update(dict.fromkeys(PICTURES, read_picture) | {VOLUME: read_volume})
