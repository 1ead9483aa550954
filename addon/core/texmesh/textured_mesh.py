"""Triangle meshes whose corners have texture coordinates and other attributes, divided into wedges."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..arrays import group_rows
from ..errors import GeometryError
from ..geometry.edges import Edges, find_edges, halfedge_ends
from ..geometry.mesh import TriangleMesh, check_points, drop_degenerate


@dataclass(frozen=True)
class TexturedMesh:
    """A mesh as a manifold of triangles, as far as its edges allow.

    A wedge is what the corners of a vertex have in common that agree in texture coordinates, attributes and material. Where the triangles
    at an edge have different wedges at one of its ends, the edge is a seam.

    Attributes:
        vertices: (V, 3) float64, in any one space. Each is used, and its triangles are connected across edges, so that two positions are
            equal where triangles touch at a point only.
        triangles: (T, 3) int32 into vertices, none without area.
        wedge_triangles: (T, 3) int32 into wedges.
        wedge_vertices: (W,) int32, the vertex of each wedge.
        uvs: (W, 2) float64, texture coordinates, v upwards.
        attributes: (W, A) float32, such as normals and colors.
        materials: (T,) int32, indices kept by the creator.
        sources: (T, 3) int32, for each corner the row of the corners that the mesh was built from.
        has_normals: whether the first three attributes are unit normals, zero on flat faces.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    wedge_triangles: np.ndarray
    wedge_vertices: np.ndarray
    uvs: np.ndarray
    attributes: np.ndarray
    materials: np.ndarray
    sources: np.ndarray
    has_normals: bool = False

    @property
    def corner_uvs(self) -> np.ndarray:
        """(T, 3, 2) float64 texture coordinates of the corners."""
        return self.uvs[self.wedge_triangles]

    @property
    def colors(self) -> np.ndarray:
        """(W, A') float32, the attributes but normals."""
        return self.attributes[:, 3 if self.has_normals else 0 :]

    def find_seams(self, edges: Edges) -> np.ndarray:
        """Return which of the `edges` of `triangles` are seams, (E,) bool. Boundaries are not."""
        is_seam = np.zeros(len(edges.ends), bool)
        first, second = edges.interior_halfedges.T
        wedges, others = (halfedge_ends(self.wedge_triangles, halfedges) for halfedges in (first, second))
        is_seam[edges.interior] = (wedges != others[:, ::-1]).any(axis=1)
        return is_seam


