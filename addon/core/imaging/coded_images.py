"""Images as bytes: JPEG, WebP (with loss, or `lossless`), PNG and raw pixels, coded with Pillow, without Blender.

Arrays are (H, W, 3) or (H, W, 4) uint8, row 0 at the bottom as everywhere in Farfield, with straight alpha; the first row of the coded
image is the top one. Pixels are as stored: color profiles and the orientation of cameras are neither written nor applied.

Raw images are a header of 16 bytes, little-endian, and the rows from the bottom up:

| bytes | content |
|---|---|
| 0-7 | FFPIXELS |
| 8-9, 10-11 | width and height, uint16 |
| 12-15 | number of channels, uint32 |
"""

import io
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal, get_args

import numpy as np

from ..errors import ImageError
from ..files.complete_files import PNG_SIGNATURE

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

ImageFormat = Literal["jpeg", "webp", "lossless", "png", "raw"]
FORMATS: tuple[ImageFormat, ...] = get_args(ImageFormat)
DEFAULT_QUALITY = 85
MAX_PIXELS = 2**29  # An image of 23,170 x 23,170 pixels is decoded at once.
MAX_RATIO = 35_000  # Decoded bytes per byte of a JPEG or PNG file, see image_files.py.
MAX_CODED_RATIO = 2  # Bytes of a coded image per byte of its pixels.
PNG_COMPRESSION = 3  # zlib level; higher ones cost much time and save little in photographs
WEBP_METHOD = 0  # the fastest; method 4 takes two to three times as long for files that are a few percent smaller
LOSSLESS_METHOD, LOSSLESS_EFFORT = 1, 20  # Of WebP without loss; more than that takes time and saves nothing in normal maps.
RAW_MAGIC, RAW_HEADER = b"FFPIXELS", struct.Struct("<8sHHI")
JPEG_START, RIFF_START = b"\xff\xd8\xff", b"RIFF"  # first bytes of JPEG and of WebP files
MODES = {"1": "RGB", "L": "RGB", "P": "RGB", "RGB": "RGB", "LA": "RGBA", "PA": "RGBA", "RGBA": "RGBA", "RGBX": "RGB"}
DAMAGES = (
    OSError,
    SyntaxError,
    ValueError,
    EOFError,
    IndexError,
    KeyError,
    TypeError,
    OverflowError,
    struct.error,
    zlib.error,
)  # as raised


def encode(image: np.ndarray, image_format: ImageFormat, quality: int = DEFAULT_QUALITY, compression: int = PNG_COMPRESSION) -> bytes:
    """Return `image` (H, W, 3 or 4) uint8, row 0 at the bottom, as a file in memory.

    The same image gives the same bytes. JPEG has no subsampling of colors, so that every block of 8 x 8 pixels is coded by itself: images
    that share whole blocks share their decoded pixels exactly. Alpha is lossless in every format that has it.

    quality: of JPEG and WebP, 1 to 100. compression: of PNG, 0 to 9.

    Raises:
        ImageError: the format has no alpha, or the image is too large for it.
    """
    height, width, channels = image.shape
    if image_format == "jpeg" and channels != 3:
        raise ImageError("JPEG images have no alpha; choose WebP, PNG or raw pixels.")
    if max(height, width) > (16383 if image_format in ("webp", "lossless") else 65535) or not image.size:
        raise ImageError(f"An image of {width} x {height} pixels cannot be coded as {image_format}; use smaller tiles.")
    if image_format == "raw":
        return RAW_HEADER.pack(RAW_MAGIC, width, height, channels) + np.ascontiguousarray(image, np.uint8).tobytes()
    return _save(image[::-1], image_format, quality, compression)


def encode_gray(values: np.ndarray) -> bytes:
    """Return `values` (H, W) uint8, row 0 at the bottom, as a PNG file with one channel in memory."""
    return _save(values[::-1], "png", DEFAULT_QUALITY, PNG_COMPRESSION)


def decode(data: bytes | memoryview, max_pixels: int = MAX_PIXELS) -> np.ndarray:
    """Return the image (H, W, 3 or 4) uint8, row 0 at the bottom, that `data` contains: JPEG, WebP, PNG or raw pixels.

    Gray images and palettes become RGB, with alpha RGBA. The size that the image declares is checked before its pixels are allocated.

    Raises:
        ImageError: the data are damaged or truncated, are no such image, have more than `max_pixels` pixels, or hold something else: CMYK
            colors, 16 bits, several images.
    """
    if bytes(data[: len(RAW_MAGIC)]) == RAW_MAGIC:
        shape = _check_raw(data, max_pixels)
        return np.frombuffer(data, np.uint8, offset=RAW_HEADER.size).reshape(shape).copy()
    with _open(io.BytesIO(data)) as image:
        return _decode_opened(image, len(data), max_pixels)


def check_coded(data: bytes | memoryview, max_pixels: int = MAX_PIXELS) -> None:
    """Check the header of the image that `data` contains, as `decode` does before it reads the pixels. Raises ImageError."""
    if bytes(data[: len(RAW_MAGIC)]) == RAW_MAGIC:
        _check_raw(data, max_pixels)
        return
    with _open(io.BytesIO(data)) as image:
        _check_opened(image, len(data), max_pixels)


