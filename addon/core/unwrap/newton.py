"""Projected Newton steps down an energy of layouts, which never flip a triangle."""

from typing import Protocol

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from ..progress import Progress, Steps

STEADY = 1e-8  # of the median of the diagonal, added to it: turning and shifting a free layout costs nothing
STEADIER = 1e3  # times as much where the factor does not hold
BACK = 0.7  # of the way to where a triangle would have no area left
SUFFICIENT = 1e-4  # of what the slope promises (Armijo)
SHORTEST = 1e-10  # a step below that is none
SERVES = 14  # steps that a factor is used for; each costs a tenth of a new one
HINDERED = 0.5  # of a whole step: after one below it squeezed triangles are mended
NEGLIGIBLE = 1e-3  # of the least energy
SHORT = 0.1  # of a whole step: after one below it the factor is made anew


class Energy(Protocol):
    """What is minimised, by layouts (V, 2), which no one changes in place; N unknowns are the coordinates of the vertices that may move."""

    def value(self, layout: np.ndarray) -> float:
        """The energy, infinite where the layout must not be."""

    def least(self) -> float:
        """What no layout goes below."""

    def longest_step(self, layout: np.ndarray, move: np.ndarray) -> float:
        """The multiple of `move` (V, 2) at which the layout would become one that must not be."""

    def slope(self, layout: np.ndarray) -> np.ndarray:
        """Slope (N,) by the unknowns."""

    def bend(self, layout: np.ndarray) -> sparse.csc_array:
        """Bend (N, N) by the unknowns, positive."""

    def move(self, unknowns: np.ndarray) -> np.ndarray:
        """Moves (V, 2) from the `unknowns` (N,)."""

    def mended(self, layout: np.ndarray) -> np.ndarray:
        """A layout of hardly more energy in which fewer triangles are squeezed: these would keep the next step short."""


def minimised(energy: Energy, layout: np.ndarray, tolerance: float, most: int) -> Steps[np.ndarray]:
    """The layout (V, 2) of least energy near `layout`, which comes back as it is where it is not allowed.

    Ends after `most` steps, or when a step with a factor of its own gains less than `tolerance` of what the energy is above its least, or
    of what would be negligible.
    """
    value, factor, served, steady = energy.value(layout), None, 0, STEADY
    if not np.isfinite(value):
        return layout
    for number in range(most):
        yield Progress(number / most, "Unwrapping")
        if factor is None or served >= SERVES:
            factor, served = _factor(energy.bend(layout), steady), 0
        slope = energy.slope(layout)
        unknowns = -factor.solve(slope)
        if not np.isfinite(unknowns).all():
            factor, steady = None, STEADIER * steady
            continue
        promised = -float(slope @ unknowns)
        taken = _along(energy, layout, energy.move(unknowns), value, promised)
        if taken is not None:
            step, layout, reached = taken
            if step < HINDERED:
                layout, reached = _better(energy, layout, reached)
            gained, value = value - reached, reached
            served = SERVES if step < SHORT else served + 1
        if taken is None or max(gained, 0.5 * promised) <= tolerance * max(value - energy.least(), NEGLIGIBLE * energy.least()):
            if served <= 1:
                break
            served = SERVES
    return layout


def _along(energy: Energy, layout: np.ndarray, move: np.ndarray, value: float, promised: float) -> tuple[float, np.ndarray, float] | None:
    """How far along `move` (V, 2) to go, where that leads, and its energy; None where nowhere is better than `value` at `layout`."""
    farthest = BACK * energy.longest_step(layout, move)
    step = min(1.0, farthest)
    there = layout + step * move
    reached = energy.value(there)
    while not reached <= value - SUFFICIENT * step * promised:
        step *= 0.5
        if step < SHORTEST:
            return None
        there = layout + step * move
        reached = energy.value(there)
    while 1.0 <= step < 0.5 * farthest:  # what pulls apart does so ever faster
        beyond = layout + 2.0 * step * move
        farther = energy.value(beyond)
        if farther >= reached:
            break
        step, there, reached = 2.0 * step, beyond, farther
    return step, there, reached


def _better(energy: Energy, layout: np.ndarray, value: float) -> tuple[np.ndarray, float]:
    """The layout mended where that is better, and its energy."""
    mended = energy.mended(layout)
    if mended is layout:
        return layout, value
    reached = energy.value(mended)
    return (mended, reached) if reached < value else (layout, value)


def _factor(bend: sparse.csc_array, steady: float):
    steadied = bend + steady * float(np.median(bend.diagonal())) * sparse.eye_array(bend.shape[0], format="csc")
    return splu(steadied, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
