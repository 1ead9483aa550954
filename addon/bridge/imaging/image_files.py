"""Image files: PNG, TIFF, JPEG and OpenEXR, read and written with Blender's OpenImageIO.

What was read is kept as it was in the file, so that writing it again changes no pixel but the intended ones, and keeps depth, channels,
color profile, compression, resolution and orientation. Pixels are as stored: the orientation of cameras is kept and not applied.
"""

import os
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ...core.errors import FileError
from ...core.files.complete_files import PNG_SIGNATURE
from ...core.files.file_access import check_readable, convert_os_errors
from ...core.files.height_maps import check_size
from ...core.files.tiffs import read_layer_count
from ..blender import import_blender_module
from .image_specs import build_spec, target_storage
from .image_storage import ImageFile, Storage, from_pixels, to_pixels

EXTENSIONS = {".png": "png", ".tif": "tiff", ".tiff": "tiff", ".jpg": "jpeg", ".jpeg": "jpeg", ".exr": "openexr"}  # and formats
MAX_PNG_CHUNKS = 10_000  # in front of the pixels
SIGNATURES = {
    PNG_SIGNATURE: "png", b"II*\0": "tiff", b"MM\0*": "tiff", b"II+\0": "tiff", b"MM\0+": "tiff", b"\xff\xd8\xff": "jpeg",
    b"v/1\x01": "openexr",
}  # fmt: skip
DTYPES = {"uint8": np.uint8, "uint16": np.uint16, "half": np.float16, "float": np.float32}
MAX_CHANNELS = 4
MAX_BYTES = 2**32  # Pixels in memory, as float32: 16384 x 16384 with four channels.
# Bytes that reading, restoring and writing an image may take, with all copies and masks: this many, or more for larger files. Compression
# reaches any ratio in uniform images, but these need no gigabytes.
MAX_WORK_BYTES, WORK_BYTES_PER_FILE_BYTE = 2**32, 1024
PIXEL_BYTES = 16  # per pixel: masks, labels of holes, luminance
PIXEL_COPIES, STORED_COPIES = 2, 3  # arrays of float32, and of the type of the file
MAX_RATIO = 35_000  # decoded to file size: deflate reaches 1032, and one bit of a palette image becomes four bytes
UNLIMITED_COMPRESSIONS = ("ccitt", "dwa")  # may reach any ratio in uniform images
PNG_END = b"IEND\xaeB`\x82"  # its absence is no error of the reader
JPEG_HEADER_BYTES = 1 << 20  # room for color profiles and other metadata
HARMLESS_WARNING = "extraneous bytes before marker"  # Some cameras' JPEG files cause it.
NO_CMYK = ("CMYK", "YCbCrK", "YCCK")
TIFF_SEPARATED, TIFF_CIELAB = 5, 8  # photometric interpretations


def read_image_file(path: Path, *, is_color: bool = True) -> ImageFile:
    """Read a PNG, TIFF, JPEG or OpenEXR file with one image of 1 to 4 channels. Palettes become RGB or RGBA.

    is_color: colors of float files are encoded, and premultiplied ones divided by alpha; otherwise the pixels are data, used as stored.

    Raises:
        FileError: the file is missing, not readable, damaged, truncated or too large, or holds something else: CMYK colors, further
            channels, layers, several images, volumes, deep pixels, or other numbers.
    """
    file_format = _read_format(path)
    file = _open_input(path)
    try:
        spec = file.spec()
        if file.format_name() != file_format:
            raise _damaged(path)
        if file_format == "png" and _is_animated(path):
            raise _several_images(path)
        _check_contents(path, spec)
        _check_size(path, spec)
        if file_format == "tiff" and read_layer_count(path) > 1:
            raise _volume(path)
        if file.seek_subimage(1, 0) or file.seek_subimage(0, 1):
            raise _several_images(path)
        file.geterror()  # Clears that of the search for further images.
        if not file.seek_subimage(0, 0):
            raise _damaged(path)
        dtype = np.dtype(DTYPES[str(spec.format)])
        stored = file.read_image(0, 0, 0, spec.nchannels, spec.format)
        warning = file.geterror()
    except UnicodeDecodeError as error:  # An attribute is no text.
        raise _damaged(path) from error
    finally:
        file.close()
    if stored is None or stored.dtype != dtype or (warning and HARMLESS_WARNING not in warning):
        raise _damaged(path)
    has_alpha = spec.alpha_channel >= 0
    is_premultiplied = has_alpha and file_format in ("tiff", "openexr") and not spec.get_int_attribute("oiio:UnassociatedAlpha")
    storage = Storage(dtype, has_alpha, is_color and dtype.kind == "f", is_color and is_premultiplied)
    return ImageFile(to_pixels(stored[::-1], storage), storage, stored, file_format, is_color, spec)


