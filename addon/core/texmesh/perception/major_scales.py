"""Major scales (section IV.A, Figure 11): which scales of a step function between distance and scale are worth showing.

Scale 0 is the finest. Row i - 1 of what describes refinements is the one from scale i to i - 1. A red refinement is perceptible, a green
one is not. Scales that only green refinements separate form a zone, in which the coarsest scale looks like all others.
"""

from collections.abc import Callable

import numpy as np

from ...errors import SettingsError

MIN_STEP = 0.05  # relative growth of the distance from one scale to the next that counts as a step of the step function


def find_red_refinements(distances: np.ndarray, min_step: float = MIN_STEP) -> np.ndarray:
    """Return which refinements (S,) bool are perceptible, from the nearest distance (S + 1,) at which each scale looks right.

    Where the step function is flat, the coarser scale serves from the same distance on: the refinement is imperceptible.

    Raises:
        SettingsError: distances are negative, not finite, or not ascending.
    """
    check_distances(distances)
    return np.diff(distances) > min_step * distances[:-1]


def check_distances(distances: np.ndarray) -> None:
    """Check distances (S + 1,) of scales from the finest to the coarsest.

    Raises:
        SettingsError: they are negative, not finite, or not ascending.
    """
    if not len(distances) or not np.isfinite(distances).all() or distances[0] < 0.0 or (np.diff(distances) < 0.0).any():
        raise SettingsError("The distances of scales must be finite numbers from 0 on that do not decrease towards coarse scales.")


def find_major_scales(is_red: np.ndarray) -> np.ndarray:
    """Return the major scale (S + 1,) that replaces each scale: the coarsest one of its zone. A scale between two red refinements is its
    own."""
    scale_count = len(is_red) + 1
    ends = np.flatnonzero(np.append(is_red, True))  # the coarsest scales of zones
    return ends[np.searchsorted(ends, np.arange(scale_count))]


def find_zones(is_red: np.ndarray) -> list[tuple[int, int]]:
    """Return the zones as pairs of their finest and coarsest scale, from fine to coarse."""
    ends = np.unique(find_major_scales(is_red))
    return [(int(start), int(end)) for start, end in zip(np.append(0, ends[:-1] + 1), ends, strict=True)]


def choose_scale(distance: float, distances: np.ndarray, is_red: np.ndarray) -> int:
    """Return the scale to show at `distance`: the coarsest that looks right there, or the major scale of its zone if it is green.

    Args:
        distances: (S + 1,), ascending, nearest distance of each scale. is_red: (S,) bool.
    """
    check_distances(distances)
    located = max(int(np.searchsorted(distances, distance, side="right")) - 1, 0)
    return int(find_major_scales(is_red)[located])


def keep_visible_scales(is_red: np.ndarray, looks_same: Callable[[int, int], bool]) -> np.ndarray:
    """Return which refinements (S,) bool are perceptible after a physical check: a scale is dropped only if that cannot be seen.

    Args:
        is_red: (S,) bool, by Weber's law or judges. looks_same: whether a coarse scale (second argument) looks like a fine one (first) at
            the distance from which the fine one is shown, such as by `SwitchCheck`. It is asked only about scales of one zone.
    """
    checked = np.array(is_red, bool)
    for start, end in find_zones(checked):
        coarse = end
        while coarse > start:
            fine = coarse - 1
            while fine >= start and looks_same(fine, coarse):
                fine -= 1
            if fine >= start:
                checked[fine] = True  # the refinement from scale fine + 1 to fine
            coarse = fine
    return checked
