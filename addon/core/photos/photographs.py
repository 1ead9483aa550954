"""A photograph with its camera, and colors sampled from it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import gaussian_filter

from ..errors import ImageError
from ..geometry.lenses import PhotoCamera
from ..imaging.colors import decode_signed_srgb, encode_signed_srgb
from ..jobs.chunks import slices

CHUNK = 1 << 19  # positions sampled at once
BLUR_PIXELS = 1.0  # of colors that must not depend on details; most of it within the distance that points keep from silhouettes


@dataclass(frozen=True)
class Photograph:
    """A photograph: its camera, and pixels (H, W, 3) uint8 or float32, sRGB-encoded, row 0 at the bottom.

    mask: (H, W) bool, true at usable pixels, or None.
    """

    camera: PhotoCamera
    pixels: np.ndarray
    mask: np.ndarray | None = None

    def check(self) -> None:
        """Check the sizes of pixels and mask.

        Raises:
            ImageError: a size differs from what the camera says.
        """
        width, height = self.camera.lens.size
        for name, values in (("photograph", self.pixels), ("mask", self.mask)):
            if values is not None and values.shape[:2] != (height, width):
                raise ImageError(
                    f'The {name} "{self.camera.name}" has {values.shape[1]} x {values.shape[0]} pixels, but its camera {width} x {height}; '
                    "use the images that the cameras were computed from, without cropping or scaling."
                )

    def sample(self, positions: np.ndarray) -> np.ndarray:
        """Return the encoded colors (N, 3) float32 at `positions` (N, 2) in pixels, by bilinear interpolation."""
        return _sample(self.pixels, positions)

    def sample_smooth(self, positions: np.ndarray) -> np.ndarray:
        """Return the encoded colors (N, 3) float32 of the blurred photograph at `positions` (N, 2) in pixels."""
        return _sample(self._blurred, positions)

    @cached_property
    def _blurred(self) -> np.ndarray:
        blurred = gaussian_filter(self.pixels.astype(np.float32), (BLUR_PIXELS, BLUR_PIXELS, 0.0))
        return np.rint(blurred).astype(np.uint8) if self.pixels.dtype == np.uint8 else blurred


def apply_gain(encoded: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Return encoded colors (N, 3) whose linear values are multiplied by `gain` (3,)."""
    return encode_signed_srgb(decode_signed_srgb(encoded) * gain.astype(np.float32))


def _sample(pixels: np.ndarray, positions: np.ndarray) -> np.ndarray:
    height, width = pixels.shape[:2]
    flat = pixels.reshape(-1, pixels.shape[2])
    result = np.empty((len(positions), 3), np.float32)
    for part in slices(len(positions), CHUNK):
        x, y = (positions[part] - 0.5).T
        x, y = np.clip(x, 0.0, width - 1.0), np.clip(y, 0.0, height - 1.0)
        left, low = np.minimum(x.astype(np.int64), max(width - 2, 0)), np.minimum(y.astype(np.int64), max(height - 2, 0))
        across, up = (x - left).astype(np.float32)[:, None], (y - low).astype(np.float32)[:, None]
        corner, right, above = low * width + left, min(1, width - 1), min(1, height - 1) * width
        lower = (1.0 - across) * flat[corner] + across * flat[corner + right]
        upper = (1.0 - across) * flat[corner + above] + across * flat[corner + above + right]
        result[part] = (1.0 - up) * lower + up * upper
    return result / np.float32(255.0) if pixels.dtype == np.uint8 else result
