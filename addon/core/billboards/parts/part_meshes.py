"""The mesh of one part: the fewest triangles within an error of the surface."""

import itertools
from dataclasses import dataclass

import numpy as np

from ...errors import GeometryError
from ...geometry.distance import TriangleTree, closest_barycentric
from ...geometry.mesh import TriangleMesh, face_areas_and_normals, longest_side
from ...geometry.tracked_points import TrackedPoints
from ...jobs.progress import Progress, Steps
from ...texmesh.settings import TexmeshSettings
from ...texmesh.simplification.levels import extract_level, simplify_by_cost
from ...texmesh.textured_mesh import build_textured_mesh
from ..decimation.decimate import propose_mesh
from ..decimation.vertex_fit import fit_vertices
from .plane_quadrics import PlaneQuadrics

COUNT_RATIO = 0.92  # Between the triangle counts of the meshes among which the coarsest is searched.
FIRST_ATTEMPTS = 3  # Meshes that are tried before a part is given up.
MIN_TRIANGLES = 4  # Of a closed mesh.
MAX_FINE_TRIANGLES = 50_000  # Larger parts are decimated to so many triangles first.
MAX_FIT_SAMPLES = 6_000  # Vertices are fitted to so many points at most.
SAMPLES_PER_TRIANGLE = 24  # Of the coarse mesh, if that is fewer.
MIN_FIT_SAMPLES = 500
TRACKING_REACH = 0.5  # In errors.
FIT_POWERS = ((2.0, 3.0), (4.0, 6.0), (6.0, 8.0))
MAX_DISTANCES = (6.0, 1.6, 1.25, 1.0)  # In errors, before each fit and after the last: meshes that are farther are given up.
MAX_EXCESS = 0.9  # In errors: vertices that are fitted beyond this distance from the surface are moved back to it.
MAX_BACK_DISTANCE = 1.25  # In errors, of points of the mesh from the surface.
SAMPLE_SPACING = 0.5  # Of the points on large faces, in errors.
MAX_SURFACE_SAMPLES = 40_000
FIRST_SAMPLES = 4_000  # Points that are measured first; most meshes that are too coarse fail there.
MAX_REVERSED_AREA = 0.01  # Fraction of the area of a mesh that may face against the surface next to it.
MIN_FACING = 0.2  # Cosine between a triangle and an axis along which it roughly faces.
MARGIN = 1.0 - 1e-6  # Of the error, for rounding.
BARYCENTRIC = np.array(
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0], [1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [1.0, 0.0, 1.0]]
)
BARYCENTRIC /= BARYCENTRIC.sum(axis=1, keepdims=True)
LABEL = "Simplifying solid parts"
CENTROID = 3  # The row of `BARYCENTRIC` that is the centroid.


@dataclass(frozen=True)
class PartMesh:
    """A mesh in the space of its source: vertices (V, 3) float64, triangles (T, 3) int."""

    vertices: np.ndarray
    triangles: np.ndarray


