"""Cameras of photographs, with lenses that distort.

Camera space is that of computer vision: x to the right, y down, z forward. A lens maps tangents (u, v) = (x, y) / z to distorted ones, and
these to pixels by focal lengths and a center. The models and the order of their coefficients are those of COLMAP, whose package pycolmap
would add 38 MB to the zip of every platform.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ..errors import FileError

ITERATIONS = 50
MAX_RESIDUAL = 1e-12  # Difference of tangents at which the inverse has converged.
DERIVATIVE_STEP = 1e-6
RADII = np.tan(np.linspace(0.0, 0.5 * np.pi, 4097)[:-1])  # Tangents where growth of the distorted radius is checked.
MAX_SIDE = 100_000  # pixels of a photograph
MIN_FOCAL, MAX_FOCAL = 1e-3, 1e5  # relative to the longer side: wider than any fisheye, and longer than any telescope
MAX_CENTER = 100.0  # distance from the upper left corner, relative to the longer side
MAX_COEFFICIENT = 1e12  # those of high powers are large if the field of view is small
MIN_RADIUS = 1e-9  # below, the direction of a tangent does not matter

Distortion = Callable[[np.ndarray, np.ndarray, tuple[float, ...]], tuple[np.ndarray, np.ndarray]]


def _scale_radially(u: np.ndarray, v: np.ndarray, coefficients: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """k1, k2, ...: the radius is multiplied by 1 + k1 r^2 + k2 r^4 + ..."""
    square = u * u + v * v
    factor = np.ones_like(u)
    for index, coefficient in enumerate(coefficients, start=1):
        factor = factor + coefficient * square**index
    return u * factor, v * factor


def _shift_tangentially(u: np.ndarray, v: np.ndarray, p1: float, p2: float) -> tuple[np.ndarray, np.ndarray]:
    square = u * u + v * v
    return 2.0 * p1 * u * v + p2 * (square + 2.0 * u * u), 2.0 * p2 * u * v + p1 * (square + 2.0 * v * v)


def _distort_opencv(u: np.ndarray, v: np.ndarray, coefficients: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """k1, k2, p1, p2."""
    k1, k2, p1, p2 = coefficients
    radial, tangential = _scale_radially(u, v, (k1, k2)), _shift_tangentially(u, v, p1, p2)
    return radial[0] + tangential[0], radial[1] + tangential[1]


def _distort_full_opencv(u: np.ndarray, v: np.ndarray, coefficients: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """k1, k2, p1, p2, k3, k4, k5, k6: a rational factor of the radius."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    square = u * u + v * v
    numerator = 1.0 + square * (k1 + square * (k2 + square * k3))
    denominator = 1.0 + square * (k4 + square * (k5 + square * k6))
    factor = numerator / np.where(np.abs(denominator) > MIN_RADIUS, denominator, MIN_RADIUS)
    tangential = _shift_tangentially(u, v, p1, p2)
    return u * factor + tangential[0], v * factor + tangential[1]


