"""Structure and texture of an image: its lowest cosine frequencies, and the rest (Textures Revisited, section 5.2).

Sub-band k of the orthonormal discrete cosine transform (DCT-II) of an image (H, W) holds the coefficients (u, v) with max(u, v) = k. The
structure consists of the lowest sub-bands, kappa in the paper: with 0 of them there is no structure, with max(H, W) nothing else.
"""

from collections.abc import Iterator
from itertools import islice

import numpy as np
from scipy.fft import dctn, idctn

from ..imaging.colors import LUMINANCE, decode_signed_srgb
from ..imaging.pyramids import reduce_image
from ..jobs.chunks import slices

MAX_DEVIATION = 0.001  # standard deviation of the autocorrelation of luminance 0..1; the paper's limit
MAX_AUTO_SUB_BANDS = 10  # finer patterns are texture; the paper uses 4 to 6
PATTERN_RATIO = 1.5  # times the deviation that remains at MAX_AUTO_SUB_BANDS is enough, too
MAX_ANALYSIS_PIXELS = 512  # per side: larger images are halved before the analysis, which only concerns low frequencies


class LowBand:
    """The structure of an image: a smooth function that can be evaluated in any part of it.

    coefficients: (K, K', C), the lowest DCT coefficients along rows and columns.
    """

    def __init__(self, image: np.ndarray, sub_bands: int) -> None:
        """Project `image` (H, W, C) to its lowest sub-bands."""
        self._rows, self._columns = (_cosines(size, min(sub_bands, size)) for size in image.shape[:2])
        parts = [np.einsum("kwc,wv->kvc", image[rows], self._columns, optimize=True) for rows in slices(len(image), 256)]  # in doubles
        partial = np.concatenate(parts)
        self.coefficients = np.einsum("ku,kvc->uvc", self._rows, partial, optimize=True)

    def evaluate(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return the structure (R, S, C) float32 at pixels in the given `rows` (R,) and `columns` (S,)."""
        partial = np.einsum("ru,uvc->rvc", self._rows[rows], self.coefficients, optimize=True)
        return np.einsum("rvc,sv->rsc", partial, self._columns[columns], optimize=True).astype(np.float32)


def luminance(image: np.ndarray, is_color: bool) -> np.ndarray:
    """Return CIE Y (H, W) of an image (H, W, C) with sRGB-encoded colors in its first three channels, or the mean of channels of data."""
    if not is_color or image.shape[2] < 3:
        return image[..., : min(image.shape[2], 3)].mean(axis=2)
    result = np.empty(image.shape[:2], np.float32)
    for rows in slices(len(image), 256):
        result[rows] = decode_signed_srgb(np.maximum(image[rows, :, :3], 0.0)) @ LUMINANCE
    return result


def choose_sub_bands(image: np.ndarray, is_color: bool) -> tuple[int, np.ndarray]:
    """Return the number of sub-bands of the structure of `image` (H, W, C), whose missing pixels are filled smoothly, and the deviations
    (K,) for numbers from 0 that decided.

    It is the smallest number for which the standard deviation of the autocorrelation of the texture is below MAX_DEVIATION, or below
    PATTERN_RATIO times what remains at MAX_AUTO_SUB_BANDS: a texture with a strong pattern of its own is never homogeneous, and more
    sub-bands would only take parts of the pattern away.
    """
    values = luminance(image, is_color)
    while max(values.shape) > MAX_ANALYSIS_PIXELS:
        values = reduce_image(values)
    count = min(MAX_AUTO_SUB_BANDS, *values.shape) + 1
    deviations = np.array(list(islice(autocorrelation_deviations(values), count)))
    return int(np.argmax(deviations < max(MAX_DEVIATION, PATTERN_RATIO * deviations[-1]))), deviations


def autocorrelation_deviations(values: np.ndarray) -> Iterator[float]:
    """Yield the standard deviation of the autocorrelation matrix of the texture of `values` (H, W), for 0, 1, 2 ... sub-bands.

    The texture is padded with zeros to a square of side N; its autocorrelation IDCT(DCT(H) ** 2) / (2 N) is clipped to (H, W). With this
    scale it does not depend on the size of the image: the largest element is about 0.4 times the variance of a texture without pattern.
    """
    coefficients = dctn(values.astype(np.float64), norm="ortho")
    side = max(values.shape)
    padding = [(0, side - size) for size in values.shape]
    for count in range(side + 1):
        coefficients[:count, :count] = 0.0
        if values.shape[0] == values.shape[1]:
            powers = coefficients**2
            mean, square = 0.5 * powers[0, 0] / side**2, 0.25 * (powers**2).sum() / side**4  # Parseval
            yield float(np.sqrt(max(square - mean**2, 0.0)))
        else:
            texture = idctn(coefficients, norm="ortho")
            correlation = idctn(dctn(np.pad(texture, padding), norm="ortho") ** 2, norm="ortho")[: values.shape[0], : values.shape[1]]
            yield float(0.5 * correlation.std() / side)


def _cosines(size: int, count: int) -> np.ndarray:
    """Return the first `count` functions of the orthonormal DCT-II at `size` samples: (size, count) float64."""
    samples, frequencies = np.arange(size)[:, None] + 0.5, np.arange(count)
    scale = np.where(frequencies == 0, np.sqrt(1.0 / size), np.sqrt(2.0 / size))
    return scale * np.cos(np.pi / size * samples * frequencies)
