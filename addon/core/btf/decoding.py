"""Decoding of relightable textures for any view and light: the shader's lookups on arrays."""

from dataclasses import dataclass

import numpy as np

from ..geometry.directions import DirectionGrid
from .factorization.factors import Factors
from .reflectance.lobes import Lobes


@dataclass(frozen=True)
class RelightableTexture:
    """The relightable texture of one level, as stored in its images. The rows of all arrays are its P pixels, row 0 at the bottom.

    Attributes:
        size: (width, height) in pixels.
        chromaticity: (P, 3) factor of the decoded residual colors.
        color: Factors with one column per light and channel, the dome last.
        alpha: Factors with one column, added to `pbr_alpha`.
        pbr_alpha: (P,) coverage in the PBR maps.
        views: Baked view directions in object space.
        lights: Baked light directions in object space.
        lobes: Reflectance model that is added to the residual colors; None without one.
    """

    size: tuple[int, int]
    chromaticity: np.ndarray
    color: Factors
    alpha: Factors
    pbr_alpha: np.ndarray
    views: DirectionGrid
    lights: DirectionGrid
    lobes: Lobes | None = None

    def interpolate_basis(self, views: np.ndarray, lights: np.ndarray) -> np.ndarray:
        """Return the color basis (V, components of all clusters, L, 3) float32, interpolated at the unit directions `views` (V, 3) and
        `lights` (L, 3)."""
        values = self.color.basis.reshape(len(self.views), -1, len(self.lights) + 1, 3)
        by_light = self.lights.interpolate(np.moveaxis(values[:, :, :-1], 2, 0), lights)  # Light, view, component, channel.
        return np.moveaxis(self.views.interpolate(np.moveaxis(by_light, 1, 0), views), 1, 2)  # View, component, light, channel.

    def radiance(self, basis: np.ndarray, view: np.ndarray, light: np.ndarray) -> np.ndarray:
        """Return the texture (H, W, 3) float32 for a view (3,) and a light (3,): straight scene-linear radiance under a sun of unit
        irradiance.

        basis: (components of all clusters, 3) for this view and light, from `interpolate_basis`.
        """
        return np.maximum(self.unclamped_radiance(basis, view, light), 0.0).reshape(self.size[1], self.size[0], 3)

    def unclamped_radiance(self, basis: np.ndarray, view: np.ndarray, light: np.ndarray) -> np.ndarray:
        """Return the same as `radiance` as (P, 3), including the negative values that the shader clamps to 0."""
        colors = self.color.reconstruct(basis) * self.chromaticity
        return colors if self.lobes is None else colors + self.lobes.radiance_under_suns(view, light[None])[:, 0].astype(np.float32)

    def coverage(self, view: np.ndarray) -> np.ndarray:
        """Return the alpha (H, W) float32 from the unit direction `view` (3,)."""
        basis = self.views.interpolate(self.alpha.basis, view[None])[0]
        alpha = self.pbr_alpha + self.alpha.reconstruct(basis)[:, 0]
        return np.clip(alpha, 0.0, 1.0).astype(np.float32).reshape(self.size[1], self.size[0])
