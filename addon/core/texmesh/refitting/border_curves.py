"""The borders of the UV islands of a mesh, along which the seam vertices of a level slide.

Moves of texture coordinates flip no triangle and keep both sides of seams together.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry.distance import TriangleTree, closest_barycentric
from ...geometry.edges import find_edges, halfedge_ends
from ...geometry.transforms import signed_areas
from ..textured_mesh import TexturedMesh
from .level_state import LevelState

MAX_TURN = np.radians(50.0)  # A vertex slides along a border that turns less; a corner would be cut off.
MIN_AREA_FRACTION = 0.15  # A triangle keeps this fraction of its area in UV space in one move.
MAX_PARTNER_STEP = 4.0  # times the expected step: a farther point on the other side of a seam belongs to another part of it
MAX_HALVINGS = 12
MIN_FRACTION = 0.01  # A step is not made if less than this fraction of it is possible.


@dataclass(frozen=True)
class BorderCurves:
    """The border edges of all UV islands.

    ends: (B, 2, 2) texture coordinates of both ends. islands: (B,). twins: (B, 2, 2), the texture coordinates of the same ends on the other
    side of the seam; NaN where the edge is a boundary of the mesh.
    """

    ends: np.ndarray
    islands: np.ndarray
    twins: np.ndarray

    @cached_property
    def _spacing(self) -> float:
        """Distance between islands in the third coordinate, by which they are told apart."""
        return 16.0 * float(np.abs(self.ends).max(initial=0.0)) + 1e-300

    @cached_property
    def _segments(self) -> np.ndarray:
        layers = np.broadcast_to(self._spacing * self.islands[:, None, None].astype(float), (len(self.ends), 2, 1))
        return np.concatenate([self.ends, layers], axis=2)[:, [0, 1, 1]]

    @cached_property
    def _tree(self) -> TriangleTree:
        return TriangleTree(self._segments)

    def project(self, uvs: np.ndarray, islands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the points (N, 2) of the borders of `islands` (N,) that are nearest to `uvs` (N, 2), and the same points on the other side
        of their seams (N, 2), NaN on a boundary."""
        points = np.column_stack([uvs, self._spacing * islands])
        _, nearest = self._tree.find_closest(points)
        coordinates = closest_barycentric(points, self._segments[nearest])
        fraction = coordinates[:, 1:].sum(axis=1)[:, None]
        on_border, on_twin = ((1.0 - fraction) * ends[nearest, 0] + fraction * ends[nearest, 1] for ends in (self.ends, self.twins))
        return on_border, on_twin


