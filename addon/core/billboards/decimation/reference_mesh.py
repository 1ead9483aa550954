"""The fine mesh as the reference of a decimation: its samples, the measurement that a coarse mesh must pass, and its final optimization."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ...geometry.distance import (
    closest_barycentric,
    closest_on_mesh,
    faces_farther_than,
    plane_barycentric,
    points_farther_than,
)
from ...geometry.mesh import face_areas_and_normals
from ...geometry.tracked_points import TrackedPoints
from .vertex_fit import EDGE_REGULARIZATION, MIN_WEIGHT, FitTargets, build_spring_matrix, solve_displacements

MAX_SAMPLES = 16_000
MIN_SAMPLES = 1_000
SAMPLES_PER_TRIANGLE = 16  # Samples per coarse triangle, for moving its vertices and evaluating its collapses and flips.
FAR_DISTANCE = 0.5  # In errors: all samples farther than this are used, even those not among the few per triangle.
TRACKING_REACH = 1.0  # In errors.
FAR_SAMPLE_DISTANCE = 0.6  # In errors, of samples that the final optimization uses.
PAIRS_PER_CHUNK = 1_000_000  # Pairs of a face and a candidate triangle at once: bounds the memory of an assignment.
MAX_STEPS = 10  # Maximum steps of the final optimization.
MAX_STEPS_WITHOUT_GAIN = 3
POWER = 8.0  # The final optimization lowers distances to this power.
NEWTON_STEP = 1.0 / (POWER - 1.0)  # Fraction of a reweighted step that is the Newton step for this power.
STRONG_REGULARIZATION = 0.3  # While the area is too large and the distances are small enough.
TARGET_DISTANCE = 0.96  # In errors; the rest is a margin for points between the samples.
MAX_WEIGHTED_DISTANCE = 1.1  # In errors: larger residuals get no more weight, because some faces fit no plane.
AREA_WEIGHT = 1_000.0  # Number of violated faces and samples that count as much as twice the allowed area.
MIN_DIRECTION_DISTANCE = 1e-6  # In errors: closer samples have no direction and no effect.
MAX_UNASSIGNED = 0.25  # Unassigned faces over coarse triangles.
MAX_VIOLATING_AREA = 0.02  # Fraction of the area beyond the normal bound of every nearby triangle; rounded creases need it.
MAX_AREA_GROWTH = 1.02  # Over the area of the fine mesh; folds and spikes exceed it, and area is what texture costs.
TOLERANCE = 0.01  # In errors, of the measured distance.
BEYOND_ERROR_RANK = 4.0  # Rank of a triangle that exceeds the error; the ranks within it are 0 (both bounds) and 1 (wrong normal).
NEAREST_PREFERENCE = 0.1  # Maximum penalty for a triangle that is not the nearest one: decides only between equal ranks.


@dataclass(frozen=True)
class DecimatedMesh:
    """A coarse mesh in the space of the fine mesh.

    An assigned face is within the error of the coarse mesh, and so are its corners of the plane of its triangle, whose normal is within
    the normal bound if a nearby triangle satisfies both. Unassigned faces, across a crease of the coarse mesh, need planes of their own.

    Attributes:
        vertices: (V, 3) float64.
        triangles: (T, 3) int32.
        assignment: (S,) int32, coarse triangle whose plane replaces each fine face; -1 for the few unassigned faces.
        normal_violations: Number of faces beyond the normal bound.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    assignment: np.ndarray
    normal_violations: int

    @property
    def unassigned(self) -> np.ndarray:
        """Indices (A,) of the unassigned fine faces."""
        return np.flatnonzero(self.assignment < 0)


Assignment = tuple[np.ndarray, np.ndarray, np.ndarray]  # see `ReferenceMesh.assign`


