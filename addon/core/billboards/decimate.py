"""Simplification with a measured bound (section 4.2): the fewest triangles that stay within the error of every point of the original.

Quadric collapses propose a mesh; its vertices are moved until it straddles the original, which halves the distance; edges are collapsed
and flipped as long as the distance of the original's samples allows it; and what is handed out has been measured on the whole original,
faces and all. Where nothing coarser keeps the bound, the original itself is the result.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ..distance import closest_on_mesh, closest_weights, one_sided_distance, plane_weights, points_beyond
from ..errors import FarfieldError
from ..mesh import face_areas_and_normals
from ..progress import Progress, Steps, scaled
from .remesh import Collapses, compact, flip, judge_collapses
from .straddle import LEAST_WEIGHT, SPRINGS, solve_moves, straddle

MAX_SAMPLES = 16_000
LEAST_SAMPLES = 1_000
SAMPLES_A_TRIANGLE = 16  # of the coarse mesh, by which vertices are moved, collapses and flips are judged
FAR = 0.6  # in errors: samples farther than this count whether they are among those few or not
STRADDLED = 0.7  # in errors, of almost all samples to the proposal to start from, once its vertices are moved
ALMOST_ALL = 0.995
JUDGED_LIMIT = 0.9  # in errors, of a collapse before vertices are moved again
FORCED_LIMIT = 2.0  # in the descent, where every collapse is tried out
PROMISING = 1.1  # in errors, at the samples: what the last moves may still mend
ROUND_SHARE = 0.12
MAX_ROUNDS = 16
ROUND_WORK = 4_000  # triangles judged in all rounds
DESCENT_SHARE = 0.06  # from the coarsest mesh that passed on, a few collapses at a time
MAX_TRIALS = 6  # of meshes from the rounds, and of the descent
TRIAL_WORK = 1_200  # triangles in all trials of each kind
STARTING_POWERS = (2.0, 3.0, 4.0)
MOVING_POWERS = (3.0, 4.0, 6.0, 6.0, 8.0, 8.0)
SETTLINGS = 3  # times that the far points are looked up anew
SETTLING_STEPS = 10
PATIENCE = 3  # steps without a better one
SETTLING_POWER = 8.0
NEWTON = 1.0 / (SETTLING_POWER - 1.0)  # of a reweighted step is the Newton step of that power
TIGHT = 0.3  # springs while the area is too large and the distances are not
SETTLED = 0.97  # in errors; the rest is for points between the samples
HOPELESS = 1.35  # in errors, after the last step of a settling
MOST_APART = 0.25  # of the coarse triangles: original faces across a crease that stand for themselves
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
    history = yield from scaled(_rounds(original, *original.start(*welded)), 0.1, 0.6)
    best, work_left = None, TRIAL_WORK
    for trial, (coarse, faces) in enumerate(reversed(history[-MAX_TRIALS:])):
        work_left -= len(faces)
        if best is not None and (len(faces) >= len(best.result.triangles) or work_left < 0):
            break
        yield Progress(0.6 + 0.2 * trial / MAX_TRIALS, f"measuring {len(faces)} triangles")
        best = _fewer(best, original.accept(coarse, faces))
    if best is None:
        return original.proposal_within(*welded)
    return (yield from scaled(_descent(original, best), 0.8, 1.0))


def _fewer(first: "_Accepted | None", second: "_Accepted | None") -> "_Accepted | None":
    if first is None or second is None:
        return first or second
    return second if len(second.result.triangles) < len(first.result.triangles) else first


def _rounds(original: "_Original", vertices: np.ndarray, triangles: np.ndarray) -> Steps[list[tuple[np.ndarray, np.ndarray]]]:
    """Ever coarser meshes that come near the bounds, by rounds of collapses, flips and moves; the first is the given one."""
    history = [(vertices, triangles)]
    work_left = ROUND_WORK
    for round_number in range(MAX_ROUNDS):
        before = len(triangles)
        work_left -= before
        yield Progress(round_number / MAX_ROUNDS, f"{before} triangles")
        if work_left < 0:
            break
        collapses = original.judge(vertices, triangles)
        limit, most = JUDGED_LIMIT * original.error, max(1, int(0.5 * ROUND_SHARE * before))
        vertices, triangles = original.smooth(*collapses.carry_out(vertices, triangles, limit, most))
        if len(original.far(vertices, triangles, PROMISING)) == 0:
            history.append((vertices, triangles))
        if len(triangles) > 0.985 * before:
            break
    return history


def _descent(original: "_Original", best: "_Accepted") -> Steps[Decimated]:
    """From `best` on, collapses that are tried out a few at a time: half as many after each that fails, then the next ones in line."""
    most, skipped, collapses = max(1, int(0.5 * DESCENT_SHARE * len(best.triangles))), 0, None
    work_left = TRIAL_WORK
    for trial in range(MAX_TRIALS):
        yield Progress(trial / MAX_TRIALS, f"{len(best.result.triangles)} triangles")
        work_left -= len(best.triangles)
        if work_left < 0:
            break
        collapses = collapses or original.judge(best.vertices, best.triangles)
        fewer = collapses.carry_out(best.vertices, best.triangles, FORCED_LIMIT * original.error, most, skipped)
        if len(fewer[1]) == len(best.triangles):
            break
        coarse, faces = original.smooth(*fewer)
        near = len(original.far(coarse, faces, PROMISING)) == 0
        found = _fewer(best, original.accept(coarse, faces)) if near else best
        if found is not best:
            best, collapses, skipped = found, None, 0
        elif most > 1:
            most //= 2
        else:
            skipped += 1
    return best.result


def _weld(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with one vertex a place and no face twice."""
    places, index = np.unique(vertices, axis=0, return_inverse=True)
    return compact(places, index.reshape(-1)[triangles])


