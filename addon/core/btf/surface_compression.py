"""Compression of the finished views of a level for a surface material: its silhouettes from every view, refined by compositing.

The material keeps the PBR maps of the level. Its reference images are not lit: they show color and normal of the source, so the refinement
makes the quads add up to what every light would shade.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..billboards.texels import Texels
from ..jobs.progress import Steps, subprogress
from .capture.shards import ShardStore
from .capture.view_data import read_silhouettes
from .factorization.factors import Factors, factorize_scalar
from .refinement.training import StoredTrainingView, refine_stored_views
from .settings import BtfSettings

SILHOUETTES_END, FACTORS_END = 0.2, 0.9


@dataclass(frozen=True)
class SurfaceTextures:
    """Compressed textures of a level with N texels, in addition to its PBR maps.

    alpha: factors of the coverage from each view, minus that of the PBR maps.
    """

    alpha: Factors

    @property
    def nbytes(self) -> int:
        """Size as half floats."""
        return self.alpha.nbytes


@dataclass(frozen=True)
class TwoSidedTexels:
    """Texels with the maps of both of their sides.

    Attributes:
        texels: The texels.
        front: (N, 6) float32, straight color and encoded normal of the front, 0..1.
        back: (N, 6) float32, the same of the back.
        alpha: (N,) coverage in the PBR maps.
        solid: (Q,) bool, the quad shows only the outside of solids, and its back is not drawn.
    """

    texels: Texels
    front: np.ndarray
    back: np.ndarray
    alpha: np.ndarray
    solid: np.ndarray

    def faces_viewer(self, direction: np.ndarray) -> np.ndarray:
        """Whether the front of each texel (N,) faces a viewer in `direction` (3,)."""
        return self.texels.face_viewer(direction)

    def is_drawn(self, direction: np.ndarray) -> np.ndarray:
        """Whether each texel (N,) is drawn for a viewer in `direction` (3,)."""
        return self.faces_viewer(direction) | ~self.solid[self.texels.quad_indices]

    def colors(self, direction: np.ndarray) -> np.ndarray:
        """Return the maps (N, 6) of the side that faces a viewer in `direction` (3,)."""
        return np.where(self.faces_viewer(direction)[:, None], self.front, self.back)


class SurfaceCompressor:
    """Compresses the silhouettes of a level from its finished views in `store`."""

    def __init__(self, store: ShardStore, sides: TwoSidedTexels, settings: BtfSettings) -> None:
        self._store, self._sides, self._settings, self._views = store, sides, settings, settings.view_grid

    def compress(self) -> Steps[SurfaceTextures]:
        """Factorize the coverage of all texels from all views. Raises FileError."""
        steps = read_silhouettes(self._store, self._sides.alpha, self._views.solid_angles)
        silhouettes = yield from subprogress(steps, 0.0, SILHOUETTES_END)
        is_drawn = np.array([self._sides.is_drawn(direction) for direction in self._views.directions])
        silhouettes = replace(silhouettes, known=silhouettes.known & is_drawn)
        steps = factorize_scalar(silhouettes, self._settings.alpha_components, self._settings.seed)
        alpha = yield from subprogress(steps, SILHOUETTES_END, FACTORS_END)
        return SurfaceTextures(alpha)

    def refine(self, textures: SurfaceTextures, training_views: list[StoredTrainingView]) -> Steps[SurfaceTextures]:
        """Return `textures` with alpha refined against the reference images of all views. Raises FileError."""
        directions, sides = self._views.directions, self._sides
        alpha = yield from refine_stored_views(
            training_views,
            textures.alpha,
            sides.alpha,
            self._views.solid_angles,
            lambda view, _rows: sides.colors(directions[view]),
            lambda view: sides.is_drawn(directions[view]),
        )
        return replace(textures, alpha=alpha)
