"""Removal of spikes: single vertices and edges of a level that are far from the fine mesh.

Least squares put vertices wherever few samples hold them, for example beside triangles that are thin in UV space. The mean deviation hardly
shows such a spike, renders do.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry.distance import TriangleTree
from ...geometry.mesh import face_areas_and_normals, scaled_normals
from ..textured_mesh import TexturedMesh
from .correspondence import Correspondence, find_correspondence
from .edge_flips import find_quads, flip_quads, select_flips
from .level_state import LevelState
from .sampling import SurfaceSamples

MAX_VERTEX_FACTOR = 4.0  # of the root mean squared distance of vertices and midpoints of edges: farther vertices are spikes
MAX_EDGE_FACTOR = 4.0  # the same for midpoints of edges
MAX_FLIPPED_FRACTION = 0.7  # of the distance of its midpoint that a flipped edge has at most
ROUNDS = 3


@dataclass(frozen=True)
class FineSurface:
    """The fine mesh that spikes are measured from, and the UV islands (T,) of its triangles."""

    mesh: TexturedMesh
    islands: np.ndarray

    def measure_distances(self, points: np.ndarray) -> np.ndarray:
        """Return the distances (N,) of `points` (N, 3) from the surface."""
        return self.find_closest(points)[0]

    def find_closest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances (N,) of `points` (N, 3) from the surface, and the nearest triangles (N,)."""
        return self._tree.find_closest(points)

    @cached_property
    def _tree(self) -> TriangleTree:
        return TriangleTree(self.mesh.vertices[self.mesh.triangles])

    def find_positions(self, points: np.ndarray, uvs: np.ndarray, islands: np.ndarray) -> np.ndarray:
        """Return the points (N, 3) of the surface with texture coordinates `uvs` (N, 2) in `islands` (N,); of several the nearest to
        `points` (N, 3)."""
        found = self._find(points, uvs, islands)
        return np.einsum("ni,nic->nc", found.barycentric, self.mesh.vertices[self.mesh.triangles[found.triangles]])

    def find_normals(self, points: np.ndarray, uvs: np.ndarray, islands: np.ndarray) -> np.ndarray:
        """Return the unit normals (N, 3) of the surface at the same points."""
        triangles = self._find(points, uvs, islands).triangles
        return face_areas_and_normals(self.mesh.vertices[self.mesh.triangles[triangles]])[1]

    def _find(self, points: np.ndarray, uvs: np.ndarray, islands: np.ndarray) -> Correspondence:
        corners = self.mesh.vertices[self.mesh.triangles]
        blank = np.zeros(len(points))
        samples = SurfaceSamples(blank.astype(np.int64), np.zeros((len(points), 3)), points, uvs, islands, blank)
        return find_correspondence(samples, corners, self.mesh.corner_uvs, self.islands)


def remove_spikes(state: LevelState, fine: FineSurface) -> LevelState:
    """Return the level with vertices that are far from the surface moved toward it, where it has their texture coordinates, and with edges
    flipped whose midpoints are far from it."""
    for _ in range(ROUNDS):
        mesh = state.mesh
        ends = state.find_edges().ends
        distances = fine.measure_distances(np.concatenate([mesh.vertices, mesh.vertices[ends].mean(axis=1)]))
        scale = float(np.sqrt((distances**2).mean()))
        spikes = np.flatnonzero(distances[: len(mesh.vertices)] > MAX_VERTEX_FACTOR * scale)
        if len(spikes):
            state = _shorten(state, fine, spikes, MAX_VERTEX_FACTOR * scale / distances[spikes])
        elif distances.max() <= MAX_EDGE_FACTOR * scale:
            break
        state = _flip_spikes(state, fine, MAX_EDGE_FACTOR * scale)
    return state


def avoid_folds(state: LevelState, vertices: np.ndarray) -> np.ndarray:
    """Return `vertices` (V, 3), but those of triangles that would turn over stay where they are in `state`."""
    before = scaled_normals(state.corners)
    is_folded = np.einsum("ti,ti->t", before, scaled_normals(vertices[state.mesh.triangles])) < 0.0
    result = vertices.copy()
    stays = state.mesh.triangles[is_folded]
    result[stays] = state.mesh.vertices[stays]
    return result


def _shorten(state: LevelState, fine: FineSurface, vertices: np.ndarray, fractions: np.ndarray) -> LevelState:
    """Return the level with `vertices` (N,) at `fractions` (N,) of the way from where the fine mesh has their texture coordinates."""
    mesh = state.mesh
    corners = np.full(len(mesh.vertices), -1)
    corners[mesh.triangles.ravel()] = np.arange(mesh.triangles.size)
    is_used = corners[vertices] >= 0
    vertices, fractions = vertices[is_used], fractions[is_used]
    corners = corners[vertices]
    positions = mesh.vertices.copy()
    uvs = mesh.uvs[mesh.wedge_triangles.ravel()[corners]]
    origins = fine.find_positions(positions[vertices], uvs, state.islands[corners // 3])
    positions[vertices] = origins + fractions[:, None] * (positions[vertices] - origins)
    return state.move(positions)


def _flip_spikes(state: LevelState, fine: FineSurface, limit: float) -> LevelState:
    quads = find_quads(state)
    points = state.mesh.vertices[quads.vertices]
    before = fine.measure_distances(points[:, [1, 3]].mean(axis=1))
    far = np.flatnonzero(before > limit)
    after = fine.measure_distances(points[far][:, [0, 2]].mean(axis=1))
    gains = np.zeros(len(before))
    gains[far] = np.where(after < MAX_FLIPPED_FRACTION * before[far], before[far] - after, 0.0)
    return flip_quads(state, quads, select_flips(state, quads, gains))
