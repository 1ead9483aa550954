"""Openings of a surface, which collapses reduce to three edges: holes with a boundary, and tunnels without one.

A tunnel is a closed curve along which a surface can be cut without falling apart, such as those around holes through a part. Half-edge
collapses keep the genus. They shorten a tunnel to a loop of three edges that are no triangle, and stop there, because each further collapse
would make an edge that exists. A cut along the loop, and a triangle on each side of it, close the tunnel. A loop around a thin neck divides
the surface, and is no tunnel: one side of it can collapse to one vertex.

An opening is three halfedges at it, in the order in which their starts are the corners of a triangle that closes it: each ends where the
one before begins.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from ...arrays import concatenate_ranges
from ...geometry.proximity import encode_pairs
from .topology import AMBIGUOUS, BOUNDARY, Topology


def find_holes(topology: Topology) -> np.ndarray:
    """Return all holes of three edges, (3, N) halfedges at each."""
    starts, ends = topology.starts, topology.ends
    boundary = np.flatnonzero((topology.twins == BOUNDARY) & (topology.boundary_counts[starts] == 2)).astype(np.int32)
    leaving = np.full(topology.vertex_count, -1, np.int32)
    leaving[starts[boundary]] = boundary
    second = leaving[ends[boundary]]
    third = np.where(second >= 0, leaving[ends[second]], -1)
    is_hole = (third >= 0) & (ends[third] == starts[boundary])
    is_hole &= (starts[boundary] < ends[boundary]) & (starts[boundary] < ends[second])
    is_hole &= ends[topology.next(boundary)] != starts[third]  # the same triangle from behind
    return np.stack([boundary, third, second])[:, is_hole]


def find_loops(topology: Topology) -> np.ndarray:
    """Return all loops of three edges inside of the surface that are no triangle: (3, L) halfedges, each beginning where the one before
    ends. Each loop is there once, in one of its two directions."""
    starts, ends, twins = topology.starts, topology.ends, topology.twins
    is_regular = topology.boundary_counts <= 2
    is_regular[starts[twins == AMBIGUOUS]] = is_regular[ends[twins == AMBIGUOUS]] = False
    forward = np.flatnonzero((starts < ends) & (twins >= 0) & is_regular[starts] & is_regular[ends])
    keys = encode_pairs(starts[forward], ends[forward], topology.vertex_count)
    order = np.argsort(keys)
    forward, keys = forward[order], keys[order]
    degrees = np.bincount(starts[forward], minlength=topology.vertex_count)
    counts = degrees[ends[forward]]
    first = np.repeat(forward, counts)
    second = forward[concatenate_ranges((np.cumsum(degrees) - degrees)[ends[forward]], counts)]
    closing = encode_pairs(starts[first], ends[second], topology.vertex_count)
    rows = np.minimum(np.searchsorted(keys, closing), len(keys) - 1)
    is_loop = keys[rows] == closing
    first, second, third = first[is_loop], second[is_loop], twins[forward[rows[is_loop]]]
    is_triangle = [ends[topology.next(side)] == starts[third] for side in (first, twins[first])]
    return np.stack([first, second, third])[:, ~is_triangle[0] & ~is_triangle[1]].astype(np.int32)


def choose_tunnels(topology: Topology, loops: np.ndarray, sizes: np.ndarray, max_count: int) -> np.ndarray:
    """Return some of `loops` (3, L) without common vertices, along all of which the surface can be cut without falling apart: up to
    `max_count`, those with the smallest `sizes` (L,) first."""
    vertices = topology.starts[loops]
    numbers = np.bitwise_xor.reduce(_number_cuts(topology)[loops], axis=0)
    is_taken = np.zeros(topology.vertex_count, bool)
    basis: dict[int, int] = {}  # numbers of chosen loops, reduced by those before, by their highest bit
    chosen = []
    for index in np.argsort(sizes, kind="stable"):
        number = 0 if is_taken[vertices[:, index]].any() else int(numbers[index])
        while number.bit_length() in basis:
            number ^= basis[number.bit_length()]
        if number and len(chosen) < max_count:
            basis[number.bit_length()] = number
            is_taken[vertices[:, index]] = True
            chosen.append(index)
    return loops[:, chosen]


def _number_cuts(topology: Topology) -> np.ndarray:
    """Return random numbers (3 T,) uint64 of halfedges, the same for both of an edge: the exclusive or of those of some edges is 0 if a cut
    along all of them divides the surface, and hardly ever otherwise.

    After Pritchard and Thurimella, "Fast Computation of Small Cuts via Cycle Space Sampling", 2011, in the graph whose nodes are triangles.
    """
    count, twins = topology.triangle_count, topology.twins
    halfedges = np.flatnonzero(twins > np.arange(len(twins)))
    numbers = np.zeros(len(twins), np.uint64)
    numbers[halfedges] = np.random.default_rng(0).integers(0, np.iinfo(np.uint64).max, len(halfedges), np.uint64, endpoint=True)
    numbers[twins[halfedges]] = numbers[halfedges]
    pairs = np.stack([halfedges % count, twins[halfedges] % count])
    graph = coo_array((np.ones(len(halfedges), bool), pairs), shape=(count, count))
    roots = np.unique(connected_components(graph, directed=False)[1], return_index=True)[1]
    pairs = np.concatenate([pairs, np.stack([np.full(len(roots), count), roots])], axis=1)  # One more node connects all components.
    graph = coo_array((np.ones(pairs.shape[1], bool), pairs), shape=(count + 1, count + 1)).tocsr()
    order, parents = breadth_first_order(graph, count, directed=False)
    children = order[1:][parents[order[1:]] < count]
    sides = twins.reshape(3, count)[:, children]
    upward = ((sides >= 0) & (sides % count == parents[children])).argmax(axis=0) * count + children
    numbers[upward] = numbers[twins[upward]] = 0
    sums = np.bitwise_xor.reduce(numbers.reshape(3, count), axis=0).tolist()
    for child, parent in zip(children[::-1].tolist(), parents[children[::-1]].tolist(), strict=True):
        sums[parent] ^= sums[child]
    numbers[upward] = numbers[twins[upward]] = np.array(sums, np.uint64)[children]
    return numbers


def find_side(topology: Topology, loops: np.ndarray) -> np.ndarray:
    """Return the corners (N,) on one side of `loops` (3, L), which must become others of their own if the surface is cut there: at each
    vertex those on the left, or on the right if a boundary is between those on the left."""
    leaving, arriving = loops.reshape(-1), np.roll(loops, 1, axis=0).reshape(-1)
    corners, owners, is_divided = _walk(topology, leaving, arriving)
    others, _, _ = _walk(topology, topology.twins[arriving[is_divided]], topology.twins[leaving[is_divided]])
    return np.concatenate([corners[~is_divided[owners]], others])


def _walk(topology: Topology, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the corners (P,) around vertices, from halfedges `first` (N,) that begin there to the triangles of those of `last` (N,) that
    end there, the rows (P,) of these, and at which a boundary comes before, (N,) bool."""
    is_divided = np.zeros(len(first), bool)
    corners, rows = first, np.arange(len(first))
    result, owners = [corners[:0]], [rows[:0]]
    while len(corners):
        result.append(corners)
        owners.append(rows)
        preceding = topology.previous(corners)
        is_between = preceding != last[rows]
        corners, rows = topology.twins[preceding[is_between]], rows[is_between]
        is_divided[rows[corners < 0]] = True
        corners, rows = corners[corners >= 0], rows[corners >= 0]
    return np.concatenate(result), np.concatenate(owners), is_divided


def list_sides(topology: Topology, loops: np.ndarray) -> np.ndarray:
    """Return the holes (3, 2 L) that a cut along `loops` (3, L) leaves on their left, then on their right."""
    return np.concatenate([loops[[0, 2, 1]], topology.twins[loops]], axis=1)
