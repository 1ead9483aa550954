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
    rows, columns, heights, places, owners = [], [], [], [], []
    for number, (corners, coordinates) in enumerate(zip(quads.corners, quads.coordinates, strict=True)):
        outline, depth = fine.project(corners)
        inside = _rays_inside(outline, fine.side)
        if len(inside) == 0:
            continue
        carried = _carried(outline, np.column_stack([coordinates, depth]), inside)
        rows.append(inside[:, 1])
        columns.append(inside[:, 0])
        places.append(carried[:, :2])
        heights.append(carried[:, 2])
        owners.append(np.full(len(inside), number, np.int32))
    if not rows:
        return Fragments(view.side**2 * parts**2, np.zeros(0, np.int32), np.zeros((0, 4), np.int32), np.zeros((0, 4), np.float32))
    row, column, height, owner = (np.concatenate(each) for each in (rows, columns, heights, owners))
    ray = ((row // parts * view.side + column // parts) * parts + row % parts) * parts + column % parts
    order = np.lexsort((-height, ray))
    numbers, shares = _texture_unit(texels, np.concatenate(places)[order], owner[order])
    return Fragments(view.side**2 * parts**2, ray[order].astype(np.int32), numbers, shares)


def _rays_inside(outline: np.ndarray, side: int) -> np.ndarray:
    """Column and row (M, 2) of those rays, of a square of `side` along each side, that pass within a convex `outline` (C, 2)."""
    following = np.roll(outline, -1, axis=0)
    area = 0.5 * float(np.sum(outline[:, 0] * following[:, 1] - outline[:, 1] * following[:, 0]))
    low = np.clip(np.floor(outline.min(axis=0)), 0, side).astype(np.int64)
    high = np.clip(np.ceil(outline.max(axis=0)), 0, side).astype(np.int64)
    if abs(area) < EDGE_ON or (high <= low).any():
        return np.zeros((0, 2), np.int64)
    x, y = np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5
    within = np.ones((len(y), len(x)), bool)
    for (from_x, from_y), (along_x, along_y) in zip(outline, np.sign(area) * (following - outline), strict=True):
        within &= along_x * (y[:, None] - from_y) - along_y * (x[None, :] - from_x) >= 0.0
    found = np.argwhere(within)
    return found[:, ::-1] + low


def _carried(outline: np.ndarray, values: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """`values` (C, D) at the corners of a planar polygon, carried over to `rays` (M, 2)."""
    affine, *_ = np.linalg.lstsq(np.column_stack([outline, np.ones(len(outline))]), values, rcond=None)
    return np.column_stack([rays + 0.5, np.ones(len(rays))]) @ affine


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
