"""Viewers of a terrain: where a camera is, what it sees, and how many pixels a length covers.

Camera space is that of Blender and OpenGL: x to the right, y up, and the camera looks along -z. The depth of a position is -z.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from ..errors import SettingsError
from .transforms import is_invertible

Kind = Literal["perspective", "orthographic", "panoramic"]
MIN_HORIZONTAL = 1e-9  # A smaller horizontal part of a camera's direction does not tell where its right is.
FULL_SPHERE = (-math.pi, math.pi, -0.5 * math.pi, 0.5 * math.pi)  # radians


@dataclass(frozen=True)
class Projection:
    """How camera space is mapped to an image.

    Attributes:
        kind: perspective, orthographic or panoramic.
        window: left, right, bottom and top border of the image: at depth 1 if perspective, in camera-space units if orthographic, and as
            angles in radians if panoramic.
        size: width and height of the image in pixels.
        near, far: range of depths that are visible.
    """

    kind: Kind
    window: tuple[float, float, float, float]
    size: tuple[int, int]
    near: float
    far: float

    @property
    def pixel_densities(self) -> tuple[float, float]:
        """Horizontal and vertical pixels per unit of `window`."""
        left, right, bottom, top = self.window
        return self.size[0] / (right - left), self.size[1] / (top - bottom)

    @property
    def field_of_view(self) -> tuple[float, float]:
        """Horizontal and vertical angle in radians between the borders of the image; 0 if orthographic."""
        left, right, bottom, top = self.window
        if self.kind == "orthographic":
            return 0.0, 0.0
        if self.kind == "panoramic":
            return right - left, top - bottom
        return math.atan(right) - math.atan(left), math.atan(top) - math.atan(bottom)

    @property
    def matrix(self) -> np.ndarray:
        """The matrix (4, 4) float64 from camera space to clip space, where -w..w is visible along every axis, as in OpenGL.

        Raises:
            SettingsError: the projection is panoramic.
        """
        if self.kind == "panoramic":
            raise SettingsError("A panoramic projection has no matrix; choose a perspective or an orthographic camera.")
        left, right, bottom, top = self.window
        width, height, depth = right - left, top - bottom, self.far - self.near
        if self.kind == "orthographic":
            return np.array(
                [
                    [2.0 / width, 0.0, 0.0, -(right + left) / width],
                    [0.0, 2.0 / height, 0.0, -(top + bottom) / height],
                    [0.0, 0.0, -2.0 / depth, -(self.far + self.near) / depth],
                    [0.0, 0.0, 0.0, 1.0],
                ]
            )
        return np.array(
            [
                [2.0 / width, 0.0, (right + left) / width, 0.0],
                [0.0, 2.0 / height, (top + bottom) / height, 0.0],
                [0.0, 0.0, -(self.far + self.near) / depth, -2.0 * self.far * self.near / depth],
                [0.0, 0.0, -1.0, 0.0],
            ]
        )

    @property
    def planes(self) -> np.ndarray:
        """The planes of the frustum in camera space, as in `Viewer.frustum_planes`, not normalized."""
        left, right, bottom, top = self.window
        depths = [[0.0, 0.0, -1.0, -self.near], [0.0, 0.0, 1.0, self.far]]
        if self.kind == "panoramic":
            return np.empty((0, 4))
        if self.kind == "orthographic":
            return np.array([[1.0, 0.0, 0.0, -left], [-1.0, 0.0, 0.0, right], [0.0, 1.0, 0.0, -bottom], [0.0, -1.0, 0.0, top], *depths])
        return np.array([[1.0, 0.0, left, 0.0], [-1.0, 0.0, -right, 0.0], [0.0, 1.0, bottom, 0.0], [0.0, -1.0, -top, 0.0], *depths])


def projection_from_matrix(matrix: np.ndarray, size: tuple[int, int], near: float, far: float) -> Projection:
    """Return the projection of a `matrix` (4, 4) like `Projection.matrix`.

    near, far: for a perspective matrix, from which `far` cannot be computed accurately. An orthographic matrix contains both.
    """
    is_orthographic = matrix[3, 3] != 0.0
    column, sign = (3, -1.0) if is_orthographic else (2, 1.0)
    left, right = (float((sign * matrix[0, column] + side) / matrix[0, 0]) for side in (-1.0, 1.0))
    bottom, top = (float((sign * matrix[1, column] + side) / matrix[1, 1]) for side in (-1.0, 1.0))
    if is_orthographic:
        near, far = (float((side + matrix[2, 3]) / matrix[2, 2]) for side in (1.0, -1.0))
    return Projection("orthographic" if is_orthographic else "perspective", (left, right, bottom, top), size, near, far)


def look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the matrix (4, 4) float64 of a camera at `position` (3,) that looks at `target` (3,), with z upwards in the image, or with y
    upwards if it looks straight down or up.

    Raises:
        SettingsError: both are the same position, or not finite.
    """
    direction = np.asarray(position, np.float64) - target
    length = np.linalg.norm(direction)
    if not 0.0 < length < np.inf:
        raise SettingsError("The camera must look at another position than its own; choose two different finite positions.")
    direction /= length
    is_vertical = np.hypot(direction[0], direction[1]) < MIN_HORIZONTAL
    right = np.cross([0.0, 1.0, 0.0] if is_vertical else [0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([right, np.cross(direction, right), direction, position])
    return matrix


def camera_window(
    extent: float, spans_width: bool, shift: tuple[float, float], size: tuple[int, int], pixel_aspect: tuple[float, float] = (1.0, 1.0)
) -> tuple[float, float, float, float]:
    """Return the `Projection.window` of a Blender camera.

    Args:
        extent: sensor size divided by focal length if perspective, orthographic scale otherwise.
        spans_width: whether `extent` is the width of the image; otherwise its height.
        shift: shift of the lens, as fractions of `extent`.
        size: width and height of the image in pixels.
        pixel_aspect: width and height of a pixel, in any unit.
    """
    width, height = size[0] * pixel_aspect[0], size[1] * pixel_aspect[1]
    unit = extent / (width if spans_width else height)
    x, y = shift[0] * extent, shift[1] * extent
    return x - 0.5 * width * unit, x + 0.5 * width * unit, y - 0.5 * height * unit, y + 0.5 * height * unit


@dataclass(frozen=True, eq=False)
class Viewer:
    """A camera that looks at a terrain.

    matrix: (4, 4) float64, camera space to the space of the terrain (or of the world). Any affine matrix; terrains may be scaled.
    is_interactive: whether it is a 3D Viewport in use, where terrain outside of the image may be coarse. Renders need it for shadows and
    reflections.
    """

    matrix: np.ndarray
    projection: Projection
    is_interactive: bool = False

    @property
    def position(self) -> np.ndarray:
        """Position (3,) float64 of the camera."""
        return self.matrix[:3, 3]

    @cached_property
    def inverse(self) -> np.ndarray:
        """The matrix (4, 4) float64 to camera space. Raises SettingsError if there is none."""
        if not is_invertible(self.matrix):
            raise SettingsError("The camera or the terrain has a scale of 0, or a transform that is not finite; clear it.")
        linear = np.linalg.inv(self.matrix[:3, :3])
        inverse = np.eye(4)
        inverse[:3, :3], inverse[:3, 3] = linear, -linear @ self.position
        return inverse

    @cached_property
    def scale_range(self) -> tuple[float, float]:
        """Lengths in camera space of the shortest and of the longest unit vector: 1 and 1 unless the terrain is scaled."""
        scales = np.linalg.svd(self.inverse[:3, :3], compute_uv=False)
        return float(scales[-1]), float(scales[0])

    def transform(self, matrix: np.ndarray, translation: np.ndarray | None = None) -> "Viewer":
        """Return the same viewer in another space.

        matrix: (4, 4), to the other space. translation: (3,) float64, added afterwards, such as the origin of a terrain.
        """
        transformed = np.asarray(matrix, np.float64) @ self.matrix
        if translation is not None:
            transformed[:3, 3] += translation
        return replace(self, matrix=transformed)

    def is_same(self, other: "Viewer | None") -> bool:
        """Return whether another viewer sees exactly the same."""
        return other is not None and self.projection == other.projection and np.array_equal(self.matrix, other.matrix)

    def frustum_planes(self, margin: float = 0.0) -> np.ndarray:
        """Return the planes (6, 4) float64 of the frustum: left, right, bottom, top, near, far. (0, 4) if panoramic: nothing is outside.

        Row (a, b, c, d) is the distance a x + b y + c z + d of a position to the plane, which is positive inside.

        margin: by which the image is larger on every side, as a fraction of its size.
        """
        left, right, bottom, top = self.projection.window
        x, y = margin * (right - left), margin * (top - bottom)
        window = (left - x, right + x, bottom - y, top + y)
        planes = replace(self.projection, window=window).planes @ self.inverse
        return planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)

    def project(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project `positions` (N, 3): return x and y (N, 2) in pixels from the lower left corner of the image, and depths (N,).

        Pixels of positions whose depth is not positive are meaningless if the projection is perspective.

        Raises:
            SettingsError: the projection is panoramic.
        """
        if self.projection.kind == "panoramic":
            raise SettingsError("Positions cannot be projected to the pixels of a panorama; choose another camera.")
        points = self._to_camera(positions)
        left, _, bottom, _ = self.projection.window
        depths = -points[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = points[:, :2] / depths[:, None] if self.projection.kind == "perspective" else points[:, :2]
        return (plane - [left, bottom]) * self.projection.pixel_densities, depths

    def pixels_per_unit_at(self, distances: np.ndarray) -> np.ndarray:
        """Return the pixels that a unit of length covers at `distances` (any shape) from the camera, for all directions alike.

        Perspective images stretch lengths further towards their borders. Infinite at distance 0 unless orthographic.
        """
        density, (shortest, longest) = max(self.projection.pixel_densities), self.scale_range
        if self.projection.kind == "orthographic":
            return np.full(np.shape(distances), density * longest)
        with np.errstate(divide="ignore"):
            return density * longest / (shortest * np.asarray(distances, np.float64))

    def _to_camera(self, positions: np.ndarray) -> np.ndarray:
        return (np.asarray(positions, np.float64) - self.position) @ self.inverse[:3, :3].T
