"""What the images of a camera show of levels by distance, as geometry nodes choose them, and the error that a budget needs.

A place of an asset is seen with pixels of a range of sizes: those at its nearest and at its farthest point, in units of the asset.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry.cameras import Camera
from ..geometry.transforms import mean_scale

MARGIN = 0.1  # Radians around the image, for motion blur and shifted lenses.
UNSEEN_FACTOR = 4.0  # Of the size of a pixel where the camera does not see: shadows are soft, but those of the coarsest level are spots.
UNSEEN_EXCESS = 1.001  # Of that size above the one from which the first level after the original shows, at least.
MAX_ERROR = 16.0  # Pixels.
STEPS, RENDER_STEPS = 24, 3  # Of the bisection for a budget, and for one of seconds, where each is a render.


@dataclass(frozen=True)
class Places:
    """Where an asset is.

    Attributes:
        matrices: (N, 4, 4), from the space of the asset to the world.
        low: lowest corner (3,) of its bounding box.
        high: highest corner (3,) of its bounding box.
    """

    matrices: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @cached_property
    def centers(self) -> np.ndarray:
        """Centers (N, 3) of the bounding boxes in world space."""
        return self.matrices[:, :3, :3] @ (0.5 * (self.low + self.high)) + self.matrices[:, :3, 3]

    @cached_property
    def axes(self) -> np.ndarray:
        """Lengths (N, 3) of the axes of the asset in world space."""
        return np.linalg.norm(self.matrices[:, :3, :3], axis=1)

    @cached_property
    def radii(self) -> np.ndarray:
        """Radii (N,) of the bounding spheres in world space."""
        return 0.5 * float(np.linalg.norm(self.high - self.low)) * self.axes.max(axis=1)

    @cached_property
    def scales(self) -> np.ndarray:
        """Length (N,) in world space of a unit of the asset."""
        return mean_scale(self.matrices)

    def distances_to(self, position: np.ndarray) -> np.ndarray:
        """Return the distances (N,) of a position (3,) in world space from the bounding boxes."""
        directions = self.matrices[:, :3, :3] / np.maximum(self.axes, 1e-20)[:, None]
        local_offsets = np.abs(np.einsum("nij,ni->nj", directions, position - self.centers))
        return np.linalg.norm(np.maximum(local_offsets - 0.5 * (self.high - self.low) * self.axes, 0.0), axis=1)


@dataclass(frozen=True)
class View:
    """A camera at one frame.

    camera: its position, lens and pixels. direction: (3,) in which it looks. diagonal: tangent of the angle between the direction and the
    corners of the image, infinite where everything may be seen.
    """

    camera: Camera
    direction: np.ndarray
    diagonal: float = math.inf

    def measure(self, places: Places) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the sizes (N,) of a pixel at the nearest point of the bounding box and at the farthest of the bounding sphere of each
        place, in units of the asset, and whether (N,) each may be seen."""
        offsets = places.centers - self.camera.position
        distances = np.linalg.norm(offsets, axis=1)
        safe = np.maximum(distances, 1e-20)
        angles = np.arccos(np.clip(offsets @ self.direction / safe, -1.0, 1.0))
        halves = np.arcsin(np.minimum(places.radii / safe, 1.0))
        is_seen = (angles < math.atan(self.diagonal) + halves + MARGIN) | (distances < places.radii) | math.isinf(self.diagonal)
        ends = (places.distances_to(self.camera.position), distances + places.radii)
        nearest, farthest = (self._pixel_sizes(at) / np.maximum(places.scales, 1e-20) for at in ends)
        return nearest, farthest, is_seen

    def extents(self, places: Places) -> np.ndarray:
        """Return the diameters (N,) of the bounding spheres in the image, in pixels."""
        distances = np.linalg.norm(places.centers - self.camera.position, axis=1)
        return 2.0 * places.radii / np.maximum(self._pixel_sizes(distances), 1e-20)

    def _pixel_sizes(self, distances: np.ndarray) -> np.ndarray:
        growth = self.camera.pixel_size(1.0) if self.camera.field_of_view else 0.0
        return distances * growth + self.camera.pixel_size(0.0)


@dataclass(frozen=True)
class PlacedLevels:
    """The levels of an asset, finest first, and the places that show them.

    Attributes:
        pixel_sizes: (L,) from which each shows, where it may leave out one pixel.
        triangles: (L,) numbers.
        error_factor: by which the allowed error of the asset differs from that of others.
        nearest: (F, N) size of a pixel at the nearest point of each place, for each frame, see `View.measure`.
        farthest: (F, N) the same at the farthest point.
        is_seen: (F, N) bool, whether the frame may show the place.
    """

    pixel_sizes: np.ndarray
    triangles: np.ndarray
    error_factor: float
    nearest: np.ndarray
    farthest: np.ndarray
    is_seen: np.ndarray

    def count_shown(self, max_error: float, fade_range: float) -> np.ndarray:
        """Return how many places (F, L) render each level in each frame. Within the fade range, a place renders two."""
        error = max_error * self.error_factor
        near, far = (error * sizes for sizes in (self.nearest, self.farthest))
        if len(self.pixel_sizes) > 1:
            near = np.where(self.is_seen, near, np.maximum(UNSEEN_FACTOR * near, UNSEEN_EXCESS * self.pixel_sizes[1]))
        ranges = np.where(self.is_seen, fade_range, 0.0)[:, :, None]
        near, far = near[:, :, None], far[:, :, None]
        ends = np.append(self.pixel_sizes[1:], np.inf)
        begins = self.pixel_sizes < np.where(ranges > 0.0, far, near)
        begins[..., 0] = True
        return (begins & ~(ends * (1.0 + ranges) < near)).sum(axis=1)


@dataclass(frozen=True)
class Forecast:
    """counts: (F, L) places that render each level, for each asset. triangles: (F,) of all in each frame."""

    counts: list[np.ndarray]
    triangles: np.ndarray


def forecast(placed: Sequence[PlacedLevels], max_error: float, fade_range: float) -> Forecast:
    """Return what the frames show where levels may leave out `max_error` pixels."""
    counts = [levels.count_shown(max_error, fade_range) for levels in placed]
    return Forecast(counts, sum((count @ levels.triangles for count, levels in zip(counts, placed, strict=True)), np.zeros(1, np.int64)))


def find_error(fits: Callable[[float], bool], min_error: float, steps: int = STEPS) -> float | None:
    """Return the smallest error in pixels, at least `min_error`, with which a budget is kept, after so many steps of bisection; None if not
    even `MAX_ERROR` does."""
    if fits(min_error):
        return min_error
    low, high = min_error, MAX_ERROR
    if high <= low or not fits(high):
        return None
    for _ in range(steps):
        error = math.sqrt(low * high)
        low, high = (low, error) if fits(error) else (error, high)
    return high


def predict_seconds(seconds: float, tried: int, samples: int, overhead: float) -> float:
    """Return how long a render with `samples` samples takes of which one with `tried` samples took `seconds`, of which `overhead` does not
    depend on samples."""
    return overhead + max(seconds - overhead, 0.0) * samples / tried


def measure_overhead(single: float, seconds: float, tried: int) -> float:
    """Return the seconds of a render that do not depend on the number of samples, from one with a single sample and one with `tried`."""
    return min(max((tried * single - seconds) / (tried - 1), 0.0), single) if tried > 1 else 0.0
