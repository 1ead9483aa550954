"""Pages: the images of equal size that hold one texture, one for each group of triangles and UDIM tile that it uses.

Arrays of texels stack the pages, the first at the bottom; UVs are those within the page of the triangle.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..errors import GeometryError
from ..geometry.transforms import signed_areas

FIRST_TILE = 1001
TILE_COLUMNS, TILE_ROWS = 10, 100  # tiles 1001 to 2000, as in Blender
MIN_TILE_AREA = 1e-6  # of the triangles of a tile, in tiles; what is smaller are rounding errors at the edge of its neighbor
MAX_PAGES = 100
MAX_TEXELS = 1 << 31  # of all pages
NO_PAGE = -1


@dataclass(frozen=True)
class PageLayout:
    """Which triangles are on which page.

    corner_uvs: (T, 3, 2) float32 in their pages; what lies outside of 0..1 has no texels. pages: (T,) int32, -1 for those on none.
    groups, tiles: (P,) the group and the number of the UDIM tile of each page, in ascending order.
    """

    corner_uvs: np.ndarray
    pages: np.ndarray
    groups: tuple[int, ...]
    tiles: tuple[int, ...]

    def find_tiles(self, group: int) -> dict[int, int]:
        """Return the pages of a group by the numbers of their tiles."""
        return {tile: page for page, (other, tile) in enumerate(zip(self.groups, self.tiles, strict=True)) if other == group}

    @property
    def is_tiled(self) -> bool:
        """Whether there are other tiles than 1001, the square from 0 to 1."""
        return any(tile != FIRST_TILE for tile in self.tiles)


def lay_out_pages(corner_uvs: np.ndarray, groups: np.ndarray | None = None) -> PageLayout:
    """Give each group and each UDIM tile that it uses a page.

    A triangle belongs to the tile with its centroid, or to the nearest one if that is no tile or hardly used: UVs left of or below 0, or
    in an eleventh column, have no texels.

    Args:
        corner_uvs: (T, 3, 2). groups: (T,) int, 0 or more; all triangles are one group by default.

    Raises:
        GeometryError: there are more than MAX_PAGES pages.
    """
    uvs = corner_uvs.astype(np.float64)
    groups = np.zeros(len(uvs), np.int64) if groups is None else groups.astype(np.int64)
    centroids = uvs.mean(axis=1)
    limits = np.array([TILE_COLUMNS, TILE_ROWS])
    is_inside = ((centroids >= 0.0) & (centroids < limits)).all(axis=1)
    cells = np.floor(np.where(is_inside[:, None], centroids, 0.0)).astype(np.int64)
    keys = (groups * TILE_ROWS + cells[:, 1]) * TILE_COLUMNS + cells[:, 0]
    found, rows = np.unique(keys, return_inverse=True)
    areas = np.bincount(rows.ravel(), np.where(is_inside, np.abs(signed_areas(uvs)), 0.0), len(found))
    used = found[areas >= MIN_TILE_AREA]
    if len(used) > MAX_PAGES:
        raise GeometryError(
            f"The UV map needs {len(used):,} images, one for each UDIM tile and material; the limit is {MAX_PAGES}. "
            "Unwrap the mesh again, or move its UVs into fewer tiles."
        )
    pages = np.searchsorted(used, keys).astype(np.int32)
    is_found = is_inside & (np.append(used, -1)[pages] == keys)
    used_groups, used_cells = used // (TILE_COLUMNS * TILE_ROWS), np.stack([used % TILE_COLUMNS, used // TILE_COLUMNS % TILE_ROWS], axis=1)
    pages[~is_found] = NO_PAGE
    for group in np.unique(groups[~is_found]):
        own = np.flatnonzero(used_groups == group)
        if len(own):
            others = np.flatnonzero(~is_found & (groups == group))
            pages[others] = own[_find_nearest(centroids[others], used_cells[own] + 0.5)]
    origins = np.vstack([used_cells, [0, 0]])[pages]  # the last one is that of no page
    tiles = FIRST_TILE + used_cells[:, 0] + TILE_COLUMNS * used_cells[:, 1]
    return PageLayout((uvs - origins[:, None]).astype(np.float32), pages, tuple(used_groups.tolist()), tuple(tiles.tolist()))


def check_texel_count(pages: np.ndarray | None, size: int) -> None:
    """Check that there is a chance to keep all texels of the `pages` (T,) of triangles, with `size` texels per side, in memory.

    Raises:
        GeometryError: there are more than MAX_TEXELS.
    """
    count = 1 if pages is None else int(pages.max(initial=0)) + 1
    if count * size**2 > MAX_TEXELS:
        raise GeometryError(f"The UV map needs {count:,} images of {size:,} x {size:,} pixels, which is too much; choose a smaller Size.")


def split_by_page(pages: np.ndarray | None, count: int) -> Iterator[np.ndarray]:
    """Yield the indices of the triangles of each page that has some; `pages` (T,) None: all `count` triangles are on one."""
    if pages is None:
        yield np.arange(count)
        return
    for page in range(int(pages.max(initial=NO_PAGE)) + 1):
        chosen = np.flatnonzero(pages == page)
        if len(chosen):
            yield chosen


def _find_nearest(points: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Return the index (N,) of the nearest of `centers` (M, 2) for each of `points` (N, 2)."""
    nearest, distances = np.zeros(len(points), np.int64), np.full(len(points), np.inf)
    for index, center in enumerate(centers):
        distance = np.square(points - center).sum(axis=1)
        is_nearer = distance < distances
        nearest[is_nearer], distances[is_nearer] = index, distance[is_nearer]
    return nearest
