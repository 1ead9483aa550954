"""Collapses of vertices and edges in rounds: which of them can be performed together, and which preserve topology and shape.

Engines that simplify meshes share these functions. They differ in their data, and stay apart for it: seams of textures, thousands of
separate domains, batches that can be undone, operations that are rated by samples. Where none of this matters, the package
fast-simplification decimates a mesh.
"""

import numpy as np
from scipy.sparse import csr_matrix

from ..arrays import TINY, gather, gather_columns
from ..errors import FarfieldError
from .edges import Edges

SELECTION_PASSES = 4  # Further passes would find few more vertices.
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


def select_independent(
    vertices: np.ndarray, keys: np.ndarray, triangles: np.ndarray, vertex_count: int, passes: int = SELECTION_PASSES
) -> np.ndarray:
    """Return some of `vertices` (N,) intp with small keys (N,) of any type, no two of which share one of the triangles (3, T) intp.

    Each pass selects the vertices whose keys are the smallest in all of their triangles, and drops their neighbors. Every vertex needs a
    triangle.
    """
    ranks = np.full(vertex_count, NO_RANK, np.uint32)
    ranks[vertices[np.argsort(keys)]] = np.arange(len(vertices), dtype=np.uint32)
    selected = []
    for _ in range(passes):
        corner_ranks = gather(ranks, triangles)
        smallest = corner_ranks.min(axis=0)
        is_active = smallest != NO_RANK
        is_blocked = np.zeros(vertex_count, bool)
        is_blocked[triangles.compress((corner_ranks != smallest).reshape(-1))] = True
        selected.append(vertices.compress(~gather(is_blocked, vertices)))
        if len(selected) == passes:
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


def select_disjoint(costs: np.ndarray, owners: np.ndarray, touched: np.ndarray, triangle_count: int, max_count: int) -> np.ndarray:
    """Return up to `max_count` of the operations with finite costs (N,), cheapest first, no two of which touch the same triangle.

    owners, touched: (P,) pairs of an operation, ascending, and a triangle that it touches.
    """
    starts, stops = (np.searchsorted(owners, np.arange(len(costs)), side) for side in ("left", "right"))
    is_free = np.ones(triangle_count, bool)
    selected: list[int] = []
    for operation in np.argsort(costs, kind="stable"):
        if not np.isfinite(costs[operation]) or len(selected) >= max_count:
            break
        triangles = touched[starts[operation] : stops[operation]]
        if is_free[triangles].all():
            is_free[triangles] = False
            selected.append(int(operation))
    return np.array(selected, np.int64)


def satisfies_link_condition(edges: Edges) -> np.ndarray:
    """Return which edges (E,) bool can collapse: their ends share only the vertices opposite to them, and no boundary is pinched."""
    ends, face_counts = edges.ends, edges.face_counts
    ones = np.ones(2 * len(ends), np.int32)
    adjacency = csr_matrix((ones, (ends.ravel(), ends[:, ::-1].ravel())), shape=(edges.vertex_count, edges.vertex_count))
    shared = np.asarray(adjacency[ends[:, 0]].multiply(adjacency[ends[:, 1]]).sum(axis=1)).ravel()
    is_boundary = face_counts == 1
    return (shared == face_counts) & (face_counts <= 2) & (is_boundary | ~edges.boundary_vertices[ends].all(axis=1))


def creates_existing_edge(owners: np.ndarray, keys: np.ndarray, edge_keys: np.ndarray, count: int) -> np.ndarray:
    """Return which of `count` half-edge collapses, (count,) bool, violate the link condition: they create an edge that exists.

    owners, keys: (P,) pairs of a collapse and an edge that it creates, see `encode_pairs`. edge_keys: (E,) keys of all edges, ascending.
    """
    creates = np.zeros(count, bool)
    creates[owners[edge_keys[np.minimum(np.searchsorted(edge_keys, keys), len(edge_keys) - 1)] == keys]] = True
    return creates


def creates_repeated_edge(owners: np.ndarray, keys: np.ndarray, count: int) -> np.ndarray:
    """Return which of `count` collapses, (count,) bool, create an edge that an earlier one creates too; see `creates_existing_edge`."""
    order = np.lexsort((owners, keys))
    owners, keys = owners[order], keys[order]
    creates = np.zeros(count, bool)
    creates[owners[1:][(keys[1:] == keys[:-1]) & (owners[1:] != owners[:-1])]] = True
    return creates


def measure_quality(double_areas: np.ndarray, squared_sides: np.ndarray) -> np.ndarray:
    """Return the quality of triangles, 1 if equilateral, 0 without area, from twice their areas and the sums of their squared sides."""
    return 2.0 * np.sqrt(3.0) * double_areas / np.maximum(squared_sides, TINY)


def quadric_decimation(vertices: np.ndarray, triangles: np.ndarray, target: int) -> tuple[np.ndarray, np.ndarray]:
    """Decimate by quadrics (Garland and Heckbert, 1997) to about `target` triangles.

    Returns vertices (V, 3) float64, some possibly unused, and triangles (T, 3) int32.

    Raises:
        FarfieldError: the package is not installed.
    """
    try:
        import fast_simplification
    except ImportError:
        raise FarfieldError(
            "This needs the package fast-simplification, which this Python lacks; install Farfield from its zip, which contains it."
        ) from None
    coarse, faces = fast_simplification.simplify(vertices, triangles, target_count=target, agg=7)
    return np.asarray(coarse, np.float64), np.asarray(faces, np.int32)
