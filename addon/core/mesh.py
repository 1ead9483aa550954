"""Triangle meshes and oriented points as plain arrays, and the checks that every tool's input passes."""

import hashlib
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from .errors import GeometryError

ZERO_AREA = 1e-14  # of the squared longest side: below this a triangle has no direction that double precision could tell

SOLID_RIM = 0.5  # of the root of its area: the longest rim of holes in what still counts as a solid
LOOSE_AREA = 0.05  # of the whole: a part with more is no leaf
LOOSE_TRIANGLES = 32
LOOSE_SIDE = 0.05  # of the longest side of the whole
LEAST_VOLUME = 1e-3  # of its area to the power 1.5 (a ball has 0.094): anything flatter is a folded sheet


@dataclass(frozen=True)
class TriangleMesh:
    """A triangle soup in world space.

    vertices: (V, 3) float64. triangles: (T, 3) int32, counter-clockwise seen from outside.
    materials: (T,) int32 index into a list that the maker of the mesh keeps, or None.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    materials: np.ndarray | None = None

    @property
    def corners(self) -> np.ndarray:
        """(T, 3, 3) float64 positions of the corners of every triangle."""
        return self.vertices[self.triangles]


@dataclass(frozen=True)
class PointCloud:
    """Oriented discs in world space: points (N, 3), unit normals (N, 3), radii (N,), all float64; colors (N, 4) scene-linear or None."""

    points: np.ndarray
    normals: np.ndarray
    radii: np.ndarray
    colors: np.ndarray | None = None


def scaled_normals(corners: np.ndarray) -> np.ndarray:
    """Cross products of the edges, (T, 3): normal direction times twice the area. `corners` is (T, 3, 3)."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def face_areas_and_normals(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Areas (T,) and unit normals (T, 3) of triangles given by `corners` (T, 3, 3). A zero-area triangle gets a zero normal."""
    doubled = scaled_normals(corners)
    lengths = np.linalg.norm(doubled, axis=1)
    return 0.5 * lengths, doubled / np.where(lengths > 0.0, lengths, 1.0)[:, None]


def longest_side(points: np.ndarray) -> float:
    """Longest side of the axis-aligned bounding box of `points` (N, 3), in their unit."""
    return float(np.ptp(points, axis=0).max())


def check_points(points: np.ndarray, name: str) -> None:
    """Raise GeometryError when `points` (N, 3) are none, are not finite, or all lie in one place. `name` says whose they are."""
    if len(points) == 0:
        raise GeometryError(f'"{name}" has no vertices; choose an object with a surface.')
    if not np.isfinite(points).all():
        count = int((~np.isfinite(points).all(axis=1)).sum())
        raise GeometryError(f'"{name}" has {count} vertices with coordinates that are not finite numbers; delete or repair them.')
    if longest_side(points) <= 0.0:
        raise GeometryError(f'All vertices of "{name}" lie in one place; there is nothing to stand for.')


def without_zero_area(mesh: TriangleMesh, name: str = "mesh") -> tuple[TriangleMesh, np.ndarray]:
    """The mesh without zero-area triangles, and the indices (K,) of the triangles that were kept.

    Raises:
        GeometryError: when the mesh is empty, not finite, or has no triangle with an area.
    """
    if len(mesh.triangles) == 0:
        raise GeometryError(f'"{name}" has no faces; choose an object with a surface.')
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.triangles] = True
    check_points(mesh.vertices[used], name)
    areas, _ = face_areas_and_normals(mesh.corners)
    kept = np.flatnonzero(areas > ZERO_AREA * longest_side(mesh.vertices[used]) ** 2)
    if len(kept) == 0:
        raise GeometryError(f'Every face of "{name}" has zero area; there is nothing to stand for.')
    materials = None if mesh.materials is None else mesh.materials[kept]
    return TriangleMesh(mesh.vertices, mesh.triangles[kept], materials), kept


