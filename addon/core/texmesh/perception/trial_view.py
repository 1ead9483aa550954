"""How two objects are placed side by side in front of a viewer, so that they look as from any distance but nothing hides them."""

import math
from dataclasses import dataclass

import numpy as np

from ...errors import SettingsError
from ...geometry.cameras import Camera

TILT = math.radians(15.0)  # towards the viewer, so that the top is seen
DEPTH = 10.0  # Depth of the objects, in distances of the near clipping plane.
MIN_DISTANCE = 2.0  # Distance of the viewer from the center, in radii.
SIDE = 0.125  # Distance of the objects from the middle, relative to the width, so that a sidebar hides neither.
MAX_FILLED = 0.9  # An object fills at most this fraction of twice that distance, or of the height.


@dataclass(frozen=True)
class TrialView:
    """A perspective viewer and two objects with the same center and radius.

    Attributes:
        camera: the viewer.
        aspect: width divided by height of the image.
        near: distance of the near clipping plane.
        center: (3,), object space.
        radius: of a sphere around the center that contains both, object units.
        pixels_per_degree: of the display that distances are meant for.
    """

    camera: Camera
    aspect: float
    near: float
    center: np.ndarray
    radius: float
    pixels_per_degree: float

    @property
    def nearest(self) -> float:
        """The smallest distance, in object units for the display, at which the objects fit next to each other into the image."""
        half_width = self.camera.pixels * min(SIDE, 0.5 / self.aspect) * MAX_FILLED
        fitting = self.radius / half_width / self._pixel_growth
        close = MIN_DISTANCE * self.radius * self.camera.pixel_size(1.0) / self._pixel_growth
        return max(fitting, close)

    @property
    def _pixel_growth(self) -> float:
        """Size of a pixel of the display per unit of distance."""
        return math.tan(math.radians(1.0 / self.pixels_per_degree))

    def object_matrix(self, distance: float, angle: float, side: int) -> np.ndarray:
        """Return the matrix (4, 4) from object space to camera space of an object seen from a distance, turned by `angle` in radians.

        It covers as many pixels as at that distance on the display. It is near the viewer and small, so that nothing hides it. side: -1 for
        the left half of the image, 1 for the right half.

        Raises:
            SettingsError: the viewer is orthographic.
        """
        if not self.camera.field_of_view:
            raise SettingsError("The 3D Viewport must show a perspective view; press Numpad 5.")
        depth = DEPTH * self.near
        pixel = self.camera.pixel_size(depth)
        scale = pixel / (distance * self._pixel_growth)
        cosine, sine = math.cos(angle), math.sin(angle)
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        cosine, sine = math.cos(TILT), math.sin(TILT)
        upright = np.array([[1.0, 0.0, 0.0], [0.0, sine, cosine], [0.0, -cosine, sine]])  # z up, seen slightly from above
        matrix = np.eye(4)
        matrix[:3, :3] = scale * upright @ turn
        position = np.array([SIDE * side * self.camera.pixels * pixel, 0.0, -depth])
        matrix[:3, 3] = position - matrix[:3, :3] @ self.center
        return matrix
