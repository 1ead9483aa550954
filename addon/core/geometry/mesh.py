"""Triangle meshes and oriented points as plain arrays, their connected components, and the checks that every input passes."""

import hashlib
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csgraph

from ..arrays import group_rows
from ..errors import GeometryError
from ..messages import format_count
from .transforms import normalize

MIN_HEIGHT = 2e-14  # Relative to a triangle's longest edge; below, its direction is lost in double precision.
MAX_COORDINATE = 1e37  # leaves room for results that are larger than their source: single precision ends at 3.4e38
COORDINATE_ROUNDING = 2e-15  # Relative to the largest coordinate; the height of a lower triangle is rounding.

MAX_SOLID_BOUNDARY = 0.5  # boundary length of a solid relative to the square root of its area
MAX_LOOSE_AREA = 0.05  # A component with a larger fraction of the whole area is not a leaf.
MAX_LOOSE_TRIANGLES = 32
MAX_LOOSE_SIDE = 0.05  # Relative to the longest side of the whole.
MIN_VOLUME = 1e-3  # Relative to area**1.5 (a ball has 0.094); anything flatter is a folded sheet.


@dataclass(frozen=True)
class TriangleMesh:
    """A triangle soup in world space.

    vertices: (V, 3) float64. triangles: (T, 3) int32, counter-clockwise seen from outside.
    materials: (T,) int32 index into a list kept by the creator of the mesh, or None.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    materials: np.ndarray | None = None

    @property
    def corners(self) -> np.ndarray:
        """(T, 3, 3) float64 corner positions of every triangle."""
        return self.vertices[self.triangles]


@dataclass(frozen=True)
class PointCloud:
    """Oriented discs in world space: points (N, 3), unit normals (N, 3), radii (N,), all float64; colors (N, 4) scene-linear or None."""

    points: np.ndarray
    normals: np.ndarray
    radii: np.ndarray
    colors: np.ndarray | None = None


def scaled_normals(corners: np.ndarray) -> np.ndarray:
    """Return the cross products of the edges, (T, 3): unit normal times twice the area. `corners` is (T, 3, 3)."""
    origins, first, second = (np.array(corners[:, corner].T, order="C") for corner in range(3))  # NumPy is slow along short axes.
    first -= origins
    second -= origins
    normals = np.empty((len(corners), 3), first.dtype)
    for axis in range(3):
        following, last = (axis + 1) % 3, (axis + 2) % 3
        normals[:, axis] = first[following] * second[last] - first[last] * second[following]
    return normals


def face_areas_and_normals(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return areas (T,) and unit normals (T, 3) of the triangles `corners` (T, 3, 3). A zero-area triangle gets a zero normal."""
    normals = scaled_normals(corners)
    x, y, z = normals.T
    lengths = np.sqrt(x * x + y * y + z * z)
    normals /= np.where(lengths > 0.0, lengths, 1.0)[:, None]
    return 0.5 * lengths, normals


def vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return unit normals (V, 3) float64 of `vertices` (V, 3), the means of the `triangles` (T, 3) around them by area; zero where
    undefined."""
    normals = np.zeros((len(vertices), 3))
    scaled = scaled_normals(vertices[triangles])
    for axis in range(3):
        normals[:, axis] = np.bincount(triangles.ravel(), np.repeat(scaled[:, axis], 3), len(vertices))
    return normalize(normals)


def has_area(corners: np.ndarray) -> np.ndarray:
    """Return whether each of the finite triangles `corners` (T, 3, 3) has an area, (T,) bool.

    Only its own size counts, so that small triangles far from each other keep theirs.
    """
    longest_edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
    min_heights = np.maximum(MIN_HEIGHT * longest_edges, COORDINATE_ROUNDING * np.abs(corners).max(axis=(1, 2)))
    return np.linalg.norm(scaled_normals(corners), axis=1) > min_heights * longest_edges


def longest_side(points: np.ndarray) -> float:
    """Return the longest side of the axis-aligned bounding box of `points` (N, 3), in their unit."""
    return float(np.ptp(points, axis=0).max())


def check_points(points: np.ndarray, name: str) -> None:
    """Check that `points` (N, 3), world space, can be worked on; `name` is that of their object.

    Raises:
        GeometryError: they are empty, not finite, beyond MAX_COORDINATE, or all at the same position.
    """
    if len(points) == 0:
        raise GeometryError(f'"{name}" has no vertices; choose an object with a surface.')
    if not np.isfinite(points).all():
        count = format_count(int((~np.isfinite(points).all(axis=1)).sum()), "vertex")
        raise GeometryError(f'"{name}" has {count} with coordinates that are not finite numbers; delete or repair them.')
    if np.abs(points).max() > MAX_COORDINATE:
        count = format_count(int((np.abs(points).max(axis=1) > MAX_COORDINATE).sum()), "vertex")
        raise GeometryError(f'"{name}" has {count} with coordinates above {MAX_COORDINATE:g}; move them closer, or delete them.')
    if longest_side(points) <= 0.0:
        raise GeometryError(f'All vertices of "{name}" are at the same position; choose an object with a surface.')


def drop_degenerate(mesh: TriangleMesh, name: str = "mesh") -> tuple[TriangleMesh, np.ndarray]:
    """Return the mesh without zero-area triangles, and the indices (K,) of the remaining triangles.

    Raises:
        GeometryError: the mesh is empty, not finite, or has no triangle with an area.
    """
    if len(mesh.triangles) == 0:
        raise GeometryError(f'"{name}" has no faces; choose an object with a surface.')
    is_used = np.zeros(len(mesh.vertices), bool)
    is_used[mesh.triangles] = True
    check_points(mesh.vertices[is_used], name)
    kept = np.flatnonzero(has_area(mesh.corners))
    if len(kept) == 0:
        raise GeometryError(f'Every face of "{name}" has zero area; choose an object with a surface.')
    materials = None if mesh.materials is None else mesh.materials[kept]
    return TriangleMesh(mesh.vertices, mesh.triangles[kept], materials), kept


def concatenate(meshes: list[TriangleMesh]) -> TriangleMesh:
    """Return one soup of all `meshes`; materials keep their indices (-1 where a mesh has none)."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    triangles = [mesh.triangles + offset for mesh, offset in zip(meshes, offsets[:-1], strict=True)]
    materials = [np.full(len(mesh.triangles), -1, np.int32) if mesh.materials is None else mesh.materials for mesh in meshes]
    return TriangleMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(triangles).astype(np.int32),
        np.concatenate(materials).astype(np.int32),
    )


