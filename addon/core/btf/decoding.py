"""What relightable textures show from any view under any light: the shader's look-ups as arrays."""

from dataclasses import dataclass

import numpy as np

from ..direction_grids import DirectionGrid
from .factors import Factors
from .lobes import Lobes


@dataclass(frozen=True)
class BakedAtlas:
    """The relightable textures of one level, as they lie in its images.

    size: (width, height) of its texture, whose P pixels are the rows of all that follows, row 0 of the texture at the bottom. tints (P, 3):
    what colours are multiplied by. colour: a column for every light, the dome last, and channel. alpha: one column, on top of `plain` (P,),
    the coverage in the plain maps. views, lights: the directions of the bake in the object's frame. lobes: what comes on top of the
    colours, None where there is nothing.
    """

    size: tuple[int, int]
    tints: np.ndarray
    colour: Factors
    alpha: Factors
    plain: np.ndarray
    views: DirectionGrid
    lights: DirectionGrid
    lobes: Lobes | None = None

    def seen_from(self, views: np.ndarray, lights: np.ndarray) -> np.ndarray:
        """The basis (V, components of all clusters, L, 3) float32 of unit directions `views` (V, 3) and `lights` (L, 3), interpolated."""
        values = self.colour.basis.reshape(len(self.views), -1, len(self.lights) + 1, 3)
        under = self.lights.interpolated(np.moveaxis(values[:, :, :-1], 2, 0), lights)  # light, view, component, channel
        return np.moveaxis(self.views.interpolated(np.moveaxis(under, 1, 0), views), 1, 2)  # view, component, light, channel

    def picture(self, basis: np.ndarray, view: np.ndarray, light: np.ndarray) -> np.ndarray:
        """The texture (H, W, 3) float32 of a view (3,) under a light (3,), with the `basis` (components of all clusters, 3) of both as
        `seen_from` gives it.

        Straight scene-linear colours: radiance under a sun of unit irradiance.
        """
        return np.maximum(self.uncut(basis, view, light), 0.0).reshape(self.size[1], self.size[0], 3)

    def uncut(self, basis: np.ndarray, view: np.ndarray, light: np.ndarray) -> np.ndarray:
        """The same (P, 3) with its negative numbers, which the shader cuts at 0."""
        colours = self.colour.applied(basis) * self.tints
        return colours if self.lobes is None else colours + self.lobes.of_suns(view, light[None])[:, 0].astype(np.float32)

    def coverage(self, view: np.ndarray) -> np.ndarray:
        """The alpha (H, W) float32 from a unit direction `view` (3,)."""
        basis = self.views.interpolated(self.alpha.basis, view[None])[0]
        alpha = self.plain + self.alpha.applied(basis)[:, 0]
        return np.clip(alpha, 0.0, 1.0).astype(np.float32).reshape(self.size[1], self.size[0])
