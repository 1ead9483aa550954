"""Worker process that reads an OpenVDB file and writes its first grid of numbers as an array; see `openvdb_files`."""

import json
import math
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

from ...core.clipbox.files.file_data import Voxels
from ...core.errors import FileError
from ...core.files.height_maps import MAX_BYTES, check_size
from ..blender import import_blender_module

try:
    import resource
except ImportError:  # Windows
    resource = None

VALUES_FILE, OUTSIDE_FILE = "values.npy", "outside.json"
EXIT_ERROR, EXIT_MEMORY = 90, 91  # exit codes; others are those of an exception or a crash
MAX_MEMORY_BYTES = 3 * MAX_BYTES  # the grid, its values as an array, and room for the library
VALUE_BYTES = 4
ENVIRONMENT = {"MALLOC_ARENA_MAX": "2"}  # each thread's own arena would count as memory
MEMORY_USE = Path("/proc/self/statm")  # in pages; on Linux, the only system that enforces a limit


def main(arguments: list[str]) -> int:
    """Read the file `arguments[0]` and write the result to the folder `arguments[1]`; return the exit code."""
    path, folder = (Path(argument) for argument in arguments)
    try:
        openvdb = import_openvdb(path)
        _limit_memory()
        voxels = _read(openvdb, path)
        np.save(folder / VALUES_FILE, voxels.values, allow_pickle=False)
        (folder / OUTSIDE_FILE).write_text(json.dumps(voxels.outside), encoding="utf-8")
    except FileError as error:
        return _fail(str(error))
    except OSError as error:
        reason = str(error.strerror or error).partition("\n")[0].rstrip(".")
        return _fail(f'"{path}" cannot be read: {reason}.')
    except MemoryError:
        return EXIT_MEMORY
    return 0


def _fail(message: str) -> int:
    print(json.dumps(message), file=sys.stderr, flush=True)
    return EXIT_ERROR


def import_openvdb(path: Path) -> ModuleType:
    """Import Blender's own module.

    Raises:
        FileError: this Blender has none; the message names the file `path`.
    """
    return import_blender_module("openvdb", f'"{path}"', "save the volume as .npy or .nii")


def _limit_memory() -> None:
    """Let this process allocate at most MAX_MEMORY_BYTES more, where the system can enforce that."""
    if resource is None or not MEMORY_USE.exists():
        return
    used = int(MEMORY_USE.read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limits = [limit for limit in (used + MAX_MEMORY_BYTES, soft) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))  # a crash leaves no file


def _read(openvdb: ModuleType, path: Path) -> Voxels:
    """Read the first grid of numbers or booleans.

    Raises:
        FileError: there is none, or it is too large.
    """
    metadata = openvdb.readAllGridMetadata(str(path))
    if not metadata:
        raise FileError(f'"{path}" contains no grid; it is empty or truncated.')
    names = [grid.name for grid in metadata if isinstance(grid, _scalar_grids(openvdb))]
    if not names:
        raise FileError(f'"{path}" contains no grid of numbers.')
    grid = openvdb.read(str(path), names[0])
    if grid.activeVoxelCount() == 0:
        raise FileError(f'"{path}" contains no voxels; its grid "{names[0]}" is empty.')
    low, high = ([int(index) for index in corner] for corner in grid.evalActiveVoxelBoundingBox())
    shape = tuple(last - first + 1 for first, last in zip(low, high, strict=True))
    check_size(path, math.prod(shape), VALUE_BYTES)
    values = np.empty(shape, np.float32)
    grid.copyToArray(values, ijk=tuple(low))
    background = float(grid.background)
    if grid.gridClass != openvdb.GridClass.LEVEL_SET:
        return Voxels(values, outside=background if math.isfinite(background) else None)
    np.negative(values, out=values)
    max_depth = float(values.max())  # a symmetric range of values puts the threshold at 0, where the surface is
    return Voxels(np.maximum(values, -max_depth, out=values), outside=-max_depth)


def _scalar_grids(openvdb: ModuleType) -> tuple[type, ...]:
    return openvdb.FloatGrid, openvdb.DoubleGrid, openvdb.Int32Grid, openvdb.Int64Grid, openvdb.BoolGrid