@dataclass(frozen=True)
class _Accepted:
    """What may be handed out, and the coarse mesh alone, without the original faces that stand for themselves, to go on from."""

    result: Decimated
    vertices: np.ndarray
    triangles: np.ndarray


class _Original:
    """The fine mesh, its samples, and the measure that a coarse mesh has to pass."""

    def __init__(self, corners: np.ndarray, error: float, least_cosine: float) -> None:
        self.corners, self.error, self.least_cosine = corners, error, least_cosine
        self.areas, self.normals = face_areas_and_normals(corners)
        middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
        on_edges = np.unique(np.concatenate([corners, middles]).reshape(-1, 3), axis=0)
        self.points = np.concatenate([on_edges, corners.mean(axis=1)])
        self.samples = _spread(self.points, MAX_SAMPLES)

    def start(self, vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The coarsest proposal that comes near enough when its vertices are moved."""
        low, high = 2, len(triangles)
        best = vertices, triangles
        while high > 1.15 * low:
            target = int(np.sqrt(low * high))
            coarse, faces = propose(vertices, triangles, target)
            if len(faces):
                samples = self._few(faces)
                coarse = straddle(samples, coarse, faces, STARTING_POWERS)
            if len(faces) and np.quantile(closest_on_mesh(samples, coarse[faces])[0], ALMOST_ALL) <= STRADDLED * self.error:
                best, high = (coarse, faces), target
            else:
                low = target + 1
        return best

    def judge(self, vertices: np.ndarray, triangles: np.ndarray) -> Collapses:
        """All collapses of the coarse mesh, judged by as many samples as it deserves."""
        return judge_collapses(self._watched(vertices, triangles), vertices, triangles)

    def smooth(self, vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The coarse mesh with its vertices moved, edges flipped where that helps, and moved again."""
        vertices = straddle(self._watched(vertices, triangles), vertices, triangles, MOVING_POWERS)
        watched = self._watched(vertices, triangles)
        triangles = flip(watched, vertices, triangles, 0.02 * self.error)
        return straddle(watched, vertices, triangles, MOVING_POWERS), triangles

    def far(self, vertices: np.ndarray, triangles: np.ndarray, errors: float) -> np.ndarray:
        """Samples (K, 3) that are more than so many errors away from the coarse mesh."""
        return self.samples[points_beyond(self.samples, vertices[triangles], errors * self.error)]

    def _few(self, triangles: np.ndarray) -> np.ndarray:
        return _spread(self.samples, max(LEAST_SAMPLES, SAMPLES_A_TRIANGLE * len(triangles)))

    def _watched(self, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """A few samples everywhere, and all that are far."""
        return np.concatenate([self._few(triangles), self.far(vertices, triangles, FAR)])

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

    def accept(self, vertices: np.ndarray, triangles: np.ndarray) -> _Accepted | None:
        """The coarse mesh after its last moves, with the fewest triangles of its own that still break a bound, or None where many do."""
        best = None
        for _ in range(SETTLINGS):
            far = self.points[points_beyond(self.points, vertices[triangles], FAR * self.error)]
            vertices, badness = self._settled(np.concatenate([self._few(triangles), far]), vertices, triangles)
            found = self.measure(vertices, triangles) if badness < HOPELESS else None
            best = _fewer(best, _Accepted(found, vertices, triangles) if found is not None else None)
            if badness > HOPELESS or (found is not None and len(found.triangles) == len(triangles)):
                break
        return best

    def measure(self, vertices: np.ndarray, triangles: np.ndarray) -> Decimated | None:
        """The coarse mesh with its figures, or None when it does not keep the bounds.

        A few original faces that lie across a crease, within the error of no one plane, may join the coarse mesh and stand for themselves.
        """
        if face_areas_and_normals(vertices[triangles])[0].sum() > AREA_GROWTH * self.areas.sum():
            return None
        primitive_of, heights, turned = self.assign(vertices, triangles)
        apart = heights > self.error
        if apart.sum() > MOST_APART * len(triangles):
            return None
        far = points_beyond(self.corners.reshape(-1, 3), vertices[triangles], (1.0 - TOLERANCE) * self.error)
        apart[far // 3] = True
        own = np.flatnonzero(apart)
        if len(own):
            primitive_of[own] = len(triangles) + np.arange(len(own))
            turned[own] = False
            triangles = np.concatenate([triangles, len(vertices) + np.arange(3 * len(own), dtype=np.int32).reshape(-1, 3)])
            vertices = np.concatenate([vertices, self.corners[own].reshape(-1, 3)])
        if len(own) > MOST_APART * len(triangles) or self.areas[turned].sum() > BEYOND_SHARE * self.areas.sum():
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

    def _settled(self, samples: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, float]:
        """Vertices moved until planes keep the corners of their faces and triangles keep the `samples`, or the best on the way there; and
        how bad these still are, where 1 keeps all bounds.

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
        return best, least


def _spread(points: np.ndarray, most: int) -> np.ndarray:
    """Every so many of `points` (N, 3) that at most about `most` are left."""
    return points[np.arange(0, len(points), max(1.0, len(points) / most)).astype(np.int64)]


def propose(vertices: np.ndarray, triangles: np.ndarray, target: int) -> tuple[np.ndarray, np.ndarray]:
    """About `target` triangles by quadric collapses.

    Raises:
        FarfieldError: when the package that does it is not installed.
    """
    try:
        import fast_simplification
    except ImportError:
        raise FarfieldError(
            "The method decimate needs the package fast-simplification, which this Python lacks; install Farfield from its zip, which "
            "brings it along, or choose the method clusters."
        ) from None
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
