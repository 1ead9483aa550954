"""Texture tiles as blocks of bytes.

A block is the coded color image, or with alpha in WebP and raw tiles the coded image. JPEG has no alpha: where a tile has unknown or
transparent texels, the JPEG image is followed by a PNG image of alpha and 4 bytes, the size of that image, uint32, little-endian. A block
without alpha ends with 4 zero bytes, so that both are read alike.
"""

import struct
from typing import NamedTuple

import numpy as np

from ...errors import ImageError
from ...imaging.coded_images import ImageFormat, decode, encode, encode_gray

ALPHA_SIZE = struct.Struct("<I")


class CodedTile(NamedTuple):
    """A texture tile as coded images: `color`, JPEG, WebP or raw pixels, and `alpha`, PNG, if color has none though it is needed."""

    color: bytes
    alpha: bytes | None


def encode_tile(colors: np.ndarray, alpha: np.ndarray, image_format: ImageFormat, quality: int) -> bytes:
    """Return a tile as a block: `colors` (H, W, 3) and `alpha` (H, W) uint8. Alpha is left out where it is 255 everywhere."""
    if (alpha == 255).all():
        return encode(colors, image_format, quality) + ALPHA_SIZE.pack(0)
    if image_format != "jpeg":
        return encode(np.dstack([colors, alpha]), image_format, quality) + ALPHA_SIZE.pack(0)
    alpha_image = encode_gray(alpha)
    return encode(colors, image_format, quality) + alpha_image + ALPHA_SIZE.pack(len(alpha_image))


def split_block(block: bytes) -> CodedTile:
    """Return the coded images of a block.

    Raises:
        ImageError: the block is damaged.
    """
    end = len(block) - ALPHA_SIZE.size
    alpha_size = ALPHA_SIZE.unpack_from(block, end)[0] if end > 0 else 0
    if end <= alpha_size:
        raise ImageError("The block of a texture tile is damaged; build the store again.")
    color = block[: end - alpha_size]
    return CodedTile(color, block[end - alpha_size : end] if alpha_size else None)


def decode_tile(block: bytes, max_pixels: int) -> np.ndarray:
    """Return the tile (H, W, 3), or (H, W, 4) with alpha, uint8.

    Raises:
        ImageError: the block is damaged.
    """
    coded = split_block(block)
    image = decode(coded.color, max_pixels)
    if coded.alpha is None:
        return image
    alpha = decode(coded.alpha, max_pixels)
    if alpha.shape[:2] != image.shape[:2]:
        raise ImageError("The block of a texture tile is damaged; build the store again.")
    return np.dstack([image[..., :3], alpha[..., :1]])
