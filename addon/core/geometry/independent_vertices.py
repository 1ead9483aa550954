"""Choice of cheap vertices that share no triangle, and of the cheapest ones of each domain."""

import numpy as np

from ..arrays import gather, gather_columns

SELECTION_PASSES = 4
NO_RANK = np.iinfo(np.uint32).max


def order_by_cost(costs: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return keys (N,) uint64 that sort vertices by their costs (N,) float32, which are not negative, and then at random.

    Without random order, flat areas would shrink row by row.

    Args:
        numbers: (N,) uint32, different for all vertices of a domain; keys of such vertices are different, too.
    """
    noise = numbers ^ (numbers >> np.uint32(16))  # every step can be inverted, so different numbers stay different
    for factor, shift in ((0x85EBCA6B, 13), (0xC2B2AE35, 16)):
        noise = noise * np.uint32(factor)
        noise ^= noise >> np.uint32(shift)
    return costs.view(np.uint32).astype(np.uint64) << np.uint64(32) | noise  # floats that are not negative sort like their bits


def select_independent(vertices: np.ndarray, keys: np.ndarray, triangles: np.ndarray, vertex_count: int) -> np.ndarray:
    """Return some of `vertices` (N,) intp with small keys (N,) uint64, no two of which share one of the triangles (3, T) intp.

    Each pass selects the vertices whose keys are the smallest in all of their triangles, and drops their neighbors.
    """
    ranks = np.full(vertex_count, NO_RANK, np.uint32)
    ranks[vertices[np.argsort(keys)]] = np.arange(len(vertices), dtype=np.uint32)
    selected = []
    for _ in range(SELECTION_PASSES):
        corner_ranks = gather(ranks, triangles)
        smallest = corner_ranks.min(axis=0)
        is_active = smallest != NO_RANK
        is_blocked = np.zeros(vertex_count, bool)
        is_blocked[triangles.compress((corner_ranks != smallest).reshape(-1))] = True
        selected.append(vertices.compress(~gather(is_blocked, vertices)))
        if len(selected) == SELECTION_PASSES:
            break
        is_taken = np.zeros(vertex_count, bool)
        is_taken[selected[-1]] = True
        touches = np.logical_or.reduce(gather(is_taken, triangles), axis=0)
        ranks[gather_columns(triangles, np.flatnonzero(touches))] = NO_RANK
        vertices = vertices.compress(gather(ranks, vertices) != NO_RANK)
        triangles = gather_columns(triangles, np.flatnonzero(is_active & ~touches))
    return np.concatenate(selected)


def select_cheapest(vertices: np.ndarray, keys: np.ndarray, domains: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return the vertices (N,) intp with the smallest keys (N,), at most `limits` (D,) int of each domain; `domains`: (N,) int."""
    counts = np.bincount(domains, minlength=len(limits))
    if (counts <= limits).all():
        return vertices
    order = np.lexsort((keys, domains))
    ranks = np.arange(len(vertices)) - np.repeat(np.cumsum(counts) - counts, counts)
    return vertices[order[ranks < limits[domains[order]]]]


def find_cutoffs(costs: np.ndarray, domains: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return the cost (D,) float32 of the `counts`-th (D,) int cheapest vertex of each domain, or of the most expensive one if there are
    fewer, or infinity if there are none.

    Args:
        costs: (N,) float32, not negative. domains: (N,) int32.
    """
    combined = np.sort(domains.astype(np.uint64) << np.uint64(32) | costs.view(np.uint32))
    available = np.bincount(domains, minlength=len(counts))
    ends = np.cumsum(available)
    positions = ends - available + np.clip(counts, 1, np.maximum(available, 1)) - 1
    cutoffs = np.full(len(counts), np.inf, np.float32)
    has_any = available > 0
    cutoffs[has_any] = combined[positions[has_any]].astype(np.uint32).view(np.float32)
    return cutoffs
