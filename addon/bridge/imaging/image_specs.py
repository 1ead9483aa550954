"""Headers of image files to write, made from the headers of files that were read.

Attributes are copied by OpenImageIO and not read in Python: it crashes on the bytes of a color profile.
"""

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ...core.errors import FileError
from .image_storage import ImageFile, Storage

NEAREST_DTYPES = {  # by format and by the type in the file that was read, where they differ
    "png": {"float16": np.uint16, "float32": np.uint16},
    "jpeg": {"uint16": np.uint8, "float16": np.uint8, "float32": np.uint8},
    "openexr": {"uint8": np.float16, "uint16": np.float32},
    "tiff": {},
}
TYPE_NAMES = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}  # OpenImageIO's names.
CHANNEL_NAMES = {1: ("Y",), 2: ("Y", "A"), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}
JPEG_QUALITY = 97
PNG_COMPRESSION = 3  # 1 to 9; six times as fast as the usual 6, for files that are a few percent larger.
LOSSY_COMPRESSIONS = {"openexr": ("b44", "b44a", "dwaa", "dwab"), "tiff": ("jpeg",)}  # would change every pixel again
LOSSY_FOR_FLOATS = "pxr24"  # keeps 24 of 32 bits; halves are lossless
# Attributes that describe the storage in the file that was read, or the color profile in words: PNG would keep them as comments.
STORAGE_PREFIXES = ("oiio:BitsPerSample", "oiio:subimages", "ICCProfile:", "tiff:PhotometricInterpretation", "tiff:ColorSpace")
FORMAT_PREFIXES = ("tiff:", "png:", "jpeg:", "openexr:", "compression", "planarconfig", "screenWindow")
COLOR_PREFIXES = ("ICCProfile", "oiio:ColorSpace", "oiio:Gamma", "Exif:ColorSpace", "chromaticities")


def target_storage(like: ImageFile, file_format: str, path: Path) -> Storage:
    """Return how the pixels of `like` are stored in a file of another, or the same, format.

    Raises:
        FileError: the format has no alpha, and `like` does; the message names the file `path`.
    """
    storage = like.storage
    if file_format == "jpeg" and (storage.has_alpha or like.stored.shape[2] not in (1, 3)):
        raise FileError(f'"{path.name}" cannot hold {like.stored.shape[2]} channels, JPEG has no alpha; use .png, .tif or .exr.')
    if file_format == like.format:
        return storage
    dtype = np.dtype(NEAREST_DTYPES[file_format].get(storage.dtype.name, storage.dtype))
    is_premultiplied = storage.has_alpha and like.is_color and (file_format == "openexr" or (file_format == "tiff" and dtype.kind == "f"))
    return Storage(dtype, storage.has_alpha, is_linear=like.is_color and dtype.kind == "f", is_premultiplied=is_premultiplied)


def build_spec(oiio: ModuleType, like: ImageFile, file_format: str, storage: Storage) -> Any:
    """Return the header, an OpenImageIO.ImageSpec, of a file with the metadata of `like`."""
    spec = like.spec.copy()
    spec.set_format(oiio.TypeDesc(TYPE_NAMES[storage.dtype.name]))
    spec.channelformats = ()
    _erase(spec, STORAGE_PREFIXES)
    if spec.get_string_attribute("oiio:ColorSpace").lower().startswith("srgb"):
        _erase(spec, ("oiio:ColorSpace",))  # the default, which PNG would keep as a comment
    if file_format != like.format:
        _reset_layout(spec)
    if storage.is_linear != like.storage.is_linear:
        _erase(spec, COLOR_PREFIXES)
    compression = spec.get_string_attribute("compression").partition(":")[0]
    is_lossy_for_floats = compression == LOSSY_FOR_FLOATS and storage.dtype == np.float32
    if is_lossy_for_floats or compression in LOSSY_COMPRESSIONS.get(file_format, ()):
        spec.attribute("compression", "zip")
    if file_format == "jpeg":
        spec.attribute("Compression", f"jpeg:{JPEG_QUALITY}")
        if like.format != "jpeg":
            spec.attribute("jpeg:subsampling", "4:4:4")
    if file_format == "png":
        spec.attribute("png:compressionLevel", PNG_COMPRESSION)
    if file_format == "tiff" and storage.dtype == np.float16:
        spec.attribute("tiff:half", 1)
    if file_format != "openexr":
        _set_alpha(spec, like, file_format, storage)
    return spec


def _set_alpha(spec: Any, like: ImageFile, file_format: str, storage: Storage) -> None:
    """Declare alpha as straight or premultiplied, as it is stored: the writer then leaves the colors alone."""
    is_straight = file_format == "png" or not storage.is_premultiplied
    if file_format == like.format:  # data with alpha, whatever it means
        is_straight = file_format == "png" or bool(like.spec.get_int_attribute("oiio:UnassociatedAlpha"))
    _erase(spec, ("oiio:UnassociatedAlpha", "tiff:UnassociatedAlpha"))
    if is_straight:
        spec.attribute("oiio:UnassociatedAlpha", 1)


def _reset_layout(spec: Any) -> None:
    """Remove what describes the format of the file that was read: tiles, windows, channel names and attributes."""
    _erase(spec, FORMAT_PREFIXES)
    spec.tile_width = spec.tile_height = spec.tile_depth = 0
    spec.x = spec.y = spec.full_x = spec.full_y = 0
    spec.full_width, spec.full_height = spec.width, spec.height
    spec.channelnames = CHANNEL_NAMES[spec.nchannels]


def _erase(spec: Any, prefixes: tuple[str, ...]) -> None:
    """Remove the attributes whose names begin with one of `prefixes`, in upper or lower case."""
    for prefix in prefixes:
        spec.erase_attribute(f"{prefix}.*")  # a regular expression; names in damaged files are not always text that Python can read