class ReferenceMesh:
    """The fine mesh, its samples, and the bounds that a coarse mesh must satisfy.

    corners (S, 3, 3) float64 of its faces. error: a length. min_cosine: between the normals of a face and of its coarse triangle.
    """

    def __init__(self, corners: np.ndarray, error: float, min_cosine: float) -> None:
        self.corners, self.error, self.min_cosine = corners, error, min_cosine
        self.areas, self.normals = face_areas_and_normals(corners)
        edge_midpoints = 0.5 * (corners + np.roll(corners, -1, axis=1))
        edge_points = np.unique(np.concatenate([corners, edge_midpoints]).reshape(-1, 3), axis=0)
        points = np.concatenate([edge_points, corners.mean(axis=1)])
        self.samples = _subsample(points, MAX_SAMPLES)
        self._dense_samples = points[::2]

    def far_samples(self, vertices: np.ndarray, triangles: np.ndarray, errors: float) -> np.ndarray:
        """Return the samples (K, 3) that are farther from the coarse mesh than this number of errors."""
        return self.samples[points_farther_than(self.samples, vertices[triangles], errors * self.error)]

    def sample(self, triangles: np.ndarray) -> np.ndarray:
        """Return samples (K, 3) of the whole mesh, as many as the number of coarse `triangles` requires."""
        return _subsample(self.samples, max(MIN_SAMPLES, SAMPLES_PER_TRIANGLE * len(triangles)))

    def active_samples(self, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """Return a few samples of the whole mesh, and all that are far from the coarse mesh."""
        return np.concatenate([self.sample(triangles), self.far_samples(vertices, triangles, FAR_DISTANCE)])

    def optimized_samples(self, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """Return samples for the final optimization, as `active_samples`, but the far ones among many more."""
        far = points_farther_than(self._dense_samples, vertices[triangles], FAR_SAMPLE_DISTANCE * self.error)
        return np.concatenate([self.sample(triangles), self._dense_samples[far]])

    def track(self, points: np.ndarray) -> TrackedPoints:
        """Return `points` (N, 3) for searches on a coarse mesh whose vertices move by fractions of an error."""
        return TrackedPoints(points, TRACKING_REACH * self.error)

    def measure(self, vertices: np.ndarray, triangles: np.ndarray, assigned: Assignment | None = None) -> DecimatedMesh | None:
        """Measure the coarse mesh. Returns None if it violates the bounds. assigned: what `assign` returns for all faces, if known."""
        if face_areas_and_normals(vertices[triangles])[0].sum() > MAX_AREA_GROWTH * self.areas.sum():
            return None
        assignment, heights, is_violating = assigned or self.assign(vertices, triangles)
        is_unassigned = heights > self.error
        if is_unassigned.sum() > MAX_UNASSIGNED * len(triangles):
            return None
        max_distance = (1.0 - TOLERANCE) * self.error
        is_unassigned |= faces_farther_than(self.corners, vertices[triangles], max_distance, TOLERANCE * self.error)
        if is_unassigned.sum() > MAX_UNASSIGNED * len(triangles) or is_unassigned.all():
            return None
        assignment = np.where(is_unassigned, np.int32(-1), assignment)
        is_violating = is_violating & ~is_unassigned
        if self.areas[is_violating].sum() > MAX_VIOLATING_AREA * self.areas.sum():
            return None
        return DecimatedMesh(vertices, triangles, assignment, int(is_violating.sum()))

    def assign(self, vertices: np.ndarray, triangles: np.ndarray, faces: np.ndarray | slice = slice(None)) -> Assignment:
        """Assign each of the fine `faces` to the nearest coarse triangle or one of its neighbors.

        Returns:
            The triangles (F,), the largest height of a face's corners over its triangle's plane (F,), and whether the angle to it exceeds
            the normal bound (F,).
        """
        corners = vertices[triangles]
        _, normals = face_areas_and_normals(corners)
        fine, fine_normals = self.corners[faces], self.normals[faces]
        centroids = fine.mean(axis=1)
        candidates = _vertex_neighbors(triangles, len(vertices))[closest_on_mesh(centroids, corners)[1]]
        offsets = np.einsum("ti,ti->t", normals, corners[:, 0])
        assignment = np.empty(len(centroids), np.int32)
        heights, is_violating = np.empty(len(centroids)), np.empty(len(centroids), bool)
        chunk = max(1, PAIRS_PER_CHUNK // candidates.shape[1])
        for start in range(0, len(centroids), chunk):
            rows = slice(start, start + chunk)
            options = candidates[rows]
            height = np.abs(np.einsum("tci,tki->tkc", fine[rows], normals[options]) - offsets[options][:, :, None]).max(axis=2)
            is_facing = np.einsum("ti,tki->tk", fine_normals[rows], normals[options]) >= self.min_cosine
            # The first candidate is the nearest triangle. A triangle within both bounds is preferred to one within the error only.
            rank = 2 * (height > self.error) + ~is_facing
            cost = np.where(rank >= 2, BEYOND_ERROR_RANK + height / self.error, rank)
            cost = cost + NEAREST_PREFERENCE * np.minimum(height / self.error, 1.0) * (options != options[:, :1])
            best = cost.argmin(axis=1)
            row = np.arange(len(options))
            assignment[rows], heights[rows], is_violating[rows] = options[row, best], height[row, best], ~is_facing[row, best]
        return assignment, heights, is_violating

    def satisfy_bounds(
        self, samples: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, assigned: Assignment
    ) -> tuple[np.ndarray, float]:
        """Move vertices until planes are within the error of their faces' corners, and triangles within the error of `samples` (K, 3).

        If the distances are small enough but the area is too large, stronger regularization shrinks it. A face keeps the plane that
        `assigned` gives it, what `assign` returns for all faces, as long as that is within the error.

        Returns:
            The best vertices (V, 3) of all steps, and the number of bounds that they still violate, plus the penalty for the area.
        """
        plane, heights, _ = assigned
        far_faces = np.flatnonzero(heights > FAR_DISTANCE * self.error)
        plane, points = plane[far_faces], self.corners[far_faces]
        best, best_cost, best_step = vertices, np.inf, 0
        spring_matrix = build_spring_matrix(triangles, len(vertices))
        tracked = self.track(samples)
        for step in range(MAX_STEPS):
            corners = vertices[triangles]
            _, normals = face_areas_and_normals(corners)
            residuals = _heights_over(points, corners, normals, plane)
            lost = np.flatnonzero(np.abs(residuals).max(axis=1) > TARGET_DISTANCE * self.error)
            plane[lost] = self.assign(vertices, triangles, far_faces[lost])[0]
            residuals[lost] = _heights_over(points[lost], corners, normals, plane[lost])
            heights = np.abs(residuals).max(axis=1)
            distances, nearest = tracked.find_closest(corners)
            max_distance = max(float(heights.max(initial=0.0)), float(distances.max()))
            growth = face_areas_and_normals(corners)[0].sum() / self.areas.sum() / MAX_AREA_GROWTH
            violations = int((heights > TARGET_DISTANCE * self.error).sum() + (distances > TARGET_DISTANCE * self.error).sum())
            cost = violations + AREA_WEIGHT * max(growth - 1.0, 0.0)
            if cost < best_cost:
                best, best_cost, best_step = vertices, cost, step
            if cost == 0.0 or step - best_step > MAX_STEPS_WITHOUT_GAIN:
                break
            flat_points, planes = points.reshape(-1, 3), np.repeat(plane, 3)
            barycentric = closest_barycentric(samples, corners[nearest])
            offsets = samples - np.einsum("nk,nkj->nj", barycentric, corners[nearest])
            lengths = np.where(distances > MIN_DIRECTION_DISTANCE * self.error, distances, np.inf)
            residuals = np.concatenate([distances, residuals.ravel()])
            relative_residuals = np.abs(residuals) / min(max_distance, MAX_WEIGHTED_DISTANCE * self.error)
            targets = FitTargets(
                triangles=np.concatenate([nearest, planes]),
                barycentric=np.concatenate([barycentric, plane_barycentric(flat_points, corners[planes])]),
                directions=np.concatenate([offsets / lengths[:, None], normals[planes]]),
                residuals=residuals,
                weights=np.minimum(relative_residuals, 1.0) ** POWER + MIN_WEIGHT,
            )
            is_too_large = growth > 1.0 and max_distance <= TARGET_DISTANCE * self.error
            regularization = STRONG_REGULARIZATION if is_too_large else EDGE_REGULARIZATION
            vertices = vertices + NEWTON_STEP * solve_displacements(vertices, triangles, targets, spring_matrix, regularization)
        return best, best_cost


def _heights_over(points: np.ndarray, corners: np.ndarray, normals: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """Return the heights (F, 3) of the corners `points` (F, 3, 3) of faces over the planes of their triangles `plane` (F,) of a mesh."""
    return np.einsum("fci,fi->fc", points - corners[plane, :1], normals[plane])


def _subsample(points: np.ndarray, max_count: int) -> np.ndarray:
    """Return at most `max_count` of `points` (N, 3), evenly distributed over their order."""
    count = min(len(points), max_count)
    return points[np.arange(count) * len(points) // count]


def _vertex_neighbors(triangles: np.ndarray, count: int) -> np.ndarray:
    """Return a table (T, K) of each triangle and those that share a vertex with it: itself first, and again to fill short rows."""
    corner = np.arange(triangles.size)
    incidence = csr_matrix((np.ones(triangles.size, np.int32), (corner // 3, triangles.ravel())), shape=(len(triangles), count))
    adjacency = (incidence @ incidence.T).tocsr()
    sizes = np.diff(adjacency.indptr)
    table = np.repeat(np.arange(len(triangles), dtype=np.int32)[:, None], sizes.max() + 1, axis=1)
    row = np.repeat(np.arange(len(triangles)), sizes)
    table[row, np.arange(len(row)) - np.repeat(adjacency.indptr[:-1], sizes) + 1] = adjacency.indices
    return table