def _distort_metashape(u: np.ndarray, v: np.ndarray, coefficients: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """k1, k2, p1, p2, k3, k4, b: four powers of the radius; the skew b moves rows sideways."""
    k1, k2, p1, p2, k3, k4, skew = coefficients
    radial, tangential = _scale_radially(u, v, (k1, k2, k3, k4)), _shift_tangentially(u, v, p1, p2)
    x, y = radial[0] + tangential[0], radial[1] + tangential[1]
    return x + skew * y, y


def _to_angles(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return tangents scaled so that their length is the angle to the optical axis (equidistant projection)."""
    radius = np.hypot(u, v)
    factor = np.where(radius > MIN_RADIUS, np.arctan(radius) / np.maximum(radius, MIN_RADIUS), 1.0)
    return u * factor, v * factor


def _distort_fisheye(u: np.ndarray, v: np.ndarray, coefficients: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """k1, k2, ...: a radial distortion of angles."""
    return _scale_radially(*_to_angles(u, v), coefficients)


def _distort_thin_prism(u: np.ndarray, v: np.ndarray, coefficients: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """k1, k2, p1, p2, k3, k4, sx1, sy1, of angles."""
    k1, k2, p1, p2, k3, k4, sx1, sy1 = coefficients
    u, v = _to_angles(u, v)
    square = u * u + v * v
    radial, tangential = _scale_radially(u, v, (k1, k2, k3, k4)), _shift_tangentially(u, v, p1, p2)
    return radial[0] + tangential[0] + sx1 * square, radial[1] + tangential[1] + sy1 * square


def _distort_fov(u: np.ndarray, v: np.ndarray, coefficients: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """omega: the field-of-view model of Devernay and Faugeras."""
    (omega,) = coefficients
    if abs(omega) < MIN_RADIUS:
        return u, v
    radius = np.hypot(u, v)
    scale = 2.0 * np.tan(0.5 * omega)
    factor = np.where(radius > MIN_RADIUS, np.arctan(radius * scale) / (np.maximum(radius, MIN_RADIUS) * omega), scale / omega)
    return u * factor, v * factor


def _distort_inversely(u: np.ndarray, v: np.ndarray, coefficients: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """k: the distorted radius d of a tangent with length r solves d (1 + k d^2) = r, by Newton steps; beyond its range it is constant."""
    (k,) = coefficients
    radius = np.hypot(u, v)
    largest = np.sqrt(-1.0 / (3.0 * k)) if k < 0.0 else np.inf
    distorted = (
        np.minimum(radius, np.maximum(radius, 1.0) ** (1.0 / 3.0) / abs(k) ** (1.0 / 3.0)) if k > 0.0 else np.minimum(radius, largest)
    )
    for _ in range(ITERATIONS if k else 0):
        derivative = np.maximum(1.0 + 3.0 * k * distorted**2, MIN_RADIUS)
        distorted = np.clip(distorted - (distorted * (1.0 + k * distorted**2) - radius) / derivative, 0.0, largest)
    factor = np.where(radius > MIN_RADIUS, distorted / np.maximum(radius, MIN_RADIUS), 1.0)
    return u * factor, v * factor


@dataclass(frozen=True)
class LensModel:
    """A model: whether both focal lengths are equal, the number of further coefficients, and the distortion."""

    is_isotropic: bool
    coefficient_count: int
    distort: Distortion


MODELS = {
    "SIMPLE_PINHOLE": LensModel(True, 0, _scale_radially),
    "PINHOLE": LensModel(False, 0, _scale_radially),
    "SIMPLE_RADIAL": LensModel(True, 1, _scale_radially),
    "RADIAL": LensModel(True, 2, _scale_radially),
    "OPENCV": LensModel(False, 4, _distort_opencv),
    "OPENCV_FISHEYE": LensModel(False, 4, _distort_fisheye),
    "FULL_OPENCV": LensModel(False, 8, _distort_full_opencv),
    "FOV": LensModel(False, 1, _distort_fov),
    "SIMPLE_RADIAL_FISHEYE": LensModel(True, 1, _distort_fisheye),
    "RADIAL_FISHEYE": LensModel(True, 2, _distort_fisheye),
    "THIN_PRISM_FISHEYE": LensModel(False, 8, _distort_thin_prism),
    "INVERSE_RADIAL": LensModel(True, 1, _distort_inversely),  # VisualSFM has it, COLMAP does not.
    "METASHAPE": LensModel(False, 7, _distort_metashape),
}


@dataclass(frozen=True)
class Lens:
    """How camera space is projected to the pixels of a photograph.

    Attributes:
        model: one of MODELS.
        size: width and height in pixels.
        focal: (fx, fy) in pixels.
        center: (cx, cy) in pixels from the upper left corner of the image.
        coefficients: those of the model, in the order of COLMAP.
    """

    model: str
    size: tuple[int, int]
    focal: tuple[float, float]
    center: tuple[float, float]
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Check the model.

        Raises:
            FileError: it is unknown or has another number of coefficients, or numbers are not finite or those of no lens.
        """
        if self.model not in MODELS:
            raise FileError(f'The lens model "{self.model}" is unknown; Farfield knows {", ".join(MODELS)}.')
        if len(self.coefficients) != MODELS[self.model].coefficient_count:
            count = MODELS[self.model].coefficient_count
            raise FileError(
                f'The lens model "{self.model}" has {count} coefficients, not {len(self.coefficients)}; export the cameras again.'
            )
        side = max(self.size)
        is_usable = (
            min(self.size) >= 1
            and side <= MAX_SIDE
            and all(MIN_FOCAL * side <= focal <= MAX_FOCAL * side for focal in self.focal)
            and all(abs(center) <= MAX_CENTER * side for center in self.center)
            and all(abs(coefficient) <= MAX_COEFFICIENT for coefficient in self.coefficients)
        )
        if not is_usable:  # no comparison holds for what is not a number
            raise FileError("A lens has no size, no focal length, or numbers that are not finite or too large; export the cameras again.")

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project `points` (N, 3) in camera space.

        Returns:
            positions (N, 2) in pixels from the lower left corner of the image, and whether (N,) bool they are valid: in front of the
            camera, and where the distortion does not fold back.
        """
        depths = points[:, 2]
        is_valid, limit = depths > 0.0, self._radius_limit()
        inverse = 1.0 / (depths if is_valid.all() else np.where(is_valid, depths, 1.0))
        u, v = points[:, 0] * inverse, points[:, 1] * inverse
        if np.isfinite(limit):
            is_valid &= u * u + v * v < limit * limit
        if not is_valid.all():
            u, v = np.where(is_valid, u, 0.0), np.where(is_valid, v, 0.0)
        if self.coefficients:
            u, v = MODELS[self.model].distort(u, v, self.coefficients)
        positions = np.empty((len(points), 2), u.dtype)
        positions[:, 0] = self.focal[0] * u + self.center[0]
        positions[:, 1] = (self.size[1] - self.center[1]) - self.focal[1] * v
        return positions, is_valid

    def unproject(self, positions: np.ndarray) -> np.ndarray:
        """Return the unit directions (N, 3) in camera space of `positions` (N, 2) in pixels from the lower left corner by Newton steps."""
        target = (
            np.stack([positions[:, 0] - self.center[0], self.size[1] - positions[:, 1] - self.center[1]]) / np.array(self.focal)[:, None]
        )
        if not self.coefficients:
            directions = np.stack([*target, np.ones(len(positions))], axis=1)
            return directions / np.sqrt(1.0 + target[0] ** 2 + target[1] ** 2)[:, None]
        limit = min(self._radius_limit(), 1e3)
        distort = MODELS[self.model].distort
        current = target.copy()
        if self.model.endswith("FISHEYE"):  # start at the tangent of the angle
            angle = np.hypot(*target)
            current *= np.tan(np.minimum(angle, 1.5)) / np.maximum(angle, MIN_RADIUS)
        for _ in range(ITERATIONS):
            radius = np.hypot(*current)
            current *= np.minimum(1.0, 0.999 * limit / np.maximum(radius, MIN_RADIUS))
            residual = np.stack(distort(*current, self.coefficients)) - target
            if np.abs(residual).max(initial=0.0) < MAX_RESIDUAL:
                break
            step = DERIVATIVE_STEP * (1.0 + np.hypot(*current))
            along_u = np.stack(distort(current[0] + step, current[1], self.coefficients)) - np.stack(
                distort(current[0] - step, current[1], self.coefficients)
            )
            along_v = np.stack(distort(current[0], current[1] + step, self.coefficients)) - np.stack(
                distort(current[0], current[1] - step, self.coefficients)
            )
            (a, c), (b, d) = along_u / (2.0 * step), along_v / (2.0 * step)
            determinant = a * d - b * c
            determinant = np.where(np.abs(determinant) > 1e-12, determinant, 1e-12)
            current = current - np.stack([d * residual[0] - b * residual[1], a * residual[1] - c * residual[0]]) / determinant
        directions = np.stack([*current, np.ones(len(positions))], axis=1)
        return directions / np.linalg.norm(directions, axis=1, keepdims=True)

    def _radius_limit(self) -> float:
        """Return the length of tangents up to which the distorted radius grows; infinite if it always does."""
        return _find_radius_limit(self.model, self.coefficients)


@lru_cache(maxsize=64)  # fits project with the same lens again and again
def _find_radius_limit(model: str, coefficients: tuple[float, ...]) -> float:
    if model in ("SIMPLE_PINHOLE", "PINHOLE", "FOV"):
        return np.inf
    distorted = np.hypot(*MODELS[model].distort(RADII, np.zeros_like(RADII), coefficients))
    falls = np.flatnonzero(np.diff(distorted) <= 0.0)
    return float(RADII[falls[0]]) if len(falls) else np.inf


@dataclass(frozen=True)
class PhotoCamera:
    """The camera of a photograph.

    name: the file name of the photograph, possibly with folders. rotation: (3, 3) and translation: (3,), x_camera = rotation @ x_world +
    translation.
    """

    name: str
    lens: Lens
    rotation: np.ndarray
    translation: np.ndarray

    @property
    def position(self) -> np.ndarray:
        """(3,) the center of projection in world space."""
        return -self.rotation.T @ self.translation

    def relative_to(self, origin: np.ndarray) -> "PhotoCamera":
        """Return the camera in coordinates whose origin is at `origin` (3,)."""
        return replace(self, translation=self.translation + self.rotation @ origin)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Project `points` (N, 3) in world space.

        Returns:
            positions (N, 2) in pixels from the lower left corner of the image, depths (N,) along the optical axis, and whether (N,) bool
            the positions are valid.
        """
        local = points @ self.rotation.T + self.translation
        positions, is_valid = self.lens.project(local)
        return positions, local[:, 2], is_valid
