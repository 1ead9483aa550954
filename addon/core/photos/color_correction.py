"""Corrections of the colors of a photograph: gain, gamma and vignetting, and their estimate from what several photographs show.

In logarithms of linear light, with the color y of a photograph, its gain g per channel, gamma c, and vignetting v of its lens, which is a
polynomial in the square of the distance r from the optical center, g + c y + v(r) is the same for all photographs of a point. These
are linear in the unknowns, which robust least squares finds together, as in `exposure`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import find_group_medians
from ..geometry.lenses import Lens
from ..imaging.colors import decode_signed_srgb, encode_signed_srgb
from .exposure import HUBER, ITERATIONS, MIN_LINEAR, REGULARIZATION, TOLERANCE, choose_observations, estimate_gains
from .observations import Observations
from .photographs import apply_gain

DEGREE = 2  # of vignetting in the square of the radius
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
    distinct = list(dict.fromkeys(lenses))
    system = _System(observed, lenses, [distinct.index(lens) for lens in lenses], weights, has_gamma, has_vignetting)
    solution = system.solve()
    count, at = len(lenses), 3 * len(lenses)
    gains, gammas, vignetting = solution[:at].reshape(count, 3), np.zeros(count), [()] * len(distinct)
    if has_gamma:
        gammas, at = solution[at : at + count], at + count
    if has_vignetting:
        vignetting = [tuple(float(value) for value in row) for row in solution[at:].reshape(-1, DEGREE)]
    gains = np.exp(gains - gammas[:, None] * system.center)
    return [
        ColorCorrection(lens, gain, 1.0 + float(gamma), vignetting[distinct.index(lens)])
        for lens, gain, gamma in zip(lenses, gains, gammas, strict=True)
    ]


class _System:
    """The least squares problem. Unknowns: gains (3 K), then gammas minus 1 (K), then coefficients of vignetting (DEGREE per lens).

    There are R rows, one for each channel of each observation; gammas turn around the logarithm `center`, so that they hardly change gains.
    """

    def __init__(
        self,
        observed: Observations,
        lenses: list[Lens],
        lens_indices: list[int],
        weights: np.ndarray | None,
        has_gamma: bool,
        has_vignetting: bool,
    ) -> None:
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
            first = width + DEGREE * np.array(lens_indices)[photographs]
            entries += [(rows, (first + power).repeat(3), powers[:, power].repeat(3)) for power in range(DEGREE)]
            lens_count = max(lens_indices) + 1
            blocks.append(np.full(DEGREE * lens_count, VIGNETTING_REGULARIZATION * 3.0 * scale / lens_count))
            width += DEGREE * lens_count
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
