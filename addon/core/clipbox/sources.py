"""Reading the files that terrains come from, each by the ending of its name.

What needs Blender is added to READERS by `bridge/terrain_sources.py`.
"""

import math
import re
import tokenize
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FileError, SettingsError
from .nifti import read_nifti
from .samples import HeightMap, Source, Voxels, check_size, native
from .tiffs import read_tiff

if TYPE_CHECKING:
    from .settings import ClipboxSettings

RAW_NAME = re.compile(r"(?:^|_)(\d+)x(\d+)x(\d+)_(u?int(?:8|16|32)|float(?:32|64))$")
BROKEN = (EOFError, OverflowError, SyntaxError, TypeError, ValueError, tokenize.TokenError)  # by NumPy


def source_of(settings: "ClipboxSettings") -> Source:
    """What the file that `settings` name holds.

    Raises:
        SettingsError: when they name none.
        FileError: when it cannot be read.
    """
    if not settings.source:
        raise SettingsError(f'The terrain "{settings.terrain}" needs a file; choose one with --source.')
    return read(Path(settings.source))


def read(path: Path) -> Source:
    """What a file holds.

    Raises:
        FileError: when there is none, no reader knows its ending, it is empty, broken, or too large.
    """
    name = path.name.lower()
    ending = max((known for known in READERS if name.endswith(known)), key=len, default=None)
    try:
        if not path.is_file():
            raise FileError(f'There is no file "{path}"; choose the one that the terrain is to come from.')
        if ending is None:
            raise FileError(f'No terrain can be read from "{path}"; its name must end in one of {", ".join(sorted(READERS))}.')
        if path.stat().st_size == 0:
            raise FileError(f'The file "{path}" is empty.')
        return READERS[ending](path)
    except OSError as error:
        raise FileError(f'"{path}" cannot be read: {error.strerror or error}.') from error
    except MemoryError as error:
        raise FileError(f'"{path}" needs more memory than there is; make it smaller first.') from error


def read_array(path: Path) -> Source:
    """A NumPy array: heights (H, W), row 0 in the north as in pictures and maps, in metres, as is the side of a pixel; or voxels (X, Y, Z).

    Raises:
        FileError: when it is none of both.
    """
    try:
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)  # mapped: a header that lies about its size costs nothing
        if not isinstance(mapped, np.ndarray):
            raise FileError(f'"{path}" is an archive, not a single array; save the array that is meant with numpy.save.')
    except BROKEN as error:
        raise FileError(f'"{path}" cannot be read as a NumPy array: it is cut short, broken or holds no plain numbers.') from error
    if mapped.ndim not in (2, 3):
        raise FileError(f'"{path}" holds an array with {mapped.ndim} axes; heights have 2, voxels 3.')
    check_size(path, mapped.size, mapped.dtype.itemsize)
    values = native(path, np.array(mapped))
    return Voxels(values) if values.ndim == 3 else HeightMap(values[::-1], (1.0, 1.0))


def read_raw(path: Path) -> Voxels:
    """Voxels and nothing else, shape and type being in the name, as in `skull_256x256x178_uint8.raw`: x varies fastest, lowest byte first.

    Raises:
        FileError: when the name does not tell them, or the file is of another size.
    """
    told = RAW_NAME.search(path.stem)
    if told is None:
        raise FileError(f'The name of "{path}" must tell its shape and type, as in "skull_256x256x178_uint8.raw".')
    shape, kind = tuple(int(count) for count in told.groups()[:3]), np.dtype(told[4]).newbyteorder("<")
    check_size(path, math.prod(shape), kind.itemsize)
    needed, size = math.prod(shape) * kind.itemsize, path.stat().st_size
    if size != needed:
        raise FileError(f'"{path}" holds {size:,} bytes; after its name it must be {needed:,}.')
    return Voxels(native(path, np.fromfile(path, kind)).reshape(shape, order="F"))


READERS: dict[str, Callable[[Path], Source]] = {
    ".npy": read_array,
    ".raw": read_raw,
    ".tif": read_tiff,
    ".tiff": read_tiff,
    ".nii": read_nifti,
    ".nii.gz": read_nifti,
}