def find_border_curves(mesh: TexturedMesh, islands: np.ndarray) -> BorderCurves:
    """Return the borders of the `islands` (T,) of a mesh."""
    halfedges, twins = find_border_halfedges(mesh)
    wedges = halfedge_ends(mesh.wedge_triangles, halfedges)
    ends = mesh.uvs[wedges]
    other = np.full_like(ends, np.nan)
    has_twin = twins >= 0
    other[has_twin] = mesh.uvs[halfedge_ends(mesh.wedge_triangles, twins[has_twin])[:, ::-1]]
    return BorderCurves(ends, islands[halfedges // 3], other)


def find_border_halfedges(mesh: TexturedMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the halfedges (B,) on seams and boundaries, and their twins (B,), -1 on a boundary."""
    edges = find_edges(mesh.triangles, len(mesh.vertices))
    seams = edges.interior_halfedges[mesh.find_seams(edges)[edges.interior]]
    boundary = np.flatnonzero(edges.face_counts[edges.face_edges.ravel()] != 2)
    halfedges = np.concatenate([seams[:, 0], seams[:, 1], boundary])
    return halfedges, np.concatenate([seams[:, 1], seams[:, 0], np.full(len(boundary), -1)])


@dataclass(frozen=True)
class Freedom:
    """How the texture coordinates of the wedges of a level may move.

    directions: (W, 2, 2), the displacement of a wedge by the two degrees of freedom of its vertex. Vertices inside of an island have both,
    vertices on one seam or boundary only the first, along that curve; others are fixed, also where the curve has a corner.
    sliding: (S,) wedges, one of each vertex on a curve. partners: (S,) wedges on the other side of the seam, -1 on a boundary.
    islands: (S,), of `sliding`.
    """

    directions: np.ndarray
    sliding: np.ndarray
    partners: np.ndarray
    islands: np.ndarray


def find_freedom(state: LevelState, uv_scale: float) -> Freedom:
    """Return the freedom of the wedges of a level. uv_scale: length of a unit of UV space on the surface."""
    mesh = state.mesh
    halfedges, _ = find_border_halfedges(mesh)
    wedges = halfedge_ends(mesh.wedge_triangles, halfedges)
    vertex_count, wedge_count = len(mesh.vertices), len(mesh.uvs)
    following, preceding = np.full(wedge_count, -1), np.full(wedge_count, -1)
    following[wedges[:, 0]], preceding[wedges[:, 1]] = wedges[:, 1], wedges[:, 0]
    out_counts = np.bincount(wedges[:, 0], minlength=wedge_count)
    in_counts = np.bincount(wedges[:, 1], minlength=wedge_count)
    on_border = np.zeros(vertex_count, bool)
    on_border[mesh.wedge_vertices[wedges]] = True
    wedge_counts = np.bincount(mesh.wedge_vertices, minlength=vertex_count)
    is_simple = (out_counts == 1) & (in_counts == 1)
    first, last = mesh.wedge_vertices[np.maximum(following, 0)], mesh.wedge_vertices[np.maximum(preceding, 0)]
    is_simple &= first != last
    simple_counts = np.bincount(mesh.wedge_vertices[is_simple], minlength=vertex_count)
    neighbors = [np.full(vertex_count, -1), np.full(vertex_count, -1)]
    for target, value in zip(neighbors, (np.minimum(first, last), np.maximum(first, last)), strict=True):
        target[mesh.wedge_vertices[is_simple]] = value[is_simple]
    same = is_simple & (np.minimum(first, last) == neighbors[0][mesh.wedge_vertices])
    same &= np.maximum(first, last) == neighbors[1][mesh.wedge_vertices]
    same_counts = np.bincount(mesh.wedge_vertices[same], minlength=vertex_count)
    edges = state.edges
    is_boundary = edges.boundary_vertices
    slides = on_border & (same_counts == wedge_counts) & (simple_counts == wedge_counts)
    slides &= np.where(is_boundary, wedge_counts == 1, wedge_counts == 2)
    turns = _is_sharp(mesh.vertices[mesh.wedge_vertices], mesh.vertices[last], mesh.vertices[first])
    turns |= _is_sharp(mesh.uvs, mesh.uvs[preceding], mesh.uvs[following])
    slides[mesh.wedge_vertices[is_simple & turns]] = False
    chord = mesh.uvs[following] - mesh.uvs[preceding]
    chord *= np.where(first > last, 1.0, -1.0)[:, None]
    length = np.linalg.norm(mesh.vertices[first] - mesh.vertices[last], axis=1)
    tangents = uv_scale * chord / np.maximum(length, 1e-300)[:, None]
    directions = np.zeros((wedge_count, 2, 2))
    directions[~on_border[mesh.wedge_vertices]] = np.eye(2)
    moving = slides[mesh.wedge_vertices]
    directions[moving, :, 0] = tangents[moving]
    order = np.flatnonzero(moving)
    vertices = mesh.wedge_vertices[order]
    _, start = np.unique(vertices, return_index=True)
    sliding = order[start]
    _, end = np.unique(vertices[::-1], return_index=True)
    partners = order[::-1][end]
    partners = np.where(partners == sliding, -1, partners)
    wedge_islands = np.zeros(wedge_count, np.int64)
    wedge_islands[mesh.wedge_triangles] = state.islands[:, None]
    return Freedom(directions, sliding, partners, wedge_islands[sliding])


def _is_sharp(points: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return where a curve through `before`, `points` and `after` (N, D) turns by more than MAX_TURN, (N,) bool."""
    first, second = points - before, after - points
    product = np.einsum("ni,ni->n", first, second)
    return product < np.cos(MAX_TURN) * np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)


def move_uvs(mesh: TexturedMesh, steps: np.ndarray, freedom: Freedom, curves: BorderCurves) -> tuple[np.ndarray, np.ndarray]:
    """Return the texture coordinates (W, 2) after `steps` (V, 2) of the degrees of freedom, and the fractions (V,) of them that were made.

    Steps are halved where triangles would lose most of their area in UV space.
    """
    moves = np.einsum("wij,wj->wi", freedom.directions, steps[mesh.wedge_vertices])
    before = signed_areas(mesh.corner_uvs)
    fractions = np.ones(len(mesh.vertices))
    for _ in range(MAX_HALVINGS):
        scaled = moves * fractions[mesh.wedge_vertices, None]
        uvs = mesh.uvs + scaled
        stays = _slide(mesh, uvs, scaled, freedom, curves)
        fractions[mesh.wedge_vertices[stays]] = 0.0
        after = signed_areas(uvs[mesh.wedge_triangles])
        is_flipped = after * np.sign(before) < MIN_AREA_FRACTION * np.abs(before)
        if not is_flipped.any():
            return uvs, fractions
        vertices = np.unique(mesh.triangles[is_flipped])
        fractions[vertices] = np.where(fractions[vertices] > MIN_FRACTION, 0.5 * fractions[vertices], 0.0)
    return mesh.uvs, np.zeros(len(mesh.vertices))


def _slide(mesh: TexturedMesh, uvs: np.ndarray, moves: np.ndarray, freedom: Freedom, curves: BorderCurves) -> np.ndarray:
    """Put the sliding wedges of `uvs` (W, 2) onto the `curves`, in place. Return those of them that stay because the point on the other
    side of the seam is not near its wedge."""
    is_moving = (moves[freedom.sliding] != 0.0).any(axis=1)
    wedges, partners = freedom.sliding[is_moving], freedom.partners[is_moving]
    if not len(wedges):
        return wedges
    on_border, on_twin = curves.project(uvs[wedges], freedom.islands[is_moving])
    is_paired = partners >= 0
    distances = np.linalg.norm(on_twin - mesh.uvs[partners], axis=1)
    is_near = distances <= MAX_PARTNER_STEP * np.linalg.norm(moves[partners], axis=1) + np.finfo(float).eps
    stays = is_paired & ~is_near  # also where the nearest curve has no other side
    uvs[wedges] = np.where(stays[:, None], mesh.uvs[wedges], on_border)
    paired = partners[is_paired]
    uvs[paired] = np.where(stays[is_paired, None], mesh.uvs[paired], on_twin[is_paired])
    return wedges[stays]
