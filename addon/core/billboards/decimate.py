"""Simplification with a measured bound (section 4.2): the fewest triangles that stay within the error of every point of the original.

Quadric collapses propose a mesh; its vertices are moved until it straddles the original, which halves the distance; edges are collapsed
and flipped as long as the distance of the original's samples allows it, in rounds of bounded work; and what is handed out has been
measured on the whole original, faces and all. A few faces that lie across a crease of the coarse mesh, where no one triangle keeps them,
are left for planes of their own. Where nothing coarser keeps the bound, the original itself is the result.
"""

import numpy as np

from ..distance import closest_on_mesh, points_beyond
from ..progress import Progress, Steps, scaled
from ..simplification import simplified
from .fine_mesh import FAR, MOST_APART, Decimated, FineMesh
from .remesh import Collapses, compact, flip, judge_collapses
from .straddle import straddle

STRADDLED = 0.7  # in errors, of almost all samples to the proposal to start from, once its vertices are moved
ALMOST_ALL = 0.995
JUDGED_LIMIT = 0.9  # in errors, of a collapse before vertices are moved again
FORCED_LIMIT = 2.0  # in the descent, where every collapse is tried out
PROMISING = 1.1  # in errors, at the samples: what the last moves may still mend
ROUND_SHARE = 0.12
MOST_SHARE = 0.4
ROOMY = 0.4  # in errors, of all samples: many collapses at once do no harm yet
ROUND_WORK = 6_000  # triangles judged in all rounds
DESCENT_SHARE = 0.06  # from the coarsest mesh that passed on, a few collapses at a time
MAX_TRIALS = 10  # of meshes from the rounds, and of the descent
TRIAL_WORK = 4_000  # triangles in all trials of each kind
STARTING_POWERS = (2.0, 3.0, 4.0)
MOVING_POWERS = (3.0, 4.0, 6.0, 6.0, 8.0, 8.0)
APART_COST = 0.4  # quads that a face which no triangle stands for will take: some share one
SETTLINGS = 2  # times that the far points are looked up anew


def decimate_to_error(vertices: np.ndarray, triangles: np.ndarray, error: float, max_normal_deviation: float) -> Steps[Decimated]:
    """The coarsest mesh found that keeps every point of the original within `error`, and almost all normals within the bound.

    Args:
        vertices: (V, 3) float64.
        triangles: (T, 3) int, none without area; non-manifold and duplicate ones are fine.
        error: length in the unit of the vertices.
        max_normal_deviation: radians between an original face and the triangle that stands for it.
    """
    fine = FineMesh(vertices[triangles], error, float(np.cos(max_normal_deviation)))
    welded = _weld(vertices, triangles)
    yield Progress(0.0, "proposing a coarse mesh")
    history = yield from scaled(_rounds(fine, *_start(fine, *welded)), 0.1, 0.6)
    best, work_left = None, TRIAL_WORK
    for trial, (coarse, faces) in enumerate(reversed(history[-MAX_TRIALS:])):
        work_left -= len(faces)
        if best is not None and (len(faces) >= _count(best) or work_left < 0):
            break
        yield Progress(0.6 + 0.2 * trial / MAX_TRIALS, f"measuring {len(faces)} triangles")
        best = _fewer(best, _accept(fine, coarse, faces))
    if best is None:
        return _proposal_within(fine, *welded)
    return (yield from scaled(_descent(fine, best), 0.8, 1.0))


def _fewer(first: Decimated | None, second: Decimated | None) -> Decimated | None:
    if first is None or second is None:
        return first or second
    return second if _count(second) < _count(first) else first


def _count(decimated: Decimated) -> float:
    """About how many quads it will take."""
    return len(decimated.triangles) + APART_COST * len(decimated.apart)


def _rounds(fine: FineMesh, vertices: np.ndarray, triangles: np.ndarray) -> Steps[list[tuple[np.ndarray, np.ndarray]]]:
    """Ever coarser meshes that come near the bounds, by rounds of collapses, flips and moves; the first is the given one."""
    history = [(vertices, triangles)]
    work_left, share = ROUND_WORK - len(triangles), ROUND_SHARE
    while work_left >= 0:
        before = len(triangles)
        yield Progress(1.0 - work_left / ROUND_WORK, f"{before} triangles")
        collapses = _judge(fine, vertices, triangles)
        limit, most = JUDGED_LIMIT * fine.error, max(1, int(0.5 * share * before))
        vertices, triangles = _smooth(fine, *collapses.carry_out(vertices, triangles, limit, most))
        if len(fine.far_samples(vertices, triangles, PROMISING)) == 0:
            history.append((vertices, triangles))
        if len(triangles) > 0.985 * before:
            break
        share = ROUND_SHARE if len(fine.far_samples(vertices, triangles, ROOMY)) else MOST_SHARE
        work_left -= len(triangles)
    return history


