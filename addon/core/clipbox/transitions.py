"""The transition between boxes: towards its border, the densities of a box become those of the next coarser one.

Without it, whatever only the finer box resolves, such as a cave, would end in a wall at the border, and all detail would change at once
when boxes move. Densities are blended where the surface is extracted. Boxes store those of the terrain alone, which never change. After
Losasso and Hoppe, Geometry Clipmaps, 2004, section 4.3.
"""

from dataclasses import dataclass

import numpy as np

from .layout import IntBox
from .meshing.surface_nets import have_one_sign
from .terrains.grids import lerp_axis
from .toroidal_grid import ToroidalGrid

RESOLUTION_PER_WIDTH = 8  # Voxels along a side of a box per voxel of the transition at each of its ends.
NEAR, FAR = np.float32(0.75), np.float32(0.25)  # The weights of the two coarser voxels along an axis whose centers surround a voxel.
MAX_DENSITY = 4.0  # Voxels to which densities are limited before they are blended. The closer to 0, the more slowly caves close.
SMALLEST = np.float16(6.0e-8)  # Keeps positive densities positive in half precision.


@dataclass(frozen=True)
class Transition:
    """The transition from a level to the next coarser one.

    Attributes:
        visible: visible part of the level.
        width: of the transition, voxels.
        coarser: voxels of the next coarser level.
    """

    visible: IntBox
    width: int
    coarser: ToroidalGrid

    @property
    def unblended(self) -> IntBox:
        """The voxels that it leaves as they are."""
        return IntBox(self.visible.low + self.width, self.visible.high - self.width)

    def blend_window(self, low: np.ndarray, window: np.ndarray) -> np.ndarray:
        """Return a `window` (X, Y, Z) float16 of voxels from `low` (3,) on with blended densities. All lie in the visible part."""
        high = low + window.shape
        coarse_low = (low - 1) // 2
        coarse = self.coarser.window(coarse_low, high // 2 + 1)
        if have_one_sign(window, coarse):
            return window
        values, ramps = coarse.astype(np.float32), []
        for axis in range(3):
            voxels = np.arange(low[axis], high[axis])
            below = (voxels - 1) // 2 - coarse_low[axis]
            values = lerp_axis(values, below, below + 1, _coarser_weights(voxels), axis)
            ramps.append(self._ramp(voxels, axis))
        weights = np.maximum(np.maximum(ramps[0][:, None, None], ramps[1][:, None]), ramps[2])
        return self._blend(window, values, weights)

    def blend_voxels(self, voxels: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the blended densities of `voxels` (..., 3) in the visible part, whose own densities are `values` (...) float16."""
        weights = np.maximum(np.maximum(*(self._ramp(voxels[..., axis], axis) for axis in (0, 1))), self._ramp(voxels[..., 2], 2))
        rows = np.nonzero(weights)
        if len(rows[0]) == 0:
            return values
        chosen = voxels[rows]
        coarse = self.coarser.cells_at((chosen - 1) // 2).astype(np.float32)
        for axis in range(3):
            below, above = _coarser_weights(chosen[:, axis]).reshape(2, -1, *[1] * (2 - axis))
            coarse = coarse[:, 0] * below + coarse[:, 1] * above
        values[rows] = self._blend(values[rows], coarse, weights[rows])
        return values

    def bounds(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the bounds of the visible part (B, 6) that blended densities in boxes `low` to `high` (B, 3) depend on, 0 for others."""
        lows = np.where(low < self.visible.low + self.width, self.visible.low, 0)
        highs = np.where(high > self.visible.high - self.width, self.visible.high, 0)
        return np.concatenate([lows, highs], axis=1)

    def _ramp(self, voxels: np.ndarray, axis: int) -> np.ndarray:
        """Return the weight of the coarser densities, by the distance from the ends of the visible part along one axis: 1 at the ends."""
        distance = np.minimum(voxels - self.visible.low[axis], self.visible.high[axis] - 1 - voxels)
        return np.maximum(np.float32(1.0) - distance.astype(np.float32) * np.float32(1.0 / self.width), np.float32(0.0))

    def _blend(self, values: np.ndarray, coarse: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return the mean of densities and coarser ones, float16, with weights."""
        limit = np.float32(MAX_DENSITY * 0.5 * self.coarser.voxel_size)
        fine, blended = np.clip(values, -limit, limit, dtype=np.float32), np.clip(coarse, -limit, limit)
        blended -= fine
        blended *= weights
        blended += fine
        half = blended.astype(np.float16)
        half[(half == 0) & (blended > 0)] = SMALLEST
        return np.where(weights > 0, half, values)


def _coarser_weights(voxels: np.ndarray) -> np.ndarray:
    """Return the weights (2, ...) of the coarser voxels below and above `voxels`, which are those from (i - 1) // 2 on."""
    is_odd = (voxels & 1).astype(bool)
    return np.stack([np.where(is_odd, NEAR, FAR), np.where(is_odd, FAR, NEAR)])
