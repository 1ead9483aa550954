"""Levels of aggregate detail, such as the leaves of a tree: fewer and larger elements with the same area.

Cook, Halstead, Planck and Ryu: Stochastic simplification of aggregate detail, 2007. An element is a loose part of a mesh. Once it is small
in an image, a flat stand-in replaces it. Once the stand-in is smaller than a pixel it grows to that size, and as many elements are dropped
as keep the area. Levels are nested: what a level has dropped, no coarser one has.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import TINY
from ..geometry.distance import segment_argmin
from ..geometry.mesh import connected_components, face_areas_and_normals, longest_side
from ..geometry.transforms import normalize

MIN_ELEMENTS = 300  # Fewer are parts of a machine rather than leaves.
MIN_AREA = 0.5  # Of all elements together, relative to the area of the mesh.
MAX_ELEMENT_AREA = 5e-3  # Of one element, relative to the area of the mesh; trunks and walls have more.
# See `measure_scatter`. Leaves have about 0.5 and 0.7. Gaps would open between roof tiles with 0.1 and 1, and between slats with 0.5 and 1.
MIN_SCATTER, MAX_ALIGNMENT = 0.35, 0.9
SAMPLES, NEIGHBORS = 2000, 8  # Elements whose neighbors are looked at, and how many.
MORTON_BITS = 10  # Per axis, of the cells by which elements are sorted.
SHEET_ERROR, SOLID_ERROR = 0.125, 0.5  # What a stand-in of a sheet, and of a twig, leaves out, relative to the width.
MIN_SIDE = 1.0  # Of a stand-in, in pixels.
# Stand-ins of sheets, pointed as leaves, and of twigs, along and across, relative to the sides of a rectangle with the same area.
RHOMBUS = np.sqrt(0.5) * np.array([(-1, 0), (0, -1), (1, 0), (0, 1)])
RECTANGLE = 0.5 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


@dataclass(frozen=True)
class Elements:
    """The elements of a mesh and their stand-ins. Lengths are in units of the mesh.

    Attributes:
        of_triangles: (T,) int32, the element of each triangle, -1 for the rest of the mesh.
        centers: (E, 3), those of their areas.
        frames: (E, 3, 3), unit vectors along and across the element, and its normal.
        sizes: (E, 2), length and width of a rectangle with the area of the stand-in.
        offsets: (E, 4, 3), the corners of the stand-in in its frame, counter-clockwise; the last two are equal in triangles.
        corners: (E, 4) int64, for each of them the corner of the mesh, 3 * triangle + corner, whose attributes it gets.
        errors: (E,), the size of what the stand-in leaves out.
        ranks: (E,), 0..1, the order in which elements are dropped, the highest first; those that remain are evenly distributed.
        is_flat: (E,) bool, whether the stand-in has the normal of its face instead of those of the corners of the mesh.
    """

    of_triangles: np.ndarray
    centers: np.ndarray
    frames: np.ndarray
    sizes: np.ndarray
    offsets: np.ndarray
    corners: np.ndarray
    errors: np.ndarray
    ranks: np.ndarray
    is_flat: np.ndarray

    @property
    def is_quad(self) -> np.ndarray:
        """Whether each stand-in has four corners: (E,) bool."""
        return (self.offsets[:, 2] != self.offsets[:, 3]).any(axis=1)


@dataclass(frozen=True)
class AggregateLevel:
    """A level of the elements of a mesh.

    Attributes:
        kept: (K,) int64, triangles of the mesh that stay as they are.
        positions: (N, 3, 3), the corners of the triangles of stand-ins.
        sources: (N, 3) int64, the corners of the mesh, 3 * triangle + corner, whose attributes they have.
        is_flat: (N,) bool, see `Elements`.
    """

    kept: np.ndarray
    positions: np.ndarray
    sources: np.ndarray
    is_flat: np.ndarray


def find_elements(vertices: np.ndarray, triangles: np.ndarray) -> Elements | None:
    """Return the elements of a mesh with `vertices` (V, 3) and `triangles` (T, 3), None if it is no aggregate: if most of its area is not
    that of many loose parts, or if these form surfaces."""
    vertices = np.asarray(vertices, np.float64)
    if len(triangles) < MIN_ELEMENTS:
        return None
    _, components = np.unique(connected_components(vertices, triangles), return_inverse=True)
    areas, normals = face_areas_and_normals(vertices[triangles])
    component_areas = np.bincount(components, areas)
    total = max(areas.sum(), TINY)
    is_element = (component_areas <= MAX_ELEMENT_AREA * total) & (component_areas > 0.0)
    if is_element.sum() < MIN_ELEMENTS or component_areas[is_element].sum() < MIN_AREA * total:
        return None
    numbers = np.where(is_element, np.cumsum(is_element) - 1, -1).astype(np.int32)
    elements = _describe(vertices, triangles, numbers[components], areas, normals)
    scatter, alignment = measure_scatter(elements)
    return elements if scatter >= MIN_SCATTER and alignment <= MAX_ALIGNMENT else None


def measure_scatter(elements: Elements) -> tuple[float, float]:
    """Return the mean sine of the angle between elements and the lines to their neighbors, 0 in a surface and 0.5 in a volume, and the mean
    cosine between their normals, 1 if they are parallel."""
    sampled = np.unique(np.linspace(0, len(elements.centers) - 1, SAMPLES).astype(int))
    _, nearest = cKDTree(elements.centers).query(elements.centers[sampled], min(NEIGHBORS + 1, len(elements.centers)))
    directions = normalize(elements.centers[nearest[:, 1:]] - elements.centers[sampled, None])
    normals, neighbors = elements.frames[sampled, 2], elements.frames[nearest[:, 1:], 2]
    weights = np.maximum(elements.sizes[sampled].prod(axis=1), TINY)
    sines, cosines = (np.abs(np.einsum("ski,si->sk", vectors, normals)).mean(axis=1) for vectors in (directions, neighbors))
    return float(np.average(sines, weights=weights)), float(np.average(cosines, weights=weights))


def count_triangles(elements: Elements, pixel_size: float) -> np.ndarray:
    """Return the number of triangles (E,) of each element in the level for a pixel size."""
    is_replaced, growth = _grow(elements, pixel_size)
    numbers = np.bincount(elements.of_triangles[elements.of_triangles >= 0], minlength=len(is_replaced))
    is_shown = elements.ranks * growth.prod(axis=1) < 1.0
    return np.where(is_replaced, np.where(elements.is_quad, 2, 1) * is_shown, numbers)


def simplify_elements(elements: Elements, pixel_size: float, is_left_out: np.ndarray | bool = False) -> AggregateLevel:
    """Return the level that looks like the elements where a pixel is larger than `pixel_size`, without some of them (E,)."""
    is_replaced, growth = _grow(elements, pixel_size)
    is_kept = ~np.asarray(is_left_out)
    is_original = np.append(~is_replaced & is_kept, False)  # The last one is that of the rest.
    kept = np.flatnonzero(is_original[elements.of_triangles])
    chosen = np.flatnonzero(is_replaced & (elements.ranks * growth.prod(axis=1) < 1.0) & is_kept)
    offsets = elements.offsets[chosen].copy()
    offsets[..., :2] *= growth[chosen, None]
    positions = elements.centers[chosen, None] + offsets @ elements.frames[chosen]
    halves = [(slice(None), [0, 1, 2]), (elements.is_quad[chosen], [0, 2, 3])]
    return AggregateLevel(
        kept,
        np.concatenate([positions[rows][:, corners] for rows, corners in halves]),
        np.concatenate([elements.corners[chosen][rows][:, corners] for rows, corners in halves]),
        np.concatenate([elements.is_flat[chosen][rows] for rows, _ in halves]),
    )


def _grow(elements: Elements, pixel_size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return which elements (E,) a stand-in replaces, and by how much it grows along and across (E, 2)."""
    return elements.errors <= pixel_size, np.maximum(MIN_SIDE * pixel_size / elements.sizes, 1.0)