def connected_components(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the label (P,) int32 of every face's connected component; points at exactly the same position count as one.

    Args:
        points: (V, 3) float64. corners: (P, C) int32 into points.
    """
    corners = group_rows(points)[corners]
    links = np.stack([corners[:, :-1], corners[:, 1:]], axis=2).reshape(-1, 2)
    count = int(corners.max()) + 1
    graph = coo_matrix((np.ones(len(links), np.int8), (links[:, 0], links[:, 1])), shape=(count, count))
    return csgraph.connected_components(graph, directed=False)[1][corners[:, 0]].astype(np.int32)


def solid_components(points: np.ndarray, triangles: np.ndarray, components: np.ndarray) -> np.ndarray:
    """Return whether each triangle's component bounds a solid, with normals pointing outwards: (T,) bool.

    Holes are ignored while the total boundary is shorter than MAX_SOLID_BOUNDARY times the square root of the component's area, such as
    those under a scanned bust. A leaf, a cup or a sheet is not solid.

    Args:
        points: (V, 3) float64. triangles: (T, 3) int32. components: (T,) int32 from `connected_components`.
    """
    corners = group_rows(points)[triangles]
    starts, ends = corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1)
    count = int(corners.max()) + 1
    forward, backward = starts.astype(np.int64) * count + ends, ends.astype(np.int64) * count + starts
    positions = points[triangles]
    lengths = np.linalg.norm(positions - np.roll(positions, -1, axis=1), axis=2)
    boundary = np.where(np.isin(forward, backward).reshape(-1, 3), 0.0, lengths).sum(axis=1)
    face_areas, _ = face_areas_and_normals(positions)
    areas = np.bincount(components, face_areas)
    weights = face_areas / np.where(areas > 0.0, areas, 1.0)[components]
    centers = np.stack([np.bincount(components, weights * positions[:, :, axis].mean(axis=1)) for axis in range(3)], axis=1)
    face_volumes = np.einsum("ti,ti->t", scaled_normals(positions), positions[:, 0] - centers[components]) / 6.0
    volumes = np.bincount(components, face_volumes)
    is_solid = (np.bincount(components, boundary) < MAX_SOLID_BOUNDARY * np.sqrt(areas)) & (volumes > MIN_VOLUME * areas**1.5)
    return is_solid[components]


def loose_components(points: np.ndarray, triangles: np.ndarray, components: np.ndarray) -> np.ndarray:
    """Return whether each triangle belongs to a loose component, such as a leaf or a card of leaves: (T,) bool.

    A loose component has a small part of the area, and has few triangles or is small. Arguments as in `solid_components`.
    """
    positions = points[triangles]
    areas, _ = face_areas_and_normals(positions)
    order = np.argsort(components, kind="stable")
    starts = np.searchsorted(components[order], np.arange(int(components.max()) + 1))
    low = np.minimum.reduceat(positions.min(axis=1)[order], starts)
    high = np.maximum.reduceat(positions.max(axis=1)[order], starts)
    has_few = np.bincount(components) < MAX_LOOSE_TRIANGLES
    is_small = (high - low).max(axis=1) < MAX_LOOSE_SIDE * longest_side(positions.reshape(-1, 3))
    return ((np.bincount(components, areas) < MAX_LOOSE_AREA * areas.sum()) & (has_few | is_small))[components]


def fingerprint(points: np.ndarray, corners: np.ndarray) -> str:
    """Return a digest of a geometry: points (V, 3) to a ten-thousandth of the longest side, and their connectivity (any integers)."""
    side = longest_side(points) or 1.0
    center = np.rint(0.5 * (points.min(axis=0) + points.max(axis=0)) * (1e4 / side))  # too large for an integer far from the origin
    with np.errstate(invalid="ignore"):  # Coordinates that are not finite become any integer.
        relative = np.rint(points * (1e4 / side) - center).astype(np.int64)
    return hashlib.sha256(center.tobytes() + relative.tobytes() + np.ascontiguousarray(corners, np.int64).tobytes()).hexdigest()
