"""Color corrections at vertices that make the photographs of neighboring triangles meet in the same color.

One sparse least squares over all pairs of a vertex and a photograph (Lempitsky and Ivanov, "Seamless Mosaicing of Image-Based Texture
Maps", 2007): corrections make up for the differences at the vertices between regions, and vary little within regions. It works on the
mesh, so seams of the UV map do not matter.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

from ..geometry.edges import Edges

SMOOTHNESS = 0.1  # of differences along edges, relative to those at seams
REGULARIZATION = 1e-3  # of corrections


class VertexLabels(NamedTuple):
    """Pairs of a vertex and a photograph: keys (P,) int64, ascending, vertex * photograph_count + photograph; and weights (P,) float32: the
    fraction of the vertex's triangles that use the photograph, 0 for pairs that only neighbors use."""

    keys: np.ndarray
    weights: np.ndarray
    photograph_count: int

    @property
    def vertices(self) -> np.ndarray:
        """(P,) the vertex of each pair."""
        return self.keys // self.photograph_count

    @property
    def photographs(self) -> np.ndarray:
        """(P,) the photograph of each pair."""
        return self.keys % self.photograph_count

    def find(self, vertices: np.ndarray, photograph: int) -> np.ndarray:
        """Return the indices of the pairs of `vertices`, of any shape, with a photograph; -1 where there is none."""
        keys = vertices.astype(np.int64) * self.photograph_count + photograph
        indices = np.minimum(np.searchsorted(self.keys, keys), max(len(self.keys) - 1, 0))
        return np.where(self.keys[indices] == keys, indices, -1) if len(self.keys) else np.full(vertices.shape, -1)


def find_vertex_labels(triangles: np.ndarray, labels: np.ndarray, areas: np.ndarray, photograph_count: int) -> VertexLabels:
    """Return the pairs of vertices and photographs of `triangles` (T, 3) with the given `labels` (T,), by `areas` (T,), and those of all
    corners of the triangles around them."""
    labeled = labels >= 0
    keys = triangles[labeled].astype(np.int64) * photograph_count + labels[labeled, None]
    pairs, indices = np.unique(keys, return_inverse=True)
    sums = np.bincount(indices.ravel(), np.repeat(areas[labeled], 3), len(pairs))
    totals = np.bincount(pairs // photograph_count, sums, int(triangles.max(initial=0)) + 1)
    weights = sums / np.maximum(totals[pairs // photograph_count], 1e-300)
    core = VertexLabels(pairs, weights.astype(np.float32), photograph_count)
    further = [pairs]
    for photograph in range(photograph_count):
        near = (core.find(triangles, photograph) >= 0).any(axis=1)
        further.append(np.unique(triangles[near]).astype(np.int64) * photograph_count + photograph)
    every = np.unique(np.concatenate(further))
    all_weights = np.zeros(len(every), np.float32)
    all_weights[np.searchsorted(every, pairs)] = core.weights
    return VertexLabels(every, all_weights, photograph_count)


def solve_corrections(pairs: VertexLabels, colors: np.ndarray, is_visible: np.ndarray, edges: Edges) -> np.ndarray:
    """Return the corrections (P, 3) float32 that are added to the colors of each pair.

    colors: (P, 3), what the photograph of each pair shows at its vertex, where `is_visible` (P,) bool.
    """
    count = len(pairs.keys)
    rows, columns, weights, differences = [], [], [], []
    used = np.flatnonzero(is_visible & (pairs.weights > 0.0))
    for step in range(1, pairs.photograph_count):
        first, second = used[:-step], used[step:]
        same = pairs.vertices[first] == pairs.vertices[second]
        if not same.any():
            break
        first, second = first[same], second[same]
        rows.append(first)
        columns.append(second)
        weights.append(np.ones(len(first)))
        differences.append(colors[second] - colors[first])
    for photograph in range(pairs.photograph_count):
        ends = pairs.find(edges.ends, photograph)
        ends = ends[(ends >= 0).all(axis=1)]
        rows.append(ends[:, 0])
        columns.append(ends[:, 1])
        weights.append(np.full(len(ends), SMOOTHNESS))
        differences.append(np.zeros((len(ends), 3)))
    first, second, weight = (np.concatenate(values) for values in (rows, columns, weights))
    difference = np.concatenate(differences) * weight[:, None]
    diagonal = np.bincount(first, weight, count) + np.bincount(second, weight, count) + REGULARIZATION
    right_side = np.stack(
        [np.bincount(first, difference[:, axis], count) - np.bincount(second, difference[:, axis], count) for axis in range(3)], axis=1
    )
    everything = np.arange(count)
    matrix = coo_matrix(
        (
            np.concatenate([diagonal, -weight, -weight]),
            (np.concatenate([everything, first, second]), np.concatenate([everything, second, first])),
        ),
        shape=(count, count),
    ).tocsc()
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return factor.solve(right_side).astype(np.float32)
