"""Parallax mapping: offsets of the normal lookup at oblique views, because quads are flat and the surfaces they replace are not.

At an oblique view, a texel shows a surface point up to one error in front of or behind its quad, and thus next to the texel. The normal is
looked up there. (Parallax mapping after Kaneko et al. 2001: one step with limited offset, using the depths of the PBR maps.)
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import TINY
from ...billboards.texels import Texels
from ...imaging.images import sample_bilinear

MAX_OFFSET = 2.0  # Texels along each axis: no farther than the textures are dilated beyond their quads.
MIN_COSINE = 0.05  # Between quad normal and view; below it the offset decreases to 0.
ALL = slice(None)


@dataclass(frozen=True)
class ParallaxMap:
    """Depths and normals of N texels on Q quads.

    Attributes:
        pixels: (N, 2), see `Texels`.
        quad_indices: (N,), see `Texels`.
        axes: (Q, 2, 3), see `parallax_axes`.
        depths: (N,) heights above the quad along its normal, -1..1, as fractions of the level's error.
        normals: (H, W, 3) the normal map, unit vectors in object space, row 0 at the bottom.
    """

    pixels: np.ndarray
    quad_indices: np.ndarray
    axes: np.ndarray
    depths: np.ndarray
    normals: np.ndarray

    def offsets(self, view: np.ndarray, rows: slice | np.ndarray = ALL) -> np.ndarray:
        """Return the offsets (M, 2), in texels, of the surface points that `rows` show from the unit direction `view` (3,)."""
        cosines = self._quad_normals @ view
        offsets_per_depth = (self.axes @ view) * (cosines / np.maximum(cosines**2, MIN_COSINE**2))[:, None]
        return np.clip(offsets_per_depth[self.quad_indices[rows]] * self.depths[rows, None], -MAX_OFFSET, MAX_OFFSET)

    def sample_normals(self, view: np.ndarray, rows: slice | np.ndarray = ALL) -> np.ndarray:
        """Return the unit normals (M, 3) that `rows` show from the unit direction `view` (3,), with bilinear filtering."""
        normals = sample_bilinear(self.normals, self.pixels[rows] + 0.5 + self.offsets(view, rows))
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)

    @cached_property
    def _quad_normals(self) -> np.ndarray:
        """Unit normals (Q, 3) of the quads."""
        normals = np.cross(self.axes[:, 0], self.axes[:, 1])
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def parallax_axes(texels: Texels, error: float) -> np.ndarray:
    """Return for every quad (Q, 2, 3) the axes whose dot products with a view direction, divided by its cosine to the quad normal, are the
    offsets in texels along x and y for a depth of `error` (a length). Quads too large or small for these numbers have no parallax."""
    steps = texels.steps
    with np.errstate(over="ignore", invalid="ignore"):
        axes = error * steps / np.maximum((steps**2).sum(axis=2, keepdims=True), TINY)
    return np.where(np.isfinite(axes), axes, 0.0)
