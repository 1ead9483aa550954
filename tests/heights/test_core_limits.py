"""Files of strangers: declared sizes are compared with the bytes that are there before memory is reserved."""

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from farfield.addon.core.bdam.fields.terrain_field import open_field
from farfield.addon.core.clipbox.files.readers import read_file
from farfield.addon.core.errors import FileError
from tiff_writer import write_tiff

pytest.importorskip("tifffile")

MAX_OVERHEAD = 64 << 20  # bytes that a refusal may take, more than a block of the largest file below
ASCII_HEADER = "ncols {}\nnrows {}\ncellsize 1\n"


def write(path: Path, start: bytes, size: int = 0) -> Path:
    """Write a file that begins with `start`; what follows up to `size` are zeros that take no room on the disk."""
    with path.open("wb") as file:
        file.write(start)
        file.truncate(max(size, len(start)))
    return path


FILES: dict[str, tuple[Callable[[Path], Path], str]] = {
    "long_number.asc": (lambda path: write(path, ASCII_HEADER.format(2, 2).encode() + b"1 2 3 " + b"9" * (8 << 20)), "other than numbers"),
    "zeros.asc": (lambda path: write(path, ASCII_HEADER.format(30_000, 30_000).encode(), 2 << 30), "other than numbers"),
    "column.asc": (lambda path: write(path, ASCII_HEADER.format(1, 3).encode() + b"1\n" * (4 << 20)), "contains 4,194,304 heights"),
    "rows.asc": (lambda path: write(path, ASCII_HEADER.format(1, 2**22).encode() + b"1\n" * 2**22), "the maximum is 1,048,576"),
    "header.npy": (lambda path: write(path, b"\x93NUMPY\x02\x00" + b"\xff" * 4, 4 << 30), "cannot be read as a NumPy array"),
    "channels.tif": (lambda path: write_tiff(path, np.ones((8, 8), np.float32), tags={277: (4, (2**31 - 1,))}), "no elevation model"),
    "wide.tif": (lambda path: write_tiff(path, np.ones((8, 8), np.float32), "deflate", tags={256: (4, (2**20,))}), "is truncated"),
    "tall.tif": (lambda path: write_tiff(path, np.ones((8, 8), np.float32), tags=dict.fromkeys((257, 278), (4, (2**20,)))), "is truncated"),
    "sparse.tif": (
        lambda path: write_tiff(
            *(path, np.ones((16, 16), np.float32), "deflate", 1, (16, 16)),
            tags={**dict.fromkeys((256, 257), (4, (2**14,))), **dict.fromkeys((324, 325), (4, (0,) * 2**20))},
        ),
        "none of its parts is stored",
    ),
    "pages.tif": (
        lambda path: write_tiff(path, np.ones((8, 8), np.float32), tags={254: (4, (2**32 - 1,)), 259: (4, (2**31,))}),
        "unsupported",
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_a_false_size_takes_no_memory(tmp_path, name):
    create, message = FILES[name]
    path = create(tmp_path / name)
    for read in (read_file, lambda path: open_field([path]).read(slice(0, 2), slice(0, 2))):
        tracemalloc.start()
        with pytest.raises(FileError, match=message):
            read(path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < MAX_OVERHEAD
