"""Simplification with a measured bound (section 4.2): the fewest triangles that stay within the error of every point of the original.

Quadric collapses propose a mesh; its vertices are moved until it straddles the original, which halves the distance; edges are collapsed
and flipped as long as the distance of the original's samples allows it; and what is handed out has been measured on the whole original,
faces and all. Where nothing coarser keeps the bound, the original itself is the result.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ..distance import closest_on_mesh, closest_weights, one_sided_distance, plane_weights
from ..errors import FarfieldError
from ..mesh import face_areas_and_normals
from ..progress import Progress, Steps
from .remesh import collapse, compact, flip
from .straddle import LEAST_WEIGHT, SPRINGS, solve_moves, straddle

MAX_SAMPLES = 16_000
JUDGED_STRIDE = 2  # collapses and flips are judged by every second sample
STRADDLED = 1.4  # a proposal up to so many errors away comes within the error by moving its vertices
JUDGED_LIMIT = 1.25  # in errors, of a collapse before vertices are moved again
PROMISING = 1.2  # in errors, at the samples: what the last moves may still mend
ROUND_SHARE = 0.2
DESCENT_SHARE = 0.06  # from the coarsest mesh that passed on, a few collapses at a time
MAX_DESCENT = 4
MAX_ROUNDS = 24
ROUND_POWERS = (2.0, 3.0, 4.0)
LAST_POWERS = (3.0, 4.0, 4.0, 6.0, 6.0, 6.0)
FAR = 0.5  # in errors: points of the original that the last moves look at whether they are samples or not
SETTLINGS = 3  # times that the far points are looked up anew
SETTLING_STEPS = 12
PATIENCE = 4  # steps without a better one
SETTLING_POWER = 8.0
NEWTON = 1.0 / (SETTLING_POWER - 1.0)  # of a reweighted step is the Newton step of that power
TIGHT = 0.3  # springs while the area is too large and the distances are not
SETTLED = 0.97  # in errors; the rest is for points between the samples
BEYOND_SHARE = 0.02  # of the area may turn farther than the normal bound from every triangle near it, for creases are rounded off
AREA_GROWTH = 1.02  # over the area of the original, as a folded or spiky mesh would have; this is what texture costs
TOLERANCE = 0.01  # of the error, in measuring


@dataclass(frozen=True)
class Decimated:
    """A coarse mesh in the space of the original.

    vertices (V, 3) float64, triangles (T, 3) int32. primitive_of (S,) int32: the triangle whose plane stands for each original triangle;
    all its corners are within the error of that plane, and its normal within the normal bound wherever a triangle near it allows both.
    distance: bound of the one-sided distance from the original to the coarse mesh, in the unit of the vertices; half the error at least.
    beyond: original triangles that break the normal bound.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    primitive_of: np.ndarray
    distance: float
    beyond: int


def decimate_to_error(vertices: np.ndarray, triangles: np.ndarray, error: float, max_normal_deviation: float) -> Steps[Decimated]:
    """The coarsest mesh found that keeps every point of the original within `error`, and almost all normals within the bound.

    Args:
        vertices: (V, 3) float64.
        triangles: (T, 3) int, none without area; non-manifold and duplicate ones are fine.
        error: length in the unit of the vertices.
        max_normal_deviation: radians between an original face and the triangle that stands for it.
    """
    original = _Original(vertices[triangles], error, float(np.cos(max_normal_deviation)))
    welded = _weld(vertices, triangles)
    yield Progress(0.0, "proposing a coarse mesh")
    history = [original.start(*welded)]
    for round_number in range(MAX_ROUNDS):
        coarse, faces = history[-1]
        yield Progress(0.05 + 0.75 * round_number / MAX_ROUNDS, f"{len(faces)} triangles")
        coarse, faces = _coarsen(original.samples, coarse, faces, error, ROUND_SHARE)
        stuck = len(faces) > 0.985 * len(history[-1][1])
        if closest_on_mesh(original.samples, coarse[faces])[0].max() <= PROMISING * error:
            history.append((coarse, faces))
        if stuck:
            break
    yield Progress(0.8, "measuring")
    best, low, high = None, 0, len(history)
    while low < high:
        middle = high - 1 if best is None else (low + high) // 2
        found = original.accept(*history[middle])
        best, low, high = (best, low, middle) if found is None else (found, middle + 1, high)
        yield Progress(1.0 - 0.2 * (high - low) / len(history), "measuring")
    if best is None:
        return original.proposal_within(*welded)
    for _ in range(MAX_DESCENT):
        yield Progress(1.0, f"{len(best.triangles)} triangles")
        coarse, faces = _coarsen(original.samples, best.vertices, best.triangles, error, DESCENT_SHARE)
        found = original.accept(coarse, faces) if len(faces) < len(best.triangles) else None
        if found is None:
            break
        best = found
    return best


