"""Simplification of height fields by rounds of independent half-edge collapses, for thousands of separate domains at once.

Every vertex that remains is a sample of the field. In each round, the cheapest vertices of every domain that share no triangle collapse. The
cost of a collapse is the largest vertical distance to the new triangles from the vertex and from all samples removed before it in its star.
After Cignoni et al., BDAM, 2003, section 5.2, with vertical distances in place of quadrics.
"""

from dataclasses import dataclass

import numpy as np

from .collapse_costs import LOCKED, GridPoints, find_targets
from .removed_samples import RemovedSamples
from .vertex_rings import VertexRings, build_rings

MAX_ROUNDS = 40
MAX_EXACT_DIFFERENCE = 1 << 11  # products of differences up to this are exact in float32
STALE_COST_RATIO = (
    2.0  # a changed vertex is evaluated again only if its last cost was below this many times the cost of the last chosen one
)
SELECTION_PASSES = 4
TOLERATED_EXCESS = 0.02  # of the vertices to be removed, above which another round runs


@dataclass(frozen=True)
class MeshBatch:
    """Separate meshes, the domains, which are simplified at once.

    x, y: (V,) int32, grid coordinates. z: (V,) float32. lines: (V,) int8, the constraints of `collapse_costs`. domains: (V,) int32, 0 to
    D - 1. triangles: (T, 3) int32, counterclockwise. samples: (S,) int32, locked vertices that belong to no triangle, but whose distances
    count. sample_triangles: (S,) int32, the triangles that contain them.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    lines: np.ndarray
    domains: np.ndarray
    triangles: np.ndarray
    samples: np.ndarray
    sample_triangles: np.ndarray


def simplify(batch: MeshBatch, excess: np.ndarray, first: tuple[np.ndarray, np.ndarray] | None = None) -> tuple[np.ndarray, RemovedSamples]:
    """Return the triangles (N, 3) int32 of the simplified meshes, with the vertices of the input, and the samples that they approximate.

    Args:
        excess: (D,) int, how many vertices to remove from each domain. Fewer are removed where locked vertices prevent it. first: vertices
            (N,) int32 that share no triangle, and their targets (N,) int32, to collapse at the start.
    """
    count, domains, triangles = len(batch.x), batch.domains, batch.triangles
    points = GridPoints(batch.x, batch.y, batch.z, np.dtype(np.float32 if _largest_extent(batch) <= MAX_EXACT_DIFFERENCE else np.float64))
    is_movable = batch.lines != LOCKED
    costs, targets, last_costs = np.full(count, np.inf, np.float32), np.zeros(count, np.int32), np.zeros(count, np.float32)
    is_exact = np.zeros(count, bool)
    samples = RemovedSamples(batch.samples, batch.sample_triangles)
    tolerated = TOLERATED_EXCESS * excess
    is_removed = np.zeros(count, bool)
    if first is not None:
        samples.update(points, build_rings(triangles, count), triangles, *first)
        triangles = _collapse(triangles, *first, samples)
        excess = excess - np.bincount(domains[first[0]], minlength=len(excess))
        is_removed[first[0]] = True
    changed = np.flatnonzero(is_movable & ~is_removed).astype(np.int32)
    for _ in range(MAX_ROUNDS):
        if (excess <= tolerated).all():
            break
        rings = build_rings(triangles, count)
        targets[changed], costs[changed] = find_targets(points, rings, batch.lines, changed)
        is_exact[changed] = False
        _, bounds = _rank(costs, domains, excess)
        raised = np.flatnonzero(~is_exact & (costs <= bounds[domains]) & np.isfinite(costs)).astype(np.int32)
        costs[raised] = samples.raise_costs(points, rings, triangles, raised, targets[raised], costs[raised])
        is_exact[raised] = True
        last_costs[changed] = costs[changed]
        last_costs[raised] = costs[raised]
        keys, cutoffs = _rank(costs, domains, excess)
        keys[~is_exact] = np.iinfo(np.uint64).max
        removed = _select_independent(keys, rings, triangles)
        if not len(removed):
            break
        removed = _limit(removed, keys, domains, excess)
        samples.update(points, rings, triangles, removed, targets[removed])
        is_removed = np.zeros(count, bool)
        is_removed[removed] = True
        is_changed = np.zeros(count, bool)
        is_changed[triangles[is_removed[triangles].any(axis=1)]] = True
        triangles = _collapse(triangles, removed, targets[removed], samples)
        excess = excess - np.bincount(domains[removed], minlength=len(excess))
        changed = is_changed & ~is_removed & is_movable
        costs[is_removed | changed] = np.inf
        changed = np.flatnonzero(changed & (last_costs <= STALE_COST_RATIO * cutoffs[domains])).astype(np.int32)
    return triangles, samples


def _largest_extent(batch: MeshBatch) -> int:
    """Return the largest extent of a domain along x or y."""
    order = np.argsort(batch.domains, kind="stable")
    starts = np.flatnonzero(np.diff(batch.domains[order], prepend=-1))
    ordered = ((axis[order]) for axis in (batch.x, batch.y))
    return max((int((np.maximum.reduceat(axis, starts) - np.minimum.reduceat(axis, starts)).max()) for axis in ordered), default=0)


def _rank(costs: np.ndarray, domains: np.ndarray, excess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return keys (V,) uint64 that order vertices by cost, the largest number for those that are not among the cheapest of their domain, and
    the cost (D,) of the most expensive one that is."""
    keys = np.full(len(costs), np.iinfo(np.uint64).max)
    candidates = np.flatnonzero(np.isfinite(costs) & (excess[domains] > 0))
    cost_bits = costs[candidates].view(np.uint32).astype(np.uint64)  # floats that are not negative sort like their bits
    of_domain = domains[candidates].astype(np.uint64)
    combined = np.sort(of_domain << np.uint64(32) | cost_bits)
    counts = np.bincount(domains[candidates], minlength=len(excess))
    ends = np.cumsum(counts)
    last = ends - counts + np.minimum(np.maximum(excess, 1), counts) - 1
    cutoff_bits = np.zeros(len(excess), np.uint64)
    has_candidates = counts > 0
    cutoff_bits[has_candidates] = combined[last[has_candidates]] & np.uint64(0xFFFFFFFF)
    is_cheap = cost_bits <= cutoff_bits[domains[candidates]]
    cheap = candidates[is_cheap]
    noise = (cheap.astype(np.uint32) * np.uint32(2654435761)).astype(np.uint64)  # breaks ties, otherwise flat areas shrink row by row
    keys[cheap] = cost_bits[is_cheap] << np.uint64(32) | noise
    return keys, cutoff_bits.astype(np.uint32).view(np.float32)