class Part:
    """A connected surface `corners` (K, 3, 3) that becomes coarser meshes for several errors."""

    def __init__(self, corners: np.ndarray) -> None:
        self._corners = corners
        self._points = np.unique(corners.reshape(-1, 3), axis=0)
        self._tree = TriangleTree(corners)
        self._areas, self._normals = face_areas_and_normals(corners)
        self._chains: dict[int, list[PartMesh]] = {}  # From coarse to fine, by the limit for which they were prepared, ascending.

    def simplify(self, error: float, max_triangles: int) -> Steps[PartMesh | None]:
        """Return a mesh with the fewest triangles, at most `max_triangles`, from which no point of the surface is farther than `error`, and
        which itself hardly is; None if there is none. Call `prepare` before.

        Distances are measured at all vertices, and on faces that are larger than the error at points about as dense as the error.
        """
        limit = min(max_triangles, len(self._corners))
        chain = next((chain for prepared, chain in self._chains.items() if prepared >= limit), [])
        count = sum(len(mesh.triangles) <= max_triangles for mesh in chain)
        if not count:
            return None
        samples = self._sample(error)
        best, low, high = None, 0, count
        while best is None and high > max(count - FIRST_ATTEMPTS, 0):  # A finer mesh does not always fit where a coarser one does.
            yield Progress(0.0, LABEL)
            high -= 1
            best = self._fit(chain[high], samples, error)
        while best is not None and low < high:
            yield Progress(1.0 - (high - low) / count, LABEL)
            index = (low + high) // 2
            found = self._fit(chain[index], samples, error)
            best, low, high = (best, index + 1, high) if found is None else (found, low, index)
        return best

    def prepare(self, limit: int) -> Steps[None]:
        """Prepare meshes of up to `limit` triangles, unless there are some for a higher limit."""
        limit = min(limit, len(self._corners))
        if limit <= max(self._chains, default=MIN_TRIANGLES - 1):
            return
        points, index = np.unique(self._corners.reshape(-1, 3), axis=0, return_inverse=True)
        unit, center = longest_side(points), points.mean(axis=0)
        fine = (points - center) / unit, index.reshape(-1, 3)
        if len(fine[1]) > max(MAX_FINE_TRIANGLES, limit):
            fine = propose_mesh(*fine, max(MAX_FINE_TRIANGLES, limit))
        steps = int(np.log(MIN_TRIANGLES / limit) / np.log(COUNT_RATIO))
        targets = sorted({int(limit * COUNT_RATIO**step) for step in range(steps + 1)}, reverse=True)
        try:
            mesh = build_textured_mesh(TriangleMesh(*fine), np.zeros((len(fine[1]), 3, 2)))
        except GeometryError:
            return
        steps = simplify_by_cost(mesh, lambda mesh, _: PlaneQuadrics(mesh), targets, TexmeshSettings(drastic_simplification=False))
        levels = [extract_level(mesh, level) for level in (yield from steps).levels]
        meshes = {len(level.triangles): PartMesh(level.vertices * unit + center, level.triangles) for level in levels}
        self._chains[limit] = [meshes[count] for count in sorted(meshes) if count >= MIN_TRIANGLES]

    def _fit(self, mesh: PartMesh, samples: np.ndarray, error: float) -> PartMesh | None:
        """Return `mesh` with its vertices moved to where it is within `error`, None if it is not."""
        count = min(max(SAMPLES_PER_TRIANGLE * len(mesh.triangles), MIN_FIT_SAMPLES), MAX_FIT_SAMPLES, len(samples))
        tracked = TrackedPoints(samples[:count], TRACKING_REACH * error)
        for powers, max_distance in zip((*FIT_POWERS, None), MAX_DISTANCES, strict=True):
            distance = tracked.find_closest(mesh.vertices[mesh.triangles])[0].max()
            if distance <= MARGIN * error and self._is_within(mesh, samples, error):
                return mesh
            if powers is None or distance > max_distance * error:
                return None
            vertices = fit_vertices(tracked, mesh.vertices, mesh.triangles, powers)
            mesh = PartMesh(self._move_back(vertices, MAX_EXCESS * error), mesh.triangles)
        return None

    def _move_back(self, vertices: np.ndarray, distance: float) -> np.ndarray:
        """Return `vertices` (V, 3), moved to `distance` from the surface where they are farther."""
        distances, nearest = self._tree.find_closest(vertices, distance)
        far = np.flatnonzero(distances > distance)
        corners = self._corners[nearest[far]]
        closest = np.einsum("nk,nki->ni", closest_barycentric(vertices[far], corners), corners)
        moved = vertices.copy()
        moved[far] = closest + (vertices[far] - closest) * (distance / distances[far])[:, None]
        return moved

    def _is_within(self, mesh: PartMesh, samples: np.ndarray, error: float) -> bool:
        corners = mesh.vertices[mesh.triangles]
        areas, normals = face_areas_and_normals(corners)
        if not (areas > 0.0).all():
            return False
        tree = TriangleTree(corners)
        for part in (samples[:FIRST_SAMPLES], samples[FIRST_SAMPLES:]):
            if len(part) and tree.find_closest(part, MARGIN * error)[0].max() > MARGIN * error:
                return False
        positions = np.einsum("sc,tci->tsi", BARYCENTRIC, corners)
        limits = np.full(positions.shape[:2], MAX_BACK_DISTANCE * error)
        limits[:, CENTROID] = 0.0
        distances, nearest = self._tree.find_closest(positions.reshape(-1, 3), limits.ravel())
        is_reversed = np.einsum("ti,ti->t", normals, self._normals[nearest.reshape(limits.shape)[:, CENTROID]]) < 0.0
        return bool(distances.max() <= MAX_BACK_DISTANCE * error and areas[is_reversed].sum() <= MAX_REVERSED_AREA * areas.sum())

    def _sample(self, error: float) -> np.ndarray:
        """Return points (N, 3) of the surface: all vertices, and points on faces that are larger than the error; in random order."""
        generator = np.random.default_rng(0)
        expected = self._areas / (SAMPLE_SPACING * error) ** 2
        expected = np.where(expected < 1.0, 0.0, expected)
        counts = np.ceil(expected * min(1.0, MAX_SURFACE_SAMPLES / max(expected.sum(), 1.0))).astype(np.int64)
        faces = np.repeat(np.arange(len(counts)), counts)
        first, second = np.sqrt(generator.random(len(faces))), generator.random(len(faces))
        weights = np.column_stack([1.0 - first, first * (1.0 - second), first * second])
        points = np.concatenate([self._points, np.einsum("nc,nci->ni", weights, self._corners[faces])])
        return points[generator.permutation(len(points))]


def find_closest_facing(
    corners: np.ndarray, normals: np.ndarray, points: np.ndarray, directions: np.ndarray, max_distance: float
) -> np.ndarray:
    """Return the triangle (N,) of `corners` (T, 3, 3) with `normals` (T, 3) that is closest to each of `points` (N, 3).

    Where that faces against the direction (N, 3) of the point, as on the other side of a plate, and one that faces roughly along its main
    axis is within `max_distance`, it is that one.
    """
    nearest = TriangleTree(corners).find_closest(points)[1]
    opposed = np.flatnonzero(np.einsum("ni,ni->n", normals[nearest], directions) < 0.0)
    axes = np.abs(directions[opposed]).argmax(axis=1)
    signs = np.where(directions[opposed, axes] < 0.0, -1.0, 1.0)
    for axis, sign in itertools.product(range(3), (-1.0, 1.0)):
        rows = opposed[(axes == axis) & (signs == sign)]
        facing = np.flatnonzero(sign * normals[:, axis] > MIN_FACING)
        if len(rows) and len(facing):
            distances, found = TriangleTree(corners[facing]).find_closest(points[rows])
            is_near = distances <= max_distance
            nearest[rows[is_near]] = facing[found[is_near]]
    return nearest
