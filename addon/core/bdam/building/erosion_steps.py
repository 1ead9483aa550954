"""Erosion of heights in memory: rivers cut valleys and leave deposits, and steep ground slides.

Rivers lower heights by the stream-power law: the rate is the gradient times the square root of the drained area, so that the law has no
scale and cells are the unit of length. A step of time is implicit: from the outlets upwards, each sample moves towards the one that it
flows to (Braun and Willett, A very efficient O(n), implicit and parallel method to solve the stream power equation governing fluvial
incision and landscape evolution, 2013). Ground that is steeper than the angle of repose moves to its lower neighbors, and all ground creeps
a little (thermal erosion: Musgrave, Kolb and Mace, The synthesis and rendering of eroded fractal terrains, 1989). Before the last step,
large rivers fill the floors of their valleys, into which that step cuts their beds.

`erode` finds the drainage of a complete grid. `erode_window` works on a part of a finer grid, for which a coarser one is already eroded: it
inherits the areas of rivers from there, and follows water over a few samples only, so that a sample depends on those within HALO.

Heights (H, W) float32 are NaN where they are unknown; such samples stay as they are.
"""

import numpy as np
from scipy import ndimage

from .drainage import OFFSETS, PAIRS, Drainage, draw_lengths, find_drainage, find_receivers, measure_lengths, pair_windows

STEPS = 5  # steps of time per level of a pyramid
WINDOW_STEPS = 2  # the same in windows, which refine the valleys of coarser levels
REACH = 12  # samples over which windows follow water in a step
MIN_AREA = 8.0  # cells from which on water cuts
MAX_AREA = 4096.0  # Larger rivers cut no faster: their valleys were cut at coarser levels.
# Part of the drop to the lowest neighbor by which ground is lowered at random at first, so that rivers on even ground branch.
ROUGHNESS = 0.9
SLIDES = 4  # rounds of moving ground per step
SLIDE_RATE = 0.1  # part of an excessive difference that moves per round; stable below 0.125
CREEP_RATE = 0.002  # part of a difference that moves per round
FLOOR_AREA = 8000.0  # cells from which on a river covers the whole floor of its valley with its deposits
FLOOR_REACH = 8  # samples from a river within which it leaves deposits
FLOOR_ROUNDS = 16  # rounds of smoothing deposits: they reach that many samples
# Deposits end where ground is higher than the lowest sample within reach by these parts of the stable difference of heights per cell.
FLOOR_HEIGHT, MAX_FLOOR_HEIGHT = 0.75, 2.25
HALO = (
    WINDOW_STEPS * (SLIDES + 2 * REACH + 3) + FLOOR_REACH + FLOOR_ROUNDS
)  # samples; even, since windows begin with 2 x 2 samples of the coarser level


