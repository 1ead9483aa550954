"""Corrections of the colors of a photograph: gain, gamma and vignetting, and their estimate from what several photographs show.

In logarithms of linear light, with the color y of a photograph, its gain g per channel, gamma c, and vignetting v of its lens, which is a
polynomial in the square of the distance r from the optical center, g + c y + v(r) is the same for all photographs of a point. These
are linear in the unknowns, which robust least squares (iterative reweighting with the weights of Huber) finds together. The mean logarithm
of gains is zero, so that the texture as a whole keeps its brightness. Gains alone are found channel by channel.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ...arrays import find_group_medians
from ...geometry.lenses import Lens
from ...imaging.colors import decode_signed_srgb, encode_signed_srgb
from .observations import Observations
from .photograph import apply_gain

EXPOSURE_POINTS = 20_000  # points on the surface that are enough to compare exposures
MIN_LINEAR, MAX_ENCODED = 0.01, 0.97  # darker colors are noise, brighter ones are clipped
HUBER = 0.1  # Larger differences of logarithms are outliers.
MAX_PER_POINT = 8  # observations of a point that are compared, chosen at random: the cost grows with the square
ITERATIONS = 20
TOLERANCE = 1e-4  # change of logarithmic gains at which iterations end
DEGREE = 2  # degree of the polynomial for vignetting in the square of the radius
REGULARIZATION = 1e-3  # relative to the number of comparisons; photographs without overlap keep their exposure
GAMMA_REGULARIZATION = 1e-2  # relative to the number of comparisons of a photograph
VIGNETTING_REGULARIZATION = 1e-3  # relative to the number of comparisons of a lens


@dataclass(frozen=True)
class ColorCorrection:
    """How the colors of one photograph are corrected in linear light: to the power `gamma`, times `gain` (3,), times the exponential of the
    polynomial with coefficients `vignetting` of r^2, r^4, ..., where r is the distance from the optical center of `lens` in units of half
    the diagonal of the photograph."""

    lens: Lens
    gain: np.ndarray
    gamma: float = 1.0
    vignetting: tuple[float, ...] = ()

    def apply(self, encoded: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Return the corrected colors of `encoded` ones (N, 3) float32 at `positions` (N, 2) in pixels from the lower left corner, to
        within 1e-3."""
        corrected = apply_gain(encoded, self.gain, self.gamma)
        if not any(self.vignetting):
            return corrected
        factors = np.exp(radius_powers(self.lens, positions, len(self.vignetting)) @ np.array(self.vignetting, np.float32))
        return encode_signed_srgb(decode_signed_srgb(corrected) * factors[:, None])


def radius_powers(lens: Lens, positions: np.ndarray, degree: int) -> np.ndarray:
    """Return r^2, r^4, ... (N, degree) float32 at `positions` (N, 2), with r = 1 half a diagonal away from the optical center."""
    width, height = lens.size
    offsets = positions - np.array([lens.center[0], height - lens.center[1]], np.float32)
    squares = np.einsum("ni,ni->n", offsets, offsets) / np.float32(0.25 * (width**2 + height**2))
    return np.stack([squares**power for power in range(1, degree + 1)], axis=1).astype(np.float32)


def estimate_corrections(
    observed: Observations, lenses: list[Lens], weights: np.ndarray | None = None, *, has_gamma: bool, has_vignetting: bool
) -> list[ColorCorrection]:
    """Return the corrections of the photographs with these `lenses`, which equal ones share; `weights` (N,) of the observations are 1 by
    default. The mean logarithm of gains is 0, the mean gamma 1; photographs without overlap keep their colors."""
    if not (has_gamma or has_vignetting):
        return [ColorCorrection(lens, gain) for lens, gain in zip(lenses, estimate_gains(observed, len(lenses), weights), strict=True)]
    system = _System(observed, lenses, weights, has_gamma, has_vignetting)
    solution = system.solve()
    count, at = len(lenses), 3 * len(lenses)
    gains, gammas, vignetting = solution[:at].reshape(count, 3), np.zeros(count), [()] * count
    if has_gamma:
        gammas, at = solution[at : at + count], at + count
    if has_vignetting:
        vignetting = [tuple(float(value) for value in row) for row in solution[at:].reshape(-1, DEGREE)]
    gains = np.exp(gains - gammas[:, None] * system.center)
    return [
        ColorCorrection(lens, gain, 1.0 + float(gamma), vignetting[index])
        for lens, gain, gamma, index in zip(lenses, gains, gammas, system.lens_indices, strict=True)
    ]


