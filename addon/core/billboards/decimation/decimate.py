"""Decimation with a measured bound (section 4.2): the fewest triangles within the error of every point of the fine mesh.

Quadric collapses propose a coarse mesh. Its vertices are moved until it lies between the extremes of the fine mesh, which halves the
distance. Edges are then collapsed and flipped, in rounds of bounded work, as long as the distance of the fine mesh's samples allows it. The
result has been measured against the whole fine mesh, including the interior of its faces. A few faces across a crease of the coarse mesh,
which no single triangle approximates, remain unassigned for planes of their own. If no coarser mesh satisfies the bound, the result is the
fine mesh.
"""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ...geometry.collapses import quadric_decimation
from ...jobs.progress import Progress, Steps, subprogress
from .edge_operations import EdgeCollapses, evaluate_collapses, flip_edges, remove_degenerate
from .reference_mesh import MAX_UNASSIGNED, DecimatedMesh, ReferenceMesh
from .vertex_fit import fit_vertices

Result = TypeVar("Result")

MAX_PROPOSAL_DISTANCE = 0.7  # In errors, of the quantile PROPOSAL_QUANTILE of the samples, after moving the vertices.
PROPOSAL_QUANTILE = 0.995
BISECTION_RATIO = 1.15  # The bisection ends at this ratio of the upper to the lower bound of a triangle count.
MAX_COLLAPSE_COST = 0.9  # In errors, of a collapse before vertices are moved again.
MAX_DESCENT_COST = 2.0  # In errors, in the descent, where the result of every collapse is measured.
MAX_PROMISING_DISTANCE = 1.1  # In errors, of the samples: the final optimization may still correct it.
COLLAPSES_PER_TRIANGLE = 0.5  # A collapse removes two triangles.
ROUND_FRACTION = 0.12  # One round may remove this fraction of the triangles.
MAX_ROUND_FRACTION = 0.4  # The same while all samples are within CLOSE_DISTANCE.
CLOSE_DISTANCE = 0.4  # In errors.
MAX_REMAINING_FRACTION = 0.985  # The rounds end when more than this fraction of the triangles remains after one.
ROUND_WORK = 6_000  # Sum of the triangle counts of all rounds.
DESCENT_FRACTION = 0.06  # One trial of the descent may remove this fraction of the triangles of the coarsest accepted mesh.
MAX_TRIALS = 10  # Maximum trials of meshes from the rounds, and of the descent.
TRIAL_WORK = 4_000  # Sum of the triangle counts of all trials of each kind.
MIN_FLIP_GAIN = 0.02  # In errors: smaller gains are not worth an edge flip.
PROPOSAL_POWERS = (2.0, 3.0, 4.0)
FIT_POWERS = (3.0, 4.0, 6.0, 6.0, 8.0, 8.0)
DESCENT_POWERS = (6.0, 8.0)  # Of fits after a few collapses.
UNASSIGNED_COST = 0.4  # Quads per unassigned face: some share one.
MAX_OPTIMIZATIONS = 2  # Optimizations of a mesh before it is measured, each with the far points of the one before.
MAX_HOPELESS_VIOLATIONS = 2.0  # Times MAX_UNASSIGNED: more violations are not optimized again.
PROPOSAL_PROGRESS, ROUNDS_PROGRESS, TRIALS_PROGRESS = 0.1, 0.6, 0.8  # Where each stage ends.


