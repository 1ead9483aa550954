"""Shifts to parts of the source that continue the surroundings of a hole, found by correlation.

The cost of a shift is the sum of squared differences between the pixels around the hole and those at the other end of the shift, as in
"sub-patch matching" of Kwatra et al., "Graphcut Textures", 2003, relative to the variance of both: smooth parts of a texture are otherwise
more similar to any of its parts than these are to each other.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import binary_dilation, distance_transform_edt


@dataclass(frozen=True)
class Tuning:
    """Numbers of the method."""

    ring: int = 3  # pixels around the hole that a shift continues
    section_pixels: int = 200  # pixels of the ring in one section, which has shifts of its own
    section_shifts: int = 4  # shifts for one section
    ring_shifts: int = 8  # shifts for all of the ring
    min_distance: int = 2  # pixels between two shifts for the same pixels
    max_uncovered: float = 0.7  # fraction of the part of the hole next to a section that may have no source
    choice: int = 3  # times as many shifts are found as an attempt uses
    min_variance: float = 0.2  # added to the variance of what is compared, relative to that of the texture
    min_cost: float = 1e-4
    jitter: float = 0.3  # relative deviation of costs, so that each attempt uses other shifts
    reach: int = 80  # pixels around a section within which its shifts are used
    max_search: int = 256  # pixels around a section within which shifts are looked for
    grid: int = 64  # corners of the searched areas are multiples of it, so that sections share areas


TUNING = Tuning()


class Area(NamedTuple):
    """A rectangle of pixels of a window; `bottom` and `right` are behind the last ones."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def index(self) -> tuple[slice, slice]:
        """The index of the pixels in arrays of the window."""
        return slice(self.top, self.bottom), slice(self.left, self.right)


class Shift(NamedTuple):
    """Rows and columns from a pixel of the hole to its source, and where in the window the shift is used."""

    step: tuple[int, int]
    area: Area


class Surroundings(NamedTuple):
    """A window with a hole.

    Attributes:
        texture: (H, W, C) float32.
        hole: (H, W) bool, the pixels to fill.
        filled: (H, W) bool, those whose texture is known.
        valid: (H, W) bool, those that may be copied.
        wrap: whether opposite borders are neighbors, along rows and columns.
    """

    texture: np.ndarray
    hole: np.ndarray
    filled: np.ndarray
    valid: np.ndarray
    wrap: tuple[bool, bool]


def find_shifts(window: Surroundings, attempts: int, generator: np.random.Generator) -> list[list[Shift]]:
    """Return as many lists of shifts as `attempts`; each may differ, since costs are varied at random."""
    ring = binary_dilation(window.hole, iterations=TUNING.ring) & window.filled
    if not ring.any():
        return [[] for _ in range(attempts)]
    numbers, count = _divide(ring)
    rows, columns = distance_transform_edt(~ring, return_distances=False, return_indices=True)
    nearest = np.where(window.hole, numbers[rows, columns], -1)

    def section(number: int) -> tuple[np.ndarray, np.ndarray]:
        return (ring, window.hole) if number < 0 else (numbers == number, nearest == number)

    sections: dict[Area, list[int]] = {}  # by the area that is searched
    for number in range(-1, count):
        part, near = section(number)
        if near.any():
            sections.setdefault(_search_area(part | near, window.wrap), []).append(number)
    best: dict[int, tuple[list[Shift], np.ndarray]] = {}
    for searched, members in sections.items():
        correlations = _Correlations(window, searched.index)  # One at a time, since they take much memory.
        for number in members:
            part, near = section(number)
            costs = correlations.costs(part[searched.index], near[searched.index])
            steps, lowest = _best_steps(costs, correlations, part[searched.index], _count_shifts(number) * TUNING.choice)
            used = Area(0, ring.shape[0], 0, ring.shape[1]) if number < 0 else _grow(part | near, TUNING.reach, window.wrap)
            best[number] = [Shift(step, used) for step in steps], lowest
    found: list[dict[Shift, None]] = [{} for _ in range(attempts)]
    for number, (candidates, lowest) in sorted(best.items()):
        for shifts in found:
            varied = lowest * np.exp(TUNING.jitter * generator.standard_normal(len(candidates)))
            shifts |= {candidates[index]: None for index in np.argsort(varied)[: _count_shifts(number)]}
    return [list(shifts) for shifts in found]


def _count_shifts(number: int) -> int:
    """Return the number of shifts for a section of the ring, or for all of it if it is negative."""
    return TUNING.ring_shifts if number < 0 else TUNING.section_shifts


