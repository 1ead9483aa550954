"""Fragments: the intersections of camera rays with a cloud's quads, for alpha compositing on arrays as a renderer does it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import concatenate_ranges
from ...billboards.texels import QuadPolygons, Texels
from ...geometry.cameras import OrthographicView

MIN_PROJECTED_AREA = 1e-3  # In rays; quads with a smaller projection are skipped.


@dataclass(frozen=True)
class Fragments:
    """F intersections of the rays of a view with quads, ordered by ray and along each ray from near to far.

    ray_count: number of rays, including those without intersections. ray_indices (F,) int32, ascending. texel_indices (F, 4) int32 and
    weights (F, 4) float32: texels and weights of the bilinear texture lookup.
    """

    ray_count: int
    ray_indices: np.ndarray
    texel_indices: np.ndarray
    weights: np.ndarray

    def __len__(self) -> int:
        return len(self.ray_indices)

    @property
    def nbytes(self) -> int:
        """Size of the arrays in bytes."""
        return self.ray_indices.nbytes + self.texel_indices.nbytes + self.weights.nbytes

    @property
    def max_depth_complexity(self) -> int:
        """Largest number of quads along one ray."""
        return int(self._lengths.max(initial=0))

    @cached_property
    def starts(self) -> np.ndarray:
        """Index of the first fragment of each ray that has fragments."""
        return np.flatnonzero(np.diff(self.ray_indices, prepend=-1))

    def subset(self, mask: np.ndarray) -> "Fragments":
        """Return the fragments where `mask` (F,) bool is set, as if the rays met nothing else."""
        return Fragments(self.ray_count, self.ray_indices[mask], self.texel_indices[mask], self.weights[mask])

    def transmittance(self, alpha: np.ndarray) -> np.ndarray:
        """Return the transmittance (F,) float32 of the fragments in front of each fragment, for the fragments' `alpha` (F,)."""
        logarithms = np.log(np.maximum(1.0 - alpha.astype(np.float64), 1e-9))
        before = np.cumsum(logarithms) - logarithms
        return np.exp(before - np.repeat(before[self.starts], self._lengths)).astype(np.float32)

    def sum_behind(self, values: np.ndarray) -> np.ndarray:
        """Return for each fragment the sum (F,) float32 of `values` (F,) over the fragments behind it."""
        cumulative = np.cumsum(values, dtype=np.float64)
        ends = self.starts + self._lengths - 1
        return (np.repeat(cumulative[ends], self._lengths) - cumulative).astype(np.float32)

    @cached_property
    def _lengths(self) -> np.ndarray:
        return np.diff(np.append(self.starts, len(self)))


def find_fragments(quads: QuadPolygons, texels: Texels, view: OrthographicView, rays_per_side: int) -> Fragments:
    """Intersect `quads` with rays_per_side x rays_per_side rays per pixel of `view`, through the centers of equal squares.

    Rays are ordered by pixel, row by row; the rays of a pixel are consecutive.
    """
    ray_view = view.supersample(rays_per_side)
    ray_count = view.resolution**2 * rays_per_side**2
    if not quads.corners:
        return Fragments(ray_count, np.zeros(0, np.int32), np.zeros((0, 4), np.int32), np.zeros((0, 4), np.float32))
    polygons, rows, columns, values = _intersect(quads, ray_view)
    quad_indices = quads.quad_indices[polygons]
    pixels = rows // rays_per_side * view.resolution + columns // rays_per_side
    ray_indices = (pixels * rays_per_side + rows % rays_per_side) * rays_per_side + columns % rays_per_side
    order = np.lexsort((-values[:, 2], ray_indices))
    texel_indices, weights = _bilinear_taps(texels, values[order, :2], quad_indices[order])
    return Fragments(ray_count, ray_indices[order].astype(np.int32), texel_indices, weights)


