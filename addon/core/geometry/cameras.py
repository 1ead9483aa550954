"""Cameras: pixel sizes, projected errors, switch distances of levels of detail, orthographic views."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import SettingsError


@dataclass(frozen=True)
class Camera:
    """A camera reduced to the values that levels of detail need.

    position: (3,) float64, world space. pixels: pixels along the side of the image that `field_of_view` spans.
    field_of_view: angle across that side in radians, or 0 for an orthographic camera; then `orthographic_scale` is the length of
    that side in scene units.
    """

    position: np.ndarray
    pixels: int
    field_of_view: float
    orthographic_scale: float = 0.0

    def pixel_size(self, distance: float) -> float:
        """Return the side of one pixel in scene units at `distance` from the camera."""
        if self.field_of_view == 0.0:
            return self.orthographic_scale / self.pixels
        return pixel_size_at(distance, self.field_of_view, self.pixels)

    def switch_distance(self, error: float) -> float:
        """Return the distance from which a length `error` covers at most one pixel; 0 (always) or inf (never) if orthographic."""
        if self.field_of_view == 0.0:
            return 0.0 if error <= self.pixel_size(0.0) else math.inf
        return switch_distance(error, self.field_of_view, self.pixels)


def pixel_size_at(distance: float, field_of_view: float, pixels: int) -> float:
    """Return the side of one pixel in scene units at `distance`, for `pixels` across an angle `field_of_view` in radians.

    Raises:
        SettingsError: the angle is not between 0 and 180 degrees, or there are no pixels.
    """
    if not 0.0 < field_of_view < math.pi or pixels < 1:
        raise SettingsError(
            f"A camera needs pixels and an angle between 0 and 180 degrees, not {pixels} and {math.degrees(field_of_view):g}."
        )
    return distance * 2.0 * math.tan(0.5 * field_of_view) / pixels


def switch_distance(error: float, field_of_view: float, pixels: int) -> float:
    """Return the distance at which a length `error` covers one pixel: the inverse of `pixel_size_at`."""
    return error / pixel_size_at(1.0, field_of_view, pixels)


def distance_to_box(position: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Return the distance of `position` (3,) to the axis-aligned box from `low` (3,) to `high` (3,); 0 inside."""
    return float(np.linalg.norm(np.maximum(np.maximum(low - position, position - high), 0.0)))


def choose_level(errors: Sequence[float], distance: float, camera: Camera, pixels: float = 1.0) -> int | None:
    """Return the index of the coarsest level whose error covers at most `pixels` pixels at `distance`.

    `errors` are lengths in scene units, in any order. None when even the smallest is too large: then the source has to be shown.
    """
    max_error = pixels * camera.pixel_size(distance)
    allowed = [index for index, error in enumerate(errors) if error <= max_error]
    return max(allowed, key=lambda index: errors[index]) if allowed else None


@dataclass(frozen=True)
class OrthographicView:
    """A square orthographic image seen from `direction` (3,), a unit vector towards the viewer, and centered at `center` (3,).

    resolution: pixels per side. pixel_size: side of one pixel in scene units.
    """

    direction: np.ndarray
    center: np.ndarray
    resolution: int
    pixel_size: float

    @cached_property
    def right(self) -> np.ndarray:
        """The x axis of the image (3,); the world's x axis for a view from directly above or below."""
        horizontal = np.cross([0.0, 0.0, 1.0], self.direction)
        length = np.linalg.norm(horizontal)
        return horizontal / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])

    @cached_property
    def up(self) -> np.ndarray:
        """The y axis of the image (3,)."""
        return np.cross(self.direction, self.right)

    def supersample(self, factor: int) -> "OrthographicView":
        """Return the same view with `factor` times the pixels per side."""
        return OrthographicView(self.direction, self.center, self.resolution * factor, self.pixel_size / factor)

    def project(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project `positions` (N, 3): return x and y (N, 2) in pixels from the lower left corner of the image, and heights (N,) above the
        center towards the viewer."""
        offsets = positions - self.center
        axes = np.stack([self.right, self.up], axis=1)
        return offsets @ axes / self.pixel_size + 0.5 * self.resolution, offsets @ self.direction


@dataclass(frozen=True)
class CameraProjection:
    """The projection of a camera.

    projection: (4, 4), world to clip space, where -w..w is visible along every axis. size: width and height of the image in pixels.
    """

    projection: np.ndarray
    size: tuple[int, int]