def _describe(vertices: np.ndarray, triangles: np.ndarray, of_triangles: np.ndarray, areas: np.ndarray, normals: np.ndarray) -> Elements:
    rows = np.flatnonzero(of_triangles >= 0)
    rows = rows[np.argsort(of_triangles[rows], kind="stable")]  # Triangles of an element are next to each other.
    owners, corners = of_triangles[rows], vertices[triangles[rows]]
    count = int(owners[-1]) + 1
    starts = np.searchsorted(owners, np.arange(count))
    weights = areas[rows]
    element_areas = np.bincount(owners, weights)
    centers = _sum(owners, corners.mean(axis=1) * weights[:, None]) / element_areas[:, None]
    relative = corners - centers[owners, None]
    sums = relative.sum(axis=1)
    moments = np.einsum("tki,tkj->tij", relative, relative) + sums[:, :, None] * sums[:, None]  # Twelve times those of unit area.
    moments = _sum(owners, (moments * weights[:, None, None]).reshape(-1, 9)).reshape(-1, 3, 3)
    eigenvalues, eigenvectors = np.linalg.eigh(moments)
    axes = eigenvectors[:, :, ::-1].transpose(0, 2, 1)
    # The sides of the rectangle with the same moments.
    length, breadth = np.sqrt(np.maximum(eigenvalues[:, [2, 1]], TINY) / element_areas[:, None]).T
    vector_areas = _sum(owners, normals[rows] * weights[:, None])
    along = axes[:, 0]
    normal = axes[:, 2] * np.where(np.einsum("ei,ei->e", axes[:, 2], vector_areas) < 0.0, -1.0, 1.0)[:, None]
    frames = np.stack([along, np.cross(normal, along), normal], axis=1)
    local = np.einsum("tki,tji->tkj", relative, frames[owners]).reshape(-1, 3)
    flat_corners = (3 * rows[:, None] + np.arange(3)).ravel()
    extremes = [segment_argmin(sign * local[:, axis], 3 * starts) for sign, axis in ((1, 0), (1, 1), (-1, 0), (-1, 1))]
    # A closed surface covers twice what a sheet of the same area covers from its front, but from all sides as much as one of half of it.
    sheetness = np.linalg.norm(vector_areas, axis=1) / element_areas
    is_sheet = sheetness > 0.5
    sizes = np.stack([length, 0.5 * (1.0 + sheetness) * element_areas / length], axis=1)
    offsets = np.zeros((count, 4, 3))
    offsets[..., :2] = np.where(is_sheet[:, None, None], RHOMBUS, RECTANGLE) * sizes[:, None]
    chosen = flat_corners[np.stack(extremes, axis=1)]
    errors = np.where(is_sheet, SHEET_ERROR, SOLID_ERROR) * np.maximum(breadth, sizes[:, 1])
    own, own_corners = _find_own_shapes(vertices, triangles, rows, starts)
    own_positions = vertices[triangles.ravel()[own_corners]] - centers[own, None]
    offsets[own] = np.einsum("eki,eji->ekj", own_positions, frames[own])
    chosen[own], errors[own] = own_corners, 0.0
    sizes[own] = np.stack([length, breadth], axis=1)[own]
    return Elements(of_triangles, centers, frames, sizes, offsets, chosen, errors, _rank(centers), ~is_sheet)


