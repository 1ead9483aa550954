"""The fine mesh that a coarse one stands for: its samples, the measure that the coarse one has to pass, and the last moves to pass it."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ..distance import closest_on_mesh, closest_weights, faces_beyond, one_sided_distance, plane_weights, points_beyond
from ..mesh import face_areas_and_normals
from .straddle import LEAST_WEIGHT, SPRINGS, solve_moves

MAX_SAMPLES = 16_000
LEAST_SAMPLES = 1_000
SAMPLES_A_TRIANGLE = 16  # of the coarse mesh, by which vertices are moved, collapses and flips are judged
FAR = 0.5  # in errors: samples farther than this count whether they are among those few or not
SETTLING_STEPS = 10
PATIENCE = 3  # steps without a better one
SETTLING_POWER = 8.0
NEWTON = 1.0 / (SETTLING_POWER - 1.0)  # of a reweighted step is the Newton step of that power
TIGHT = 0.3  # springs while the area is too large and the distances are not
SETTLED = 0.96  # in errors; the rest is for points between the samples
CLIPPED = 1.1  # in errors: what is farther pulls no harder, for some faces keep to no plane
AREA_WEIGHT = 1_000.0  # broken faces and samples that as much more area is worth as the bound
MOST_APART = 0.25  # of the coarse triangles: original faces across a crease that no triangle stands for
BEYOND_SHARE = 0.02  # of the area may turn farther than the normal bound from every triangle near it, for creases are rounded off
AREA_GROWTH = 1.02  # over the area of the original, as a folded or spiky mesh would have; this is what texture costs
TOLERANCE = 0.01  # of the error, in measuring


@dataclass(frozen=True)
class Decimated:
    """A coarse mesh in the space of the original.

    vertices (V, 3) float64, triangles (T, 3) int32.
    primitive_of (S,) int32: the triangle whose plane stands for each original triangle; all its corners are within the error of that
    plane, and its normal within the normal bound wherever a triangle near it allows both. -1 for the few that lie across a crease of the
    coarse mesh, within the error of no one triangle: they need planes of their own.
    distance: bound of the one-sided distance from the others to the coarse mesh, in the unit of the vertices; half the error at least.
    beyond: original triangles that break the normal bound.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    primitive_of: np.ndarray
    distance: float
    beyond: int

    @property
    def apart(self) -> np.ndarray:
        """The original triangles (A,) that no triangle stands for."""
        return np.flatnonzero(self.primitive_of < 0)


