"""The texels of a texture on the surface: which triangle covers each, and where in the triangle it is."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...imaging.raster import rasterize


@dataclass(frozen=True)
class TexelTile:
    """Some texels: flat indices (N,) in the texture, their triangles (N,) and barycentric coordinates (N, 3) float32."""

    texels: np.ndarray
    triangles: np.ndarray
    barycentric: np.ndarray

    def interpolate(self, corner_values: np.ndarray) -> np.ndarray:
        """Return the values (N, C) float32 of `corner_values` (T, 3, C) at the texels."""
        result = np.zeros((len(self.texels), corner_values.shape[2]), np.float32)
        for corner in range(3):
            result += self.barycentric[:, corner, None] * np.take(corner_values[:, corner], self.triangles, axis=0)
        return result

    def select(self, rows: np.ndarray) -> "TexelTile":
        """Return only some of the texels, by indices or a mask."""
        return TexelTile(self.texels[rows], self.triangles[rows], self.barycentric[rows])


class TexelMap:
    """The triangle of every texel whose center a triangle covers.

    triangles: (P * H * W,) int32, -1 where there is none. size: texels per side. pages: (T,) of the triangles. corners:
    (T, 3, 2) float64, positions in the page in texels.
    """

    def __init__(self, corner_uvs: np.ndarray, size: int, pages: np.ndarray | None = None) -> None:
        """Rasterize triangles with UVs (T, 3, 2), of which only the part in 0..1 has texels; `pages` (T,): all are on one by default."""
        self.size = size
        self.pages = np.zeros(len(corner_uvs), np.int32) if pages is None else pages
        self.page_count = max(int(self.pages.max(initial=0)) + 1, 1)
        self.corners = corner_uvs.astype(np.float64) * size
        self.triangles = np.full(self.page_count * size * size, -1, np.int32)
        for triangles, texels, _ in self._rasterize(None):
            self.triangles[texels] = triangles

    @property
    def stacked_corners(self) -> np.ndarray:
        """(T, 3, 2) float64, positions in texels in the image of all pages, the first at the bottom."""
        offsets = np.stack([np.zeros(len(self.pages)), self.pages * float(self.size)], axis=1)
        return self.corners + offsets[:, None]

    def tiles(self, chosen: np.ndarray | None = None) -> Iterator[TexelTile]:
        """Yield all covered texels, each of them once; only those of some triangles (K,), if they are given."""
        for triangles, texels, barycentric in self._rasterize(chosen):
            is_own = self.triangles[texels] == triangles
            yield TexelTile(texels[is_own], triangles[is_own].astype(np.int32), barycentric[is_own].astype(np.float32))

    def _rasterize(self, chosen: np.ndarray | None) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Yield what `rasterize` yields, page by page, for all triangles or those `chosen` (K,)."""
        for page in range(self.page_count):
            is_own = (self.pages if chosen is None else self.pages[chosen]) == page
            own = np.flatnonzero(is_own) if chosen is None else chosen[is_own]
            corners = self.corners if chosen is None and is_own.all() else self.corners[own]
            for rows, texels, barycentric in rasterize(corners, (self.size, self.size)):
                yield own[rows], texels + page * self.size**2, barycentric
