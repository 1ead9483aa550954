"""Erosion of terrains, for `bench_bdam.py`: time, memory, and how close eroded ground comes to real ground."""

from argparse import Namespace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from bdam_builds import measure_process
from bdam_stores import Workplace, write_fractal
from bdam_terrains import CELL_SIZE, HEIGHT_STEP, FractalTerrain, read_real, write_grid
from scipy import ndimage

from farfield.addon.core.bdam.building.drainage import find_drainage
from farfield.addon.core.bdam.building.erosion import erode_heights
from farfield.addon.core.bdam.building.height_grid import HeightGrid
from farfield.addon.core.jobs.progress import run_to_end

REAL_CELL = 75.0  # meters, about the mean of both axes at 46 to 49 degrees
ENLARGED, FACTOR = "N49W123", 4  # The elevation model that is reduced by this factor, and enlarged again.
SIDE = 1025  # samples
AREAS = 2.0 ** np.arange(4, 15)  # samples that drain through a river, limits of classes
MIN_MEMBERS = 30  # samples of a class


def measure_erosion(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Measure the erosion of a fractal terrain, and compare a smaller one and an enlarged elevation model with real ones."""
    source = write_fractal(workplace, FractalTerrain(given.size, given.seed))
    figures: dict[str, Any] = {str(given.size): measure_process(["erode", str(source), "--out", str(workplace.folder / "eroded.raw")])}
    fractal = FractalTerrain(SIDE, given.seed).read_all()
    figures["fractal"] = describe_ground(fractal, CELL_SIZE)
    figures["fractal eroded"] = describe_ground(erode(fractal, CELL_SIZE, workplace.folder), CELL_SIZE)
    for path in sorted(given.data.glob("*.tif")):
        heights = read_real(path)[0][: SIDE // FACTOR * FACTOR, : SIDE // FACTOR * FACTOR]
        figures[path.stem] = describe_ground(heights, REAL_CELL)
        if path.stem == ENLARGED:
            reduced = heights.reshape(SIDE // FACTOR, FACTOR, -1, FACTOR).mean(axis=(1, 3))
            enlarged = ndimage.zoom(reduced, FACTOR, order=3).astype(np.float32)
            figures[f"{ENLARGED} enlarged"] = describe_ground(enlarged, REAL_CELL)
            figures[f"{ENLARGED} enlarged, eroded"] = describe_ground(erode(enlarged, REAL_CELL, workplace.folder), REAL_CELL)
    return figures


def erode(heights: np.ndarray, cell_size: float, folder: Path) -> np.ndarray:
    """Return eroded heights (H, W) float32, meters."""
    source = write_grid(heights, HEIGHT_STEP, folder / "before-erosion.raw")
    result = HeightGrid(folder / "after-erosion.raw", *heights.shape)
    run_to_end(erode_heights(source, result.path, cell_size / HEIGHT_STEP, 1.0))
    steps, _ = result.read(slice(0, result.rows), slice(0, result.columns))
    return (steps * HEIGHT_STEP).astype(np.float32)


def describe_ground(heights: np.ndarray, cell_size: float) -> dict[str, float]:
    """Return measures of heights (H, W) float32 in meters.

    concavity: the power of the drained area by which gradients of rivers fall. pits_per_1000: samples lower than all neighbors.
    degrees: gradients that 10, 50, 90 and 99 % of the samples are below. hypsometric_integral: the mean height, 0 to 1 of the range.
    """
    drainage = find_drainage(heights, 0)
    areas, flat = drainage.accumulate(), heights.reshape(-1)
    gradients = (flat - flat[drainage.receivers]) / (drainage.lengths * cell_size)
    means, centers = [], []
    for low, high in pairwise(AREAS):
        members = (areas >= low) & (areas < high) & (gradients > 0.0)
        if np.count_nonzero(members) >= MIN_MEMBERS:
            means.append(gradients[members].mean())
            centers.append(np.sqrt(low * high))
    is_pit = heights[1:-1, 1:-1] < ndimage.minimum_filter(heights, footprint=np.ones((3, 3)) - np.pad([[1.0]], 1))[1:-1, 1:-1]
    degrees = np.degrees(np.arctan(np.hypot(*np.gradient(heights, cell_size))))
    return {
        "concavity": round(-float(np.polyfit(np.log(centers), np.log(means), 1)[0]), 2),
        "pits_per_1000": round(1e3 * float(is_pit.mean()), 2),
        "degrees": [round(float(value), 1) for value in np.percentile(degrees, [10, 50, 90, 99])],
        "hypsometric_integral": round(float((heights.mean() - heights.min()) / np.ptp(heights)), 2),
        "mean_height_m": round(float(heights.mean()), 1),
    }
