"""Tunnels: closed curves on a surface along which it can be cut without falling apart, such as those around holes through a part.

Half-edge collapses keep the genus of a surface. They shorten a tunnel to a loop of three edges that are no triangle, and stop there, because
each further collapse would make an edge that exists. A cut along the loop, and a triangle on each side of it, close the tunnel. A loop
around a thin neck divides the surface, and is no tunnel: what is on one side of it collapses to one vertex.
"""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from ...arrays import concatenate_ranges
from ...geometry.proximity import encode_pairs
from .topology import AMBIGUOUS, Topology


def find_loops(topology: Topology) -> np.ndarray:
    """Return all loops of three edges that are no triangle, away from boundaries: (3, L) halfedges, each beginning where the one before
    ends. Each loop is there once, in one of its two directions."""
    starts, ends, twins = topology.starts, topology.ends, topology.twins
    is_inside = topology.boundary_counts == 0
    is_inside[starts[twins == AMBIGUOUS]] = is_inside[ends[twins == AMBIGUOUS]] = False
    forward = np.flatnonzero((starts < ends) & is_inside[starts] & is_inside[ends])
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


def find_left_corners(topology: Topology, loops: np.ndarray) -> np.ndarray:
    """Return the corners (N,) at the vertices of `loops` (3, L) of the triangles to the left of these."""
    corners, last = loops.reshape(-1), np.roll(loops, 1, axis=0).reshape(-1)
    result = [corners[:0]]
    while len(corners):
        result.append(corners)
        preceding = topology.previous(corners)
        is_inside = preceding != last
        corners, last = topology.twins[preceding[is_inside]], last[is_inside]
    return np.concatenate(result)