class FineMesh:
    """The fine mesh, its samples, and the measure that a coarse mesh has to pass."""

    def __init__(self, corners: np.ndarray, error: float, least_cosine: float) -> None:
        self.corners, self.error, self.least_cosine = corners, error, least_cosine
        self.areas, self.normals = face_areas_and_normals(corners)
        middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
        on_edges = np.unique(np.concatenate([corners, middles]).reshape(-1, 3), axis=0)
        self.points = np.concatenate([on_edges, corners.mean(axis=1)])
        self.samples = _spread(self.points, MAX_SAMPLES)

    def far_samples(self, vertices: np.ndarray, triangles: np.ndarray, errors: float) -> np.ndarray:
        """Samples (K, 3) that are more than so many errors away from the coarse mesh."""
        return self.samples[points_beyond(self.samples, vertices[triangles], errors * self.error)]

    def few_samples(self, triangles: np.ndarray) -> np.ndarray:
        """Samples (K, 3) everywhere, as many as the coarse `triangles` deserve."""
        return _spread(self.samples, max(LEAST_SAMPLES, SAMPLES_A_TRIANGLE * len(triangles)))

    def watched(self, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """A few samples everywhere, and all that are far."""
        return np.concatenate([self.few_samples(triangles), self.far_samples(vertices, triangles, FAR)])

    def measure(self, vertices: np.ndarray, triangles: np.ndarray) -> Decimated | None:
        """The coarse mesh with its figures, or None when it does not keep the bounds."""
        if face_areas_and_normals(vertices[triangles])[0].sum() > AREA_GROWTH * self.areas.sum():
            return None
        primitive_of, heights, turned = self.assign(vertices, triangles)
        apart = heights > self.error
        if apart.sum() > MOST_APART * len(triangles):
            return None
        most_distant = (1.0 - TOLERANCE) * self.error
        apart |= faces_beyond(self.corners, vertices[triangles], most_distant, TOLERANCE * self.error)
        if apart.sum() > MOST_APART * len(triangles) or apart.all():
            return None
        primitive_of[apart] = -1
        turned &= ~apart
        if self.areas[turned].sum() > BEYOND_SHARE * self.areas.sum():
            return None
        distance = one_sided_distance(self.corners[~apart], vertices[triangles], TOLERANCE * self.error, 0.5 * self.error)
        if distance > self.error:
            return None
        return Decimated(vertices, triangles, primitive_of, distance, int(turned.sum()))

    def assign(
        self, vertices: np.ndarray, triangles: np.ndarray, faces: np.ndarray | slice = slice(None)
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """For each of the original `faces` the coarse triangle that stands for it, the largest height of its corners over that, and whether
        its normal is beyond the bound."""
        corners = vertices[triangles]
        _, normals = face_areas_and_normals(corners)
        fine, fine_normals = self.corners[faces], self.normals[faces]
        centroids = fine.mean(axis=1)
        candidates = _neighbours(triangles, len(vertices))[closest_on_mesh(centroids, corners)[1]]
        offsets = np.einsum("ti,ti->t", normals, corners[:, 0])
        chosen = np.empty(len(centroids), np.int32)
        heights, turned = np.empty(len(centroids)), np.empty(len(centroids), bool)
        chunk = max(1, 1_000_000 // candidates.shape[1])
        for start in range(0, len(centroids), chunk):
            rows = slice(start, start + chunk)
            options = candidates[rows]
            height = np.abs(np.einsum("tci,tki->tkc", fine[rows], normals[options]) - offsets[options][:, :, None]).max(axis=2)
            facing = np.einsum("ti,tki->tk", fine_normals[rows], normals[options]) >= self.least_cosine
            # The first candidate is the nearest triangle; any that holds both bounds beats any that holds one.
            rank = 2 * (height > self.error) + ~facing
            order = np.where(rank >= 2, 4.0 + height / self.error, rank) + 0.1 * np.minimum(height / self.error, 1.0) * (
                options != options[:, :1]
            )
            pick = order.argmin(axis=1)
            index = np.arange(len(options))
            chosen[rows], heights[rows], turned[rows] = options[index, pick], height[index, pick], ~facing[index, pick]
        return chosen, heights, turned

    def settled(self, samples: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, float]:
        """Vertices moved until planes keep the corners of their faces and triangles keep the `samples`, or the best on the way there; and
        how many faces and samples these still do not keep.

        Where they do with an area too large, springs shrink it.
        """
        watched = np.flatnonzero(self.assign(vertices, triangles)[1] > FAR * self.error)
        best, least, best_step = vertices, np.inf, 0
        for step in range(SETTLING_STEPS):
            corners = vertices[triangles]
            _, normals = face_areas_and_normals(corners)
            plane, heights, _ = self.assign(vertices, triangles, watched)
            distances, nearest = closest_on_mesh(samples, corners)
            worst = max(float(heights.max(initial=0.0)), float(distances.max()))
            growth = face_areas_and_normals(corners)[0].sum() / self.areas.sum() / AREA_GROWTH
            broken = int((heights > SETTLED * self.error).sum() + (distances > SETTLED * self.error).sum())
            badness = broken + AREA_WEIGHT * max(growth - 1.0, 0.0)
            if badness < least:
                best, least, best_step = vertices, badness, step
            if badness == 0.0 or step - best_step > PATIENCE:
                break
            points, plane = self.corners[watched].reshape(-1, 3), np.repeat(plane, 3)
            at_samples = closest_weights(samples, corners[nearest])
            away = samples - np.einsum("nk,nkj->nj", at_samples, corners[nearest])
            apart = np.where(distances > 1e-6 * self.error, distances, np.inf)
            residuals = np.concatenate([distances, np.einsum("ij,ij->i", points - corners[plane, 0], normals[plane])])
            vertices = vertices + NEWTON * solve_moves(
                vertices,
                triangles,
                np.concatenate([nearest, plane]),
                np.concatenate([at_samples, plane_weights(points, corners[plane])]),
                np.concatenate([away / apart[:, None], normals[plane]]),
                residuals,
                np.minimum(np.abs(residuals) / min(worst, CLIPPED * self.error), 1.0) ** SETTLING_POWER + LEAST_WEIGHT,
                TIGHT if growth > 1.0 and worst <= SETTLED * self.error else SPRINGS,
            )
        return best, least


def _spread(points: np.ndarray, most: int) -> np.ndarray:
    """Every so many of `points` (N, 3) that at most `most` are left."""
    count = min(len(points), most)
    return points[np.arange(count) * len(points) // count]


def _neighbours(triangles: np.ndarray, count: int) -> np.ndarray:
    """(T, K) each triangle and those that share a vertex with it; itself first, and again where it has fewer than K."""
    corner = np.arange(triangles.size)
    incidence = csr_matrix((np.ones(triangles.size, np.int32), (corner // 3, triangles.ravel())), shape=(len(triangles), count))
    touching = (incidence @ incidence.T).tocsr()
    sizes = np.diff(touching.indptr)
    table = np.repeat(np.arange(len(triangles), dtype=np.int32)[:, None], sizes.max() + 1, axis=1)
    row = np.repeat(np.arange(len(triangles)), sizes)
    table[row, np.arange(len(row)) - np.repeat(touching.indptr[:-1], sizes) + 1] = touching.indices
    return table
