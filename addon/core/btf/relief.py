"""Relief: quads are flat, what they stand for is not.

Seen aslant, a texel shows what lies up to an error before or behind its quad, and so beside it: its normal is looked up there. (Parallax
mapping after Kaneko et al. 2001, one step with a limit; the depths are those of the plain maps.)
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..images import bilinear
from .texels import Texels

MOST = 2.0  # texels that a look-up moves, along each axis: no farther than textures go on beyond their quads
LEAST_FACING = 0.05  # cosine between quad and view below which it moves less and less
ALL = slice(None)


@dataclass(frozen=True)
class Relief:
    """Relief of N texels of Q quads.

    pixels (N, 2), quads (N,): see `Texels`. axes (Q, 2, 3): see `axes_of`. depths (N,): heights over the quad along its normal, -1..1, as
    shares of the error. normals (H, W, 3): the normal map, unit vectors in the object's frame, row 0 at the bottom.
    """

    pixels: np.ndarray
    quads: np.ndarray
    axes: np.ndarray
    depths: np.ndarray
    normals: np.ndarray

    def moved(self, view: np.ndarray, rows: slice | np.ndarray = ALL) -> np.ndarray:
        """How far (M, 2) from each of `rows`, in texels, lies what is seen of it from the unit direction `view` (3,)."""
        facing = self._across @ view
        along = (self.axes @ view) * (facing / np.maximum(facing**2, LEAST_FACING**2))[:, None]
        return np.clip(along[self.quads[rows]] * self.depths[rows, None], -MOST, MOST)

    @cached_property
    def _across(self) -> np.ndarray:
        """The unit normals (Q, 3) of the quads."""
        across = np.cross(self.axes[:, 0], self.axes[:, 1])
        return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)

    def seen(self, view: np.ndarray, rows: slice | np.ndarray = ALL) -> np.ndarray:
        """The unit normals (M, 3) that `rows` show from there, as the texture unit finds them."""
        found = bilinear(self.normals, self.pixels[rows] + 0.5 + self.moved(view, rows))
        return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-6)


def axes_of(texels: Texels, error: float) -> np.ndarray:
    """For every quad (Q, 2, 3) what a view's direction, times these, gives: texels along x, and along y, that it passes for every error (a
    length) that it goes on, times its cosine to the quad."""
    steps = texels.steps
    return error * steps / np.maximum((steps**2).sum(axis=2, keepdims=True), 1e-300)