@contextmanager
def _open(file: BinaryIO) -> "Iterator[ImageFile]":
    """Open an image whose header is read, and close it after the block. Raises ImageError, also for damages found in the block."""
    from PIL import Image

    plugin = _find_plugin(file.read(12))
    file.seek(0)
    if plugin is None:
        raise ImageError("The image is no JPEG, WebP or PNG; save it in one of these formats.")
    try:
        with plugin(file) as image:
            yield image
    except (*DAMAGES, Image.DecompressionBombError) as error:  # the latter for sizes that WebP cannot have
        raise ImageError("The image is damaged or truncated; open it in an image editor and save it again.") from error


def read_coded_image(path: Path, max_pixels: int = MAX_PIXELS) -> np.ndarray:
    """Return the pixels of a JPEG, WebP or PNG file as `decode` does.

    Raises:
        ImageError: see `decode`; the message names the file.
        OSError: the file cannot be read.
    """
    with _open_file(path) as image:
        return _decode_opened(image, path.stat().st_size, max_pixels)


def read_coded_shape(path: Path) -> tuple[int, int, int]:
    """Return the rows, columns and channels (3 or 4) of a JPEG, WebP or PNG file. Only its header is read.

    Raises:
        ImageError: see `decode`; the message names the file.
        OSError: the file cannot be read.
    """
    with _open_file(path) as image:
        _check_opened(image, path.stat().st_size, MAX_PIXELS)
        return image.size[1], image.size[0], len(_rgb_mode(image))


@contextmanager
def _open_file(path: Path) -> "Iterator[ImageFile]":
    """Do `_open` for a file, which errors name. Raises OSError, too."""
    with path.open("rb") as file:
        try:
            with _open(file) as image:
                yield image
        except ImageError as error:
            raise ImageError(f'"{path.name}": {error}') from error


def _find_plugin(start: bytes) -> "type[ImageFile] | None":
    """Return the reader of a file with these first 12 bytes, None if there is none. It is called directly: Image.open would apply a limit
    that is global to the process."""
    from PIL import JpegImagePlugin, PngImagePlugin, WebPImagePlugin  # here, so that importing the core needs only NumPy and SciPy

    if start.startswith(JPEG_START):
        return JpegImagePlugin.JpegImageFile
    if start.startswith(PNG_SIGNATURE):
        return PngImagePlugin.PngImageFile
    return WebPImagePlugin.WebPImageFile if start.startswith(RIFF_START) and start[8:] == b"WEBP" else None


def _save(image: np.ndarray, image_format: str, quality: int, compression: int) -> bytes:
    """Return an image with row 0 at the top as a file in memory."""
    from PIL import Image, ImageFile

    # Pillow codes optimized JPEG images into one buffer, which is too small for noise at high quality by default.
    ImageFile.MAXBLOCK = max(ImageFile.MAXBLOCK, MAX_CODED_RATIO * image.size)
    picture = Image.fromarray(np.ascontiguousarray(image, np.uint8))
    file = io.BytesIO()
    if image_format == "jpeg":
        picture.save(file, "JPEG", quality=quality, subsampling=0, optimize=True)
    elif image_format == "webp":
        picture.save(file, "WEBP", quality=quality, method=WEBP_METHOD, exact=True)
    elif image_format == "lossless":
        picture.save(file, "WEBP", lossless=True, quality=LOSSLESS_EFFORT, method=LOSSLESS_METHOD, exact=True)
    else:
        picture.save(file, "PNG", compress_level=compression)
    return file.getvalue()


def _decode_opened(image: "ImageFile", data_size: int, max_pixels: int) -> np.ndarray:
    """Return the pixels of an image whose header was read. Raises ImageError, or one of DAMAGES."""
    _check_opened(image, data_size, max_pixels)
    mode = _rgb_mode(image)
    pixels = image if image.mode == mode else image.convert(mode)
    return np.asarray(pixels)[::-1].copy()


def _check_opened(image: "ImageFile", data_size: int, max_pixels: int) -> None:
    """Check the header of an image. Raises ImageError, or one of DAMAGES."""
    width, height = image.size
    if width * height > max_pixels:
        raise ImageError(f"The image has {width} x {height} pixels, more than {max_pixels:,}; use a smaller one, or a TIFF file.")
    if width * height * len(image.getbands()) > MAX_RATIO * data_size and image.format != "WEBP":
        raise ValueError("more pixels than the data can hold")
    if getattr(image, "n_frames", 1) > 1:
        raise ImageError("The file contains several images; save one image per file.")
    if image.mode not in MODES:
        raise ImageError(f"The image has pixels of type {image.mode}; save it as RGB or RGBA with 8 bits per channel.")


def _rgb_mode(image: "ImageFile") -> str:
    return "RGBA" if "transparency" in image.info else MODES[image.mode]


def _check_raw(data: bytes | memoryview, max_pixels: int) -> tuple[int, int, int]:
    """Return the rows, columns and channels of a raw image. Raises ImageError."""
    if len(data) < RAW_HEADER.size:
        raise ImageError("The raw image is truncated; write it again.")
    _, width, height, channels = RAW_HEADER.unpack(data[: RAW_HEADER.size])
    if width * height > max_pixels:
        raise ImageError(f"The raw image has {width} x {height} pixels, more than {max_pixels:,}; use smaller tiles.")
    if channels not in (3, 4) or RAW_HEADER.size + width * height * channels != len(data):
        raise ImageError("The raw image is damaged or truncated; write it again.")
    return height, width, channels
