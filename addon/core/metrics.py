"""How alike two pictures are: PSNR, SSIM and overlap of silhouettes, and how renders are prepared for them.

Renders are compared as people see them: cropped to the object, laid over mid-grey, encoded as sRGB.
"""

import numpy as np

SSIM_SIGMA = 1.5
SSIM_RADIUS = 5  # 11 x 11 pixels
SSIM_K1 = 0.01
SSIM_K2 = 0.03


def psnr(reference: np.ndarray, picture: np.ndarray) -> float:
    """Peak signal-to-noise ratio in decibels of two pictures of one shape with values in 0..1; infinite when they are equal."""
    _check_same_shape(reference, picture)
    mean_squared_error = np.mean((reference.astype(np.float64) - picture.astype(np.float64)) ** 2)
    return float("inf") if mean_squared_error == 0.0 else float(-10.0 * np.log10(mean_squared_error))


def ssim(reference: np.ndarray, picture: np.ndarray) -> float:
    """Mean structural similarity of two pictures (H, W) or (H, W, C) with values in 0..1; 1.0 when they are equal.

    Wang et al. 2004: an 11 x 11 Gaussian window of sigma 1.5, K1 = 0.01, K2 = 0.03, population covariance. The mean runs over all channels
    and over the pixels whose window lies wholly inside, so a frame of 5 pixels is context only.

    Raises:
        ValueError: when the shapes differ, or a side is shorter than 11 pixels.
    """
    _check_same_shape(reference, picture)
    if min(reference.shape[:2]) < 2 * SSIM_RADIUS + 1:
        raise ValueError(f"SSIM needs {2 * SSIM_RADIUS + 1} pixels a side; the pictures are {reference.shape[:2]}.")
    first, second = reference.astype(np.float64), picture.astype(np.float64)
    first_mean, second_mean = _windowed_mean(first), _windowed_mean(second)
    first_variance = _windowed_mean(first * first) - first_mean**2
    second_variance = _windowed_mean(second * second) - second_mean**2
    covariance = _windowed_mean(first * second) - first_mean * second_mean
    luminance_floor, contrast_floor = SSIM_K1**2, SSIM_K2**2
    similarity = (2.0 * first_mean * second_mean + luminance_floor) * (2.0 * covariance + contrast_floor)
    similarity /= (first_mean**2 + second_mean**2 + luminance_floor) * (first_variance + second_variance + contrast_floor)
    return float(similarity[SSIM_RADIUS:-SSIM_RADIUS, SSIM_RADIUS:-SSIM_RADIUS].mean())


def alpha_iou(first: np.ndarray, second: np.ndarray) -> float:
    """Overlap of two silhouettes (H, W) in 0..1: summed minima over summed maxima; 1.0 when both are empty."""
    _check_same_shape(first, second)
    union = np.maximum(first, second).sum(dtype=np.float64)
    return 1.0 if union == 0.0 else float(np.minimum(first, second).sum(dtype=np.float64) / union)


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """sRGB values in 0..1 (IEC 61966-2-1) of scene-linear Rec.709 values; what is out of range is clipped."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1.0 / 2.4) - 0.055)


def decode_srgb(encoded: np.ndarray) -> np.ndarray:
    """Scene-linear Rec.709 values of sRGB values in 0..1. Inverse of `encode_srgb`."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def over_grey(premultiplied: np.ndarray, grey: float = 0.5) -> np.ndarray:
    """A render (H, W, 4), scene-linear and premultiplied, laid over a grey: (H, W, 3) sRGB values in 0..1.

    `grey` is the sRGB value of the ground; light is mixed scene-linear, as in front of a real grey card.
    """
    ground = float(decode_srgb(np.float64(grey)))
    return encode_srgb(premultiplied[..., :3] + (1.0 - premultiplied[..., 3:]) * ground)


def crop_to_object(alpha: np.ndarray, margin: int = SSIM_RADIUS, threshold: float = 1.0 / 255.0) -> tuple[slice, slice]:
    """Rows and columns of the smallest rectangle around all of `alpha` (H, W) above `threshold`.

    It is widened by `margin` pixels, as far as the picture goes. The default is the radius of the SSIM window: the windows that count
    are then those centred on the object's rectangle.

    Raises:
        ValueError: when nothing is above the threshold.
    """
    inside = alpha > threshold
    if not inside.any():
        raise ValueError("The picture is empty: no pixel shows the object.")
    return tuple(_span(inside.any(axis=axis), margin) for axis in (1, 0))


def _span(occupied: np.ndarray, margin: int) -> slice:
    """The range of set entries of `occupied` (N,), widened by `margin` at both ends."""
    places = np.flatnonzero(occupied)
    return slice(max(int(places[0]) - margin, 0), min(int(places[-1]) + 1 + margin, len(occupied)))


def _windowed_mean(picture: np.ndarray) -> np.ndarray:
    """Gaussian-weighted mean around every pixel of (H, W) or (H, W, C), each channel by itself."""
    from scipy.ndimage import gaussian_filter

    sigma = (SSIM_SIGMA, SSIM_SIGMA, 0.0)[: picture.ndim]
    return gaussian_filter(picture, sigma, truncate=SSIM_RADIUS / SSIM_SIGMA)


def _check_same_shape(first: np.ndarray, second: np.ndarray) -> None:
    if first.shape != second.shape:
        raise ValueError(f"Pictures of one shape are compared; these are {first.shape} and {second.shape}.")
