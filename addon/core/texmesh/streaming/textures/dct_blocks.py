"""Blocks of 8 x 8 pixels as JPEG codes them: YCbCr colors, the discrete cosine transform, zigzag order, quantization.

Coefficients are (..., 64) in zigzag order; their scale is that of JPEG: the first is 8 times the mean of the block.
"""

import numpy as np
from scipy.fft import dct

BLOCK = 8
COEFFICIENTS = BLOCK * BLOCK
YCC_OF_RGB = np.array([[0.299, 0.587, 0.114], [-0.168735892, -0.331264108, 0.5], [0.5, -0.418687589, -0.081312411]])
RGB_OF_YCC = np.array([[1.0, 0.0, 1.402], [1.0, -0.344136286, -0.714136286], [1.0, 1.772, 0.0]])
MAX_STEP = 255  # of quantization; larger ones need tables of 16 bits
# Annex K of the JPEG standard, row by row: for luminance and chrominance.
LUMINANCE_STEPS = np.array(
    "16 11 10 16 24 40 51 61 12 12 14 19 26 58 60 55 14 13 16 24 40 57 69 56 14 17 22 29 51 87 80 62 "  # noqa: SIM905
    "18 22 37 56 68 109 103 77 24 35 55 64 81 104 113 92 49 64 78 87 103 121 120 101 72 92 95 98 112 100 103 99".split(),
    int,
)
CHROMINANCE_STEPS = np.array(
    "17 18 24 47 99 99 99 99 18 21 26 66 99 99 99 99 24 26 56 99 99 99 99 99 47 66 99 99 99 99 99 99".split() + ["99"] * 32,  # noqa: SIM905
    int,
)


def zigzag_order() -> np.ndarray:
    """Return the position (64,) in a block, row by row, of each coefficient in zigzag order."""
    rows, columns = np.divmod(np.arange(COEFFICIENTS), BLOCK)
    diagonals = rows + columns
    return np.lexsort((np.where(diagonals % 2 == 0, columns, rows), diagonals))


ZIGZAG = zigzag_order()


def transform_tiles(tiles: np.ndarray, component_count: int) -> np.ndarray:
    """Return the coefficients (C, N, B, 64) float32 of `tiles` (N, S, S, 3) uint8, RGB: of YCbCr, or of Y alone. Blocks are row by row."""
    count, side = tiles.shape[:2]
    matrix = YCC_OF_RGB[:component_count].astype(np.float32)
    colors = tiles.reshape(-1, 3).astype(np.float32) @ matrix.T
    colors[:, 0] -= 128.0
    blocks = colors.reshape(count, side // BLOCK, BLOCK, side // BLOCK, BLOCK, component_count).transpose(5, 0, 1, 3, 2, 4)
    transformed = dct(dct(np.ascontiguousarray(blocks), axis=-1, norm="ortho"), axis=-2, norm="ortho")
    return transformed.reshape(component_count, count, -1, COEFFICIENTS)[..., ZIGZAG]


def quantize(coefficients: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return `coefficients` (C, N, B, 64) as the nearest multiples int16 of `steps` (C, N, 64)."""
    return np.rint(coefficients / steps[:, :, None].astype(np.float32)).astype(np.int16)


def standard_steps(quality: int, component_count: int, factor: float = 1.0) -> np.ndarray:
    """Return the steps (C, 64) int64 of quantization, in zigzag order, of the JPEG library for a `quality` of 1 to 100, times `factor`."""
    scale = factor * (5000 / quality if quality < 50 else 200 - 2 * quality)
    tables = [LUMINANCE_STEPS, CHROMINANCE_STEPS, CHROMINANCE_STEPS][:component_count]
    return np.clip(np.floor((np.stack(tables)[:, ZIGZAG] * scale + 50.0) / 100.0), 1, MAX_STEP).astype(np.int64)
