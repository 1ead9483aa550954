"""Pages: the images of equal size that hold one texture, one for each group of triangles and UDIM tile that it uses; and triangles that
share texels with others, which cannot have textures of their own.

Arrays of texels stack the pages, the first at the bottom; UVs are those within the page of the triangle.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...errors import GeometryError
from ...geometry.transforms import signed_areas
from ...imaging.raster import rasterize

FIRST_TILE = 1001
TILE_COLUMNS, TILE_ROWS = 10, 100  # tiles 1001 to 2000, as in Blender
MIN_TILE_AREA = 1e-6  # Triangles with a smaller area, in tiles, are rounding errors at the edge of the neighbor of a tile.
MAX_PAGES = 100
MAX_TEXELS = 1 << 31  # in all pages
NO_PAGE = -1
OVERLAP_SIZE = 1024  # texels per side in which UV maps are searched for overlaps
INSIDE = 0.01  # smallest barycentric coordinate: neighbors may share the texels on their edge
MIN_SHARED = 0.5  # A triangle overlaps others if it shares this fraction of its texels with them.
MAX_FRACTION = 0.01  # fraction of all texels that may be shared


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


def lay_out_pages(corner_uvs: np.ndarray, groups: np.ndarray | None = None, *, keeps_tiles: bool = True) -> PageLayout:
    """Give each group and each UDIM tile that it uses a page.

    A triangle belongs to the tile with its centroid, or to the nearest one if that is no tile or hardly used: UVs left of or below 0, or
    in an eleventh column, have no texels. A group whose UVs are all in one unit square outside of the tiles is moved to tile 1001, since
    images repeat.

    Args:
        corner_uvs: (T, 3, 2). groups: (T,) int, 0 or more; all triangles are one group by default.
        keeps_tiles: False moves groups in one other tile than 1001 there, too.

    Raises:
        GeometryError: there are more than MAX_PAGES pages.
    """
    uvs = corner_uvs.astype(np.float64)
    groups = np.zeros(len(uvs), np.int64) if groups is None else groups.astype(np.int64)
    _move_to_first_tile(uvs, groups, keeps_tiles)
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
            pages[others] = own[cKDTree(used_cells[own] + 0.5).query(centroids[others])[1]]
    origins = np.vstack([used_cells, [0, 0]])[pages]  # the last one is that of no page
    tiles = FIRST_TILE + used_cells[:, 0] + TILE_COLUMNS * used_cells[:, 1]
    return PageLayout((uvs - origins[:, None]).astype(np.float32), pages, tuple(used_groups.tolist()), tuple(tiles.tolist()))


def _move_to_first_tile(uvs: np.ndarray, groups: np.ndarray, keeps_tiles: bool) -> None:
    """Move `uvs` (T, 3, 2) of groups in one unit square to that from 0 to 1, in place; with `keeps_tiles` only if it is no tile."""
    if uvs.min(initial=0.0) >= 0.0 and uvs.max(initial=1.0) <= 1.0:
        return
    cells, areas = np.floor(uvs.mean(axis=1)), np.abs(signed_areas(uvs))
    for group in np.unique(groups):
        own = np.flatnonzero(groups == group)
        found, rows = np.unique(cells[own], axis=0, return_inverse=True)
        used = found[np.bincount(rows.ravel(), areas[own], len(found)) >= MIN_TILE_AREA]
        if len(used) == 1 and not (keeps_tiles and ((used[0] >= 0) & (used[0] < (TILE_COLUMNS, TILE_ROWS))).all()):
            uvs[own] -= used[0]


def check_texel_count(pages: np.ndarray | None, size: int) -> None:
    """Check that there is a chance to keep all texels of the `pages` (T,) of triangles, with `size` texels per side, in memory. Raises
    GeometryError if there are more than MAX_TEXELS."""
    count = 1 if pages is None else int(pages.max(initial=0)) + 1
    if count * size**2 > MAX_TEXELS:
        raise GeometryError(f"The UV map needs {count:,} images of {size:,} x {size:,} pixels, which is too much; choose a smaller Size.")


def find_overlapping(corner_uvs: np.ndarray, pages: np.ndarray | None = None) -> np.ndarray:
    """Return which triangles (T,) bool with UVs (T, 3, 2) share most of their texels with others of the same of `pages` (T,); none of a
    page if these are few altogether."""
    found = np.zeros(len(corner_uvs), bool)
    for page in [None] if pages is None else np.unique(pages[pages != NO_PAGE]):
        chosen = slice(None) if page is None else pages == page
        found[chosen] = _find_overlapping(corner_uvs[chosen])
    return found


def _find_overlapping(corner_uvs: np.ndarray) -> np.ndarray:
    """Do what `find_overlapping` does, for one page."""
    corners = corner_uvs.astype(np.float64) * OVERLAP_SIZE
    counts = np.zeros(OVERLAP_SIZE * OVERLAP_SIZE, np.int32)
    for _, texels, barycentric in rasterize(corners, (OVERLAP_SIZE, OVERLAP_SIZE)):
        counts += np.bincount(texels[_is_inside(barycentric)], minlength=OVERLAP_SIZE * OVERLAP_SIZE).astype(np.int32)
    is_shared = counts > 1
    if is_shared.sum() <= MAX_FRACTION * np.count_nonzero(counts):
        return np.zeros(len(corners), bool)
    shared, covered = np.zeros(len(corners)), np.zeros(len(corners))
    for triangles, texels, barycentric in rasterize(corners, (OVERLAP_SIZE, OVERLAP_SIZE)):
        inside = _is_inside(barycentric)
        covered += np.bincount(triangles[inside], minlength=len(corners))
        shared += np.bincount(triangles[inside], is_shared[texels[inside]], len(corners))
    return (covered > 0) & (shared >= MIN_SHARED * covered)


def _is_inside(barycentric: np.ndarray) -> np.ndarray:
    """Return which texels (N,) bool with barycentric coordinates (N, 3) are inside their triangle. The comparisons take a tenth of the time
    of a minimum over each row."""
    return (barycentric[:, 0] > INSIDE) & (barycentric[:, 1] > INSIDE) & (barycentric[:, 2] > INSIDE)


def describe_overlaps(count: int) -> str:
    """Return the end of the sentence that refuses a UV map in which `count` triangles overlap others."""
    return (
        f"{count:,} triangles share texels with others, which would get the same picture; unwrap the mesh again, or move the islands "
        "apart, also those of modifiers like Mirror."
    )


def check_overlaps(corner_uvs: np.ndarray, pages: np.ndarray | None = None) -> None:
    """Check that triangles with UVs (T, 3, 2) have texels of their own in their `pages` (T,). Raises GeometryError if they do not."""
    count = int(np.count_nonzero(find_overlapping(corner_uvs, pages)))
    if count:
        raise GeometryError(f"The UV map overlaps itself: {describe_overlaps(count)}")