def read_image_size(path: Path) -> tuple[int, int]:
    """Return width and height of an image without reading its pixels.

    Raises:
        FileError: the file cannot be read as an image.
    """
    _read_format(path)
    file = _open_input(path)
    try:
        spec = file.spec()
        return spec.width, spec.height
    finally:
        file.close()


def check_openexr(path: Path) -> None:
    """Read an OpenEXR file to its end: parts and damaged blocks can end the process in Blender's own reader. Other files are not read.

    Raises:
        FileError: the file is damaged, or holds several images or deep pixels.
    """
    with convert_os_errors(f'Cannot read "{path}"'), path.open("rb") as content:
        if SIGNATURES.get(content.read(4)) != "openexr":
            return
    file = _open_input(path)
    try:
        spec = file.spec()
        if spec.deep:
            raise FileError(f'"{path}" contains deep pixels; save it as a flat image.')
        check_size(path, spec.width * spec.height * spec.nchannels, 4)
        if file.seek_subimage(1, 0):
            raise _several_images(path)
        file.geterror()  # Clears that of the search for further images.
        if file.read_image(0, 0, 0, spec.nchannels, spec.format) is None or file.geterror():
            raise _damaged(path)
    finally:
        file.close()


def write_image_file(path: Path, pixels: np.ndarray, like: ImageFile, changed: np.ndarray) -> None:
    """Write `pixels` (H, W, C), row 0 at the bottom, to a file with the header of `like`; the extension selects the format.

    changed: (H, W) bool, the pixels that differ from `like.pixels`. All others are written as they were read, bit by bit, unless the format
    is another one or JPEG. A format that lacks the depth gets the nearest one it has: JPEG 8 bits, PNG 16, OpenEXR floats. OpenEXR and TIFF
    with lossy compression become lossless. The file is read again, since a full disk may not be reported.

    Raises:
        FileError: the file cannot be written, or its format has no alpha.
    """
    file_format = _format_of(path)
    oiio = _import_oiio(path)
    storage = target_storage(like, file_format, path)
    if storage == like.storage:
        stored = like.stored.copy()
        stored[changed[::-1]] = from_pixels(pixels[::-1][changed[::-1]], storage)
    else:
        stored = from_pixels(pixels[::-1], storage)
    spec = build_spec(oiio, like, file_format, storage)
    with convert_os_errors(f'Cannot write "{path.name}"'):
        if file_format == "jpeg":
            _check_space(path, stored.nbytes)
        file = oiio.ImageOutput.create(file_format)
        is_written = file is not None and file.open(str(path), spec) and file.write_image(stored)
        if file is not None:
            is_written = file.close() and is_written
        if not is_written or not _holds(oiio, path, stored, is_lossy=file_format == "jpeg"):
            reason = file.geterror().strip().partition("\n")[0].rstrip(".") if file is not None else ""
            raise FileError(f'Cannot write "{path.name}": {reason or "the file is incomplete; free some space there"}.')


def _format_of(path: Path) -> str:
    """Return the format that the extension of `path` selects.

    Raises:
        FileError: it selects none.
    """
    try:
        return EXTENSIONS[path.suffix.lower()]
    except KeyError:
        raise FileError(f'"{path}" must end in one of {", ".join(EXTENSIONS)}.') from None


def _import_oiio(path: Path) -> ModuleType:
    return import_blender_module("OpenImageIO", f'"{path}"', "use a Blender from blender.org, or install the module for its Python")


def _open_input(path: Path) -> Any:
    """Open an image to read it. Raises FileError."""
    oiio = _import_oiio(path)
    configuration = oiio.ImageSpec()
    configuration.attribute("oiio:UnassociatedAlpha", 1)  # colors come as stored, not multiplied by alpha
    file = oiio.ImageInput.open(str(path), configuration)
    if file is None:
        oiio.geterror()  # reads and clears it
        raise _damaged(path)
    return file


def _read_format(path: Path) -> str:
    """Return the format by the first bytes of the file. Only the readers of these formats ever see the file."""
    check_readable(path)
    with convert_os_errors(f'Cannot read "{path}"'), path.open("rb") as file:
        start = file.read(8)
    if not start:
        raise FileError(f'"{path}" is empty; save the image again.')
    for signature, file_format in SIGNATURES.items():
        if start.startswith(signature):
            return file_format
    raise FileError(f'"{path}" is no PNG, TIFF, JPEG or OpenEXR image; save it in one of these formats.')