def merge(meshes: list[TriangleMesh]) -> TriangleMesh:
    """One soup of all `meshes`; materials keep their indices (-1 where a mesh has none)."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    triangles = [mesh.triangles + offset for mesh, offset in zip(meshes, offsets[:-1], strict=True)]
    materials = [np.full(len(mesh.triangles), -1, np.int32) if mesh.materials is None else mesh.materials for mesh in meshes]
    return TriangleMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(triangles).astype(np.int32),
        np.concatenate(materials).astype(np.int32),
    )


def connected_parts(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Label (P,) int32 of the connected part of every face; points at exactly the same place count as one.

    Args:
        points: (V, 3) float64. corners: (P, C) int32 into points.
    """
    _, welded = np.unique(points, axis=0, return_inverse=True)
    corners = welded.reshape(-1)[corners]
    links = np.stack([corners[:, :-1], corners[:, 1:]], axis=2).reshape(-1, 2)
    count = int(corners.max()) + 1
    graph = coo_matrix((np.ones(len(links), np.int8), (links[:, 0], links[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1][corners[:, 0]].astype(np.int32)


def solid_parts(points: np.ndarray, triangles: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Whether the connected part of each triangle bounds a solid whose outside its normals look to: (T,) bool.

    Holes whose summed rim is shorter than SOLID_RIM times the root of the part's area are overlooked, as those under a scanned bust are;
    a leaf, a cup or a sheet is no solid.

    Args:
        points: (V, 3) float64. triangles: (T, 3) int32. parts: (T,) int32 from `connected_parts`.
    """
    _, welded = np.unique(points, axis=0, return_inverse=True)
    corners = welded.reshape(-1)[triangles]
    starts, ends = corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1)
    count = int(corners.max()) + 1
    forward, backward = starts.astype(np.int64) * count + ends, ends.astype(np.int64) * count + starts
    positions = points[triangles]
    lengths = np.linalg.norm(positions - np.roll(positions, -1, axis=1), axis=2)
    rim = np.where(np.isin(forward, backward).reshape(-1, 3), 0.0, lengths).sum(axis=1)
    areas, _ = face_areas_and_normals(positions)
    total = np.bincount(parts, areas)
    centres = np.stack([np.bincount(parts, areas * positions[:, :, axis].mean(axis=1)) / total for axis in range(3)], axis=1)
    volumes = np.bincount(parts, np.einsum("ti,ti->t", scaled_normals(positions), positions[:, 0] - centres[parts]) / 6.0)
    solid = (np.bincount(parts, rim) < SOLID_RIM * np.sqrt(total)) & (volumes > LEAST_VOLUME * total**1.5)
    return solid[parts]


def loose_parts(points: np.ndarray, triangles: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Whether each triangle belongs to a loose part, such as a leaf or a card of leaves, and not to a connected surface: (T,) bool.

    A loose part has little of the area, and is made of few triangles or small. Arguments as in `solid_parts`.
    """
    positions = points[triangles]
    areas, _ = face_areas_and_normals(positions)
    order = np.argsort(parts, kind="stable")
    starts = np.searchsorted(parts[order], np.arange(int(parts.max()) + 1))
    low = np.minimum.reduceat(positions.min(axis=1)[order], starts)
    high = np.maximum.reduceat(positions.max(axis=1)[order], starts)
    few = np.bincount(parts) < LOOSE_TRIANGLES
    small = (high - low).max(axis=1) < LOOSE_SIDE * longest_side(positions.reshape(-1, 3))
    return ((np.bincount(parts, areas) < LOOSE_AREA * areas.sum()) & (few | small))[parts]


def fingerprint(points: np.ndarray, corners: np.ndarray) -> str:
    """Digest of a geometry: points (V, 3) to a ten-thousandth of the longest side, and which of them are joined (any ints)."""
    side = longest_side(points) or 1.0
    rounded = np.rint(points * (1e4 / side)).astype(np.int64)
    return hashlib.sha256(rounded.tobytes() + np.ascontiguousarray(corners, np.int64).tobytes()).hexdigest()
