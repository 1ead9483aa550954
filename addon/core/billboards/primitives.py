"""Primitives of the clustering: the triangles of a mesh, or one square per disc of a point cloud, and their connected components."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import GeometryError
from ..geometry.mesh import (
    PointCloud,
    TriangleMesh,
    check_points,
    connected_components,
    face_areas_and_normals,
    loose_components,
    solid_components,
)
from ..geometry.proximity import neighbor_pairs
from ..geometry.transforms import frames_from_normals

MAX_NORMAL_LENGTH_ERROR = 1e-3  # Normals of points whose length differs more from 1 count as missing.
NEIGHBOR_COUNT = 50  # n of section 4.3.1.
TRIANGLE_COVARIANCE_SCALE = 1.0 / 4.0  # Covariance of a triangle's area over the mean covariance of its corners.
SQUARE_COVARIANCE_SCALE = 1.0 / 3.0  # The same for a square.


@dataclass(frozen=True)
class Primitives:
    """P planar convex polygons with C corners each, in world space.

    points (V, 3) float64; corners (P, C) int32 into points; areas (P,); normals (P, 3) unit.
    """

    points: np.ndarray
    corners: np.ndarray
    areas: np.ndarray
    normals: np.ndarray

    def __len__(self) -> int:
        return len(self.corners)

    @cached_property
    def positions(self) -> np.ndarray:
        """(P, C, 3) corner positions."""
        return self.points[self.corners]

    @cached_property
    def covariances(self) -> np.ndarray:
        """(P, 3, 3) covariance of each primitive's area about its centroid."""
        scale = TRIANGLE_COVARIANCE_SCALE if self.corners.shape[1] == 3 else SQUARE_COVARIANCE_SCALE
        centered = self.positions - self.positions.mean(axis=1, keepdims=True)
        return scale * np.einsum("pci,pcj->pij", centered, centered) / self.corners.shape[1]

    @cached_property
    def proximity_graph(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs (E, 2) int32 of neighboring primitives and their distances (E,), see `neighbor_pairs`. Independent of the error."""
        return neighbor_pairs(self.positions, NEIGHBOR_COUNT)

    def find_points(self, indices: np.ndarray) -> np.ndarray:
        """Return which points (N,), ascending, the primitives `indices` (K,) use: far fewer than their corners."""
        is_used = np.zeros(len(self.points), bool)
        is_used[self.corners[indices]] = True
        return np.flatnonzero(is_used)

    def subset(self, indices: np.ndarray) -> "Primitives":
        """Return the primitives `indices` (K,) in that order. Keeps all points."""
        return Primitives(self.points, self.corners[indices], self.areas[indices], self.normals[indices])


def from_mesh(mesh: TriangleMesh) -> Primitives:
    """Return the triangles of a mesh without zero-area triangles (see `drop_degenerate`)."""
    areas, normals = face_areas_and_normals(mesh.corners)
    return Primitives(mesh.vertices, mesh.triangles, areas, normals)


def drop_incomplete_points(cloud: PointCloud, name: str) -> tuple[PointCloud, np.ndarray]:
    """Return the points that have a radius above 0 and a unit normal, and their indices (K,).

    Raises:
        GeometryError: the cloud is empty or not finite, or no point is complete; the message contains `name`.
    """
    check_points(cloud.points, name)
    has_radius = np.isfinite(cloud.radii) & (cloud.radii > 0.0)
    has_normal = np.abs(np.linalg.norm(cloud.normals, axis=1) - 1.0) < MAX_NORMAL_LENGTH_ERROR
    kept = np.flatnonzero(has_radius & has_normal)
    if len(kept) == 0:
        missing = "a normal" if has_radius.any() and not has_normal.any() else "a finite radius above 0"
        missing = "both" if has_radius.any() and has_normal.any() else missing
        raise GeometryError(f'No point of "{name}" has {missing}; correct its normals and radii, or remove them to have them estimated.')
    colors = None if cloud.colors is None else cloud.colors[kept]
    return PointCloud(cloud.points[kept], cloud.normals[kept], cloud.radii[kept], colors), kept


def from_points(cloud: PointCloud) -> Primitives:
    """Return per disc its circumscribed square in the tangent plane, so that bounds on the corners hold for the whole splat."""
    u, v, _ = np.moveaxis(frames_from_normals(cloud.normals), 1, 0)
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    diagonals = signs[:, 0, None] * u[:, None] + signs[:, 1, None] * v[:, None]
    positions = cloud.points[:, None] + cloud.radii[:, None, None] * diagonals
    corners = np.arange(4 * len(cloud.points), dtype=np.int32).reshape(-1, 4)
    return Primitives(positions.reshape(-1, 3), corners, 4.0 * cloud.radii**2, cloud.normals)


@dataclass(frozen=True)
class Components:
    """The connected component of each of P primitives.

    labels (P,) int32: component. solid (P,) bool: the component bounds a solid. loose (P,) bool: the component is a leaf or a card.
    """

    labels: np.ndarray
    solid: np.ndarray
    loose: np.ndarray

    @property
    def sheets(self) -> np.ndarray:
        """(P,) bool: loose sheets, such as leaves. They share no quad with other surfaces, while bolts may with what they sit on."""
        return self.loose & ~self.solid

    def subset(self, indices: np.ndarray) -> "Components":
        """Return the entries of the primitives `indices` (K,). Labels do not change."""
        return Components(self.labels[indices], self.solid[indices], self.loose[indices])


def find_components(primitives: Primitives) -> Components:
    """Find the connected components of `primitives`. A point cloud is a single component, neither solid nor loose."""
    count = len(primitives)
    if primitives.corners.shape[1] != 3:
        return Components(np.zeros(count, np.int32), np.zeros(count, bool), np.zeros(count, bool))
    mesh = (primitives.points, primitives.corners)
    labels = connected_components(*mesh)
    return Components(labels, solid_components(*mesh, labels), loose_components(*mesh, labels))


def find_shared_surfaces(components: Components, owner: np.ndarray) -> np.ndarray:
    """Find the connected surfaces that several quads divide between them.

    Args:
        owner: (P,) int32 quad that owns each primitive.

    Returns:
        (P,) bool: the primitive belongs to such a surface. False for loose sheets.
    """
    labels = components.labels
    min_owner = np.full(int(labels.max()) + 1, np.iinfo(np.int32).max)
    max_owner = np.full(len(min_owner), -1)
    np.minimum.at(min_owner, labels, owner)
    np.maximum.at(max_owner, labels, owner)
    return (min_owner < max_owner)[labels] & ~components.sheets