def _coarsen(samples: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, error: float, share: float) -> tuple[np.ndarray, np.ndarray]:
    """One round of collapses, flips and moves that takes up to `share` of the triangles away."""
    most = max(1, int(0.5 * share * len(triangles)))
    collapsed = collapse(samples[::JUDGED_STRIDE], vertices, triangles, JUDGED_LIMIT * error, most)
    if len(collapsed[1]) == 0:
        return vertices, triangles
    vertices, triangles = collapsed
    vertices = straddle(samples, vertices, triangles, ROUND_POWERS)
    triangles = flip(samples[::JUDGED_STRIDE], vertices, triangles, 0.02 * error)
    return straddle(samples, vertices, triangles, ROUND_POWERS), triangles


def _weld(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with one vertex a place and no face twice."""
    places, index = np.unique(vertices, axis=0, return_inverse=True)
    return compact(places, index.reshape(-1)[triangles])


class _Original:
    """The fine mesh, its samples, and the measure that a coarse mesh has to pass."""

    def __init__(self, corners: np.ndarray, error: float, least_cosine: float) -> None:
        self.corners, self.error, self.least_cosine = corners, error, least_cosine
        self.areas, self.normals = face_areas_and_normals(corners)
        middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
        on_edges = np.unique(np.concatenate([corners, middles]).reshape(-1, 3), axis=0)
        self.points = np.concatenate([on_edges, corners.mean(axis=1)])
        stride = max(1.0, len(self.points) / MAX_SAMPLES)
        self.samples = self.points[np.arange(0, len(self.points), stride).astype(np.int64)]

    def start(self, vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The coarsest proposal that is near enough to be moved within the error."""
        low, high = 2, len(triangles)
        best = vertices, triangles
        while high > 1.15 * low:
            target = int(np.sqrt(low * high))
            coarse, faces = propose(vertices, triangles, target)
            near = len(faces) > 0 and closest_on_mesh(self.samples, coarse[faces])[0].max() <= STRADDLED * self.error
            if near:
                best, high = (coarse, faces), target
            else:
                low = target + 1
        return straddle(self.samples, best[0], best[1], ROUND_POWERS), best[1]

    def proposal_within(self, vertices: np.ndarray, triangles: np.ndarray) -> Decimated:
        """The coarsest proposal that passes as it is; the original where none does."""
        best = None
        low, high = 2, len(triangles)
        while high > 1.15 * low:
            target = int(np.sqrt(low * high))
            coarse, faces = propose(vertices, triangles, target)
            found = self.measure(coarse, faces) if len(faces) else None
            best, low, high = (best, target + 1, high) if found is None else (found, low, target)
        return best if best is not None else self.measure(vertices, triangles)

    def accept(self, vertices: np.ndarray, triangles: np.ndarray) -> Decimated | None:
        """The coarse mesh after its last moves, or None when it does not keep the bounds."""
        vertices = straddle(self._watched(vertices, triangles), vertices, triangles, LAST_POWERS)
        for _ in range(SETTLINGS):
            vertices = self._settled(self._watched(vertices, triangles), vertices, triangles)
            found = self.measure(vertices, triangles)
            if found is not None:
                return found
        return None

    def _watched(self, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """The samples, and all points of the original that are far from the coarse mesh."""
        far = closest_on_mesh(self.points, vertices[triangles])[0] > FAR * self.error
        return np.concatenate([self.samples, self.points[far]])

    def measure(self, vertices: np.ndarray, triangles: np.ndarray) -> Decimated | None:
        """The coarse mesh with its figures, or None when it does not keep the bounds."""
        if face_areas_and_normals(vertices[triangles])[0].sum() > AREA_GROWTH * self.areas.sum():
            return None
        primitive_of, heights, turned = self.assign(vertices, triangles)
        if heights.max() > self.error or self.areas[turned].sum() > BEYOND_SHARE * self.areas.sum():
            return None
        distance = one_sided_distance(self.corners, vertices[triangles], TOLERANCE * self.error, 0.5 * self.error)
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

    def _settled(self, samples: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """Vertices moved until planes keep the corners of their faces and triangles keep the `samples`, or the best on the way there.

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
            badness = max(worst / (SETTLED * self.error), 1.0) + max(growth - 1.0, 0.0)
            if badness < least:
                best, least, best_step = vertices, badness, step
            if badness <= 1.0 or step - best_step > PATIENCE:
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
                (np.abs(residuals) / worst) ** SETTLING_POWER + LEAST_WEIGHT,
                TIGHT if growth > 1.0 and worst <= SETTLED * self.error else SPRINGS,
            )
        return best


def propose(vertices: np.ndarray, triangles: np.ndarray, target: int) -> tuple[np.ndarray, np.ndarray]:
    """About `target` triangles by quadric collapses.

    Raises:
        FarfieldError: when the library that does it is missing.
    """
    try:
        import fast_simplification
    except ModuleNotFoundError as missing:
        raise FarfieldError("The method decimate needs the library fast-simplification; install Farfield from its zip.") from missing
    coarse, faces = fast_simplification.simplify(vertices, triangles, target_count=target, agg=7)
    return compact(np.asarray(coarse, np.float64), np.asarray(faces, np.int32)) if len(faces) else (coarse, faces)


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
