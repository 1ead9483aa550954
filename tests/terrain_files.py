"""Writers of terrain files for tests."""

import gzip
import struct
import zlib
from pathlib import Path

import numpy as np

WGS84_KEYS = (1, 1, 0, 1, 1024, 0, 1, 2)  # GeoTIFF keys: x and y are degrees
FEET_KEYS = (1, 1, 0, 2, 1024, 0, 1, 1, 3076, 0, 1, 9002)  # x and y are feet of a projection


def write_png(path: Path, gray: np.ndarray, declared: tuple[int, int] | None = None) -> Path:
    """Write a gray image (H, W) uint8 or uint16, row 0 at the top. declared: another width and height in its header."""
    rows = np.ascontiguousarray(gray.astype(gray.dtype.newbyteorder(">"))).view(np.uint8).reshape(len(gray), -1)
    lines = np.concatenate([np.zeros((len(gray), 1), np.uint8), rows], axis=1)
    header = struct.pack(">2I5B", *(declared or gray.shape[::-1]), 8 * gray.itemsize, 0, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes())), (b"IEND", b"")]
    packed = [struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content)) for name, content in chunks]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(packed))
    return path


def write_geotiff(
    path: Path, heights: np.ndarray, pixel_size: tuple[float, float], north_west: tuple[float, float], keys: tuple = ()
) -> Path:
    """Write elevations (H, W), row 0 in the north, with the pixel size, the position of the corner and geo keys."""
    import tifffile

    tags = [(33550, 12, 3, (*pixel_size, 0.0), True), (33922, 12, 6, (0.0, 0.0, 0.0, *north_west, 0.0), True)]
    tags += [(34735, 3, len(keys), keys, True)] if keys else []
    tifffile.imwrite(path, heights, extratags=tags, metadata=None)
    return path


def nifti(values: np.ndarray, order: str = "<", scale: float = 0.0, offset: float = 0.0, sizes: tuple = (1.0, 1.0, 1.0)) -> bytes:
    """Return `values` (X, Y, Z) as a NIfTI-1 file."""
    codes = {"u1": 2, "i2": 4, "i4": 8, "f4": 16, "f8": 64, "i1": 256, "u2": 512, "u4": 768}
    header = bytearray(352)
    struct.pack_into(f"{order}i", header, 0, 348)
    struct.pack_into(f"{order}8h", header, 40, 3, *values.shape, 1, 1, 1, 1)
    struct.pack_into(f"{order}2h", header, 70, codes[values.dtype.str[1:]], 8 * values.itemsize)
    struct.pack_into(f"{order}4f", header, 76, 1.0, *sizes)
    struct.pack_into(f"{order}3f", header, 108, 352.0, scale, offset)
    header[344:348] = b"n+1\0"
    return bytes(header) + values.astype(values.dtype.newbyteorder(order)).tobytes(order="F")


def patch_bytes(content: bytes, offset: int, layout: str, *numbers: float | bytes) -> bytes:
    """Return `content` with `numbers` packed into it at `offset`."""
    patched = bytearray(content)
    struct.pack_into(layout, patched, offset, *numbers)
    return bytes(patched)


def write_voxels(path: Path, values: np.ndarray) -> Path:
    """Write `values` (X, Y, Z) as .npy, .raw, .nii or .nii.gz. The shape and type are added to the name of a .raw file."""
    if path.suffix == ".npy":
        np.save(path, values)
    elif path.suffix == ".raw":
        path = path.with_stem(f"{path.stem}_{'x'.join(str(count) for count in values.shape)}_{values.dtype}")
        path.write_bytes(values.tobytes(order="F"))
    else:
        content = nifti(values)
        path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)
    return path
