"""What a viewer's rays meet of a cloud's quads: the compositing that a renderer does, as arrays."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .texels import Quads, Texels, View

EDGE_ON = 1e-3  # of the rays that would cross a quad seen face on: below it none does


@dataclass(frozen=True)
class Fragments:
    """F places where rays of a view meet quads, ray by ray and nearest first along each.

    rays: how many there are, those that meet nothing included. ray (F,) int32, ascending. texels (F, 4) int32 and shares (F, 4) float32:
    whose values the texture unit mixes there.
    """

    rays: int
    ray: np.ndarray
    texels: np.ndarray
    shares: np.ndarray

    def __len__(self) -> int:
        return len(self.ray)

    @property
    def bytes(self) -> int:
        """What the arrays take."""
        return self.ray.nbytes + self.texels.nbytes + self.shares.nbytes

    @property
    def deepest(self) -> int:
        """The most quads behind each other along a ray."""
        return int(self._lengths.max(initial=0))

    @cached_property
    def starts(self) -> np.ndarray:
        """Where a ray's fragments begin."""
        return np.flatnonzero(np.diff(self.ray, prepend=-1))

    def chosen(self, which: np.ndarray) -> "Fragments":
        """Some of them (F,) bool alone, as if rays met nothing else."""
        return Fragments(self.rays, self.ray[which], self.texels[which], self.shares[which])

    def transmitted(self, alpha: np.ndarray) -> np.ndarray:
        """How much (F,) of each fragment is seen through those before it, where they have `alpha` (F,)."""
        logarithms = np.log(np.maximum(1.0 - alpha.astype(np.float64), 1e-9))
        before = np.cumsum(logarithms) - logarithms
        return np.exp(before - np.repeat(before[self.starts], self._lengths)).astype(np.float32)

    def behind(self, sent: np.ndarray) -> np.ndarray:
        """What the fragments behind each one send (F,), where each sends `sent` (F,)."""
        up_to = np.cumsum(sent, dtype=np.float64)
        ends = self.starts + self._lengths - 1
        return (np.repeat(up_to[ends], self._lengths) - up_to).astype(np.float32)

    @cached_property
    def _lengths(self) -> np.ndarray:
        return np.diff(np.append(self.starts, len(self)))


