"""Triangles that share texels with others, which cannot have textures of their own."""

import numpy as np

from ..errors import GeometryError
from ..imaging.raster import rasterize
from .pages import split_by_page

SIZE = 1024  # texels per side in which UV maps are examined
INSIDE = 0.01  # smallest barycentric coordinate: neighbors may share the texels on their edge
MIN_SHARED = 0.5  # of the texels of a triangle, from which it overlaps others
MAX_FRACTION = 0.01  # of all texels, which may be shared


def find_overlapping(corner_uvs: np.ndarray, pages: np.ndarray | None = None) -> np.ndarray:
    """Return which triangles (T,) bool with UVs (T, 3, 2) share most of their texels with others of the same of `pages` (T,); none of a
    page if these are few altogether."""
    found = np.zeros(len(corner_uvs), bool)
    for chosen in split_by_page(pages, len(corner_uvs)):
        found[chosen] = _find_overlapping(corner_uvs[chosen])
    return found


def _find_overlapping(corner_uvs: np.ndarray) -> np.ndarray:
    """Do what `find_overlapping` does, for one page."""
    corners = corner_uvs.astype(np.float64) * SIZE
    counts = np.zeros(SIZE * SIZE, np.int32)
    for _, texels, barycentric in rasterize(corners, (SIZE, SIZE)):
        counts += np.bincount(texels[_is_inside(barycentric)], minlength=SIZE * SIZE).astype(np.int32)
    is_shared = counts > 1
    if is_shared.sum() <= MAX_FRACTION * np.count_nonzero(counts):
        return np.zeros(len(corners), bool)
    shared, covered = np.zeros(len(corners)), np.zeros(len(corners))
    for triangles, texels, barycentric in rasterize(corners, (SIZE, SIZE)):
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
    """Check that triangles with UVs (T, 3, 2) have texels of their own in their `pages` (T,).

    Raises:
        GeometryError: they do not.
    """
    count = int(np.count_nonzero(find_overlapping(corner_uvs, pages)))
    if count:
        raise GeometryError(f"The UV map overlaps itself: {describe_overlaps(count)}")
