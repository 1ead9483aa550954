"""Attributes that a bare point cloud lacks: consistently oriented normals, and radii of discs that close its surface."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from ..jobs.chunks import slices

CHUNK_POINTS = 65_536


def estimate_normals(points: np.ndarray, neighbors: int = 16) -> np.ndarray:
    """Return unit normals (N, 3) float64 of the surface sampled by `points` (N, 3).

    Each normal is the direction of least variance of the nearest `neighbors`. Signs agree along the spanning tree of least normal
    variation (after Hoppe et al.), and point away from the centroid at the farthest point of every connected component.
    """
    nearest = _nearest(points, neighbors)[1]
    normals = np.empty((len(points), 3))
    for chunk in slices(len(points), CHUNK_POINTS):
        patches = points[nearest[chunk]]
        patches = patches - patches.mean(axis=1, keepdims=True)
        scale = np.abs(patches).max(axis=(1, 2), keepdims=True)
        patches /= np.where(scale > 0.0, scale, 1.0)
        normals[chunk] = np.linalg.eigh(np.einsum("nki,nkj->nij", patches, patches))[1][:, :, 0]
    return normals * _orientation_signs(points, normals, nearest)[:, None]


def splat_radii(points: np.ndarray, neighbors: int = 8) -> np.ndarray:
    """Return radii (N,) float64, in the unit of `points` (N, 3), of discs that close the surface between evenly spaced neighbors.

    With d the distance to the last of the neighbors, d / sqrt(neighbors) is the mean spacing; its half diagonal covers a square grid.
    """
    distances = _nearest(points, neighbors)[0]
    count = max(distances.shape[1] - 1, 1)
    radii = distances[:, -1] * np.sqrt(2.0 / count)
    positive = radii[radii > 0.0]
    return np.maximum(radii, positive.min() if len(positive) else 0.0)


def _nearest(points: np.ndarray, neighbors: int) -> tuple[np.ndarray, np.ndarray]:
    """Return distances and indices (N, K + 1) of every point's nearest points, itself included; K is smaller in a smaller cloud."""
    count = min(neighbors + 1, len(points))
    distances, nearest = cKDTree(points).query(points, k=count)
    return distances.reshape(len(points), count), nearest.reshape(len(points), count)


def _orientation_signs(points: np.ndarray, normals: np.ndarray, nearest: np.ndarray) -> np.ndarray:
    """Return signs (N,) +-1 that make `normals` (N, 3) agree along the tree of least variation over the neighbors `nearest` (N, K)."""
    count = len(points)
    start, stop = np.repeat(np.arange(count), nearest.shape[1]), nearest.ravel()
    is_link = start != stop
    start, stop = start[is_link], stop[is_link]
    variation = 1.0 - np.abs(np.einsum("ij,ij->i", normals[start], normals[stop]))
    order = np.lexsort((variation, np.maximum(start, stop), np.minimum(start, stop)))
    low, high = np.minimum(start, stop)[order], np.maximum(start, stop)[order]
    unique = np.flatnonzero((np.diff(low, prepend=-1) != 0) | (np.diff(high, prepend=-1) != 0))
    weights = np.maximum(variation[order][unique], 1e-9)  # a stored zero would not count as an edge
    tree = minimum_spanning_tree(coo_matrix((weights, (low[unique], high[unique])), shape=(count, count))).tocoo()
    components = connected_components(tree, directed=False)[1]
    outward = points - _component_centroids(points, components)
    roots = _outermost(outward, components)
    rows, columns = np.append(tree.row, np.full(len(roots), count)), np.append(tree.col, roots)
    rooted = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count + 1, count + 1))
    parent = breadth_first_order(rooted.tocsr(), count, directed=False)[1]
    parent[count] = count
    padded = np.vstack([normals, np.zeros(3)])
    signs = np.where(np.einsum("ij,ij->i", padded, padded[parent]) < 0.0, -1.0, 1.0)
    signs[roots] = np.where(np.einsum("ij,ij->i", normals[roots], outward[roots]) < 0.0, -1.0, 1.0)
    while (parent != count).any():  # pointer jumping: the product of the signs up to the root
        signs, parent = signs * np.where(parent == count, 1.0, signs[parent]), parent[parent]
    return signs[:count]


def _component_centroids(points: np.ndarray, components: np.ndarray) -> np.ndarray:
    """Return the (N, 3) centroid of every point's connected component."""
    sums = np.stack([np.bincount(components, points[:, axis]) for axis in range(3)], axis=1)
    return (sums / np.bincount(components)[:, None])[components]


def _outermost(outward: np.ndarray, components: np.ndarray) -> np.ndarray:
    """Return the index of every component's point farthest from its centroid; `outward` (N, 3) are the offsets from the centroids."""
    order = np.lexsort((-np.linalg.norm(outward, axis=1), components))
    return order[np.flatnonzero(np.diff(components[order], prepend=-1))]