def build_textured_mesh(
    mesh: TriangleMesh,
    corner_uvs: np.ndarray,
    corner_attributes: np.ndarray | None = None,
    name: str = "mesh",
    has_normals: bool = False,
) -> TexturedMesh:
    """Build a textured mesh from triangles with values at their corners.

    Triangles without area are dropped. Vertices at the same position become one where boundaries meet, as along the seams of meshes whose
    vertices have one texture coordinate each, unless more than two triangles would share an edge.

    Args:
        mesh: (T,) triangles. corner_uvs: (T, 3, 2). corner_attributes: (T, 3, A), None for none. name: of the object, for messages.
        has_normals: see `TexturedMesh`.

    Raises:
        GeometryError: the mesh is empty, not finite or without area; texture coordinates are not finite.
    """
    if not np.isfinite(corner_uvs).all():
        raise GeometryError(f'"{name}" has texture coordinates that are not finite numbers; correct its UV map.')
    mesh, kept = drop_degenerate(mesh, name)
    used, triangles = np.unique(mesh.triangles, return_inverse=True)
    points = mesh.vertices[used]
    check_points(points, name)
    triangles = _weld_boundaries(points, triangles.reshape(-1, 3).astype(np.int32))
    corner_vertices = _split_fans(triangles)
    _, first, vertices = np.unique(corner_vertices, return_index=True, return_inverse=True)
    vertices = vertices.reshape(-1, 3).astype(np.int32)
    materials = np.zeros(len(kept), np.int32) if mesh.materials is None else mesh.materials
    values = np.zeros((len(kept), 3, 0), np.float32) if corner_attributes is None else corner_attributes[kept].astype(np.float32)
    uvs = corner_uvs[kept].astype(np.float64)
    wedges, examples = _find_wedges(vertices, materials, uvs, values)
    return TexturedMesh(
        vertices=points[triangles.reshape(-1)[first]],
        triangles=vertices,
        wedge_triangles=wedges,
        wedge_vertices=vertices.reshape(-1)[examples],
        uvs=uvs.reshape(-1, 2)[examples],
        attributes=values[examples // 3, examples % 3],
        materials=materials,
        sources=(3 * kept[:, None] + np.arange(3)).astype(np.int32),
        has_normals=has_normals,
    )


def group_by_texture(mesh: TexturedMesh, has_colors: bool = False) -> np.ndarray:
    """Return the groups (W,) int32 of wedges of a vertex with the same material and texture coordinates.

    has_colors: whether wedges of a group have the same attributes but normals, too.
    """
    materials = np.zeros(len(mesh.uvs))
    materials[mesh.wedge_triangles.reshape(-1)] = np.repeat(mesh.materials, 3)
    keys = [mesh.wedge_vertices[:, None], materials[:, None], mesh.uvs, *([mesh.colors] if has_colors else [])]
    return group_rows(np.concatenate(keys, axis=1)).astype(np.int32)


def divide_wedges(wedge_triangles: np.ndarray, parts: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Divide wedges whose corners belong to several of `count` parts, such as vertices.

    Args:
        wedge_triangles, parts: (T, 3), the wedge and the part of each corner.

    Returns:
        The new wedges (T, 3) int32 of the corners; the wedge (W,) before and the part (W,) of each.
    """
    pairs, wedges = np.unique(wedge_triangles.astype(np.int64) * count + parts, return_inverse=True)
    return wedges.reshape(-1, 3).astype(np.int32), pairs // count, pairs % count


def reverse_triangles(is_reversed: np.ndarray, columns: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return arrays (T, 3) of corners in which the triangles that `is_reversed` (T,) bool names have the opposite orientation."""
    corners = np.where(is_reversed[:, None], [0, 2, 1], [0, 1, 2])
    return [np.take_along_axis(column, corners, axis=1) for column in columns]


def merge_wedges(mesh: TexturedMesh) -> TexturedMesh:
    """Return `mesh` without normals, in which wedges of a vertex that differ by normals only are one, so that hard edges are no seams."""
    groups = group_by_texture(mesh, has_colors=True)
    _, examples = np.unique(groups, return_index=True)
    return replace(
        mesh,
        wedge_triangles=groups[mesh.wedge_triangles],
        wedge_vertices=mesh.wedge_vertices[examples],
        uvs=mesh.uvs[examples],
        attributes=mesh.colors[examples],
        has_normals=False,
    )


def _weld_boundaries(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return triangles (T, 3) int32 in which vertices on boundaries are one if they are at the same position, unless that gives edges with
    more than two triangles, or triangles with equal directions along an edge."""
    on_boundary = np.flatnonzero(find_edges(triangles, len(points)).boundary_vertices)
    if not len(on_boundary):
        return triangles
    _, first, group = np.unique(points[on_boundary], axis=0, return_index=True, return_inverse=True)
    target = np.arange(len(points), dtype=np.int32)
    target[on_boundary] = on_boundary[first[group.reshape(-1)]]
    while True:
        welded = target[triangles]
        is_refused = _find_ambiguous(welded, len(points)).any(axis=1) | (welded == np.roll(welded, -1, axis=1)).any(axis=1)
        moved = np.flatnonzero(target != np.arange(len(points)))
        undone = moved[np.isin(target[moved], welded[is_refused])]
        if not len(undone):
            return welded
        target[undone] = undone


def _find_ambiguous(triangles: np.ndarray, vertex_count: int) -> np.ndarray:
    """Return which halfedges (T, 3) bool belong to an edge with more than two triangles, or with two that have the same direction."""
    edges = find_edges(triangles, vertex_count)
    is_forward = np.roll(triangles, -1, axis=1) < np.roll(triangles, -2, axis=1)
    forward = np.bincount(edges.face_edges[is_forward], minlength=len(edges.ends))
    backward = edges.face_counts - forward
    return ((forward > 1) | (backward > 1))[edges.face_edges]


def _split_fans(triangles: np.ndarray) -> np.ndarray:
    """Return vertex numbers (T, 3) that are equal only for corners whose triangles are connected across edges around the vertex. All
    triangles of an edge are, however many it has."""
    edges = find_edges(triangles)
    order = np.argsort(edges.face_edges.ravel(), kind="stable")
    same = np.flatnonzero(np.diff(edges.face_edges.ravel()[order]) == 0)
    first, second = order[same], order[same + 1]
    pairs = []
    for offset in (1, 2):
        corner = 3 * (first // 3) + (first + offset) % 3
        vertex = triangles.reshape(-1)[corner]
        for other_offset in (1, 2):
            other = 3 * (second // 3) + (second + other_offset) % 3
            is_same = triangles.reshape(-1)[other] == vertex
            pairs.append(np.stack([corner[is_same], other[is_same]]))
    first_corners, second_corners = np.concatenate(pairs, axis=1)
    connected = coo_array((np.ones(len(first_corners), bool), (first_corners, second_corners)), shape=(triangles.size,) * 2)
    return connected_components(connected, directed=False)[1].reshape(-1, 3)


def _find_wedges(triangles: np.ndarray, materials: np.ndarray, uvs: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the wedges (T, 3) int32 of corners, and the index (W,) of one corner of each, in ascending order of their vertices."""
    keys = np.concatenate(
        [
            triangles.reshape(-1, 1).astype(np.float64),
            np.repeat(materials, 3)[:, None].astype(np.float64),
            uvs.reshape(-1, 2),
            values.reshape(triangles.size, values.shape[2]).astype(np.float64),
        ],
        axis=1,
    )
    _, examples, wedges = np.unique(keys + 0.0, axis=0, return_index=True, return_inverse=True)  # + 0.0 makes -0.0 equal to 0.0
    return wedges.reshape(-1, 3).astype(np.int32), examples
