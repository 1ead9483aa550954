"""The colors of texels from the photographs that show them."""

from copy import copy

import numpy as np

from ...files.scratch import Scratch
from ..photographs.color_correction import ColorCorrection
from ..photographs.photograph import Photograph
from .face_visibility import FaceVisibility, SeenTexels, ShownSurface
from .highlights import HighlightDetector
from .regions import VertexLabels
from .texel_map import TexelTile

NO_PHOTOGRAPH = -1


class TileColors:
    """What has been found for the N texels of a tile.

    weights: (N,) float32, 0 where no photograph was added. source: (N,) int16, the photograph with the largest weight. resolution: (N,)
    float32, the largest number of pixels per unit of area of all photographs that were added.
    """

    def __init__(self, tile: TexelTile) -> None:
        count = len(tile.texels)
        self.tile = tile
        self._sums = np.zeros((count, 3), np.float32)
        self._largest = np.zeros(count, np.float32)
        self.weights, self.resolution = np.zeros(count, np.float32), np.zeros(count, np.float32)
        self.source = np.full(count, NO_PHOTOGRAPH, np.int16)

    @property
    def colors(self) -> np.ndarray:
        """(N, 3) float32 means, 0 where no photograph was added."""
        return self._sums / np.where(self.weights > 0.0, self.weights, 1.0)[:, None]

    def add(self, photograph: int, texels: np.ndarray, colors: np.ndarray, weights: np.ndarray, resolution: np.ndarray) -> None:
        """Add the `colors` (M, 3) of a photograph at `texels` (M,), with `weights` (M,) and a `resolution` (M,)."""
        self._sums[texels] += weights[:, None] * colors
        self.weights[texels] += weights
        self.resolution[texels] = np.maximum(self.resolution[texels], resolution)
        is_largest = weights > self._largest[texels]
        self._largest[texels[is_largest]] = weights[is_largest]
        self.source[texels[is_largest]] = photograph


class TexelPainter:
    """Computes the texels of tiles, of several at the same time if required."""

    def __init__(
        self,
        surface: ShownSurface,
        faces: list[FaceVisibility],
        photographs: list[Photograph],
        color_corrections: list[ColorCorrection],
        scratch: Scratch,
        *,
        reduces_highlights: bool,
    ) -> None:
        """Prepare to paint.

        faces: what each of the photographs shows. scratch: keeps what belongs to a photograph in its group. reduces_highlights: whether
        photographs count less where they show highlights, in averages.
        """
        self._surface, self._photographs, self._color_corrections = surface, photographs, color_corrections
        self.faces, self._scratch = faces, scratch
        self._regions: list[np.ndarray] = []
        self._corrections: np.ndarray | None = None
        self._highlights = HighlightDetector(photographs, color_corrections, scratch) if reduces_highlights else None

    def use_labels(self, pairs: VertexLabels, corrections: np.ndarray) -> None:
        """Texture the triangles around each of the `pairs` of a vertex and a photograph from it, with `corrections` (P, 3) of colors."""
        self._regions = [pairs.find(self._surface.corner_vertices.T, index).astype(np.int32) for index in range(len(self.faces))]
        self._pair_weights = np.append(pairs.weights, np.float32(0.0))  # the last one is that of no pair
        self._corrections = np.concatenate([corrections, np.zeros((1, 3), np.float32)])

    def with_photographs(self, photographs: list[Photograph]) -> "TexelPainter":
        """Return a painter that takes `photographs` in place of its own, as they are: without gains and corrections."""
        result = copy(self)
        result._photographs, result._color_corrections = photographs, None
        result._corrections = None
        return result

    def paint(self, tile: TexelTile) -> TileColors:
        """Return the colors of a tile: from the photographs of the labels, and where those do not show it, from all others."""
        found, points = TileColors(tile), self.locate(tile)
        for index, region in enumerate(self._regions):
            pairs = region[tile.triangles]
            blend = np.einsum("ni,ni->n", tile.barycentric, self._pair_weights[pairs])
            seen = self.faces[index].see(tile, points, np.flatnonzero(blend > 0.0))
            colors = self.sample(index, seen.positions)
            if self._corrections is not None:
                colors += np.einsum("ni,nic->nc", tile.barycentric[seen.indices], self._corrections[pairs[seen.indices]])
            found.add(index, seen.indices, colors, blend[seen.indices], seen.resolution)
            self._scratch.release(index)
        rest = np.flatnonzero(found.weights == 0.0)
        if self._highlights is None:
            for index, faces in enumerate(self.faces):
                seen = faces.see(tile, points, rest)
                found.add(index, seen.indices, self.sample(index, seen.positions), seen.weights, seen.resolution)
                self._scratch.release(index)
            return found
        every = [faces.see(tile, points, rest) for faces in self.faces]
        for index, (seen, factors) in enumerate(zip(every, self._highlights.rate(every, len(points)), strict=True)):
            found.add(index, seen.indices, self.sample(index, seen.positions), seen.weights * factors, seen.resolution)
            self._scratch.release(index)
        return found

    def locate(self, tile: TexelTile) -> np.ndarray:
        """Return the points (N, 3) of a tile on the surface."""
        return tile.interpolate(self._surface.corners)

    def see(self, index: int, tile: TexelTile, points: np.ndarray, rows: np.ndarray) -> SeenTexels:
        """Return how a photograph shows the texels `rows` (R,) of a tile at `points` (N, 3)."""
        seen = self.faces[index].see(tile, points, rows)
        self._scratch.release(index)
        return seen

    def sample(self, index: int, positions: np.ndarray) -> np.ndarray:
        """Return the colors (N, 3) of a photograph, with its gain, at `positions` (N, 2) in pixels."""
        colors = self._photographs[index].sample(positions)
        return colors if self._color_corrections is None else self._color_corrections[index].apply(colors, positions)