def decimate_to_error(vertices: np.ndarray, triangles: np.ndarray, error: float, max_normal_deviation: float) -> Steps[DecimatedMesh]:
    """Find the coarsest mesh within `error` of every point of the fine mesh, with almost all normals within their bound.

    Args:
        vertices: (V, 3) float64.
        triangles: (T, 3) int, none without area; may be non-manifold and contain duplicates.
        error: length in the unit of the vertices.
        max_normal_deviation: radians between a fine face and the triangle that replaces it.
    """
    reference = ReferenceMesh(vertices[triangles], error, float(np.cos(max_normal_deviation)))
    positions, index = np.unique(vertices, axis=0, return_inverse=True)
    welded = remove_degenerate(positions, index.reshape(-1)[triangles])
    yield Progress(0.0, "Proposing a coarse mesh")
    steps = _run_rounds(reference, *_find_start(reference, *welded))
    history = yield from subprogress(steps, PROPOSAL_PROGRESS, ROUNDS_PROGRESS)
    best, work_left = None, TRIAL_WORK
    for trial, (coarse, faces) in enumerate(reversed(history[-MAX_TRIALS:])):
        work_left -= len(faces)
        if best is not None and (len(faces) >= _estimate_quads(best) or work_left < 0):
            break
        yield Progress(ROUNDS_PROGRESS + (TRIALS_PROGRESS - ROUNDS_PROGRESS) * trial / MAX_TRIALS, f"Measuring {len(faces)} triangles")
        best = _choose_better(best, _optimize_and_measure(reference, coarse, faces))
    if best is None:
        return _find_valid_proposal(reference, *welded)
    return (yield from subprogress(_descend(reference, best), TRIALS_PROGRESS, 1.0))


def _choose_better(first: DecimatedMesh | None, second: DecimatedMesh | None) -> DecimatedMesh | None:
    if first is None or second is None:
        return first or second
    return second if _estimate_quads(second) < _estimate_quads(first) else first


def _estimate_quads(decimated: DecimatedMesh) -> float:
    """Estimate the number of quads that it needs."""
    return len(decimated.triangles) + UNASSIGNED_COST * len(decimated.unassigned)


def _run_rounds(reference: ReferenceMesh, vertices: np.ndarray, triangles: np.ndarray) -> Steps[list[tuple[np.ndarray, np.ndarray]]]:
    """Run rounds of collapses, flips and vertex fits. Returns ever coarser meshes that nearly satisfy the bounds, the input first."""
    history = [(vertices, triangles)]
    work_left, fraction = ROUND_WORK - len(triangles), ROUND_FRACTION
    while work_left >= 0:
        count = len(triangles)
        yield Progress(1.0 - work_left / ROUND_WORK, f"{count} triangles")
        collapses = _evaluate_collapses(reference, vertices, triangles)
        max_cost, max_count = MAX_COLLAPSE_COST * reference.error, max(1, int(COLLAPSES_PER_TRIANGLE * fraction * count))
        vertices, triangles = _fit_and_flip(reference, *collapses.apply(vertices, triangles, max_cost, max_count))
        if len(reference.far_samples(vertices, triangles, MAX_PROMISING_DISTANCE)) == 0:
            history.append((vertices, triangles))
        if len(triangles) > MAX_REMAINING_FRACTION * count:
            break
        is_close = len(reference.far_samples(vertices, triangles, CLOSE_DISTANCE)) == 0
        fraction = MAX_ROUND_FRACTION if is_close else ROUND_FRACTION
        work_left -= len(triangles)
    return history


def _descend(reference: ReferenceMesh, best: DecimatedMesh) -> Steps[DecimatedMesh]:
    """Try a few more collapses of `best` at a time: half as many after each failure, then the next ones in the order of cost."""
    max_count, skipped, collapses = max(1, int(COLLAPSES_PER_TRIANGLE * DESCENT_FRACTION * len(best.triangles))), 0, None
    work_left = TRIAL_WORK
    for trial in range(MAX_TRIALS):
        yield Progress(trial / MAX_TRIALS, f"{len(best.triangles)} triangles")
        work_left -= len(best.triangles)
        if work_left < 0:
            break
        collapses = collapses or _evaluate_collapses(reference, best.vertices, best.triangles)
        collapsed = collapses.apply(best.vertices, best.triangles, MAX_DESCENT_COST * reference.error, max_count, skipped)
        if len(collapsed[1]) == len(best.triangles):
            break
        coarse, faces = _fit_and_flip(reference, *collapsed, DESCENT_POWERS)
        is_promising = len(reference.far_samples(coarse, faces, MAX_PROMISING_DISTANCE)) == 0
        better = _choose_better(best, _optimize_and_measure(reference, coarse, faces)) if is_promising else best
        if better is not best:
            best, collapses, skipped = better, None, 0
        elif max_count > 1:
            max_count //= 2
        else:
            skipped += 1
    return best


