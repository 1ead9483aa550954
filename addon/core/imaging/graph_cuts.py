"""Minimal cuts of graphs with pairwise terms (Kolmogorov and Zabih, "What Energy Functions Can Be Minimized via Graph Cuts?", 2004)."""

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

MAX_CAPACITY = 1 << 24  # Sums of the capacities of many edges are still integers of 32 bits.


def minimize_binary(linear: np.ndarray, first: np.ndarray, second: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the variables x (N,) bool that minimize sum linear[i] x[i] + sum weights[k] (1 - x[first[k]]) x[second[k]].

    linear: (N,) float. first, second: (K,) indices of variables. weights: (K,) float, none negative. Values are rounded to integers. Of
    several minima, returns the one with the most variables set, or nothing set if no linear term is negative.
    """
    count = len(linear)
    linear = np.rint(np.clip(linear, -MAX_CAPACITY, MAX_CAPACITY)).astype(np.int32)
    weights = np.rint(np.minimum(weights, MAX_CAPACITY)).astype(np.int32)
    positive, negative = np.flatnonzero(linear > 0), np.flatnonzero(linear < 0)
    if not len(negative):
        return np.zeros(count, bool)
    source, sink = count, count + 1
    used = weights > 0
    rows = np.concatenate([first[used], np.full(len(positive), source), negative])
    columns = np.concatenate([second[used], positive, np.full(len(negative), sink)])
    capacities = np.concatenate([weights[used], linear[positive], -linear[negative]])
    graph = csr_matrix((capacities, (rows, columns)), shape=(count + 2, count + 2))
    residual = graph - maximum_flow(graph, source, sink).flow
    residual.data = (residual.data > 0).astype(np.int8)
    residual.eliminate_zeros()
    result = np.ones(count + 2, bool)
    result[breadth_first_order(residual, source, return_predecessors=False)] = False
    return result[:count]
