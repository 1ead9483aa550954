"""Bytes, numbers, lines and rotations in files. Readers raise a ValueError or another one of `DAMAGE` where a file is damaged."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.file_access import read_file
from ...geometry.transforms import rotations_of_quaternions

FLIP = np.diag([1.0, -1.0, -1.0])  # from y up and looking along -z, as in OpenGL, to y down and looking along z
MIN_QUATERNION_LENGTH = 1e-6
MAX_PRODUCT_ERROR = 1e-3  # between products of the axes of a rotation and those of unit vectors

ReadSize = Callable[[str], tuple[int, int]]  # returns width and height of the photograph with a name


def read_text_lines(path: Path) -> list[str]:
    """Return the lines of a file in UTF-8, with or without a byte order mark. Raises FileError if it cannot be read or decoded."""
    try:
        return read_file(path).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise FileError(f'"{path}" is not a text file in UTF-8; save it again.') from error


class BinaryReader:
    """Reads little-endian numbers and texts from `data`; struct.error or ValueError at its end."""

    def __init__(self, data: bytes) -> None:
        """Read nothing yet."""
        self._bytes = data
        self._position = 0

    def read(self, layout: str) -> tuple:
        """Read the numbers of a `layout` of the module `struct`."""
        values = struct.unpack_from("<" + layout, self._bytes, self._position)
        self._position += struct.calcsize("<" + layout)
        return values

    def read_count(self, item_bytes: int) -> int:
        """Read the number, 64 bits, of items that follow, of at least `item_bytes` bytes each. Raises ValueError if the file is shorter."""
        (count,) = self.read("Q")
        if count * item_bytes > len(self._bytes) - self._position:
            raise ValueError("more items than bytes")
        return count

    def read_text(self) -> str:
        """Read a text in UTF-8 up to its zero byte."""
        text = self.read_bytes(self._bytes.index(b"\0", self._position) - self._position).decode("utf-8")
        self.skip(1)
        return text

    def read_counted_text(self) -> str:
        """Read a text in UTF-8 after the number of its bytes."""
        return self.read_bytes(self.read_count(1)).decode("utf-8")

    def read_bytes(self, count: int) -> bytes:
        """Read `count` bytes."""
        self._position += count
        return self._bytes[self._position - count : self._position]

    def skip(self, count: int) -> None:
        """Skip `count` bytes."""
        self._position += count


def check_rotation(matrix: np.ndarray, position: np.ndarray) -> None:
    """Raise ValueError unless a matrix is (3, 3), its rows are perpendicular unit vectors, and the position (3,) is finite."""
    is_rotation = matrix.shape == (3, 3) and np.allclose(matrix @ matrix.T, np.eye(3), atol=MAX_PRODUCT_ERROR)
    if not is_rotation or not np.isfinite(position).all():
        raise ValueError("not a rotation")


def rotation_of_quaternion(quaternion: tuple[float, ...], path: Path) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a quaternion (w, x, y, z), which is normalized.

    Raises:
        FileError: the quaternion has no length; the message names `path`.
    """
    length = float(np.linalg.norm(quaternion))
    if not np.isfinite(length) or length < MIN_QUATERNION_LENGTH:
        raise FileError(f'An image in "{path}" has no rotation; export the cameras again.')
    return rotations_of_quaternions(np.array(quaternion, np.float64) / length)
