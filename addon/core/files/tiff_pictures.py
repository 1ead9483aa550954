"""Segments of TIFF files that are pictures of their own: JPEG (TIFF Technical Note 2) and WebP (a number of libtiff), decoded with Pillow.

The quantization and Huffman tables that all JPEG segments of a file have in common are stored once, in the tag JPEGTables. Whether colors
are YCbCr or RGB is in the TIFF tags only; the marker that Adobe's programs write tells it to the decoder.
"""

import io

import numpy as np

from ..imaging.coded_images import MAX_RATIO

JPEG, WEBP = 7, 50001  # values of the tag Compression
MARKER_BYTES = 2  # a marker stands at the start and at the end of a JPEG stream
ADOBE_MARKER = b"\xff\xee\x00\x0eAdobe\x00\x64\x00\x00\x00\x00"  # followed by one of these bytes
RGB_TRANSFORM, YCBCR_TRANSFORM = b"\0", b"\1"
MODES = {1: "L", 3: "RGB", 4: "RGBA"}  # Pillow's name of pixels by channels


def decode_picture(data: bytes, compression: int, shape: tuple[int, int, int], tables: bytes, is_ycbcr: bool) -> np.ndarray:
    """Return the pixels (h, columns, channels) uint8 of a segment; gray values, or red, green and blue, with alpha if it has any.

    compression: JPEG or WEBP. shape: rows, columns and channels of the segment; the last strip of an image may have fewer rows. tables:
    value of the tag JPEGTables. is_ycbcr: whether the colors of a JPEG segment are stored as YCbCr.

    Raises:
        ValueError: the segment is damaged, or has another size or type of pixels.
    """
    from PIL import Image, JpegImagePlugin, WebPImagePlugin  # here, so that importing the core needs only NumPy and SciPy

    plugin = WebPImagePlugin.WebPImageFile if compression == WEBP else JpegImagePlugin.JpegImageFile
    if compression == JPEG and shape[0] * shape[1] * shape[2] > MAX_RATIO * len(data):
        raise ValueError("a segment is too short for its pixels")
    stream = data if compression == WEBP else _complete_jpeg(data, tables, is_ycbcr)
    try:
        with plugin(io.BytesIO(stream)) as image:
            if image.size[0] != shape[1] or not 0 < image.size[1] <= shape[0]:
                raise ValueError("a segment has another size than the file says")
            pixels = np.asarray(image.convert(MODES[shape[2]]) if compression == WEBP else image)
            if image.mode == "CMYK":
                pixels = ~pixels  # Pillow inverts four channels, as Adobe stores inks; here they are colors and alpha.
    except (OSError, SyntaxError, EOFError, Image.DecompressionBombError) as error:
        raise ValueError("a segment is damaged, or has pixels of another type") from error
    if pixels.size != image.size[1] * shape[1] * shape[2]:
        raise ValueError("a segment has another number of channels than the file says")
    return pixels.reshape(-1, *shape[1:])


def _complete_jpeg(data: bytes, tables: bytes, is_ycbcr: bool) -> bytes:
    """Return a JPEG stream that can be decoded by itself."""
    marker = ADOBE_MARKER + (YCBCR_TRANSFORM if is_ycbcr else RGB_TRANSFORM)
    return data[:MARKER_BYTES] + tables[MARKER_BYTES:-MARKER_BYTES] + marker + data[MARKER_BYTES:]