def _intersect(quads: QuadPolygons, view: OrthographicView) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Intersect rays through the pixel centers of `view` with quads.

    Returns polygon, row and column (M,) int64, and (M, 3): texture coordinates in texels and height above the view's center.
    """
    counts = np.array([len(corners) for corners in quads.corners])
    first, offsets = np.cumsum(counts) - counts, np.arange(counts.max())
    # Shorter outlines repeat their last corner: an edge of zero length, which excludes no ray.
    corners, is_corner = first[:, None] + np.minimum(offsets, counts[:, None] - 1), offsets < counts[:, None]
    projected, heights = view.project(np.concatenate(quads.corners))
    values = np.column_stack([np.concatenate(quads.texel_coordinates), heights])[corners]
    outlines = projected[corners]
    following = np.roll(outlines, -1, axis=1)
    areas = 0.5 * (outlines[..., 0] * following[..., 1] - outlines[..., 1] * following[..., 0]).sum(axis=1)
    drawn = np.flatnonzero(np.abs(areas) >= MIN_PROJECTED_AREA)
    edges = np.sign(areas[drawn])[:, None, None] * (following - outlines)[drawn]
    spans = _find_spans(outlines[drawn], edges, view.resolution)
    widths = spans[:, 3] - spans[:, 2]
    outline_indices, rows = np.repeat(spans[:, :2], widths, axis=0).T
    columns = concatenate_ranges(spans[:, 2], widths)
    affine = _fit_affine(outlines[drawn], values[drawn], is_corner[drawn])[outline_indices]
    x, y = columns[:, None] + 0.5, rows[:, None] + 0.5
    return drawn[outline_indices], rows, columns, x * affine[:, 0] + y * affine[:, 1] + affine[:, 2]


def _find_spans(outlines: np.ndarray, edges: np.ndarray, resolution: int) -> np.ndarray:
    """Return the rows of pixels inside convex `outlines` (Q, C, 2) with counterclockwise `edges` (Q, C, 2) in a square image.

    Each span is outline, row, first column and end column, (S, 4) int64.
    """
    low = np.clip(np.ceil(outlines[..., 1].min(axis=1) - 0.5), 0, resolution).astype(np.int64)
    high = np.clip(np.floor(outlines[..., 1].max(axis=1) - 0.5) + 1.0, low, resolution).astype(np.int64)
    outline_indices = np.repeat(np.arange(len(outlines)), high - low)
    rows = concatenate_ranges(low, high - low)
    left, right = np.zeros(len(rows)), np.full(len(rows), float(resolution))
    for corner in range(outlines.shape[1]):
        (start_x, start_y), (edge_x, edge_y) = outlines[outline_indices, corner].T, edges[outline_indices, corner].T
        is_crossing = edge_y != 0.0
        crossing_x = start_x + edge_x * (rows + 0.5 - start_y) / np.where(is_crossing, edge_y, 1.0)
        right = np.where(edge_y > 0.0, np.minimum(right, crossing_x), right)
        left = np.where(edge_y < 0.0, np.maximum(left, crossing_x), left)
    first = np.clip(np.ceil(left - 0.5), 0, resolution).astype(np.int64)
    end = np.clip(np.floor(right - 0.5) + 1.0, first, resolution).astype(np.int64)
    return np.column_stack([outline_indices, rows, first, end])


def _fit_affine(outlines: np.ndarray, values: np.ndarray, is_corner: np.ndarray) -> np.ndarray:
    """Fit affine maps (Q, 3, D) from image positions to values; the rows are factors of x, y and 1. Least squares.

    outlines (Q, C, 2), values (Q, C, D): at the corners of planar polygons; entries outside `is_corner` (Q, C) are ignored.
    """
    counts = is_corner.sum(axis=1)[:, None]
    center, mean = ((array * is_corner[..., None]).sum(axis=1) / counts for array in (outlines, values))
    centered_outlines, centered_values = (
        (array - offset[:, None]) * is_corner[..., None] for array, offset in ((outlines, center), (values, mean))
    )
    linear_part = np.linalg.pinv(centered_outlines, rcond=1e-14) @ centered_values  # Normal equations would degrade thin oblique polygons.
    return np.concatenate([linear_part, (mean - np.einsum("qi,qid->qd", center, linear_part))[:, None]], axis=1)


def _bilinear_taps(texels: Texels, uv: np.ndarray, quad_indices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return texel indices (F, 4) and weights (F, 4) of a bilinear lookup at `uv` (F, 2), in texels.

    Taps outside the texels of their quad (`quad_indices` (F,)) are replaced by the nearest tap inside; weights are 0 when there is none.
    """
    low = np.floor(uv - 0.5).astype(np.int64)
    x, y = (uv - 0.5 - low).T.astype(np.float32)
    index_map = texels.index_map
    taps = np.full((len(uv), 4), -1, np.int64)
    for tap, (right, up) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        column = np.clip(low[:, 0] + right, 0, texels.texture_size[0] - 1)
        row = np.clip(low[:, 1] + up, 0, texels.texture_size[1] - 1)
        found = index_map[row, column]
        taps[:, tap] = np.where(texels.quad_indices[found] == quad_indices, found, -1)
    weights = np.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y], axis=1)
    best = np.where(taps >= 0, weights, -1.0).argmax(axis=1)
    nearest = taps[np.arange(len(taps)), best]
    taps = np.where(taps >= 0, taps, nearest[:, None])
    return np.maximum(taps, 0).astype(np.int32), np.where(taps >= 0, weights, np.float32(0.0))