def _select_independent(keys: np.ndarray, rings: VertexRings, triangles: np.ndarray) -> np.ndarray:
    """Return vertices (N,) int32 with small keys, no two of which share a triangle."""
    keys, none = keys.copy(), np.iinfo(np.uint64).max
    degrees = rings.degrees
    is_selected = np.zeros(len(keys), bool)
    for _ in range(SELECTION_PASSES):
        corner_keys = keys[triangles]
        smallest = corner_keys.argmin(axis=1)
        rows = np.arange(len(triangles))
        has_any = corner_keys[rows, smallest] != none
        wins = np.bincount(triangles[rows, smallest][has_any], minlength=len(keys))
        is_minimum = (wins == degrees) & (keys != none) & (degrees > 0)
        is_selected |= is_minimum
        keys[triangles[is_minimum[triangles].any(axis=1)]] = none
    return np.flatnonzero(is_selected).astype(np.int32)


def _limit(removed: np.ndarray, keys: np.ndarray, domains: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """Return the cheapest of the vertices `removed`, at most `excess` (D,) of each domain."""
    of_domain = domains[removed]
    counts = np.bincount(of_domain, minlength=len(excess))
    if (counts <= excess).all():
        return removed
    order = np.lexsort((keys[removed], of_domain))
    ranks = np.arange(len(removed)) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.sort(removed[order[ranks < excess[of_domain[order]]]])


def _collapse(triangles: np.ndarray, removed: np.ndarray, targets: np.ndarray, samples: RemovedSamples) -> np.ndarray:
    """Return the triangles after the collapse of `removed` onto `targets`; the triangles of the samples are renumbered."""
    renumbering = np.arange(triangles.max() + 1, dtype=np.int32)
    renumbering[removed] = targets
    moved = renumbering[triangles]
    a, b, c = moved.T
    is_kept = (a != b) & (b != c) & (c != a)
    samples.triangles = (np.cumsum(is_kept, dtype=np.int32) - 1)[samples.triangles]
    return moved[is_kept]