class _Correlations:
    """Costs of all shifts within an area of a window, by Fourier transforms. Shifts are cyclic; what leaves the area is unknown."""

    def __init__(self, window: Surroundings, area: tuple[slice, slice]) -> None:
        filled, valid, hole = (values[area] for values in (window.filled, window.valid, window.hole))
        rows, columns = np.nonzero(binary_dilation(hole, iterations=TUNING.ring))
        extents = (np.ptp(rows) + 1, np.ptp(columns) + 1)
        self.size = [
            side if wraps else next_fast_len(int(side + extent), real=True)
            for side, extent, wraps in zip(hole.shape, extents, window.wrap, strict=True)
        ]
        texture = window.texture[area]
        deviations = texture - texture[filled].mean(axis=0)
        self._variance = float(np.square(deviations[filled]).sum(axis=1).mean())
        self._values = np.where(filled[..., None], deviations, np.float32(0.0)).transpose(2, 0, 1)
        self._texture = rfft2(self._values, self.size)
        self._squares = rfft2((self._values**2).sum(axis=0), self.size)
        self._unknown, self._unusable = (rfft2(self._outside(inside), self.size) for inside in (filled, valid))

    def costs(self, part: np.ndarray, near: np.ndarray) -> np.ndarray:
        """Return the costs (S, T) of all cyclic shifts for the pixels `part` (H, W) of the ring, infinite where the other end is not known
        or too much of `near` (H, W), the pixels of the hole next to them, has no source there."""
        weights = part.astype(np.float32)
        count = weights.sum()
        spectrum = np.conj(rfft2(weights, self.size))
        product = (np.conj(rfft2(weights * self._values, self.size)) * self._texture).sum(axis=0)
        energies = irfft2(spectrum * self._squares, self.size) + np.square(self._values * weights).sum()
        differences = energies - 2.0 * irfft2(product, self.size)
        missing = irfft2(spectrum * self._unknown, self.size)
        uncovered = irfft2(np.conj(rfft2(near.astype(np.float32), self.size)) * self._unusable, self.size) / near.sum()
        relative = np.maximum(differences, 0.0) / np.maximum(energies + TUNING.min_variance * count * self._variance, 1e-9)
        costs = (relative + TUNING.min_cost) * (1.0 + uncovered)
        costs[(uncovered > TUNING.max_uncovered) | (missing > 0.5)] = np.inf
        return costs

    def _outside(self, inside: np.ndarray) -> np.ndarray:
        padded = np.ones(self.size, np.float32)
        padded[: inside.shape[0], : inside.shape[1]] = ~inside
        return padded


def _best_steps(costs: np.ndarray, correlations: _Correlations, part: np.ndarray, count: int) -> tuple[list[tuple[int, int]], np.ndarray]:
    """Return the rows and columns of the `count` shifts with the lowest `costs`, which are overwritten, and these costs (count,)."""
    steps, lowest, positions = [], [], np.nonzero(part)
    around = np.arange(-TUNING.min_distance, TUNING.min_distance + 1)
    for _ in range(count):
        best = np.unravel_index(int(costs.argmin()), costs.shape)
        if not np.isfinite(costs[best]):
            break
        lowest.append(float(costs[best]))
        sides = zip(best, correlations.size, part.shape, positions, strict=True)
        steps.append(tuple(int(step) if where.max() + step < side else int(step) - full for step, full, side, where in sides))
        costs[np.ix_(*((step + around) % full for step, full in zip(best, correlations.size, strict=True)))] = np.inf
    return steps, np.array(lowest)


def _divide(ring: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the number (H, W) of the section of each pixel of the ring, -1 elsewhere, and the number of sections."""
    positions = np.argwhere(ring)
    parts = [np.arange(len(positions))]
    for _ in range(round(len(positions) / TUNING.section_pixels) - 1):
        part = parts.pop(int(np.argmax([len(each) for each in parts])))
        axis = int(np.argmax(np.ptp(positions[part], axis=0)))
        part = part[np.argsort(positions[part, axis], kind="stable")]
        parts += [part[: len(part) // 2], part[len(part) // 2 :]]
    numbers = np.full(ring.shape, -1)
    for number, part in enumerate(parts):
        numbers[tuple(positions[part].T)] = number
    return numbers, len(parts)


def _search_area(used: np.ndarray, wrap: tuple[bool, bool]) -> Area:
    """Return the area around the pixels `used` (H, W) in which shifts are looked for."""
    top, bottom, left, right = _grow(used, TUNING.max_search, wrap)
    (height, width), grid = used.shape, TUNING.grid
    return Area(top // grid * grid, min(height, -(-bottom // grid) * grid), left // grid * grid, min(width, -(-right // grid) * grid))


def _grow(used: np.ndarray, margin: int, wrap: tuple[bool, bool]) -> Area:
    """Return the bounding box of the pixels `used` (H, W) with a margin; an axis whose borders are neighbors is complete."""
    bounds: list[int] = []
    for axis, wraps in enumerate(wrap):
        where, side = np.flatnonzero(used.any(axis=1 - axis)), used.shape[axis]
        bounds += [0, side] if wraps else [max(int(where[0]) - margin, 0), min(int(where[-1]) + 1 + margin, side)]
    return Area(*bounds)
