"""Largest vertical distances between triangles and the field, measured at all samples (BDAM, section 5.2)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...arrays import concatenate_ranges
from ..triangle_gradients import weigh_gradients
from .height_grid import HeightGrid, split_rows

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
    low, high = np.ceil(corners[..., 1].min(axis=1)).astype(np.int64), np.floor(corners[..., 1].max(axis=1)).astype(np.int64)
    planes = _Planes(corners, heights)
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
            rows = np.repeat(triangles[start:stop], counts[start:stop])
            y = concatenate_ranges(first[triangles[start:stop]], counts[start:stop])
            for spans, distances, known in planes.measure_spans(rows, y, window, None if is_complete else is_known, (left, band.start)):
                np.maximum.at(errors, spans, distances)
                has_known[spans[known]] = True
            start = stop
    return Measurement(errors, ~has_known)


class _Planes:
    """Heights of triangles as linear functions of grid coordinates."""

    def __init__(self, corners: np.ndarray, heights: np.ndarray) -> None:
        self._x, self._y = corners[..., 0].astype(np.float64), corners[..., 1].astype(np.float64)
        z = heights.astype(np.float64)
        along_x, along_y, area = weigh_gradients(self._x.T, self._y.T, z.T)
        self._gradient_x, self._gradient_y = along_x / area, along_y / area
        self._offset = z[:, 0] - self._gradient_x * self._x[:, 0] - self._gradient_y * self._y[:, 0]

    def measure_spans(
        self, triangles: np.ndarray, y: np.ndarray, window: np.ndarray, is_known: np.ndarray | None, origin: tuple[int, int]
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Measure rows `y` (N,) of `triangles` (N,) against heights (H, W) whose lower left sample is at `origin`.

        Args:
            is_known: (H, W) bool; None: all are.

        Yields:
            Triangles (M,), largest distances (M,) in one row of each, and whether one of the samples is known (M,).
        """
        left, right = self._find_span(triangles, y)
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

    def _find_span(self, triangles: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the first and last column (N,) int64 of rows `y` (N,) of counterclockwise `triangles` (N,)."""
        left, right = np.full(len(y), -np.inf), np.full(len(y), np.inf)
        for start, end in ((0, 1), (1, 2), (2, 0)):
            x0, y0 = self._x[triangles, start], self._y[triangles, start]
            height = self._y[triangles, end] - y0
            with np.errstate(divide="ignore", invalid="ignore"):
                crossing = x0 + (y - y0) * ((self._x[triangles, end] - x0) / height)
            left = np.where(height < 0.0, np.maximum(left, np.ceil(crossing - TOLERANCE)), left)
            right = np.where(height > 0.0, np.minimum(right, np.floor(crossing + TOLERANCE)), right)
        return left.astype(np.int64), right.astype(np.int64)
