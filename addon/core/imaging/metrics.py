"""Image similarity: PSNR, SSIM and overlap of silhouettes, and the preparation of renders for them.

Renders are compared as displayed: cropped to the object, composited over mid-gray, encoded as sRGB.
"""

import numpy as np

from .colors import decode_signed_srgb, encode_signed_srgb

SSIM_SIGMA = 1.5
SSIM_RADIUS = 5  # 11 x 11 pixels
SSIM_K1 = 0.01
SSIM_K2 = 0.03


def psnr(reference: np.ndarray, image: np.ndarray) -> float:
    """Return the peak signal-to-noise ratio in decibels of two images of one shape with values in 0..1; infinite when they are equal."""
    _check_same_shape(reference, image)
    mean_squared_error = np.mean((reference.astype(np.float64) - image.astype(np.float64)) ** 2)
    return float("inf") if mean_squared_error == 0.0 else float(-10.0 * np.log10(mean_squared_error))


def ssim(reference: np.ndarray, image: np.ndarray) -> float:
    """Return the mean structural similarity of two images (H, W) or (H, W, C) with values in 0..1; 1.0 when they are equal.

    The mean of `ssim_map` over all channels and over the pixels whose window lies completely inside, so a frame of 5 pixels is context
    only.

    Raises:
        ValueError: the shapes differ, or a side is shorter than 11 pixels.
    """
    if min(reference.shape[:2]) < 2 * SSIM_RADIUS + 1:
        raise ValueError(f"SSIM needs {2 * SSIM_RADIUS + 1} pixels per side; the images are {reference.shape[:2]}.")
    return float(ssim_map(reference, image)[SSIM_RADIUS:-SSIM_RADIUS, SSIM_RADIUS:-SSIM_RADIUS].mean())


def ssim_map(reference: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return the structural similarity around every pixel of two images (H, W) or (H, W, C) with values in 0..1.

    Wang et al. 2004: an 11 x 11 Gaussian window of sigma 1.5, K1 = 0.01, K2 = 0.03, population covariance.

    Raises:
        ValueError: the shapes differ.
    """
    _check_same_shape(reference, image)
    first, second = reference.astype(np.float64), image.astype(np.float64)
    first_mean, second_mean = _windowed_mean(first), _windowed_mean(second)
    first_variance = _windowed_mean(first * first) - first_mean**2
    second_variance = _windowed_mean(second * second) - second_mean**2
    covariance = _windowed_mean(first * second) - first_mean * second_mean
    luminance_floor, contrast_floor = SSIM_K1**2, SSIM_K2**2
    similarity = (2.0 * first_mean * second_mean + luminance_floor) * (2.0 * covariance + contrast_floor)
    similarity /= (first_mean**2 + second_mean**2 + luminance_floor) * (first_variance + second_variance + contrast_floor)
    return similarity


def alpha_iou(first: np.ndarray, second: np.ndarray) -> float:
    """Return the overlap of two silhouettes (H, W) in 0..1: sum of minima over sum of maxima; 1.0 when both are empty."""
    _check_same_shape(first, second)
    union = np.maximum(first, second).sum(dtype=np.float64)
    return 1.0 if union == 0.0 else float(np.minimum(first, second).sum(dtype=np.float64) / union)


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Return sRGB values in 0..1 (IEC 61966-2-1) of scene-linear Rec.709 values, clipped to 0..1."""
    return encode_signed_srgb(np.clip(linear, 0.0, 1.0))


def decode_srgb(encoded: np.ndarray) -> np.ndarray:
    """Return scene-linear Rec.709 values of sRGB values in 0..1. Inverts `encode_srgb`."""
    return decode_signed_srgb(encoded)


def composite_over_gray(premultiplied: np.ndarray, gray: float = 0.5) -> np.ndarray:
    """Composite a render (H, W, 4), scene-linear and premultiplied, over a gray background: (H, W, 3) sRGB values in 0..1.

    `gray` is the sRGB value of the background; light is mixed scene-linear, as in front of a real gray card.
    """
    background = float(decode_srgb(np.float64(gray)))
    return encode_srgb(premultiplied[..., :3] + (1.0 - premultiplied[..., 3:]) * background)


def crop_to_object(alpha: np.ndarray, margin: int = SSIM_RADIUS, threshold: float = 1.0 / 255.0) -> tuple[slice, slice]:
    """Return rows and columns of the smallest rectangle around all of `alpha` (H, W) above `threshold`.

    It is widened by `margin` pixels, within the image. The default is the radius of the SSIM window: the windows that count are then those
    centered on the object's rectangle.

    Raises:
        ValueError: nothing is above the threshold.
    """
    inside = alpha > threshold
    if not inside.any():
        raise ValueError("The image is empty: no pixel shows the object.")
    return tuple(_occupied_range(inside.any(axis=axis), margin) for axis in (1, 0))


def _occupied_range(occupied: np.ndarray, margin: int) -> slice:
    """Return the range of set entries of `occupied` (N,), widened by `margin` at both ends."""
    indices = np.flatnonzero(occupied)
    return slice(max(int(indices[0]) - margin, 0), min(int(indices[-1]) + 1 + margin, len(occupied)))


def _windowed_mean(image: np.ndarray) -> np.ndarray:
    """Return the Gaussian-weighted mean around every pixel of (H, W) or (H, W, C), per channel."""
    from scipy.ndimage import gaussian_filter

    sigma = (SSIM_SIGMA, SSIM_SIGMA, 0.0)[: image.ndim]
    return gaussian_filter(image, sigma, truncate=SSIM_RADIUS / SSIM_SIGMA)


def _check_same_shape(first: np.ndarray, second: np.ndarray) -> None:
    if first.shape != second.shape:
        raise ValueError(f"Images must have the same shape to be compared; these are {first.shape} and {second.shape}.")