class _System:
    """The least squares problem. Unknowns: gains (3 K), then gammas minus 1 (K), then coefficients of vignetting (DEGREE per lens).

    There are R rows, one for each channel of each observation; gammas turn around the logarithm `center`, so that they hardly change gains.
    """

    def __init__(
        self, observed: Observations, lenses: list[Lens], weights: np.ndarray | None, has_gamma: bool, has_vignetting: bool
    ) -> None:
        distinct = list(dict.fromkeys(lenses))
        self.lens_indices = [distinct.index(lens) for lens in lenses]
        chosen, given = choose_observations(observed, weights)
        points, photographs = observed.points[chosen], observed.photographs[chosen]
        linear = decode_signed_srgb(observed.colors[chosen])
        self.values = np.log(np.maximum(linear, MIN_LINEAR)).ravel()
        self._given = (given[:, None] * (linear > MIN_LINEAR)).ravel()
        self.center = float(np.median(self.values)) if len(self.values) else 0.0
        self._groups = np.unique((3 * points[:, None] + np.arange(3)).ravel(), return_inverse=True)[1]
        count, rows = len(lenses), np.arange(len(self.values))
        entries = [(rows, (3 * photographs[:, None] + np.arange(3)).ravel(), np.ones(len(rows)))]
        scale = max(float(self._given.sum()) / 3.0, 1.0)
        blocks = [np.full(3 * count, REGULARIZATION * scale / count)]
        width = 3 * count
        if has_gamma:
            entries.append((rows, width + photographs.repeat(3), self.values - self.center))
            blocks.append(np.full(count, GAMMA_REGULARIZATION * 3.0 * scale / count))
            width += count
        if has_vignetting:
            powers = np.zeros((len(points), DEGREE), np.float32)
            for index, lens in enumerate(lenses):
                own = photographs == index
                powers[own] = radius_powers(lens, observed.positions[chosen][own], DEGREE)
            first = width + DEGREE * np.array(self.lens_indices)[photographs]
            entries += [(rows, (first + power).repeat(3), powers[:, power].repeat(3)) for power in range(DEGREE)]
            blocks.append(np.full(DEGREE * len(distinct), VIGNETTING_REGULARIZATION * 3.0 * scale / len(distinct)))
            width += DEGREE * len(distinct)
        row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
        self._matrix = csr_matrix((value, (row, column)), shape=(len(rows), width))
        self._regularization = np.diag(np.concatenate(blocks))
        for channel in range(3):
            gains = np.arange(channel, 3 * count, 3)
            self._regularization[np.ix_(gains, gains)] += scale / count**2
        if has_gamma:
            self._regularization[3 * count : 4 * count, 3 * count : 4 * count] += 3.0 * scale / count**2

    def solve(self) -> np.ndarray:
        """Return the unknowns by iteratively reweighted least squares with the weights of Huber."""
        solution = np.zeros(self._matrix.shape[1])
        for _ in range(ITERATIONS if len(self.values) else 0):
            adjusted = self.values + self._matrix @ solution
            residuals = np.abs(adjusted - _medians(self._groups, adjusted))
            previous, solution = solution, self._solve_weighted(self._given * np.minimum(1.0, HUBER / np.maximum(residuals, 1e-9)))
            if np.abs(solution - previous).max() < TOLERANCE:
                break
        return solution

    def _solve_weighted(self, weights: np.ndarray) -> np.ndarray:
        """Return the unknowns with the least weighted variance of each channel of each point over the photographs."""
        totals = np.maximum(np.bincount(self._groups, weights), 1e-30)
        collect = csr_matrix((weights, (self._groups, np.arange(len(weights)))), shape=(len(totals), len(weights)))
        sums = (collect @ self._matrix).tocsr()
        means = (collect @ self.values) / totals
        weighted = self._matrix.multiply(weights[:, None]).tocsr()
        variance = (weighted.T @ self._matrix - sums.T @ sums.multiply(1.0 / totals[:, None])).toarray()
        return np.linalg.solve(variance + self._regularization, -(weighted.T @ (self.values - means[self._groups])))


