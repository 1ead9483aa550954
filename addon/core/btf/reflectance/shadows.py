"""Self-shadowing as an angular signed distance field: the angle from every light direction to the shadow boundary of a texel.

The suns of a bake are as large as a cell of their grid, so radiance baked under them has blurred shadows, and interpolation between two
suns shows both shadows at half strength. In the space of light directions, however, the shadow boundary of a texel is a curve, and the
angle to it is smooth: few components represent it, and it stays sharp when interpolated. (Signed distances instead of sharp edges after
Green 2007, who uses them for glyph textures.) The visibility of each light is looked up in an ID buffer rendered from its direction.
"""

from dataclasses import dataclass

import numpy as np

from ...geometry.directions import DirectionGrid
from ...jobs.chunks import slices
from ...jobs.progress import Progress, Steps, subprogress
from ..capture.shard_files import FULLY_VISIBLE, UNKNOWN
from ..factorization.factors import Factors, factorize_scalar
from .disc_lights import DiscLights

PENUMBRA_ANGLE = 0.2  # Radians of light movement in which visibility goes from 0 to 1.
MAX_ANGLE = 0.6  # Radians; larger angles to the boundary are clamped.
MIN_COSINE = 0.1  # Minimum weight of a texel for a grazing light.
MAX_PARTIAL_VISIBILITY = 0.9  # Between 1 minus this and this, the visible fraction of a texel itself gives the angle.
CHUNK_TEXELS = 8_192  # Processed at once.


@dataclass(frozen=True)
class Shadows:
    """Shadow boundaries of N texels. angles: in radians, one column, with a view for each direction of `grid`; positive where lit."""

    grid: DirectionGrid
    angles: Factors

    @property
    def nbytes(self) -> int:
        """Size as half floats."""
        return self.angles.nbytes

    def visibility(self, lights: np.ndarray, rows: slice | np.ndarray = slice(None)) -> np.ndarray:
        """Return the visibility (M, L) float32, 0..1, of point-like suns in the directions `lights` (L, 3) from the texels `rows`."""
        basis = self.grid.interpolate(self.angles.basis[:, :, 0], lights)
        return np.clip(0.5 + self.angles.weights[rows] @ (basis.T / PENUMBRA_ANGLE), 0.0, 1.0)

    def sky_visibility(self, normals: np.ndarray) -> np.ndarray:
        """Return the cosine-weighted visible fraction (N,) float32 of a dome for texels with `normals` (N, 3), on their brighter side."""
        visible, total = np.zeros((2, 2, len(normals)), np.float32)
        for rows in slices(len(normals), CHUNK_TEXELS):
            cosines = (normals[rows] @ self.grid.directions.T) * self.grid.solid_angles
            visibility = self.visibility(self.grid.directions, rows)
            for side, side_cosines in enumerate((np.maximum(cosines, 0.0), np.maximum(-cosines, 0.0))):
                total[side, rows], visible[side, rows] = side_cosines.sum(axis=1), (side_cosines * visibility).sum(axis=1)
        return (visible / np.maximum(total, 1e-6)).max(axis=0)

    def mean_visibility(self, suns: DiscLights) -> np.ndarray:
        """Return the visibility (N, L) float32 of each of `suns`: the mean over its disc."""
        angles = np.arccos(np.clip(self.grid.directions @ suns.directions.T, -1.0, 1.0))
        half_cell = 0.5 * np.sqrt(self.grid.solid_angles.mean())  # A disc ends within cells.
        weights = self.grid.solid_angles[:, None] * np.clip(0.5 + (suns.radius - angles) / (2.0 * half_cell), 0.0, 1.0)
        weights = (weights / np.maximum(weights.sum(axis=0), 1e-12)).astype(np.float32)
        visibility = np.empty((len(self.angles.weights), len(suns.directions)), np.float32)
        for rows in slices(len(visibility), CHUNK_TEXELS):
            visibility[rows] = np.minimum(self.visibility(self.grid.directions, rows) @ weights, 1.0)
        return visibility


