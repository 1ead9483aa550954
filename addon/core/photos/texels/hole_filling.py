"""Holes of a texture, restored in a layout of their own (Textures Revisited, sections 4 to 6).

A hole is what no photograph shows, across the seams of the UV map. It is unwrapped together with a ring around it, resampled evenly,
restored as an image, and sampled back: what it copies has the metric of the surface.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix, csgraph

from ...errors import FarfieldError, GeometryError
from ...geometry.mesh import TriangleMesh, drop_degenerate, face_areas_and_normals
from ...geometry.transforms import signed_areas
from ...imaging.images import dilate_in_place, sample_bilinear
from ...jobs.progress import Progress, Steps
from ...restore.restoration import restore
from ...restore.settings import RestoreSettings
from ...unwrap.settings import UnwrapSettings
from ...unwrap.unwrapping import unwrap
from ..photographs.surface import Surface
from .pages import NO_PAGE
from .texel_map import TexelMap, TexelTile

MIN_TEXELS = 64  # Smaller holes show no texture.
MERGE_TEXELS = 16  # holes that are closer than this are one
RING_FRACTION = 0.6  # width of the ring relative to the square root of the hole's area
MIN_RING_TEXELS = 32
MIN_KNOWN_FRACTION = 0.5  # area of the ring relative to that of the hole
MARGIN = 56  # Of islands of a hole, in texels of the default texture size of an unwrap.
MIN_SIDE, MAX_SIDE = 32, 2048  # pixels of the layout of a hole
MIN_KNOWN_WEIGHT = 0.5  # A color is interpolated where that of the texels around it with a photograph is larger.
MIN_LENGTH = 1e-6  # Shorter edges, in texels, count as so long.


class HoleCounts(NamedTuple):
    """The holes of at least MIN_TEXELS texels, and how many of them were restored.

    The others have too little of the surface around them, or cannot be unwrapped.
    """

    found: int
    restored: int


def find_specks(mask: np.ndarray) -> np.ndarray:
    """Return the connected parts (H, W) bool of a mask (H, W) that are too small to show texture."""
    parts, _ = ndimage.label(mask)
    is_small = np.bincount(parts.ravel()) < MIN_TEXELS
    return mask & is_small[parts]


class Layout(NamedTuple):
    """A part of the surface: triangles (K,), ascending; positions (K, 3, 2) of their corners in pixels, and the map of the pixels."""

    triangles: np.ndarray
    positions: np.ndarray
    map: TexelMap


class HoleFiller:
    """Restores the holes of a texture."""

    def __init__(self, surface: Surface, texel_map: TexelMap, colors: np.ndarray, found: np.ndarray) -> None:
        """Prepare to fill the holes of `colors`.

        Args:
            surface: in any unit.
            texel_map: its texels.
            colors: (N, 3) float32 of all texels, sRGB-encoded, with a first guess in the holes.
            found: (N,) bool, texels that a photograph shows.
        """
        self.mesh, self.edges, self.map, self.colors, self.found = surface.mesh, surface.edges, texel_map, colors, found
        areas, _ = face_areas_and_normals(self.mesh.corners)
        self.texel_side = float(np.sqrt(areas.sum() / max(np.count_nonzero(texel_map.triangles >= 0), 1)))  # on the surface
        first, second = self.edges.ends.T
        lengths = np.linalg.norm(self.mesh.vertices[first] - self.mesh.vertices[second], axis=1)
        shape = self.edges.vertex_count, self.edges.vertex_count
        self.distances = coo_matrix((np.maximum(lengths, MIN_LENGTH * self.texel_side), (first, second)), shape=shape).tocsr()

    def fill(self) -> Steps[HoleCounts]:
        """Write restored colors into the holes of `colors`."""
        holes, restored = self._find_holes(), 0
        for index, hole in enumerate(holes):
            message = Progress(index / len(holes), f"Restoring hole {index + 1} of {len(holes)}")
            yield message
            try:
                for _ in self._restore(hole):  # only so that it can be canceled: the time of a hole is short
                    yield message
                restored += 1
            except FarfieldError:
                continue  # the first guess stays
        return HoleCounts(len(holes), restored)

    def _find_holes(self) -> list[np.ndarray]:
        """Return the triangles with missing texels of each hole."""
        missing = self.map.triangles[~self.found & (self.map.triangles >= 0)]
        counts = np.bincount(missing, minlength=len(self.mesh.triangles))
        triangles = np.flatnonzero(counts)
        if not len(triangles):
            return []
        is_near = self._measure_distances(triangles, 0.5 * MERGE_TEXELS * self.texel_side)
        first, second = self.edges.ends[is_near[self.edges.ends].all(axis=1)].T
        links = coo_matrix((np.ones(len(first), bool), (first, second)), shape=self.distances.shape)
        _, components = csgraph.connected_components(links, directed=False)
        groups = components[self.mesh.triangles[triangles, 0]]
        order = np.argsort(groups, kind="stable")
        starts = np.flatnonzero(np.diff(groups[order])) + 1
        holes = [triangles[rows] for rows in np.split(order, starts)]
        return [hole for hole in holes if counts[hole].sum() >= MIN_TEXELS]

    def _measure_distances(self, triangles: np.ndarray, limit: float) -> np.ndarray:
        """Return which vertices (V,) lie within `limit` along edges of the vertices of `triangles`."""
        seeds = np.unique(self.mesh.triangles[triangles])
        distances = csgraph.dijkstra(self.distances, directed=False, indices=seeds, min_only=True, limit=limit)
        return np.isfinite(distances)

    def _restore(self, hole: np.ndarray) -> Steps[None]:
        """Restore the hole with `triangles`. Raises FarfieldError."""
        texels = [tile.select(~self.found[tile.texels]) for tile in self.map.tiles(hole)]
        missing_count = sum(len(tile.texels) for tile in texels)
        width = max(RING_FRACTION * np.sqrt(missing_count), MIN_RING_TEXELS) * self.texel_side
        triangles = np.flatnonzero(self._measure_distances(hole, width)[self.mesh.triangles].any(axis=1))
        layout = yield from self._lay_out(triangles)
        image, known, covered = self._resample(layout)
        if np.count_nonzero(known) < MIN_KNOWN_FRACTION * missing_count:
            raise GeometryError("There is too little around the hole to copy from.")
        dilate_in_place(image, known)
        mask = covered & ~known & ~find_specks(covered & ~known)
        if mask.any():
            restored = yield from restore(image, mask, RestoreSettings(), source_mask=known, barriers=~covered)
            image = np.ascontiguousarray(restored.pixels)
        dilate_in_place(image, covered)
        rows = np.full(len(self.mesh.triangles), -1)
        rows[layout.triangles] = np.arange(len(layout.triangles))
        for tile in texels:
            tile = tile.select(rows[tile.triangles] >= 0)
            inside = TexelTile(tile.texels, rows[tile.triangles], tile.barycentric)
            self.colors[tile.texels] = sample_bilinear(image, inside.interpolate(layout.positions))

    def _lay_out(self, triangles: np.ndarray) -> Steps[Layout]:
        """Unwrap a part of the surface. Raises GeometryError."""
        used, corners = np.unique(self.mesh.triangles[triangles], return_inverse=True)
        part, kept = drop_degenerate(TriangleMesh(self.mesh.vertices[used], corners.reshape(-1, 3).astype(np.int32)))
        count = len(part.triangles)
        settings = UnwrapSettings(margin=MARGIN)
        unwrapped = yield from unwrap(part, np.arange(count), np.zeros((0, 2), np.int32), np.zeros(count), settings)
        uv_area = float(np.abs(signed_areas(unwrapped.corner_uvs)).sum())
        area = float(face_areas_and_normals(part.corners)[0].sum())
        side = int(np.clip(np.ceil(np.sqrt(area / uv_area) / self.texel_side), MIN_SIDE, MAX_SIDE))
        return Layout(triangles[kept], unwrapped.corner_uvs * side, TexelMap(unwrapped.corner_uvs, side))

    def _resample(self, layout: Layout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the colors (H, W, 3) of a layout, which of them are known, and which of them lie on the surface (H, W) bool."""
        side = layout.map.size
        colors, known = np.zeros((side * side, 3), np.float32), np.zeros(side * side, bool)
        corners = self.map.corners[layout.triangles]
        for tile in layout.map.tiles():
            pages = self.map.pages[layout.triangles[tile.triangles]]
            colors[tile.texels], known[tile.texels] = self._sample(tile.interpolate(corners), pages)
        return colors.reshape(side, side, 3), known.reshape(side, side), (layout.map.triangles >= 0).reshape(side, side)

    def _sample(self, positions: np.ndarray, pages: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return colors (N, 3) at `positions` (N, 2) in texels of `pages` (N,), interpolated between texels with a photograph, and where
        there is one."""
        size = self.map.size
        low = np.floor(positions - 0.5).astype(np.int64)
        fractions = positions - 0.5 - low
        colors, weights = np.zeros((len(positions), 3), np.float32), np.zeros(len(positions), np.float32)
        for x, y in ((0, 0), (1, 0), (0, 1), (1, 1)):
            columns, rows = np.clip(low[:, 0] + x, 0, size - 1), np.clip(low[:, 1] + y, 0, size - 1)
            texels = (pages.astype(np.int64) * size + rows) * size + columns
            weight = np.abs(1 - x - fractions[:, 0]) * np.abs(1 - y - fractions[:, 1]) * self.found[texels]
            colors += weight[:, None].astype(np.float32) * self.colors[texels]
            weights += weight.astype(np.float32)
        return colors / np.maximum(weights, 1e-6)[:, None], (weights >= MIN_KNOWN_WEIGHT) & (pages != NO_PAGE)
