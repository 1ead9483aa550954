"""Colors of texture tiles: sRGB tables, halving in linear light, colors where nothing is known, visible detail.

Tiles are (H, W, 4) uint8, sRGB-encoded with straight alpha; alpha 0 is unknown.
"""

import numpy as np

from ...imaging.colors import LINEAR_OF_BYTE, LUMINANCE, encode_signed_srgb
from ...imaging.images import dilate_in_place

QUARTERS = np.round(LINEAR_OF_BYTE * (65535 // 4)).astype(np.uint16)  # a quarter of the scale of ENCODED: the sum of four fits into 16 bits
ENCODED = np.round(255.0 * encode_signed_srgb(np.arange(65536) / 65535.0)).astype(np.uint8)  # sRGB bytes by scene-linear value * 65535
EXTENSION = 8  # texels; a block of JPEG with a known texel is filled to its last texel
DETAIL_FRACTION = 1e-3  # part of the texels whose contrast exceeds the detail of a tile


def encode_linear(linear: np.ndarray) -> np.ndarray:
    """Return scene-linear values of any shape as sRGB bytes; values beyond 0..1 are clamped."""
    scaled = np.clip(linear, 0.0, 1.0)
    scaled *= np.float32(65535.0)
    scaled += np.float32(0.5)
    return ENCODED.take(scaled.astype(np.uint16))


def encode_alpha(alpha: np.ndarray) -> np.ndarray:
    """Return alpha 0..1 as bytes. It is never rounded to 0: a tile with a known texel has ancestors with known texels."""
    rounded = np.floor(np.clip(alpha, 0.0, 1.0) * np.float32(255.0) + np.float32(0.5)).astype(np.uint8)
    return np.where(alpha > 0.0, np.maximum(rounded, 1), 0).astype(np.uint8)


def encode_premultiplied(image: np.ndarray) -> np.ndarray:
    """Return a scene-linear, premultiplied image (H, W, 4) float32 as a tile; unknown texels are 0."""
    alpha = image[..., 3]
    result = np.zeros(image.shape, np.uint8)
    result[..., 3] = encode_alpha(alpha)
    is_opaque = bool((alpha == 1.0).all())
    scale = None if is_opaque else np.divide(1.0, alpha, out=np.zeros_like(alpha), where=alpha > 0.0)[..., None]
    result[..., :3] = encode_linear(image[..., :3] if is_opaque else image[..., :3] * scale)
    return result


def halve(tile: np.ndarray, row_weights: np.ndarray, column_weights: np.ndarray) -> np.ndarray:
    """Return the means over 2 x 2 texels of `tile` (H, W, 4), H and W even, in linear light: (H / 2, W / 2, 4) uint8.

    row_weights, column_weights: (H,) and (W,) float32, the part of each row and column that counts. Colors are weighted by alpha.
    """
    height, width = tile.shape[0] // 2, tile.shape[1] // 2
    is_full = bool((row_weights == 1.0).all() and (column_weights == 1.0).all())
    if is_full and bool((tile[..., 3] == 255).all()):
        quarters = QUARTERS.take(tile[..., :3])
        rows = quarters[0::2] + quarters[1::2]
        result = np.full((height, width, 4), 255, np.uint8)
        result[..., :3] = ENCODED.take(rows[:, 0::2] + rows[:, 1::2])
        return result
    weights = row_weights[:, None] * column_weights
    coverage = weights * tile[..., 3] * np.float32(1.0 / 255.0)
    sums = np.concatenate([LINEAR_OF_BYTE.take(tile[..., :3]) * coverage[..., None], coverage[..., None], weights[..., None]], axis=2)
    sums = sums[0::2] + sums[1::2]
    sums = sums[:, 0::2] + sums[:, 1::2]
    total = sums[..., 4:]
    return encode_premultiplied(np.divide(sums[..., :4], total, out=np.zeros_like(sums[..., :4]), where=total > 0.0))


def extend_colors(tile: np.ndarray) -> np.ndarray:
    """Return the colors (H, W, 3) uint8 of `tile` with those of unknown texels filled from known ones, so that interpolation and filters
    see no dark fringe.

    Up to EXTENSION texels away from a known texel the color depends only on texels within that distance.
    """
    known = tile[..., 3] > 0
    if known.all():
        return tile[..., :3]
    colors = LINEAR_OF_BYTE.take(tile[..., :3])
    dilate_in_place(colors, tile[..., 3] * np.float32(1.0 / 255.0), EXTENSION)
    return np.where(known[..., None], tile[..., :3], encode_linear(colors))


def measure_detail(tile: np.ndarray) -> float:
    """Return the contrast that is lost when `tile` (H, W, 4) is halved and interpolated bilinearly.

    This is the difference of luma, or of alpha, that one texel in a thousand exceeds, in units of 1/255. The two outermost texels of each
    side do not count.
    """
    ones = [np.ones(size, np.float32) for size in tile.shape[:2]]
    fine, coarse = _luma_and_alpha(tile), _luma_and_alpha(halve(tile, *ones))
    for axis in (0, 1):
        coarse = _expand(coarse, axis)
    is_known = np.minimum(fine[1], coarse[1]) > 0.0
    difference = np.maximum(np.abs(fine[0] - coarse[0]) * is_known, np.abs(fine[1] - coarse[1]))[2:-2, 2:-2].reshape(-1)
    rank = int(len(difference) * (1.0 - DETAIL_FRACTION))
    return float(np.partition(difference, rank)[rank])


def _luma_and_alpha(tile: np.ndarray) -> np.ndarray:
    """Return encoded luma, 0 where alpha is 0, and alpha, (2, H, W) float32, 0 to 255."""
    return np.stack([tile[..., :3] @ LUMINANCE, tile[..., 3].astype(np.float32)])


def _expand(values: np.ndarray, axis: int) -> np.ndarray:
    """Return `values` (2, H, W) at twice the size along an axis, linear between the centers."""
    moved = np.moveaxis(values, axis + 1, -1)
    padded = np.concatenate([moved[..., :1], moved, moved[..., -1:]], axis=-1)
    result = np.empty((*moved.shape[:-1], 2 * moved.shape[-1]), np.float32)
    result[..., 0::2] = 0.75 * moved + 0.25 * padded[..., :-2]
    result[..., 1::2] = 0.75 * moved + 0.25 * padded[..., 2:]
    return np.moveaxis(result, -1, axis + 1)
