"""Texture tiles as image files that other programs read, in memory."""

import struct

import numpy as np

from ...imaging.coded_images import RAW_MAGIC, decode
from .grid import TILE_SIZE
from .tile_blocks import CodedTile

TARGA_HEADER = struct.Struct("<BBBHHBHHHHBB")
TARGA_TRUE_COLOR = 2


def to_image_files(tile: CodedTile) -> CodedTile:
    """Return a tile whose color image every program reads: raw pixels become an uncompressed Targa file, other images stay as stored.

    Raises:
        ImageError: the raw pixels are damaged.
    """
    if not tile.color.startswith(RAW_MAGIC):
        return tile
    return CodedTile(encode_targa(decode(tile.color, TILE_SIZE**2)), tile.alpha)


def encode_targa(pixels: np.ndarray) -> bytes:
    """Return `pixels` (H, W, 3 or 4) uint8, row 0 at the bottom, straight alpha, as an uncompressed Targa file."""
    height, width, channels = pixels.shape
    header = TARGA_HEADER.pack(0, 0, TARGA_TRUE_COLOR, 0, 0, 0, 0, 0, width, height, 8 * channels, 8 if channels == 4 else 0)
    return header + np.ascontiguousarray(pixels[..., [2, 1, 0, 3][:channels]]).tobytes()