def _medians(groups: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the median (N,) of the group of each value."""
    order = np.argsort(groups, kind="stable")
    result = np.empty_like(values)
    result[order] = find_group_medians(groups[order], values[order, None])[:, 0]
    return result


def estimate_gains(observed: Observations, count: int, weights: np.ndarray | None = None) -> np.ndarray:
    """Return gains (K, 3) for `count` photographs; `weights` (N,) of the observations are 1 by default."""
    usable, given = choose_observations(observed, weights)
    points, photographs = observed.points[usable], observed.photographs[usable]
    logarithms = np.log(np.maximum(decode_signed_srgb(observed.colors[usable]), MIN_LINEAR))
    rows = np.unique(points, return_inverse=True)[1]
    gains = np.zeros((count, 3))
    for channel in range(3):
        for _ in range(ITERATIONS):
            adjusted = logarithms[:, channel] + gains[photographs, channel]
            residuals = adjusted - find_group_medians(points, adjusted[:, None])[:, 0]
            robust = given * np.minimum(1.0, HUBER / np.maximum(np.abs(residuals), 1e-9))
            previous = gains[:, channel].copy()
            gains[:, channel] = _solve(rows, photographs, logarithms[:, channel], robust, count)
            if np.abs(gains[:, channel] - previous).max() < TOLERANCE:
                break
    return np.exp(gains)


def choose_observations(observed: Observations, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return which observations (N,) bool are compared, not clipped and few of each point, and the weights (M,) of those."""
    usable = (observed.colors.max(axis=1) < MAX_ENCODED) & (True if weights is None else weights > 0.0)
    given = np.ones(len(observed.points)) if weights is None else weights
    usable &= _rank(observed.points, usable) < MAX_PER_POINT
    return usable, given[usable]


def _rank(points: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return the place (N,) of each observation among the usable ones of its point, in random order."""
    order = np.lexsort((np.random.default_rng(0).random(len(points)), ~usable, points))
    starts = np.searchsorted(points, points)  # points ascend
    ranks = np.empty(len(points), np.int64)
    ranks[order] = np.arange(len(points)) - starts[order]
    return ranks


def _solve(rows: np.ndarray, photographs: np.ndarray, values: np.ndarray, weights: np.ndarray, count: int) -> np.ndarray:
    """Return the logarithmic gains (K,) that minimize the weighted variance of each point, with the index `rows` (N,), over the
    photographs."""
    totals = np.bincount(rows, weights)
    matrix = csr_matrix((weights, (rows, photographs)), shape=(len(totals), count))
    normalized = csr_matrix((weights / np.maximum(totals, 1e-30)[rows], (rows, photographs)), shape=(len(totals), count))
    means = np.bincount(rows, weights * values) / np.maximum(totals, 1e-30)
    right_side = -np.bincount(photographs, weights * (values - means[rows]), count)
    scale = max(float(weights.sum()), 1.0)
    variance = np.diag(np.bincount(photographs, weights, count)) - (matrix.T @ normalized).toarray()
    return np.linalg.solve(variance + REGULARIZATION * scale / count * np.eye(count) + scale / count**2, right_side)
