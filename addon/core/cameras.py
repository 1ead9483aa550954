"""What a camera can tell apart: pixel sizes, projected errors, and the distances from which a level looks like the original."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .errors import SettingsError


@dataclass(frozen=True)
class Camera:
    """A view, as far as levels of detail need it.

    position: (3,) float64, world space. pixels: pixels along the side of the picture that `field_of_view` spans.
    field_of_view: angle across that side in radians, or 0 for an orthographic camera; then `orthographic_scale` is the length of
    that side in scene units.
    """

    position: np.ndarray
    pixels: int
    field_of_view: float
    orthographic_scale: float = 0.0

    def pixel_size(self, distance: float) -> float:
        """Side of one pixel in scene units at `distance` from the camera."""
        if self.field_of_view == 0.0:
            return self.orthographic_scale / self.pixels
        return pixel_size_at(distance, self.field_of_view, self.pixels)

    def switch_distance(self, error: float) -> float:
        """Distance from which a length `error` shows as at most one pixel; an orthographic camera gives 0 (always) or inf (never)."""
        if self.field_of_view == 0.0:
            return 0.0 if error <= self.pixel_size(0.0) else math.inf
        return switch_distance(error, self.field_of_view, self.pixels)


def pixel_size_at(distance: float, field_of_view: float, pixels: int) -> float:
    """Side of one pixel in scene units at `distance`, for `pixels` across an angle `field_of_view` in radians.

    Raises:
        SettingsError: when the angle is not between 0 and 180 degrees or there are no pixels.
    """
    if not 0.0 < field_of_view < math.pi or pixels < 1:
        raise SettingsError(
            f"A camera needs pixels and an angle between 0 and 180 degrees, not {pixels} and {math.degrees(field_of_view):g}."
        )
    return distance * 2.0 * math.tan(0.5 * field_of_view) / pixels


def switch_distance(error: float, field_of_view: float, pixels: int) -> float:
    """The distance at which a length `error` is one pixel: the inverse of `pixel_size_at`."""
    return error / pixel_size_at(1.0, field_of_view, pixels)


def faded_share(pixel: np.ndarray | float, error: float, span: float) -> np.ndarray | float:
    """How far a cross-fade to a coarser level has come, 0..1, where a pixel is `pixel` long: it begins where the coarser level's `error`
    shows as one pixel and ends where a pixel is longer by the share `span`."""
    return np.clip((pixel - error) / (span * error), 0.0, 1.0)


def distance_to_box(position: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Distance of `position` (3,) to the axis-aligned box from `low` (3,) to `high` (3,); 0 inside."""
    return float(np.linalg.norm(np.maximum(np.maximum(low - position, position - high), 0.0)))


def choose_level(errors: Sequence[float], distance: float, camera: Camera, pixels: float = 1.0) -> int | None:
    """Index of the coarsest level whose error, seen from `distance`, shows as at most `pixels` pixels.

    `errors` are lengths in scene units, in any order. None when even the finest is larger: then the original has to be shown.
    """
    allowed = pixels * camera.pixel_size(distance)
    fitting = [index for index, error in enumerate(errors) if error <= allowed]
    return max(fitting, key=lambda index: errors[index]) if fitting else None
