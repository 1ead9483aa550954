"""Half-edge collapses of Farfield on a whole field as one domain, whose border stays on its lines, for `bench_bdam.py`."""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from farfield.addon.core.bdam.building.diamond_meshes import DiamondMeshes
from farfield.addon.core.bdam.building.simplified_diamonds import choose_grid_collapses
from farfield.addon.core.bdam.simplification.collapse_costs import FREE, HORIZONTAL, LOCKED, VERTICAL
from farfield.addon.core.bdam.simplification.decimation import MeshBatch, simplify

MIN_VERTICES = 64


@dataclass(frozen=True)
class Simplified:
    """A simplified field. triangles: (T, 3) int32, of samples row * columns + column. cpu_seconds: since the start, of this process."""

    triangles: np.ndarray
    seconds: float
    cpu_seconds: float


def halve_field(heights: np.ndarray) -> Iterator[Simplified]:
    """Yield triangulations of heights (H, W), in steps, with a half, a quarter, an eighth of the samples and so on.

    Each begins with the one before it. All samples that were removed are measured again, which a build does only with some of them.
    """
    rows, columns = heights.shape
    y, x = (axis.ravel().astype(np.int32) for axis in np.mgrid[:rows, :columns])
    z, domains = heights.ravel(), np.zeros(len(x), np.int32)
    triangles, lines = _triangulate(rows, columns), _classify(x, y, rows, columns)
    samples, sample_triangles, first = np.zeros(0, np.int32), np.zeros(0, np.int32), None
    started = time.perf_counter(), time.process_time()
    count = len(x)
    while count > 2 * MIN_VERTICES:
        excess = np.array([count // 2])
        if count == len(x):
            no_gradients, no_samples = np.full((count, 2), np.nan, np.float32), np.zeros((0, 3), np.int32)
            meshes = DiamondMeshes(domains, x, y, z.astype(np.int32), no_gradients, triangles, no_samples, np.zeros(0, np.int32))
            first = choose_grid_collapses(meshes, lines, excess)
        points = (np.concatenate([axis, axis[samples]]) for axis in (x, y, z.astype(np.float32)))
        batch = MeshBatch(*points, lines, domains, triangles, sample_triangles, max(rows, columns))
        triangles, removed = simplify(batch, excess, np.full(1, np.inf, np.float32), first)
        vertices = np.concatenate([np.arange(len(x), dtype=np.int32), samples])  # the simplifier numbers samples after all vertices
        samples, sample_triangles, first = vertices[removed.vertices], removed.triangles, None
        count = len(np.unique(triangles))
        yield Simplified(triangles, time.perf_counter() - started[0], time.process_time() - started[1])


def _triangulate(rows: int, columns: int) -> np.ndarray:
    """Return counterclockwise triangles (T, 3) int32 of all samples with alternating diagonals, as in a build."""
    numbers = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    y, x = np.mgrid[: rows - 1, : columns - 1]
    a, b, c, d = numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, 1:], numbers[1:, :-1]
    is_even = ((x + y) % 2 == 0)[..., None]
    first = np.where(is_even, np.stack([a, b, c], axis=-1), np.stack([a, b, d], axis=-1))
    second = np.where(is_even, np.stack([a, c, d], axis=-1), np.stack([b, c, d], axis=-1))
    return np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])


def _classify(x: np.ndarray, y: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Return the constraints (V,) int8: borders stay on their lines, the four corners stay where they are."""
    lines = np.full(len(x), FREE, np.int8)
    on_side, on_end = (x == 0) | (x == columns - 1), (y == 0) | (y == rows - 1)
    lines[on_side], lines[on_end], lines[on_side & on_end] = VERTICAL, HORIZONTAL, LOCKED
    return lines