def _bisect_count(count: int, attempt: Callable[[int], Result | None]) -> Result | None:
    """Return the result of `attempt` for the smallest triangle count below `count` for which it is not None, found by bisection."""
    best = None
    low, high = 2, count
    while high > BISECTION_RATIO * low:
        target = int(np.sqrt(low * high))
        result = attempt(target)
        best, low, high = (best, target + 1, high) if result is None else (result, low, target)
    return best


def _find_start(reference: ReferenceMesh, vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the coarsest proposal that is close enough after moving its vertices."""

    def attempt(target: int) -> tuple[np.ndarray, np.ndarray] | None:
        coarse, faces = propose_mesh(vertices, triangles, target)
        if not len(faces):
            return None
        samples = reference.track(reference.sample(faces))
        coarse = fit_vertices(samples, coarse, faces, PROPOSAL_POWERS)
        distance = np.quantile(samples.find_closest(coarse[faces])[0], PROPOSAL_QUANTILE)
        return (coarse, faces) if distance <= MAX_PROPOSAL_DISTANCE * reference.error else None

    return _bisect_count(len(triangles), attempt) or (vertices, triangles)


def _evaluate_collapses(reference: ReferenceMesh, vertices: np.ndarray, triangles: np.ndarray) -> EdgeCollapses:
    """Evaluate all collapses of the coarse mesh on its active samples."""
    return evaluate_collapses(reference.active_samples(vertices, triangles), vertices, triangles)


def _fit_and_flip(
    reference: ReferenceMesh, vertices: np.ndarray, triangles: np.ndarray, powers: tuple[float, ...] = FIT_POWERS
) -> tuple[np.ndarray, np.ndarray]:
    """Move the vertices of the coarse mesh, flip edges that lower the distance, and move the vertices again."""
    vertices = fit_vertices(reference.track(reference.active_samples(vertices, triangles)), vertices, triangles, powers)
    samples = reference.active_samples(vertices, triangles)
    triangles = flip_edges(samples, vertices, triangles, MIN_FLIP_GAIN * reference.error)
    return fit_vertices(reference.track(samples), vertices, triangles, powers), triangles


def _optimize_and_measure(reference: ReferenceMesh, vertices: np.ndarray, triangles: np.ndarray) -> DecimatedMesh | None:
    """Run the final optimization. Returns the mesh with the fewest unassigned faces, or None if these are too many."""
    best, assigned = None, reference.assign(vertices, triangles)
    for _ in range(MAX_OPTIMIZATIONS):
        samples = reference.optimized_samples(vertices, triangles)
        moved, violations = reference.satisfy_bounds(samples, vertices, triangles, assigned)
        assigned = assigned if moved is vertices else reference.assign(moved, triangles)
        measured = reference.measure(moved, triangles, assigned)
        best = _choose_better(best, measured)
        is_hopeless = measured is None and violations > MAX_HOPELESS_VIOLATIONS * MAX_UNASSIGNED * len(triangles)
        if is_hopeless or moved is vertices or (measured is not None and len(measured.unassigned) == 0):
            break
        vertices = moved
    return best


def _find_valid_proposal(reference: ReferenceMesh, vertices: np.ndarray, triangles: np.ndarray) -> DecimatedMesh:
    """Find the coarsest proposal that satisfies the bounds without optimization, or return the fine mesh."""

    def attempt(target: int) -> DecimatedMesh | None:
        coarse, faces = propose_mesh(vertices, triangles, target)
        return reference.measure(coarse, faces) if len(faces) else None

    best = _bisect_count(len(triangles), attempt)
    return best if best is not None else reference.measure(vertices, triangles)


def propose_mesh(vertices: np.ndarray, triangles: np.ndarray, target: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a mesh with about `target` triangles, made by quadric collapses.

    Raises:
        FarfieldError: the package fast-simplification is not installed.
    """
    coarse, faces = quadric_decimation(vertices, triangles, target)
    return remove_degenerate(coarse, faces) if len(faces) else (coarse, faces)
