"""The transition between boxes: towards its border, the densities of a box become those of the next coarser one.

Without it, whatever only the finer box resolves, such as a cave, would end in a wall at the border. Detail that is smaller than a coarser
voxel stays. Densities are blended where the surface is extracted. Boxes store those of the terrain alone, which never change. After
Losasso and Hoppe, Geometry Clipmaps, 2004, section 4.3.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from .layout import CENTER_STEPS, IntBox, box_slices
from .meshing.surface_nets import have_one_sign
from .terrains.grids import lerp_axis
from .toroidal_grid import ToroidalGrid

RESOLUTION_PER_WIDTH, MAX_WIDTH = 8, 8  # Voxels along a side of a box per voxel of the transition at its ends, and the most of these.
NEAR, FAR = np.float32(0.75), np.float32(0.25)  # The weights of the two coarser voxels along an axis whose centers surround a voxel.
MAX_DETAIL = 2.0  # Voxels by which densities may differ from coarser ones even at the border, where they would change with every move.
DENSITY_MARGIN = 0.4  # Of a transition at its end, where densities have changed and vertices change.
MIN_VERTEX_WIDTH = 0.5  # Voxels in which vertices change in small boxes.
MAX_DENSITY = 4.0  # Voxels to which densities are limited before they are blended. The closer to 0, the more slowly caves close.


@dataclass(frozen=True)
class Transition:
    """The transition from a level to the next coarser one.

    Attributes:
        visible: visible part of the level.
        width: of the transition, voxels.
        coarser: voxels of the next coarser level.
    """

    visible: IntBox
    width: float
    coarser: ToroidalGrid

    @cached_property
    def unblended(self) -> IntBox:
        """The voxels that it leaves as they are."""
        raise NotImplementedError

    def blend_window(self, low: np.ndarray, window: np.ndarray) -> np.ndarray:
        """Return a `window` (X, Y, Z) float16 of visible voxels from `low` (3,) on, whose densities are blended in place.

        If all densities, also the coarser ones, have one sign, they may stay as they are.
        """
        high = low + window.shape
        coarse_low = (low - 1) // 2
        coarse = self.coarser.window(coarse_low, high // 2 + 1)
        if have_one_sign(window, coarse):
            return window
        for first, last in self._split(low, high):
            values, ramps = coarse[box_slices((first - 1) // 2 - coarse_low, last // 2 + 1 - coarse_low)].astype(np.float32), []
            for axis in (2, 1, 0):  # The last one is the fastest.
                below, above, weights = _locate_coarser(int(first[axis] & 1), int(last[axis] - first[axis]))
                values = lerp_axis(values, below, above, weights, axis)
                ramps.append(self._weights(self._distances(np.arange(first[axis], last[axis]), axis)))
            weights = np.maximum(np.maximum(ramps[2][:, None, None], ramps[1][:, None]), ramps[0])
            part = window[box_slices(first - low, last - low)]
            part[...] = self._blend(part, values, weights)
        return window

    def _split(self, low: np.ndarray, high: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the voxels `low` to `high` (3,) that are blended, as disjoint boxes."""
        low, high, inner = low.copy(), high.copy(), self.unblended
        for axis in range(3):
            start, stop = max(low[axis], inner.low[axis]), min(high[axis], inner.high[axis])
            for first, last in ((low[axis], min(high[axis], start)), (max(stop, start), high[axis])):
                if first < last:
                    part_low, part_high = low.copy(), high.copy()
                    part_low[axis], part_high[axis] = first, last
                    yield part_low, part_high
            if start >= stop:
                return
            low[axis], high[axis] = start, stop

    def blend_voxels(self, voxels: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the blended densities of `voxels` (..., 3), whose own densities are `values` (...) float16. Hidden ones stay."""
        x, y, z = (self._distances(voxels[..., axis], axis) for axis in range(3))
        distances = np.minimum(np.minimum(x, y), z)
        rows = np.nonzero((distances < self._density_width) & self.visible.contains(voxels))
        if len(rows[0]) == 0:
            return values
        chosen = voxels[rows]
        coarse = self.coarser.cells_at((chosen - 1) // 2).astype(np.float32)
        for axis in (2, 1, 0):
            below, above = _coarser_weights(chosen[:, axis]).reshape(2, -1, *[1] * axis)
            coarse = coarse[..., 0] * below + coarse[..., 1] * above
        values[rows] = self._blend(values[rows], coarse, self._weights(distances[rows]))
        return values

    def bounds(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return numbers (B, N) that determine the weights in boxes `low` to `high` (B, 3), together with the visible part of the boxes."""
        raise NotImplementedError

    def _distances(self, voxels: np.ndarray, axis: int) -> np.ndarray:
        """Return how far the centers of `voxels` are from where the transition ends along an axis, in voxels: 0 and less there."""
        raise NotImplementedError

    def _blend(self, values: np.ndarray, coarse: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return densities, float16, that have gone from `values` to coarser ones by `weights`."""
        raise NotImplementedError

    def _weights(self, distances: np.ndarray) -> np.ndarray:
        """Return the weights of the coarser densities: 1 where the transition ends."""
        weights = np.float32(1.0) - distances.astype(np.float32) * np.float32(1.0 / self._density_width)
        return np.clip(weights, np.float32(0.0), np.float32(1.0), out=weights)

    @property
    def _density_width(self) -> float:
        """Width of the transition of densities, voxels."""
        return self.width

    @property
    def _limit(self) -> np.float32:
        """The density to which others are limited."""
        return np.float32(MAX_DENSITY * 0.5 * self.coarser.voxel_size)


@dataclass(frozen=True)
class BorderTransition(Transition):
    """A transition by the distance from the border of the box, with which it moves in steps. Detail stays."""

    @cached_property
    def unblended(self) -> IntBox:
        """The voxels that it leaves as they are."""
        return IntBox(self.visible.low + self.width, self.visible.high - self.width)

    def bounds(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the bounds of the visible part (B, 6) that blended densities in boxes `low` to `high` (B, 3) depend on, 0 for others."""
        lows = np.where(low < self.visible.low + self.width, self.visible.low, 0)
        highs = np.where(high > self.visible.high - self.width, self.visible.high, 0)
        return np.concatenate([lows, highs], axis=1)

    def _distances(self, voxels: np.ndarray, axis: int) -> np.ndarray:
        return np.minimum(voxels - self.visible.low[axis], self.visible.high[axis] - 1 - voxels)

    def _blend(self, values: np.ndarray, coarse: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return blended densities, except for differences that are detail."""
        fine, coarse = (np.clip(densities, -self._limit, self._limit, dtype=np.float32) for densities in (values, coarse))
        detail, change = np.float32(MAX_DETAIL * 0.5 * self.coarser.voxel_size), coarse - fine
        change -= np.clip(change, -detail, detail)
        is_changed = change != 0.0
        if not is_changed.any():
            return values
        change *= weights
        change += fine
        return np.where(is_changed, change.astype(np.float16), values)


@dataclass(frozen=True)
class ViewerTransition(Transition):
    """A transition by the distance from the viewer, which ends before the border: when boxes move, next to nothing changes there.

    center: (3,) int64, the viewer in voxels / `CENTER_STEPS`. end: distance from the viewer at which it ends, voxels.
    """

    center: np.ndarray
    end: float

    @classmethod
    def around(cls, center: np.ndarray, start: float, end: float, visible: IntBox, coarser: ToroidalGrid) -> "ViewerTransition":
        """Return a transition from the distance `start` on."""
        return cls(visible, end - start, coarser, center, end)

    @cached_property
    def unblended(self) -> IntBox:
        """The voxels that it leaves as they are."""
        position, start = self.center / CENTER_STEPS, self.end - self.width
        return IntBox(np.ceil(position - start - 0.5).astype(np.int64), np.floor(position + start + 0.5).astype(np.int64))

    def bounds(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the coordinates of the viewer that weights in boxes `low` to `high` (B, 3) depend on, and where all are 1, (B, 4)."""
        first, last = np.maximum(low, self.visible.low), np.minimum(high, self.visible.high)
        offsets = np.stack([self._offsets(first, slice(None)), self._offsets(last - 1, slice(None))])
        farthest = np.abs(offsets).max(axis=0)
        nearest = np.where(np.sign(offsets).prod(axis=0) > 0, np.abs(offsets).min(axis=0), 0.0)
        is_complete = (nearest >= self._vertex_range[1] + 0.5).any(axis=1, keepdims=True)
        is_relevant = (farthest > self.end - self.width) & ~is_complete & (first < last).all(axis=1, keepdims=True)
        return np.concatenate([np.where(is_relevant, 2 * self.center + 1, 0), is_complete], axis=1)

    @property
    def _density_width(self) -> float:
        return (1.0 - DENSITY_MARGIN) * self.width

    def _offsets(self, voxels: np.ndarray, axis: int | slice) -> np.ndarray:
        """Return where the centers of `voxels` are relative to the viewer along an axis, voxels."""
        return (2 * CENTER_STEPS * voxels + CENTER_STEPS - 2 * self.center[axis]) / (2.0 * CENTER_STEPS)

    def _distances(self, voxels: np.ndarray, axis: int) -> np.ndarray:
        return self.end - DENSITY_MARGIN * self.width - np.abs(self._offsets(voxels, axis))

    def vertex_weights(self, corners: np.ndarray) -> np.ndarray:
        """Return how far the vertices at `corners` (V, 3) have gone to the surface of the coarser level, (V,) float32 from 0 to 1."""
        distances = np.abs(CENTER_STEPS * corners - self.center).max(axis=1).astype(np.float32) * np.float32(1.0 / CENTER_STEPS)
        start, end = self._vertex_range
        return np.clip((distances - np.float32(start)) * np.float32(1.0 / (end - start)), np.float32(0.0), np.float32(1.0))

    @property
    def _vertex_range(self) -> tuple[float, float]:
        """Distances between which vertices change. All densities around them are coarser ones: others would lead to other targets."""
        start = self.end - DENSITY_MARGIN * self.width + 1.0
        return start, max(self.end, start + MIN_VERTEX_WIDTH)

    def _blend(self, values: np.ndarray, coarse: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return blended densities. Where one is solid and the other air, the surface passes when the limited ones balance."""
        fine = values.astype(np.float32)
        result = coarse - fine
        result *= weights
        result += fine
        rows = np.nonzero(((fine > 0) != (coarse > 0)) & (np.maximum(np.abs(fine), np.abs(coarse)) > self._limit))
        if len(rows[0]):
            low, high = np.minimum(fine[rows], coarse[rows]), np.maximum(fine[rows], coarse[rows])
            limited = [np.clip(densities[rows], -self._limit, self._limit) for densities in (fine, coarse)]
            balance = limited[0] + (limited[1] - limited[0]) * np.broadcast_to(weights, fine.shape)[rows]
            result[rows] = balance * np.maximum(np.where(balance > 0, high, -low) / self._limit, np.float32(1.0))
        return result.astype(np.float16)


@lru_cache(maxsize=512)
def _locate_coarser(parity: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the coarser voxels (N,) below and above `count` voxels, counted from the first one below, and their weights (2, N).

    parity: 1 if the first of the voxels has an odd index, otherwise 0.
    """
    voxels = np.arange(parity, parity + count)
    below = (voxels - 1) // 2 - (parity - 1) // 2
    return below, below + 1, _coarser_weights(voxels)


def _coarser_weights(voxels: np.ndarray) -> np.ndarray:
    """Return the weights (2, ...) of the coarser voxels below and above `voxels`, which are those from (i - 1) // 2 on."""
    is_odd = (voxels & 1).astype(bool)
    return np.stack([np.where(is_odd, NEAR, FAR), np.where(is_odd, FAR, NEAR)])
