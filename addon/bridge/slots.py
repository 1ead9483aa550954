"""Where each quad of a level lies while it is captured: its slot, the quad laid flat upon its rectangle of the atlas.

In the plane of the slots one atlas is `texel * width` by `texel * height` large and centred on the origin; a quad keeps its size, its
u, v and normal lie along x, y and z. So lengths, and with them bumps, are what they are in the scene.
"""

from dataclasses import dataclass

import numpy as np

from ..core.billboards.cloud import Level


@dataclass(frozen=True)
class Slots:
    """Motions of Q quads into the plane of the slots: p -> scale * axes @ (p - centers) + places.

    centers (Q, 3); axes (Q, 3, 3), rows u, v, n; places (Q, 3) with z = 0; scales (Q,), below 1 only where a rectangle is smaller than
    its quad.
    """

    centers: np.ndarray
    axes: np.ndarray
    places: np.ndarray
    scales: np.ndarray

    def move(self, points: np.ndarray, quads: np.ndarray) -> np.ndarray:
        """Points (N, K, 3) of the world, K on each of the quads `quads` (N,), moved into the plane of the slots."""
        local = np.einsum("nij,nkj->nki", self.axes[quads], points - self.centers[quads][:, None])
        return self.scales[quads][:, None, None] * local + self.places[quads][:, None]

    def restore(self, flat: np.ndarray, quads: np.ndarray) -> np.ndarray:
        """World places (N, 3) on the quads `quads` (N,) of points `flat` (N, 2) in the plane of the slots: the inverse of `move`."""
        local = (flat - self.places[quads, :2]) / self.scales[quads, None]
        return self.centers[quads] + np.einsum("ni,nij->nj", local, self.axes[quads, :2])


def slots_of(level: Level) -> Slots:
    """The slots of every quad of `level`: centred on the rectangles of its atlas."""
    rectangles = level.atlas.rectangles.astype(np.float64)
    middle = rectangles[:, :2] + 0.5 * rectangles[:, 2:] - 0.5 * np.array(level.atlas.size, np.float64)
    places = np.column_stack([level.texel * middle, np.zeros(len(middle))])
    room = 0.5 * level.texel * rectangles[:, 2:] / np.maximum(level.quads.half_sizes, 1e-300)
    return Slots(level.quads.centers, level.quads.frames, places, np.minimum(room.min(axis=1), 1.0))


def texture_coordinates(level: Level, slots: Slots, quad: int, cutout: np.ndarray) -> np.ndarray:
    """UVs (C, 2) of the points `cutout` (C, 2), in -1..1 of the half sizes of one `quad`."""
    flat = slots.places[quad, :2] + slots.scales[quad] * cutout * level.quads.half_sizes[quad]
    return flat / (level.texel * np.array(level.atlas.size)) + 0.5