def compute_shadows(visibility: np.ndarray, grid: DirectionGrid, normals: np.ndarray, components: int, seed: int = 0) -> Steps[Shadows]:
    """Compute the shadow boundaries of texels with `normals` (N, 3) from the encoded `visibility` (D, N) of lights in all directions of
    `grid`, see `encode_visibility`."""
    angles = yield from subprogress(_signed_angles(visibility, grid), 0.0, 0.3)
    factors = yield from subprogress(factorize_scalar(_AngleData(visibility, angles, grid, normals), components, seed), 0.3, 1.0)
    return Shadows(grid, factors)


@dataclass(frozen=True)
class _AngleData:
    """The `als_scalar.ScalarData` of `angles` (D, N) to the shadow boundaries of texels with `normals` (N, 3), known where the encoded
    `visibility` (D, N) is."""

    visibility: np.ndarray
    angles: np.ndarray
    grid: DirectionGrid
    normals: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Number of light directions D and of texels N."""
        return self.visibility.shape

    def read(self, rows: slice | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the angles and weights of the texels `rows`; see `ScalarData`."""
        weights = np.maximum(np.abs(self.grid.directions @ self.normals[rows].T), MIN_COSINE) * self.grid.solid_angles[:, None]
        return self.angles[:, rows].astype(np.float32), np.where(self.visibility[:, rows] != UNKNOWN, weights, 0.0).astype(np.float32)


def _signed_angles(visibility: np.ndarray, grid: DirectionGrid) -> Steps[np.ndarray]:
    """Return the angle (D, N) float16 of every light direction to the nearest one with the opposite visibility; positive where lit."""
    grid_angles = np.arccos(np.clip(grid.directions @ grid.directions.T, -1.0, 1.0))
    nearest = np.argsort(grid_angles, axis=1)[:, 1:]
    count = int((np.sort(grid_angles, axis=1)[:, 1:] < MAX_ANGLE).sum(axis=1).max())
    angles = np.empty(visibility.shape, np.float16)
    for rows in slices(visibility.shape[1], CHUNK_TEXELS):
        yield Progress(rows.start / visibility.shape[1], "Finding shadow boundaries")
        angles[:, rows] = _chunk_signed_angles(visibility[:, rows], grid_angles, nearest[:, :count])
    return angles


def _chunk_signed_angles(visibility: np.ndarray, grid_angles: np.ndarray, nearest: np.ndarray) -> np.ndarray:
    """Compute `_signed_angles` of a chunk of texels. nearest (D, R): the nearest directions of each direction, in order; grid_angles
    (D, D): the angles between all directions."""
    side = np.where(visibility == UNKNOWN, 0, np.where(visibility > FULLY_VISIBLE // 2, 1, -1)).astype(np.int8)
    opposite_side = np.where(side == 0, np.int8(2), -side)
    count = nearest.shape[1]
    ranks = np.full(visibility.shape, count, np.min_scalar_type(count))
    for rank in reversed(range(count)):  # The nearest direction last: it overwrites the others.
        np.copyto(ranks, rank, where=side[nearest[:, rank]] == opposite_side)
    max_angles = np.full((len(grid_angles), 1), MAX_ANGLE)
    by_rank = np.column_stack([np.minimum(np.take_along_axis(grid_angles, nearest, axis=1), MAX_ANGLE), max_angles]).astype(np.float32)
    angles = np.take_along_axis(by_rank, ranks.astype(np.intp), axis=1)
    fraction = visibility / np.float32(FULLY_VISIBLE)
    is_partial = (fraction > 1.0 - MAX_PARTIAL_VISIBILITY) & (fraction < MAX_PARTIAL_VISIBILITY)
    return np.where(is_partial, PENUMBRA_ANGLE * (fraction - 0.5), side * angles)
