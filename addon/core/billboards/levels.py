"""Levels for any error: coverings by the chosen method, then quads, atlas and cutouts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..progress import StageClock, Steps
from . import methods
from .atlas import pack
from .cloud import Level
from .cutouts import cut_corners
from .patches import Covering, Patch, overlapping, to_quads
from .primitives import Primitives
from .rectangles import bounds_of
from .settings import BillboardSettings
from .surfaces import Surfaces, shared_surfaces

METHODS = {"clusters": methods.clusters, "hough": methods.hough, "decimate": methods.decimate}
MARGIN = 0.25  # of the error: quads of a convex surface that meet at 30 degrees are apart by about this much
KEPT_BACK = 1e-4  # of the error and the normal bound: room for rounding to single precision in Blender and in files


@dataclass(frozen=True)
class LevelBuilder:
    """Builds levels with `settings`, but with an error that the caller names: a share of `side`, the longest side of the whole source.

    `clock` takes the time of every stage.
    """

    settings: BillboardSettings
    side: float
    clock: StageClock

    def coverings(
        self,
        primitives: Primitives,
        surfaces: Surfaces,
        share: float,
        count: int,
        standing: Sequence[Covering] = (),
        area: float | None = None,
    ) -> Steps[list[Covering]]:
        """The coverings of the `count` finest levels, finest first, with the error `share` at the finest; see `methods`."""
        inner = [error * (1.0 - KEPT_BACK) for error in self._errors(share, count)]
        return METHODS[self.settings.method](primitives, surfaces, inner, self.settings, self.clock, standing, area)

    def levels(self, primitives: Primitives, surfaces: Surfaces, coverings: Sequence[Covering], share: float) -> list[Level]:
        """The levels that `coverings` make, finest first, in the space and numbering of `primitives`.

        Raises:
            SettingsError: when no texture is large enough for one of them.
        """
        with self.clock.stage("pack"):
            return [
                _level(primitives, covering, surfaces, error, self.settings.texel_error * error, self.settings.cutout_corners)
                for covering, error in zip(coverings, self._errors(share, len(coverings)), strict=True)
            ]

    def _errors(self, share: float, count: int) -> list[float]:
        """The errors of the `count` finest levels as lengths."""
        return [share * self.side * 2.0**level for level in range(count)]


def _level(primitives: Primitives, covering: Covering, surfaces: Surfaces, error: float, texel: float, most_corners: int) -> Level:
    """Quads, atlas and cutouts of one level."""
    shared = shared_surfaces(surfaces, covering.owner)
    covering = overlapping(primitives, covering, shared, MARGIN * error)
    quads = to_quads(covering.patches, covering.owner)
    cutouts = [_cutout(primitives, patch, texel, most_corners) for patch in covering.patches]
    joined = np.array([patch.outline is None and bool(shared[patch.shown].any()) for patch in covering.patches])
    solid = np.array([bool(surfaces.solid[patch.shown].all()) for patch in covering.patches])
    return Level(error, texel, quads, pack(quads.half_sizes, texel), cutouts, joined, solid)


def _cutout(primitives: Primitives, patch: Patch, texel: float, most_corners: int) -> np.ndarray:
    """The polygon that `patch` is cut to, in -1..1 of its half sides; half a texel stays free around what it shows."""
    if patch.outline is not None:
        return patch.outline
    middle = patch.rectangle.reshape(2, 2).mean(axis=1)
    half = np.maximum(0.5 * np.ptp(patch.rectangle.reshape(2, 2), axis=1), 1e-12 * texel)
    bounds = (bounds_of(primitives.positions[patch.shown], patch.axes).reshape(-1, 2, 2) - middle[:, None]) / half[:, None]
    sticking_out = (np.abs(bounds) > 1.0 + 1e-6).any(axis=(1, 2))
    local = (primitives.positions[patch.shown[~sticking_out]].reshape(-1, 3) @ patch.axes.T - middle) / half
    # What sticks out is cut at the rectangle: the corners of its box hold all that is left of it.
    boxes = np.clip(bounds[sticking_out], -1.0, 1.0)
    corners = np.stack([boxes[:, 0][:, [0, 1, 1, 0]], boxes[:, 1][:, [0, 0, 1, 1]]], axis=2).reshape(-1, 2)
    return cut_corners(np.clip(np.concatenate([local, corners]), -1.0, 1.0), 0.5 * texel / half, most_corners)
