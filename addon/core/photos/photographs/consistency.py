"""Parts of photographs that show something else than the surface: a passer-by, a branch in front, a reflection.

Observations of the same point are compared. Whether one is an outlier is decided together with its neighbors in the photograph, so that
outliers are connected parts of photographs instead of single pixels, and so that parts that only one or two photographs show are decided by
their surroundings: each observation has the logarithm of odds (its evidence) that it shows the surface, from its distance to the mean of
the other photographs, weighted by how likely those show the surface; and these are smoothed over the photograph, in turns (mean-field
iterations of a Markov random field).
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter, label, minimum_filter

from ...arrays import find_group_medians
from ...jobs.progress import Progress, Steps
from .observations import LABEL, Observations


@dataclass(frozen=True)
class Tuning:
    """Numbers of the method."""

    cells: int = 150  # along the longer side of a photograph
    min_cell: float = 4.0  # pixels
    max_evidence: float = 3.0  # from one observation, in logarithms of odds
    prior: float = 0.5
    min_deviation: float = 0.015  # Registration, highlights and noise may cause deviations of encoded colors per channel from this ...
    max_deviation: float = 0.05  # ... to this one.
    outlier_deviations: float = 4.0  # An observation this many deviations away is rather an outlier.
    neighbor_weight: float = 2.0
    neighbor_cells: float = 1.5  # standard deviation of the smoothing
    iterations: int = 12
    min_region: int = 6  # cells; smaller outliers are highlights or edges


TUNING = Tuning()


def rate_photographs(observed: Observations, colors: np.ndarray, sizes: list[tuple[int, int]]) -> Steps[list[np.ndarray]]:
    """Return for each photograph of `sizes` (width, height) how far (h, w) float32, 0 to 1, each of its cells can be trusted.

    colors: (N, 3), the encoded colors of the observations after exposures were adjusted. The cells divide the photograph evenly.
    """
    cells = [count_cells(size) for size in sizes]
    if len(observed.points) == 0:
        return [np.ones((rows, columns), np.float32) for columns, rows in cells]
    grid = _CellGrid(observed, sizes, cells)
    groups, counts = np.unique(observed.points, return_inverse=True, return_counts=True)[1:]
    counts = counts[groups]
    deviations = _deviations(colors - find_group_medians(observed.points, colors))
    typical = 1.4826 * float(np.median(deviations[counts >= 3])) if (counts >= 3).any() else TUNING.min_deviation
    limit = TUNING.outlier_deviations * np.clip(typical, TUNING.min_deviation, TUNING.max_deviation)
    evidence = np.where(counts >= 3, _evidence(deviations, limit), 0.0)
    in_pair = counts == 2
    agrees = _evidence(2.0 * deviations, limit)  # the median of two is their mean
    evidence[in_pair] = np.maximum(agrees[in_pair], 0.0)

    def find_odds() -> np.ndarray:
        return _keep_the_best(evidence + TUNING.prior + TUNING.neighbor_weight * grid.smooth(evidence), groups, counts)

    for iteration in range(TUNING.iterations):
        yield Progress(iteration / TUNING.iterations, LABEL)
        odds = find_odds()
        trust = 1.0 / (1.0 + np.exp(-odds))
        totals = np.bincount(groups, trust)[groups] - trust
        others = np.stack([np.bincount(groups, trust * channel)[groups] - trust * channel for channel in colors.T], axis=1)
        others /= np.maximum(totals, 1e-6)[:, None]
        updated = _evidence(_deviations(colors - others), limit) * np.minimum(totals, 1.0)
        evidence = 0.5 * evidence + 0.5 * np.where(counts >= 2, updated, 0.0)
    return [_clean(each) for each in grid.average(find_odds())]


def count_cells(size: tuple[int, int], most: int = TUNING.cells) -> tuple[int, int]:
    """Return the number of columns and rows of cells of a photograph of `size` (width, height), along its longer side `most` of them."""
    cell = max(max(size) / most, TUNING.min_cell)
    return max(round(size[0] / cell), 1), max(round(size[1] / cell), 1)


class _CellGrid:
    """The cells of all photographs, and which one each observation lies in."""

    def __init__(self, observed: Observations, sizes: list[tuple[int, int]], cells: list[tuple[int, int]]) -> None:
        self.cells = cells
        self._rows = []
        for photograph, (size, (columns, rows)) in enumerate(zip(sizes, cells, strict=True)):
            own = np.flatnonzero(observed.photographs == photograph)
            x, y = (observed.positions[own] / np.array(size) * (columns, rows)).T.astype(np.int64)
            self._rows.append((own, np.clip(y, 0, rows - 1) * columns + np.clip(x, 0, columns - 1)))

    def average(self, values: np.ndarray, deviation: float = 0.7) -> list[np.ndarray]:
        """Return the Gaussian-weighted means (h, w) of `values` (N,) around each cell; the prior where there are none."""
        means = []
        for (own, cell), (columns, rows) in zip(self._rows, self.cells, strict=True):
            sums = np.bincount(cell, values[own], rows * columns).reshape(rows, columns)
            weights = np.bincount(cell, minlength=rows * columns).reshape(rows, columns).astype(np.float64)
            sums, weights = (gaussian_filter(each, deviation, mode="constant") for each in (sums, weights))
            means.append(np.where(weights > 1e-3, sums / np.maximum(weights, 1e-3), TUNING.prior))
        return means

    def smooth(self, values: np.ndarray) -> np.ndarray:
        """Return the means of the neighbors of each observation (N,)."""
        result = np.empty_like(values)
        for (own, cell), mean in zip(self._rows, self.average(values, TUNING.neighbor_cells), strict=True):
            result[own] = mean.ravel()[cell]
        return result


def _deviations(differences: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("nc,nc->n", differences, differences) / differences.shape[1])


def _evidence(deviations: np.ndarray, limit: float) -> np.ndarray:
    """Return logarithms of odds: TUNING.max_evidence for observations that agree, 0 at the `limit`, and at least -TUNING.max_evidence."""
    return np.maximum(TUNING.max_evidence * (1.0 - np.square(deviations / limit)), -TUNING.max_evidence)


def _keep_the_best(odds: np.ndarray, groups: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return odds such that one of several photographs of each point is not an outlier."""
    best = np.full(int(groups.max()) + 1, -np.inf)
    np.maximum.at(best, groups, odds)
    return odds - np.where(counts >= 2, np.minimum(best[groups], 0.0), 0.0)


def _clean(odds: np.ndarray) -> np.ndarray:
    """Return the trust (h, w) without outliers of few cells, with a margin around the others."""
    trust = 1.0 / (1.0 + np.exp(-2.0 * odds))
    regions, count = label(trust < 0.5)
    sizes = np.bincount(regions.ravel(), minlength=count + 1)
    trust[(regions > 0) & (sizes[regions] < TUNING.min_region)] = 1.0
    return minimum_filter(trust, 3).astype(np.float32)
