"""AVIF files of tiles as a header, which tiles share, and a payload: the data of AV1, which begin with few bytes of their own.

A file is the header, the size of the payload (uint32, big-endian), the head of the box `mdat` (uint32, big-endian, the size of the payload
plus 8, and the letters mdat), and the payload. To this end, the header has the boxes ftyp and meta, and the last box in meta is `iloc` (ISO
14496-12, 8.11.3), whose last field is the size of the payload.
"""

import io
import struct
from collections.abc import Iterator

import numpy as np

from ...errors import FileError
from ...imaging.coded_images import DAMAGES

SPEED = 6  # Speed of the encoder; 4 takes four times as long for files that are 5 % smaller, 8 a third for files 25 % larger.
LOCATION = struct.Struct(">IBBHHHHI")  # iloc up to the size: version and flags, sizes of fields, items, ID, references, extents, offset
SIZE_FIELD = b"\0\0\0\0"  # Size of the payload, which the header does not know.
ITEM = 1
META_VERSION = b"\0\0\0\0"
Box = tuple[bytes, bytes]


def encode_tile(image: np.ndarray, quality: int) -> tuple[bytes, bytes]:
    """Return the header and the payload of a tile.

    Colors are not subsampled: the same image gives the same bytes.

    Args:
        image: (S, S, 3) or, without colors, (S, S) uint8, row 0 at the top. quality: 1 to 100.
    """
    from PIL import Image  # here, so that importing the core needs only NumPy and SciPy

    file = io.BytesIO()
    picture = Image.fromarray(np.ascontiguousarray(image))
    picture.save(file, "AVIF", quality=quality, speed=SPEED, subsampling="4:4:4" if image.ndim == 3 else "4:0:0", max_threads=1)
    return split_file(file.getvalue())


def decode_tile(header: bytes, payload: bytes | memoryview, side: int) -> np.ndarray:
    """Return the pixels (side, side, 3) uint8 of a tile, row 0 at the top.

    Raises:
        FileError: the data are damaged, or have another size.
    """
    from PIL import AvifImagePlugin

    try:
        with AvifImagePlugin.AvifImageFile(io.BytesIO(join_file(header, payload))) as picture:
            if picture.size != (side, side):
                raise _damage()
            return np.array(picture.convert("RGB"))
    except (*DAMAGES, RuntimeError) as error:
        raise _damage() from error


def join_file(header: bytes, payload: bytes | memoryview) -> bytes:
    """Return the AVIF file of a header and a payload."""
    size = len(payload)
    return b"".join([header, size.to_bytes(4, "big"), (size + 8).to_bytes(4, "big"), b"mdat", payload])


def split_file(content: bytes) -> tuple[bytes, bytes]:
    """Return the header and the payload of an AVIF file of one image without alpha.

    Raises:
        FileError: it is no such file.
    """
    boxes = dict(_read_boxes(content))
    if not {b"ftyp", b"meta", b"mdat"} <= set(boxes):
        raise _damage()
    children = [box for box in _read_boxes(boxes[b"meta"][len(META_VERSION) :]) if box[0] != b"iloc"]
    described = META_VERSION + b"".join(_write_box(*box) for box in children)

    def write_header(offset: int) -> bytes:
        location = _write_box(b"iloc", LOCATION.pack(0, 0x44, 0, 1, ITEM, 0, 1, offset) + SIZE_FIELD)
        return _write_box(b"ftyp", boxes[b"ftyp"]) + _write_box(b"meta", described + location)

    offset = len(write_header(0)) + 8  # behind the head of mdat
    return write_header(offset)[: -len(SIZE_FIELD)], boxes[b"mdat"]


def _read_boxes(content: bytes) -> Iterator[Box]:
    """Yield the type and the content of each box."""
    position = 0
    while position < len(content):
        size = int.from_bytes(content[position : position + 4], "big")
        if size < 8 or position + size > len(content):
            raise _damage()
        yield content[position + 4 : position + 8], content[position + 8 : position + size]
        position += size


def _write_box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", 8 + len(content)) + kind + content


def _damage() -> FileError:
    return FileError("A tile of a texture is damaged; export the package again, or copy it again.")
