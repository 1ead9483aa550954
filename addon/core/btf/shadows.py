"""Shadows of an original upon itself: how far, in angle, every sun stands from where a texel falls into shadow.

Suns of a bake are as broad as a cell of their grid, so what is baked under them has blurred shadows, and between two suns both of a
shadow's places at half strength. Where a texel begins to be shadowed is a line in the directions of suns, though, and the angle to that
line is smooth: few components hold it, and interpolated it is sharp again. (Signed distances in place of sharp edges after Green 2007, who
does so in textures of glyphs.) From where a sun reaches a texel is looked up in pictures of face numbers alone, seen from the sun.
"""

from dataclasses import dataclass

import numpy as np

from ..direction_grids import DirectionGrid
from ..parallel import slices
from ..progress import Progress, Steps, scaled
from .broad_suns import BroadSuns
from .factors import Factors, factorise_columns
from .shards import UNKNOWN

PENUMBRA = 0.2  # radians over which a sun sets behind an edge
FARTHEST = 0.6  # radians: what is farther from the edge counts as that
LEAST_FACING = 0.1  # cosine: what a texel counts at least for a sun that grazes it
CLEAR = 0.9  # share of a texel's parts: of those that are reached less, and more than the rest, the share itself says where the edge is
CHUNK = 8_192  # texels at once
WHOLE = UNKNOWN - 1  # the byte of a texel that a sun reaches wholly


@dataclass(frozen=True)
class Shadows:
    """angles: of N texels to their edge of shadow, radians, one column; its views are the directions of `grid`. Above 0 a sun reaches."""

    grid: DirectionGrid
    angles: Factors

    @property
    def bytes(self) -> int:
        """What they take as half floats."""
        return self.angles.bytes

    def reached(self, lights: np.ndarray, rows: slice | np.ndarray = slice(None)) -> np.ndarray:
        """How much (M, L) float32, 0..1, of suns like points from `lights` (L, 3) reaches the texels `rows`."""
        basis = self.grid.interpolated(self.angles.basis[:, :, 0], lights)
        return np.clip(0.5 + self.angles.weights[rows] @ (basis.T / PENUMBRA), 0.0, 1.0)

    def openness(self, normals: np.ndarray) -> np.ndarray:
        """How much (N,) float32 of a dome reaches matt texels with `normals` (N, 3), on the side where more does."""
        shown, full = np.zeros((2, 2, len(normals)), np.float32)
        for rows in slices(len(normals), CHUNK):
            cosines = (normals[rows] @ self.grid.directions.T) * self.grid.solid_angles
            reached = self.reached(self.grid.directions, rows)
            for side, facing in enumerate((np.maximum(cosines, 0.0), np.maximum(-cosines, 0.0))):
                full[side, rows], shown[side, rows] = facing.sum(axis=1), (facing * reached).sum(axis=1)
        return (shown / np.maximum(full, 1e-6)).max(axis=0)

    def reached_by(self, suns: BroadSuns) -> np.ndarray:
        """How much (N, L) float32 of each broad sun reaches the texels: the mean over its disc."""
        apart = np.arccos(np.clip(self.grid.directions @ suns.directions.T, -1.0, 1.0))
        spread = 0.5 * np.sqrt(self.grid.solid_angles.mean())  # a disc ends within cells
        within = self.grid.solid_angles[:, None] * np.clip(0.5 + (suns.radius - apart) / (2.0 * spread), 0.0, 1.0)
        within = (within / np.maximum(within.sum(axis=0), 1e-12)).astype(np.float32)
        made = np.empty((len(self.angles.weights), len(suns.directions)), np.float32)
        for rows in slices(len(made), CHUNK):
            made[rows] = np.minimum(self.reached(self.grid.directions, rows) @ within, 1.0)
        return made


def find_shadows(lit: np.ndarray, grid: DirectionGrid, normals: np.ndarray, components: int, seed: int = 0) -> Steps[Shadows]:
    """Shadows of the texels with `normals` (N, 3), out of what suns from all directions of `grid` reach: bytes (D, N), see `lit_bytes`."""
    angles = yield from scaled(_angles(lit, grid), 0.0, 0.3)
    found = yield from scaled(factorise_columns(_Edges(lit, angles, grid, normals), components, seed), 0.3, 1.0)
    return Shadows(grid, found)


@dataclass(frozen=True)
class _Edges:
    """Angles (D, N) of texels with `normals` (N, 3) to their edge of shadow, known where their shares `lit` (D, N) are; see
    `columns.Columns`."""

    lit: np.ndarray
    angles: np.ndarray
    grid: DirectionGrid
    normals: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """D, N."""
        return self.lit.shape

    def read(self, rows: slice | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `columns.Columns`."""
        facing = np.maximum(np.abs(self.grid.directions @ self.normals[rows].T), LEAST_FACING) * self.grid.solid_angles[:, None]
        return self.angles[:, rows].astype(np.float32), np.where(self.lit[:, rows] != UNKNOWN, facing, 0.0).astype(np.float32)


def _angles(lit: np.ndarray, grid: DirectionGrid) -> Steps[np.ndarray]:
    """The angle (D, N) float16 of every direction to the next one where a texel fares the other way, above 0 where it is lit (D, N)."""
    apart = np.arccos(np.clip(grid.directions @ grid.directions.T, -1.0, 1.0))
    nearest = np.argsort(apart, axis=1)[:, 1:]
    reach = int((np.sort(apart, axis=1)[:, 1:] < FARTHEST).sum(axis=1).max())
    made = np.empty(lit.shape, np.float16)
    for rows in slices(lit.shape[1], CHUNK):
        yield Progress(rows.start / lit.shape[1], "Looking for the edges of shadows")
        made[:, rows] = _angles_of(lit[:, rows], apart, nearest[:, :reach])
    return made


def _angles_of(lit: np.ndarray, apart: np.ndarray, nearest: np.ndarray) -> np.ndarray:
    """`_angles` of some texels. nearest (D, R): the directions around each, in order; apart (D, D): the angles between them."""
    side = np.where(lit == UNKNOWN, 0, np.where(lit > WHOLE // 2, 1, -1)).astype(np.int8)
    wanted = np.where(side == 0, np.int8(2), -side)
    reach = nearest.shape[1]
    ranks = np.full(lit.shape, reach, np.min_scalar_type(reach))
    for rank in reversed(range(reach)):  # the nearest last, so that it has the last word
        np.copyto(ranks, rank, where=side[nearest[:, rank]] == wanted)
    farthest = np.full((len(apart), 1), FARTHEST)
    angles = np.column_stack([np.minimum(np.take_along_axis(apart, nearest, axis=1), FARTHEST), farthest]).astype(np.float32)
    angle = np.take_along_axis(angles, ranks.astype(np.intp), axis=1)
    share = lit / np.float32(WHOLE)
    partly = (share > 1.0 - CLEAR) & (share < CLEAR)
    return np.where(partly, PENUMBRA * (share - 0.5), side * angle)
