"""Triangle meshes and oriented points as plain arrays, and the checks that every tool's input passes."""

from dataclasses import dataclass

import numpy as np

from .errors import GeometryError

ZERO_AREA = 1e-14  # of the squared longest side: below this a triangle has no direction that double precision could tell


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


def connected_parts(mesh: TriangleMesh) -> np.ndarray:
    """Label (T,) int32 of the connected part of every triangle; vertices at exactly the same place count as one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    _, welded = np.unique(mesh.vertices, axis=0, return_inverse=True)
    corners = welded.reshape(-1)[mesh.triangles]
    links = np.concatenate([corners[:, :2], corners[:, 1:]])
    count = int(corners.max()) + 1
    graph = coo_matrix((np.ones(len(links), np.int8), (links[:, 0], links[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1][corners[:, 0]].astype(np.int32)