def _sum(owners: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the sums (E, C) of `values` (N, C) by owner."""
    return np.stack([np.bincount(owners, column) for column in values.T], axis=1)


def _find_own_shapes(vertices: np.ndarray, triangles: np.ndarray, rows: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the elements (N,) of one triangle, or of two with a common edge, and their corners (N, 4) as in `Elements`."""
    sizes = np.diff(np.append(starts, len(rows)))
    single, double = np.flatnonzero(sizes == 1), np.flatnonzero(sizes == 2)
    corners_of_single = 3 * rows[starts[single]][:, None] + [0, 1, 2, 2]
    first, second = rows[starts[double]], rows[starts[double] + 1]
    positions = vertices[triangles]
    is_equal = (positions[first][:, :, None] == positions[second][:, None]).all(axis=3)
    has_common_edge = (is_equal.sum(axis=(1, 2)) == 2) & (is_equal.any(axis=2).sum(axis=1) == 2)
    apex, other = (~is_equal.any(axis=2)).argmax(axis=1), (~is_equal.any(axis=1)).argmax(axis=1)
    corners_of_double = np.stack([3 * first + (apex + 1) % 3, 3 * second + other, 3 * first + (apex + 2) % 3, 3 * first + apex], axis=1)
    elements = np.concatenate([single, double[has_common_edge]])
    return elements, np.concatenate([corners_of_single, corners_of_double[has_common_edge]])


def _rank(centers: np.ndarray) -> np.ndarray:
    """Return numbers (E,) in 0..1 such that the elements with a rank below any number are evenly distributed in space: the radical inverses
    of their positions along a space-filling curve."""
    side = max(longest_side(centers), TINY)
    cells = np.minimum((centers - centers.min(axis=0)) / side * (1 << MORTON_BITS), (1 << MORTON_BITS) - 1).astype(np.int64)
    codes = np.zeros(len(centers), np.int64)
    for bit in range(MORTON_BITS):
        for axis in range(3):
            codes |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    positions = np.empty(len(centers), np.int64)
    positions[np.argsort(codes, kind="stable")] = np.arange(len(centers))
    ranks = np.zeros(len(centers))
    for bit in range(len(centers).bit_length()):
        ranks += ((positions >> bit) & 1) * 0.5 ** (bit + 1)
    return ranks
