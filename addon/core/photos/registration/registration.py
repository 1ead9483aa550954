"""Cameras of photographs from pairs of points: places on the mesh and where a photograph shows them (Textures Revisited, section 7).

Poses of triples of pairs (perspective-three-point problem, Grunert's quartic) start a robust least-squares fit of pose, focal length and
radial distortion.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ...errors import GeometryError
from ...geometry.lenses import Lens, PhotoCamera

MIN_PAIRS, MIN_PAIRS_WITH_LENS = 6, 4
FIELDS_OF_VIEW = np.deg2rad([12.0, 18.0, 26.0, 36.0, 48.0, 62.0, 78.0, 96.0])  # along the longer side, where unknown lenses start
MAX_TRIPLES = 40  # that are tried with every focal length
STARTS, STARTS_WITHOUT_PAIR = 6, 2  # poses that are refined, and that are when a pair is left out
MIN_SQUARE_RATIO = 1e-24  # Below it, relative to the other squared distances, two points are the same to rounding.
SIGMA_PIXELS = 1.0  # expected error of a position
SIGMA_DISTORTION = 0.1  # expected size of the radial distortion
MIN_GAIN = 9.0  # factor by which the mean square error decreases without a wrong pair
MIN_WRONG_PIXELS = 6.0  # distance of a wrong pair to its projection
BEHIND_PIXELS = 1e4  # error of points behind the camera


@dataclass(frozen=True)
class Registration:
    """A registered camera.

    residuals: (N, 2) projected minus given positions in pixels. is_wrong: (N,) bool, pairs that do not fit to the others; they had no
    influence on the camera.
    """

    camera: PhotoCamera
    residuals: np.ndarray
    is_wrong: np.ndarray

    @property
    def mean_error(self) -> float:
        """Mean distance in pixels of the pairs that are not wrong."""
        return float(np.linalg.norm(self.residuals[~self.is_wrong], axis=1).mean())


def register(name: str, points: np.ndarray, positions: np.ndarray, size: tuple[int, int], lens: Lens | None = None) -> Registration:
    """Find the camera that projects `points` (N, 3) in world space to `positions` (N, 2) in pixels from the lower left corner.

    Args:
        name: of the photograph.
        size: its width and height in pixels.
        lens: if known. Otherwise focal length and a radial distortion are found, and the center is that of the photograph.

    Raises:
        GeometryError: there are too few pairs, numbers are not finite, or no camera sees the points like that.
    """
    points, positions = np.asarray(points, np.float64), np.asarray(positions, np.float64)
    needed = MIN_PAIRS_WITH_LENS if lens else MIN_PAIRS
    if len(points) < needed:
        advice = "" if lens else f", or {MIN_PAIRS_WITH_LENS} if its lens is known"
        raise GeometryError(f'"{name}" has {len(points)} of the {needed} pairs of points that are needed{advice}.')
    if not np.isfinite(points).all() or not np.isfinite(positions).all():
        raise GeometryError(f'A pair of points of "{name}" has a number that is not finite; set it again.')
    fit = _Fit(points, positions, size, lens)
    if np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] <= 1e-6 * fit.scale:
        raise GeometryError(f'The points of "{name}" lie on one line; add pairs away from it.')
    starts = fit.find_starts()
    distances = fit.measure_distances(starts)
    kept = np.ones(len(points), bool)
    parameters = fit.refine_best(starts, distances, kept)
    while parameters is not None and kept.sum() > fit.pairs_to_judge:
        found = _find_wrong(fit, starts, distances, parameters, kept)
        if found is None:
            break
        kept[found[0]], parameters = False, found[1]
    if parameters is None:
        raise GeometryError(f'No camera sees the points of "{name}" at the given positions; check the pairs.')
    camera = fit.to_camera(name, parameters)
    return Registration(camera, fit.project(parameters) - positions, ~kept)


def _find_wrong(
    fit: "_Fit", starts: list[np.ndarray], distances: np.ndarray, parameters: np.ndarray, kept: np.ndarray
) -> tuple[int, np.ndarray] | None:
    """Return the index of the pair without which the others fit much better, with the parameters of that fit; None if there is none."""
    mean_square, smallest = fit.mean_square(parameters, kept), (0.5 * SIGMA_PIXELS) ** 2
    if mean_square <= MIN_GAIN * smallest:  # no other fit is so much better
        return None
    starts = [parameters, *starts]
    distances = np.concatenate([fit.measure_distances(starts[:1]), distances])
    candidates = []
    for index in np.flatnonzero(kept):
        others = kept.copy()
        others[index] = False
        refined = fit.refine_best(starts, distances, others, STARTS_WITHOUT_PAIR)
        if refined is not None:
            candidates.append((fit.mean_square(refined, others), index, refined))
    if not candidates:
        return None
    error, index, refined = min(candidates, key=lambda candidate: candidate[0])
    distance = np.linalg.norm(fit.project(refined)[index] - fit.positions[index])
    is_wrong = distance > MIN_WRONG_PIXELS and mean_square > MIN_GAIN * max(error, smallest)
    return (int(index), refined) if is_wrong else None


class _Fit:
    """The fit to pairs. Parameters are a rotation vector and a translation in units of `scale`, then, without a known lens, the logarithm
    of the focal length relative to the longer side and the radial distortion."""

    def __init__(self, points: np.ndarray, positions: np.ndarray, size: tuple[int, int], lens: Lens | None) -> None:
        self.origin = points.mean(axis=0)
        self.scale = float(np.linalg.norm(points - self.origin, axis=1).max()) or 1.0
        self.points = (points - self.origin) / self.scale
        self.positions, self.size, self.lens = positions, size, lens
        self.parameter_count = 6 if lens else 8
        self.pairs_to_judge = self.parameter_count // 2 + 2  # more than one other pair must contradict a wrong one

    def to_lens(self, parameters: np.ndarray) -> Lens:
        if self.lens is not None:
            return self.lens
        focal = float(max(self.size) * np.exp(np.clip(parameters[6], -3.0, 5.0)))
        center = (0.5 * self.size[0], 0.5 * self.size[1])
        return Lens("SIMPLE_RADIAL", self.size, (focal, focal), center, (float(parameters[7]),))

    def to_camera(self, name: str, parameters: np.ndarray) -> PhotoCamera:
        rotation = Rotation.from_rotvec(parameters[:3]).as_matrix()
        return PhotoCamera(name, self.to_lens(parameters), rotation, self.scale * parameters[3:6] - rotation @ self.origin)

    def project(self, parameters: np.ndarray) -> np.ndarray:
        """Return the projections (N, 2) of all points; far off for those behind the camera."""
        local = Rotation.from_rotvec(parameters[:3]).apply(self.points) + parameters[3:6]
        positions, is_valid = self.to_lens(parameters).project(local)
        return np.where(is_valid[:, None], positions, self.positions + BEHIND_PIXELS)

    def mean_square(self, parameters: np.ndarray, kept: np.ndarray) -> float:
        """Return the squared error of the kept pairs per degree of freedom."""
        errors = (self.project(parameters) - self.positions)[kept]
        return float((errors**2).sum() / max(2 * kept.sum() - self.parameter_count, 1))

    def measure_distances(self, starts: list[np.ndarray]) -> np.ndarray:
        """Return the distances (S, N) of all pairs to their projections with each start, as the larger of both coordinates."""
        return np.array([np.abs(self.project(start) - self.positions).max(axis=1) for start in starts]).reshape(-1, len(self.points))

    def refine_best(self, starts: list[np.ndarray], distances: np.ndarray, kept: np.ndarray, count: int = STARTS) -> np.ndarray | None:
        """Return the parameters that fit the kept pairs best, by robust least squares from the `count` starts with the smallest median
        distance; None if none fits."""
        scores = np.median(distances[:, kept], axis=1)
        refined = [self._refine(starts[index], kept) for index in np.argsort(scores)[:count]]
        refined = [parameters for parameters in refined if (np.abs(self.project(parameters) - self.positions)[kept] < BEHIND_PIXELS).all()]
        return min(refined, key=lambda parameters: self._cost(parameters, kept)) if refined else None

    def _errors(self, parameters: np.ndarray, kept: np.ndarray) -> np.ndarray:
        errors = ((self.project(parameters) - self.positions)[kept] / SIGMA_PIXELS).ravel()
        return errors if self.lens else np.append(errors, parameters[7] / SIGMA_DISTORTION)

    def _cost(self, parameters: np.ndarray, kept: np.ndarray) -> float:
        return float(np.log1p(self._errors(parameters, kept) ** 2).sum())

    def _refine(self, start: np.ndarray, kept: np.ndarray) -> np.ndarray:
        linear = least_squares(self._errors, start, args=(kept,), loss="soft_l1", f_scale=3.0, max_nfev=60, x_scale="jac")
        return linear.x

    def find_starts(self) -> list[np.ndarray]:
        """Return parameters from the poses of triples of pairs, with the known lens or with several focal lengths."""
        if self.lens is not None:
            lenses = [(self.lens, [])]
        else:
            focals = 0.5 / np.tan(0.5 * FIELDS_OF_VIEW)
            lenses = [(self.to_lens(np.array([0.0] * 6 + [np.log(focal), 0.0])), [np.log(focal), 0.0]) for focal in focals]
        triples = list(combinations(range(len(self.points)), 3))
        if len(triples) > MAX_TRIPLES:
            chosen = np.random.default_rng(0).choice(len(triples), MAX_TRIPLES, replace=False)
            triples = [triples[index] for index in chosen]
        starts = []
        for lens, rest in lenses:
            directions = lens.unproject(self.positions)
            for triple in triples:
                poses = solve_p3p(self.points[list(triple)], directions[list(triple)])
                starts += [np.concatenate([Rotation.from_matrix(pose[:, :3]).as_rotvec(), pose[:, 3], rest]) for pose in poses]
        return starts


def solve_p3p(points: np.ndarray, directions: np.ndarray) -> list[np.ndarray]:
    """Return the poses (3, 4), world to camera, from which three `points` (3, 3) appear in unit `directions` (3, 3) of camera space.

    Distances by the quartic of Grunert in the form of Haralick et al., Review and Analysis of Solutions of the Three Point Perspective
    Pose Estimation Problem, 1994.
    """
    a2, b2, c2 = (float(((points[i] - points[j]) ** 2).sum()) for i, j in ((1, 2), (0, 2), (0, 1)))
    cos_a, cos_b, cos_c = (float(directions[i] @ directions[j]) for i, j in ((1, 2), (0, 2), (0, 1)))
    if min(a2, b2, c2) <= MIN_SQUARE_RATIO * max(a2, b2, c2):
        return []
    difference, total = (a2 - c2) / b2, (a2 + c2) / b2
    polynomial = [
        (difference - 1.0) ** 2 - 4.0 * c2 / b2 * cos_a**2,
        4.0 * (difference * (1.0 - difference) * cos_b - (1.0 - total) * cos_a * cos_c + 2.0 * c2 / b2 * cos_a**2 * cos_b),
        2.0
        * (
            difference**2
            - 1.0
            + 2.0 * difference**2 * cos_b**2
            + 2.0 * (b2 - c2) / b2 * cos_a**2
            - 4.0 * total * cos_a * cos_b * cos_c
            + 2.0 * (b2 - a2) / b2 * cos_c**2
        ),
        4.0 * (-difference * (1.0 + difference) * cos_b + 2.0 * a2 / b2 * cos_c**2 * cos_b - (1.0 - total) * cos_a * cos_c),
        (1.0 + difference) ** 2 - 4.0 * a2 / b2 * cos_c**2,
    ]
    poses = []
    for root in np.roots(polynomial):
        v, divisor = float(root.real), 2.0 * (cos_c - root.real * cos_a)
        square = 1.0 + v * v - 2.0 * v * cos_b
        if abs(root.imag) > 1e-3 * abs(root) or v <= 0.0 or abs(divisor) < 1e-12 or square <= 0.0:
            continue
        u = ((difference - 1.0) * v * v - 2.0 * difference * cos_b * v + 1.0 + difference) / divisor
        if u > 0.0:
            distance = np.sqrt(b2 / square)
            poses.append(_align(points, directions * (distance * np.array([1.0, u, v]))[:, None]))
    return poses


def _align(points: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return the rigid motion (3, 4) that takes `points` (N, 3) nearest to `targets` (N, 3) (Kabsch)."""
    center, target_center = points.mean(axis=0), targets.mean(axis=0)
    left, _, right = np.linalg.svd((targets - target_center).T @ (points - center))
    rotation = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return np.concatenate([rotation, (target_center - rotation @ center)[:, None]], axis=1)
