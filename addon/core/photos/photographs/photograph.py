"""A photograph with its camera, and colors sampled from it."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import gaussian_filter

from ...errors import ImageError
from ...files.scratch import Scratch
from ...geometry.lenses import PhotoCamera
from ...imaging.colors import decode_signed_srgb, encode_signed_srgb
from ...imaging.images import sample_bilinear
from ...jobs.chunks import slices

CHUNK = 1 << 18  # positions sampled at once
BLUR_PIXELS = 1.0  # Colors that must not depend on details are blurred this much, which is less than points keep away from silhouettes.
CURVE_SIZE = 4096  # entries of the tables that apply gains


@dataclass(frozen=True)
class Photograph:
    """A photograph with its camera.

    Attributes:
        camera: how it shows the world.
        pixels: (H, W, 3) uint8 or float32, sRGB-encoded, row 0 at the bottom.
        mask: (H, W) bool, true at usable pixels, or None.
        displacements: (h, w, 2) float32 in pixels for cells that divide the photograph evenly, or None: what belongs to a position is
            found at this distance from it.
    """

    camera: PhotoCamera
    pixels: np.ndarray
    mask: np.ndarray | None = None
    displacements: np.ndarray | None = None

    @property
    def white(self) -> float:
        """The value of pixels for an encoded 1."""
        return 255.0 if self.pixels.dtype == np.uint8 else 1.0

    def shrink(self, max_side: int) -> tuple[np.ndarray, tuple[slice, slice]]:
        """Return a picture (h, w, 3) float32 of pixels at equal distances, with at most `max_side` pixels along its longer side, and the
        index of these pixels."""
        step = max(1, -(-max(self.pixels.shape[:2]) // max_side))
        area = (slice(step // 2, None, step),) * 2
        return self.pixels[area].astype(np.float32) / np.float32(self.white), area

    def check(self) -> None:
        """Check the sizes of pixels and mask. Raises ImageError if a size differs from what the camera says."""
        width, height = self.camera.lens.size
        for name, values in (("photograph", self.pixels), ("mask", self.mask)):
            if values is not None and values.shape[:2] != (height, width):
                raise ImageError(
                    f'The {name} "{self.camera.name}" has {values.shape[1]} x {values.shape[0]} pixels, but its camera {width} x {height}; '
                    "use the images that the cameras were computed from, without cropping or scaling."
                )

    def keep_in(self, scratch: Scratch, group: int) -> "Photograph":
        """Return the photograph with pixels and mask that `scratch` keeps."""
        mask = None if self.mask is None else scratch.keep(self.mask, group)
        return replace(self, pixels=scratch.keep(self.pixels, group), mask=mask)

    def pack_in(self, scratch: Scratch, group: int) -> "Photograph":
        """Return the photograph with a copy of its pixels in `scratch` from which `sample` is fast."""
        result = replace(self)
        if self.pixels.dtype == np.uint8:
            result.__dict__["_packed"] = scratch.keep(result._packed, group)
        return result

    def displace(self, displacements: np.ndarray) -> "Photograph":
        """Return the photograph with other displacements."""
        result = replace(self, displacements=displacements)
        if "_packed" in self.__dict__:
            result.__dict__["_packed"] = self._packed
        return result

    def sample(self, positions: np.ndarray) -> np.ndarray:
        """Return the encoded colors (N, 3) float32 that belong to `positions` (N, 2) in pixels, by bilinear interpolation."""
        positions = shift_positions(positions, self.displacements, self.camera.lens.size)
        height, width = self.pixels.shape[:2]
        result = np.empty((len(positions), 3), np.float32)
        for part in slices(len(positions), CHUNK):
            x, y = (np.clip(positions[part, axis] - 0.5, 0.0, length - 1.0) for axis, length in ((0, width), (1, height)))
            left, low = np.minimum(x.astype(np.int64), max(width - 2, 0)), np.minimum(y.astype(np.int64), max(height - 2, 0))
            across, up = (x - left).astype(np.float32)[:, None], (y - low).astype(np.float32)[:, None]
            corner, right, above = low * width + left, min(1, width - 1), min(1, height - 1) * width
            lower = self._gather(corner)
            lower += across * (self._gather(corner + right) - lower)
            upper = self._gather(corner + above)
            upper += across * (self._gather(corner + (above + right)) - upper)
            result[part] = (lower + up * (upper - lower))[:, :3]
        return result / np.float32(self.white)

    def smoothed(self) -> "Photograph":
        """Return the photograph without its finest details."""
        blurred = gaussian_filter(self.pixels.astype(np.float32), (BLUR_PIXELS, BLUR_PIXELS, 0.0))
        return replace(self, pixels=np.rint(blurred).astype(np.uint8) if self.pixels.dtype == np.uint8 else blurred)

    def _gather(self, indices: np.ndarray) -> np.ndarray:
        """Return the pixels (N, 3 or 4) float32 at flat `indices` (N,)."""
        if self.pixels.dtype == np.uint8:
            return np.take(self._packed, indices).view(np.uint8).reshape(-1, 4).astype(np.float32)
        return np.take(self.pixels.reshape(-1, 3), indices, axis=0)

    @cached_property
    def _packed(self) -> np.ndarray:
        """(H * W,) uint32: four bytes per pixel, which are gathered at once."""
        padded = np.zeros((*self.pixels.shape[:2], 4), np.uint8)
        padded[..., :3] = self.pixels
        return padded.reshape(-1).view(np.uint32)


def shift_positions(positions: np.ndarray, displacements: np.ndarray | None, size: tuple[int, int]) -> np.ndarray:
    """Return `positions` (N, 2) in a photograph of `size` after the `displacements` (h, w, 2) of its cells, if there are any."""
    if displacements is None:
        return positions
    return positions + sample_bilinear(displacements, positions / np.array(size, np.float32) * np.float32(displacements.shape[1::-1]))


def apply_gain(encoded: np.ndarray, gain: np.ndarray, gamma: float = 1.0) -> np.ndarray:
    """Return encoded colors (N, 3) float32 whose linear values are raised to the power `gamma` and multiplied by `gain` (3,), to within
    1e-3."""
    curves = _expose(np.linspace(0.0, 1.0, CURVE_SIZE)[:, None], gain, gamma).astype(np.float32)
    indices = np.clip(encoded, 0.0, 1.0) * np.float32(CURVE_SIZE - 1) + np.float32(0.5)
    result = np.stack([np.take(curves[:, channel], indices[:, channel].astype(np.int16)) for channel in range(3)], axis=1)
    if encoded.min(initial=0.0) < 0.0 or encoded.max(initial=1.0) > 1.0:
        outside = np.flatnonzero(((encoded < 0.0) | (encoded > 1.0)).any(axis=1))
        result[outside] = _expose(encoded[outside], gain, gamma)
    return result


def _expose(encoded: np.ndarray, gain: np.ndarray, gamma: float) -> np.ndarray:
    linear = decode_signed_srgb(encoded)
    if gamma != 1.0:
        linear = np.copysign(np.abs(linear) ** gamma, linear)
    return encode_signed_srgb(linear * gain)