def fragments_of(quads: Quads, texels: Texels, view: View, parts: int) -> Fragments:
    """The fragments of `quads` under parts x parts rays a pixel of `view`, through the middles of equal squares.

    Rays are numbered row by row, pixel by pixel, the parts of a pixel together.
    """
    fine = view.finer(parts)
    if not quads.corners:
        return Fragments(view.side**2 * parts**2, np.zeros(0, np.int32), np.zeros((0, 4), np.int32), np.zeros((0, 4), np.float32))
    owners, rows, columns, carried = _crossings(quads, fine)
    ray = ((rows // parts * view.side + columns // parts) * parts + rows % parts) * parts + columns % parts
    order = np.lexsort((-carried[:, 2], ray))
    numbers, shares = _texture_unit(texels, carried[order, :2], owners[order])
    return Fragments(view.side**2 * parts**2, ray[order].astype(np.int32), numbers, shares)


def _crossings(quads: Quads, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Where the rays through the middles of the pixels of `view` meet quads: quad, row and column (M,) int64; and (M, 3), the place in the
    texture and the height above the view's centre."""
    counts = np.array([len(corners) for corners in quads.corners])
    first, number = np.cumsum(counts) - counts, np.arange(counts.max())
    # Shorter outlines repeat their last corner: an edge without length, on whose inner side all rays are.
    corners, is_corner = first[:, None] + np.minimum(number, counts[:, None] - 1), number < counts[:, None]
    outline, heights = view.project(np.concatenate(quads.corners))
    values = np.column_stack([np.concatenate(quads.coordinates), heights])[corners]
    outlines = outline[corners]
    following = np.roll(outlines, -1, axis=1)
    areas = 0.5 * (outlines[..., 0] * following[..., 1] - outlines[..., 1] * following[..., 0]).sum(axis=1)
    faced = np.flatnonzero(np.abs(areas) >= EDGE_ON)
    edges = np.sign(areas[faced])[:, None, None] * (following - outlines)[faced]
    spans = _spans(outlines[faced], edges, view.side)
    widths = spans[:, 3] - spans[:, 2]
    owners, rows, columns, _ = np.repeat(spans, widths, axis=0).T
    columns = columns + _counted(widths)
    affine = _affine(outlines[faced], values[faced], is_corner[faced])[owners]
    x, y = columns[:, None] + 0.5, rows[:, None] + 0.5
    return faced[owners], rows, columns, x * affine[:, 0] + y * affine[:, 1] + affine[:, 2]


def _spans(outlines: np.ndarray, edges: np.ndarray, side: int) -> np.ndarray:
    """Rows of pixels within convex `outlines` (Q, C, 2), whose `edges` (Q, C, 2) go round to the left, in a square of `side` pixels:
    outline, row, first column and the one after the last (S, 4) int64."""
    low = np.clip(np.ceil(outlines[..., 1].min(axis=1) - 0.5), 0, side).astype(np.int64)
    high = np.clip(np.floor(outlines[..., 1].max(axis=1) - 0.5) + 1.0, low, side).astype(np.int64)
    owners = np.repeat(np.arange(len(outlines)), high - low)
    rows = low[owners] + _counted(high - low)
    left, right = np.zeros(len(rows)), np.full(len(rows), float(side))
    for corner in range(outlines.shape[1]):
        (from_x, from_y), (along_x, along_y) = outlines[owners, corner].T, edges[owners, corner].T
        leaning = along_y != 0.0
        crossed = from_x + along_x * (rows + 0.5 - from_y) / np.where(leaning, along_y, 1.0)
        right = np.where(along_y > 0.0, np.minimum(right, crossed), right)
        left = np.where(along_y < 0.0, np.maximum(left, crossed), left)
    first = np.clip(np.ceil(left - 0.5), 0, side).astype(np.int64)
    stop = np.clip(np.floor(right - 0.5) + 1.0, first, side).astype(np.int64)
    return np.column_stack([owners, rows, first, stop])


def _affine(outlines: np.ndarray, values: np.ndarray, is_corner: np.ndarray) -> np.ndarray:
    """What carries `values` (Q, C, D) at the corners of planar polygons over to a place in a picture: (Q, 3, D), times x, y and 1.

    In the picture the corners are `outlines` (Q, C, 2); some count twice but for `is_corner` (Q, C). Least squares.
    """
    counts = is_corner.sum(axis=1)[:, None]
    middle, mean = ((each * is_corner[..., None]).sum(axis=1) / counts for each in (outlines, values))
    apart, own = ((each - at[:, None]) * is_corner[..., None] for each, at in ((outlines, middle), (values, mean)))
    slopes = np.linalg.pinv(apart, rcond=1e-14) @ own  # squared, thin slanting polygons would be lines
    return np.concatenate([slopes, (mean - np.einsum("qi,qid->qd", middle, slopes))[:, None]], axis=1)


def _counted(counts: np.ndarray) -> np.ndarray:
    """0, 1 and so on up to each of `counts` (N,), one after the other."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def _texture_unit(texels: Texels, places: np.ndarray, owners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (F, 4) and shares (F, 4) of the texels around `places` (F, 2); beyond its quad's own, a place takes the nearest of them."""
    low = np.floor(places - 0.5).astype(np.int64)
    x, y = (places - 0.5 - low).T.astype(np.float32)
    numbers = texels.numbers
    own = np.full((len(places), 4), -1, np.int64)
    for tap, (right, up) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        column = np.clip(low[:, 0] + right, 0, texels.size[0] - 1)
        row = np.clip(low[:, 1] + up, 0, texels.size[1] - 1)
        found = numbers[row, column]
        own[:, tap] = np.where(texels.quads[found] == owners, found, -1)
    shares = np.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y], axis=1)
    best = np.where(own >= 0, shares, -1.0).argmax(axis=1)
    nearest = own[np.arange(len(own)), best]
    own = np.where(own >= 0, own, nearest[:, None])
    return np.maximum(own, 0).astype(np.int32), np.where(own >= 0, shares, np.float32(0.0))
