"""Texture tiles as blocks of bytes.

| bytes | content, little-endian |
|---|---|
| 0-3, 4-7 | sizes of the two coded images, uint32 |
| 8- | the color image: JPEG, WebP or raw pixels, the latter two with alpha where the tile has it |
| rest | alpha as a PNG image with one channel: of JPEG tiles with unknown or transparent texels, otherwise nothing |
"""

import struct
from typing import NamedTuple

import numpy as np

from ...errors import ImageError
from ...imaging.coded_images import ImageFormat, check_coded, decode, encode, encode_gray

SIZES = struct.Struct("<II")


class CodedTile(NamedTuple):
    """A texture tile as coded images: `color`, JPEG, WebP or raw pixels, and `alpha`, PNG, if color has none though it is needed."""

    color: bytes
    alpha: bytes | None

    @property
    def nbytes(self) -> int:
        """Bytes of both images."""
        return len(self.color) + len(self.alpha or b"")


def encode_tile(colors: np.ndarray, alpha: np.ndarray, image_format: ImageFormat, quality: int) -> bytes:
    """Return a tile as a block: `colors` (H, W, 3) and `alpha` (H, W) uint8. Alpha is left out where it is 255 everywhere."""
    has_alpha = bool((alpha < 255).any())
    is_separate = has_alpha and image_format == "jpeg"
    image = np.dstack([colors, alpha]) if has_alpha and not is_separate else colors
    color_image = encode(image, image_format, quality)
    alpha_image = encode_gray(alpha) if is_separate else b""
    return SIZES.pack(len(color_image), len(alpha_image)) + color_image + alpha_image


def split_block(block: bytes, max_pixels: int) -> CodedTile:
    """Return the coded images of a block, whose headers are checked.

    Raises:
        ImageError: the block is damaged, or holds something else than images of at most `max_pixels` pixels.
    """
    coded = _split(block)
    for image in coded if coded.alpha is not None else coded[:1]:
        check_coded(image, max_pixels)
    return coded


def _split(block: bytes) -> CodedTile:
    """Return the parts of a block. Raises ImageError."""
    color_size, alpha_size = SIZES.unpack_from(block) if len(block) >= SIZES.size else (0, 0)
    end = SIZES.size + color_size
    if end + alpha_size != len(block):
        raise ImageError("The block of a texture tile is damaged; build the store again.")
    return CodedTile(block[SIZES.size : end], block[end:] if alpha_size else None)


def decode_tile(block: bytes, max_pixels: int) -> np.ndarray:
    """Return the tile (H, W, 3), or (H, W, 4) with alpha, uint8.

    Raises:
        ImageError: the block is damaged.
    """
    coded = _split(block)
    image = decode(coded.color, max_pixels)
    if coded.alpha is None:
        return image
    alpha = decode(coded.alpha, max_pixels)
    if alpha.shape[:2] != image.shape[:2]:
        raise ImageError("The block of a texture tile is damaged; build the store again.")
    return np.dstack([image[..., :3], alpha[..., :1]])