def _check_contents(path: Path, spec: Any) -> None:
    """Raise FileError unless the header describes one flat image of up to four channels with supported numbers."""
    if spec.deep:
        raise FileError(f'"{path}" contains deep pixels; save it as a flat image.')
    if spec.depth > 1:
        raise _volume(path)
    interpretation = spec.get_int_attribute("tiff:PhotometricInterpretation", -1)
    if spec.get_string_attribute("jpeg:ColorSpace") in NO_CMYK or interpretation in (TIFF_SEPARATED, TIFF_CIELAB):
        raise FileError(f'"{path}" has CMYK or Lab colors; convert it to RGB.')
    if spec.nchannels > MAX_CHANNELS:
        raise FileError(f'"{path}" has {spec.nchannels} channels, and more than {MAX_CHANNELS} are not supported; save one layer as RGBA.')
    if spec.alpha_channel >= 0 and (spec.alpha_channel != spec.nchannels - 1 or spec.nchannels == 1):
        raise FileError(f'"{path}" has alpha in channel {spec.alpha_channel + 1} of {spec.nchannels}; save it as RGBA.')
    formats = {str(item) for item in (spec.format, *spec.channelformats)}
    if not formats <= DTYPES.keys():
        raise FileError(f'"{path}" has channels of type {", ".join(sorted(formats))}; save it with 8 or 16 bits or floats.')


def _check_size(path: Path, spec: Any) -> None:
    """Raise FileError unless the size in the header is plausible for the file's size, and its pixels fit into memory."""
    if spec.width < 1 or spec.height < 1:
        raise FileError(f'"{path}" has no pixels; its size is {spec.width} x {spec.height}.')
    size = spec.width * spec.height * spec.nchannels
    if size * 4 > MAX_BYTES:
        raise FileError(
            f'"{path}" has {spec.width} x {spec.height} pixels with {spec.nchannels} channels, more than {MAX_BYTES >> 30} GiB; '
            "use a smaller image."
        )
    with convert_os_errors(f'Cannot read "{path}"'):
        file_size = path.stat().st_size
    sample_bytes = 4 * PIXEL_COPIES + STORED_COPIES * np.dtype(DTYPES[str(spec.format)]).itemsize
    work_bytes = size * sample_bytes + spec.width * spec.height * PIXEL_BYTES
    if size > MAX_RATIO * file_size and not spec.get_string_attribute("compression").startswith(UNLIMITED_COMPRESSIONS):
        raise _damaged(path)
    if work_bytes > max(MAX_WORK_BYTES, WORK_BYTES_PER_FILE_BYTE * file_size):
        raise FileError(
            f'"{path}" has {spec.width} x {spec.height} pixels in {file_size:,} bytes; working on it takes {work_bytes / 2**30:.1f} GiB, '
            "so use a smaller image."
        )


def _is_animated(path: Path) -> bool:
    """Whether a PNG file has several frames: a chunk `acTL` before the pixels."""
    with convert_os_errors(f'Cannot read "{path}"'), path.open("rb") as file:
        file.seek(len(PNG_SIGNATURE))
        for _ in range(MAX_PNG_CHUNKS):
            start = file.read(8)
            if start[4:] == b"acTL":
                return True
            if len(start) < 8 or start[4:] == b"IDAT":
                return False
            file.seek(int.from_bytes(start[:4], "big") + 4, os.SEEK_CUR)
    return False


def _several_images(path: Path) -> FileError:
    return FileError(f'"{path}" contains several images or resolutions; save one image per file.')


def _volume(path: Path) -> FileError:
    return FileError(f'"{path}" contains a volume; save it as a flat image.')


def _damaged(path: Path) -> FileError:
    return FileError(f'"{path}" is damaged or truncated; open it in an image editor and save it again.')


def _check_space(path: Path, size: int) -> None:
    """Write a file of the largest size that a JPEG file of `size` bytes of pixels can have, and delete it. Raises OSError.

    The JPEG library ends the process when the disk is full.
    """
    try:
        with path.open("wb") as file:
            for _ in range(-(-(size + JPEG_HEADER_BYTES) // JPEG_HEADER_BYTES)):
                file.write(bytes(JPEG_HEADER_BYTES))
    finally:
        path.unlink(missing_ok=True)


def _holds(oiio: ModuleType, path: Path, stored: np.ndarray, is_lossy: bool) -> bool:
    """Whether the file at `path` can be read and holds exactly `stored`; pixels of lossy formats are not compared."""
    configuration = oiio.ImageSpec()
    configuration.attribute("oiio:UnassociatedAlpha", 1)
    file = oiio.ImageInput.open(str(path), configuration)
    if file is None:
        oiio.geterror()
        return False
    pixels = file.read_image(0, 0, 0, file.spec().nchannels, file.spec().format)
    message = file.geterror()
    file.close()
    if file.format_name() == "png":
        with path.open("rb") as content:
            content.seek(-len(PNG_END), os.SEEK_END)
            if content.read() != PNG_END:
                return False
    if pixels is None or message or pixels.shape != stored.shape:
        return False
    return is_lossy or (pixels.dtype == stored.dtype and np.array_equal(pixels.view(np.uint8), stored.view(np.uint8)))