def erode(heights: np.ndarray, repose: float, rate: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the eroded heights of a complete grid, and the areas (H, W) float32 in cells that drain through its samples.

    repose: largest stable difference of heights per cell. rate: 1 for valleys that are cut completely. seed: of random numbers.
    """
    for step in range(STEPS):
        heights = slide(heights, repose, SLIDES)
        drainage = find_drainage(roughen(heights, (0, 0), seed), seed)
        areas = drainage.accumulate()
        heights = _incise(heights, drainage, _cutting_factors(areas, drainage.lengths, rate / STEPS))
        if step == STEPS - 2:
            heights = deposit(heights, areas, repose)
    return heights, areas.reshape(heights.shape).astype(np.float32)


def erode_window(
    heights: np.ndarray, inherited: np.ndarray, first: tuple[int, int], repose: float, rate: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return eroded heights and areas of a window, see `erode`; they are right for samples that are HALO away from its borders, unless
    these are borders of the grid.

    inherited: areas of the coarser samples, in cells of this grid. first: even row and column of the window in the grid.
    """
    diagonals = draw_lengths(first, heights.shape, seed)
    for step in range(WINDOW_STEPS):
        heights = slide(heights, repose, SLIDES)
        receivers = find_receivers(roughen(heights, first, seed), diagonals)
        flows = (receivers != np.arange(len(receivers))).astype(np.float32)
        areas = np.ones(len(receivers))
        for _ in range(REACH):
            areas = 1.0 + np.bincount(receivers, flows * areas, len(receivers))
        areas = np.maximum(areas.astype(np.float32), _find_rivers(heights, receivers, inherited))
        factors = flows * _cutting_factors(areas, measure_lengths(receivers, heights.shape[1]), rate / WINDOW_STEPS)
        old = heights.reshape(-1)
        new = old
        for _ in range(REACH):
            new = np.minimum(old, (old + factors * new[receivers]) / (1.0 + factors))
        heights = new.reshape(heights.shape)
        if step == WINDOW_STEPS - 2:
            heights = deposit(heights, areas, repose)
    return heights, areas.reshape(heights.shape)


def _find_rivers(heights: np.ndarray, receivers: np.ndarray, inherited: np.ndarray) -> np.ndarray:
    """Return areas (N,) of rivers that start in the lowest of the 2 x 2 samples of each coarser one, and follow the receivers (N,)."""
    rows, columns = heights.shape
    padded = np.pad(heights, [(0, rows % 2), (0, columns % 2)], constant_values=np.nan)
    padded[np.isnan(padded)] = np.inf
    blocks = padded.reshape(padded.shape[0] // 2, 2, -1, 2).transpose(0, 2, 1, 3).reshape(padded.shape[0] // 2, -1, 4)
    lowest = np.argmin(blocks, axis=2)
    rivers = np.zeros(padded.shape, np.float32)
    y, x = np.mgrid[: lowest.shape[0], : lowest.shape[1]]
    rivers[2 * y + lowest // 2, 2 * x + lowest % 2] = inherited
    rivers = rivers[:rows, :columns].reshape(-1)
    for _ in range(REACH):
        np.maximum.at(rivers, receivers, rivers.copy())
    return rivers


def roughen(heights: np.ndarray, first: tuple[int, int], seed: int) -> np.ndarray:
    """Return heights of a window, lowered at random by less than the drop to the lowest neighbor, so that no pit appears. first: see
    `erode_window`."""
    rows, columns = heights.shape
    padded = np.pad(heights, 1, constant_values=np.nan)
    drops = np.zeros_like(heights)
    for row, column in OFFSETS[:4]:
        np.fmax(drops, heights - padded[1 + row : 1 + row + rows, 1 + column : 1 + column + columns], out=drops)
    return heights - np.float32(ROUGHNESS) * drops * (draw_lengths(first, heights.shape, ~seed) - 1.0)


def slide(heights: np.ndarray, repose: float, rounds: int) -> np.ndarray:
    """Return heights after rounds of moving ground to lower neighbors; their sum stays. repose: see `erode`."""
    for _ in range(rounds):
        change = np.zeros_like(heights)
        for row, column in PAIRS:
            first, second = pair_windows(heights.shape, row, column)
            stable = np.float32(repose * np.hypot(row, column))
            differences = heights[first] - heights[second]
            moved = np.float32(SLIDE_RATE) * (differences - np.clip(differences, -stable, stable)) + np.float32(CREEP_RATE) * differences
            np.nan_to_num(moved, copy=False)
            change[first] -= moved
            change[second] += moved
        heights = heights + change
    return heights


def deposit(heights: np.ndarray, areas: np.ndarray, repose: float) -> np.ndarray:
    """Return heights (H, W) with the deposits of rivers: narrow valleys get floors, the flatter the larger their rivers are.

    areas: (N,), see `erode`. repose: see `erode`. Ground that is near a river and hardly higher approaches the mean of its neighbors.
    """
    rivers = ndimage.maximum_filter(areas.reshape(heights.shape).astype(np.float32), 2 * FLOOR_REACH + 1)
    low = ndimage.minimum_filter(np.where(np.isnan(heights), np.float32(np.inf), heights), 2 * FLOOR_REACH + 1)
    excess = (heights - low) / np.float32(repose) - np.float32(FLOOR_HEIGHT)
    weights = np.clip(rivers / np.float32(FLOOR_AREA), 0.0, 1.0)
    weights *= np.clip(1.0 - excess / np.float32(MAX_FLOOR_HEIGHT - FLOOR_HEIGHT), 0.0, 1.0)
    weights *= np.float32(0.125)
    for _ in range(FLOOR_ROUNDS):
        padded = np.pad(heights, 1, mode="edge")
        change = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:] - np.float32(4.0) * heights
        heights = heights + weights * np.nan_to_num(change)
    return heights


def _cutting_factors(areas: np.ndarray, lengths: np.ndarray, rate: float) -> np.ndarray:
    """Return the weights (N,) float32 of the heights of receivers in an implicit step."""
    return (rate * np.sqrt(np.clip(areas - MIN_AREA, 0.0, MAX_AREA)) / lengths).astype(np.float32)


def _incise(heights: np.ndarray, drainage: Drainage, factors: np.ndarray) -> np.ndarray:
    flat = heights.reshape(-1).copy()
    for start, stop in zip(drainage.starts[1:-1], drainage.starts[2:], strict=True):
        members = drainage.order[start:stop]
        own, factor = flat[members], factors[members]
        flat[members] = np.minimum(own, (own + factor * flat[drainage.receivers[members]]) / (1.0 + factor))
    return flat.reshape(heights.shape)
