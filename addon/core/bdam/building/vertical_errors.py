"""Largest vertical distances between triangles and the field, measured at all samples (BDAM, section 5.2)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...arrays import concatenate_ranges
from ..height_meshes import weigh_gradients
from .height_grid import HeightGrid, split_rows
from .patch_set import PatchSet

MAX_SPANS = 1 << 14  # rows of triangles at once
MAX_SAMPLES = 1 << 16  # samples at once
TOLERANCE = 1e-6  # cells beyond an edge that count as on it


@dataclass(frozen=True)
class Measurement:
    """Distances of triangles to the field.

    errors: (T,) float32, the largest vertical distance in steps to a known sample in each triangle. is_hole: (T,) bool, triangles without
    known samples.
    """

    errors: np.ndarray
    is_hole: np.ndarray


def measure_triangles(corners: np.ndarray, heights: np.ndarray, grid: HeightGrid) -> Measurement:
    """Measure triangles within the field.

    Args:
        corners: (T, 3, 2), grid coordinates (x, y), integers if they are samples. heights: (T, 3) in steps.
    """
    errors, has_known = np.zeros(len(corners), np.float32), np.zeros(len(corners), bool)
    if not len(corners):
        return Measurement(errors, ~has_known)
    left, right = int(corners[..., 0].min()), int(np.ceil(corners[..., 0].max())) + 1
    planes = _Planes(corners, heights)
    low, high = planes.find_rows()
    for band in split_rows(int(low.min()), int(high.max()) + 1, right - left):
        first, last = np.maximum(low, band.start), np.minimum(high, band.stop - 1)
        triangles = np.flatnonzero(last >= first)
        if not len(triangles):
            continue
        window, is_known = grid.read(band, slice(left, right))
        is_complete = bool(is_known.all())
        counts = last[triangles] - first[triangles] + 1
        ends = np.cumsum(counts)
        start = 0
        while start < len(triangles):
            stop = max(int(np.searchsorted(ends, (ends[start - 1] if start else 0) + MAX_SPANS, side="right")), start + 1)
            part = triangles[start:stop]
            for spans, distances, known in planes.measure_spans(
                part, first[part], counts[start:stop], window, None if is_complete else is_known, (left, band.start)
            ):
                np.maximum.at(errors, spans, distances)
                has_known[spans[known]] = True
            start = stop
    return Measurement(errors, ~has_known)


class _Planes:
    """Heights of triangles as linear functions of grid coordinates, and their edges: the long one from the lowest corner to the highest,
    and the two others on one side of it."""

    def __init__(self, corners: np.ndarray, heights: np.ndarray) -> None:
        x, y, z = corners[..., 0].T.astype(np.float64), corners[..., 1].T.astype(np.float64), heights.T.astype(np.float64)
        along_x, along_y, area = weigh_gradients(x, y, z)
        self._gradient_x, self._gradient_y = along_x / area, along_y / area
        self._offset = z[0] - self._gradient_x * x[0] - self._gradient_y * y[0]
        order = np.argsort(y, axis=0, kind="stable")
        (x0, x1, x2), (y0, self._median, self._high) = np.take_along_axis(x, order, axis=0), np.take_along_axis(y, order, axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            x_per_row = (x2 - x0) / (self._high - y0), (x1 - x0) / (self._median - y0), (x2 - x1) / (self._high - self._median)
        self._low, self._starts, self._x_per_row = y0, (x0, x0, x1), x_per_row
        self._is_long_left = (x1 - x0) * (self._high - y0) > (x2 - x0) * (self._median - y0)

    def find_rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the first and last row (T,) int64 of all triangles."""
        return np.ceil(self._low).astype(np.int64), np.floor(self._high).astype(np.int64)

    def measure_spans(
        self,
        triangles: np.ndarray,
        first: np.ndarray,
        counts: np.ndarray,
        window: np.ndarray,
        is_known: np.ndarray | None,
        origin: tuple[int, int],
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Measure rows of `triangles` (N,) against heights (H, W) whose lower left sample is at `origin`.

        Args:
            first, counts: (N,) int64, the first row and the number of rows of each triangle. is_known: (H, W) bool; None: all are.

        Yields:
            Triangles (M,), largest distances (M,) in one row of each, and whether one of the samples is known (M,).
        """
        y = concatenate_ranges(first, counts)
        left, right = self._find_spans(triangles, counts, y)
        triangles = np.repeat(triangles, counts)
        lengths = right - left + 1
        used = np.flatnonzero(lengths > 0)
        triangles, y, left, lengths = triangles[used], y[used], left[used], lengths[used]
        ends = np.cumsum(lengths)
        start = 0
        while start < len(triangles):
            stop = max(int(np.searchsorted(ends, (ends[start - 1] if start else 0) + MAX_SAMPLES, side="right")), start + 1)
            part = slice(start, stop)
            counts, of_triangle = lengths[part], triangles[part]
            gradient = self._gradient_x[of_triangle]
            base = self._offset[of_triangle] + self._gradient_y[of_triangle] * y[part] + gradient * left[part]
            starts = np.cumsum(counts) - counts
            steps = np.arange(counts.sum(), dtype=np.int32)
            steps -= np.repeat(starts.astype(np.int32), counts)  # from the first sample of each span
            flat = np.repeat(((y[part] - origin[1]) * window.shape[1] - origin[0] + left[part]).astype(np.int32), counts)
            flat += steps
            distances = np.repeat(gradient.astype(np.float32), counts)
            distances *= steps.astype(np.float32)
            distances += np.repeat(base.astype(np.float32), counts)
            distances -= window.reshape(-1).take(flat).astype(np.float32)
            np.abs(distances, out=distances)
            known = np.ones(len(of_triangle), bool)
            if is_known is not None:
                sample_is_known = is_known.reshape(-1)[flat]
                distances *= sample_is_known
                known = np.logical_or.reduceat(sample_is_known, starts)
            yield of_triangle, np.maximum.reduceat(distances, starts), known
            start = stop

    def _find_spans(self, triangles: np.ndarray, counts: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the first and last column (M,) int64 of rows `y` (M,), which are `counts` (N,) rows of each of `triangles` (N,)."""
        low, median, is_long_left = (np.repeat(values[triangles], counts) for values in (self._low, self._median, self._is_long_left))
        above = y - low
        crossings = [np.repeat(self._starts[0][triangles], counts) + above * np.repeat(self._x_per_row[0][triangles], counts)]
        is_upper = (y > median) | (median == low)
        rows = np.repeat(triangles, counts)
        start, step = (np.where(is_upper, upper[rows], lower[rows]) for lower, upper in (self._starts[1:], self._x_per_row[1:]))
        crossings.append(start + (y - np.where(is_upper, median, low)) * step)
        left, right = np.where(is_long_left, crossings, crossings[::-1])
        return np.ceil(left - TOLERANCE).astype(np.int64), np.floor(right + TOLERANCE).astype(np.int64)


def bound_curvature_errors(patches: PatchSet, curvature: float) -> np.ndarray:
    """Return upper bounds (P,) float32, in steps, of the vertical distances of patches in the local frame to the same patches in the grid.

    A point with the barycentric coordinates w in a triangle of the grid, and the point with the same coordinates in the triangle whose
    vertices were projected, are at most half of the curvature times the sum of w_i |v_i - p|^2 apart (Taylor's theorem), and that sum is at
    most a third of the square of the longest edge. The height changes by that distance times the gradient. Close to an edge, the gradient
    may be that of the other triangle; so the largest one around the vertices is used.

    Args:
        curvature: in cells per square cell, see `measure_curvature` of frames.
    """
    if not curvature:
        return np.zeros(len(patches.indices), np.float32)
    starts = np.repeat(patches.vertex_starts[:-1], np.diff(patches.triangle_starts))
    vertices = patches.triangles + starts[:, None]
    x, y, z = (axis.astype(np.float64)[vertices.T] for axis in (patches.x, patches.y, patches.z))
    along_x, along_y, area = weigh_gradients(x, y, z)
    around = np.zeros(len(patches.x))
    np.maximum.at(around, vertices, np.hypot(along_x / area, along_y / area)[:, None])
    edges = np.stack([x - np.roll(x, 1, axis=0), y - np.roll(y, 1, axis=0)])
    longest_squares = (edges**2).sum(axis=0).max(axis=0)
    bounds = around[vertices].max(axis=1) * (curvature / 6.0) * longest_squares
    return np.maximum.reduceat(bounds, patches.triangle_starts[:-1]).astype(np.float32)