def _descent(fine: FineMesh, best: Decimated) -> Steps[Decimated]:
    """From `best` on, collapses that are tried out a few at a time: half as many after each that fails, then the next ones in line."""
    most, skipped, collapses = max(1, int(0.5 * DESCENT_SHARE * len(best.triangles))), 0, None
    work_left = TRIAL_WORK
    for trial in range(MAX_TRIALS):
        yield Progress(trial / MAX_TRIALS, f"{len(best.triangles)} triangles")
        work_left -= len(best.triangles)
        if work_left < 0:
            break
        collapses = collapses or _judge(fine, best.vertices, best.triangles)
        fewer = collapses.carry_out(best.vertices, best.triangles, FORCED_LIMIT * fine.error, most, skipped)
        if len(fewer[1]) == len(best.triangles):
            break
        coarse, faces = _smooth(fine, *fewer)
        near = len(fine.far_samples(coarse, faces, PROMISING)) == 0
        found = _fewer(best, _accept(fine, coarse, faces)) if near else best
        if found is not best:
            best, collapses, skipped = found, None, 0
        elif most > 1:
            most //= 2
        else:
            skipped += 1
    return best


def _weld(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with one vertex a place and no face twice."""
    places, index = np.unique(vertices, axis=0, return_inverse=True)
    return compact(places, index.reshape(-1)[triangles])


def _start(fine: FineMesh, vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The coarsest proposal that comes near enough when its vertices are moved."""
    low, high = 2, len(triangles)
    best = vertices, triangles
    while high > 1.15 * low:
        target = int(np.sqrt(low * high))
        coarse, faces = propose(vertices, triangles, target)
        if len(faces):
            samples = fine.few_samples(faces)
            coarse = straddle(samples, coarse, faces, STARTING_POWERS)
        if len(faces) and np.quantile(closest_on_mesh(samples, coarse[faces])[0], ALMOST_ALL) <= STRADDLED * fine.error:
            best, high = (coarse, faces), target
        else:
            low = target + 1
    return best


def _judge(fine: FineMesh, vertices: np.ndarray, triangles: np.ndarray) -> Collapses:
    """All collapses of the coarse mesh, judged by as many samples as it deserves."""
    return judge_collapses(fine.watched(vertices, triangles), vertices, triangles)


def _smooth(fine: FineMesh, vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The coarse mesh with its vertices moved, edges flipped where that helps, and moved again."""
    vertices = straddle(fine.watched(vertices, triangles), vertices, triangles, MOVING_POWERS)
    watched = fine.watched(vertices, triangles)
    triangles = flip(watched, vertices, triangles, 0.02 * fine.error)
    return straddle(watched, vertices, triangles, MOVING_POWERS), triangles


def _accept(fine: FineMesh, vertices: np.ndarray, triangles: np.ndarray) -> Decimated | None:
    """The coarse mesh after its last moves, with the fewest faces left apart, or None where these are many."""
    best = None
    for _ in range(SETTLINGS):
        far = fine.points[points_beyond(fine.points, vertices[triangles], FAR * fine.error)]
        moved, broken = fine.settled(np.concatenate([fine.few_samples(triangles), far]), vertices, triangles)
        found = fine.measure(moved, triangles)
        best = _fewer(best, found)
        hopeless = found is None and broken > 2.0 * MOST_APART * len(triangles)
        if hopeless or moved is vertices or (found is not None and len(found.apart) == 0):
            break
        vertices = moved
    return best


def _proposal_within(fine: FineMesh, vertices: np.ndarray, triangles: np.ndarray) -> Decimated:
    """The coarsest proposal that passes as it is; the original where none does."""
    best = None
    low, high = 2, len(triangles)
    while high > 1.15 * low:
        target = int(np.sqrt(low * high))
        coarse, faces = propose(vertices, triangles, target)
        found = fine.measure(coarse, faces) if len(faces) else None
        best, low, high = (best, target + 1, high) if found is None else (found, low, target)
    return best if best is not None else fine.measure(vertices, triangles)


def propose(vertices: np.ndarray, triangles: np.ndarray, target: int) -> tuple[np.ndarray, np.ndarray]:
    """About `target` triangles by quadric collapses.

    Raises:
        FarfieldError: when the package that does it is not installed.
    """
    coarse, faces = simplified(vertices, triangles, target)
    return compact(coarse, faces) if len(faces) else (coarse, faces)
