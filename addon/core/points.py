"""What a bare point cloud lacks: consistently oriented normals and the radii of the discs that close its surface."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

CHUNK_POINTS = 65_536


def estimate_normals(points: np.ndarray, neighbours: int = 16) -> np.ndarray:
    """Unit normals (N, 3) float64 of the surface that `points` (N, 3) sample.

    Each normal is the direction of least variance of the nearest `neighbours`. Signs agree along the spanning tree of least turning
    (after Hoppe et al.), and point away from the centroid at the farthest point of every connected part.
    """
    near = _nearest(points, neighbours)[1]
    normals = np.empty((len(points), 3))
    for start in range(0, len(points), CHUNK_POINTS):
        chunk = slice(start, start + CHUNK_POINTS)
        patches = points[near[chunk]]
        patches = patches - patches.mean(axis=1, keepdims=True)
        scale = np.abs(patches).max(axis=(1, 2), keepdims=True)
        patches /= np.where(scale > 0.0, scale, 1.0)
        normals[chunk] = np.linalg.eigh(np.einsum("nki,nkj->nij", patches, patches))[1][:, :, 0]
    return normals * _signs(points, normals, near)[:, None]


def splat_radii(points: np.ndarray, neighbours: int = 8) -> np.ndarray:
    """Radii (N,) float64, in the unit of `points` (N, 3), of discs that close the surface between evenly spread neighbours.

    With d the distance to the last of the neighbours, d / sqrt(neighbours) is the mean spacing; its half diagonal covers a square grid.
    """
    distances = _nearest(points, neighbours)[0]
    count = max(distances.shape[1] - 1, 1)
    radii = distances[:, -1] * np.sqrt(2.0 / count)
    positive = radii[radii > 0.0]
    return np.maximum(radii, positive.min() if len(positive) else 0.0)


def _nearest(points: np.ndarray, neighbours: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances and indices (N, K + 1) of every point's nearest points, itself among them; K is less in a smaller cloud."""
    count = min(neighbours + 1, len(points))
    distances, near = cKDTree(points).query(points, k=count)
    return distances.reshape(len(points), count), near.reshape(len(points), count)


def _signs(points: np.ndarray, normals: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Signs (N,) +-1 that make `normals` (N, 3) agree along the tree of least turning over the neighbours `near` (N, K)."""
    count = len(points)
    start, stop = np.repeat(np.arange(count), near.shape[1]), near.ravel()
    linked = start != stop
    start, stop = start[linked], stop[linked]
    turning = 1.0 - np.abs(np.einsum("ij,ij->i", normals[start], normals[stop]))
    cheapest = np.lexsort((turning, np.maximum(start, stop), np.minimum(start, stop)))
    low, high = np.minimum(start, stop)[cheapest], np.maximum(start, stop)[cheapest]
    once = np.flatnonzero((np.diff(low, prepend=-1) != 0) | (np.diff(high, prepend=-1) != 0))
    # A stored zero would count as no edge at all.
    weights = np.maximum(turning[cheapest][once], 1e-9)
    tree = minimum_spanning_tree(coo_matrix((weights, (low[once], high[once])), shape=(count, count))).tocoo()
    parts = connected_components(tree, directed=False)[1]
    outward = points - _part_centroids(points, parts)
    roots = _outermost(outward, parts)
    rows, columns = np.append(tree.row, np.full(len(roots), count)), np.append(tree.col, roots)
    rooted = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count + 1, count + 1))
    parent = breadth_first_order(rooted.tocsr(), count, directed=False)[1]
    parent[count] = count
    along = np.vstack([normals, np.zeros(3)])
    signs = np.where(np.einsum("ij,ij->i", along, along[parent]) < 0.0, -1.0, 1.0)
    signs[roots] = np.where(np.einsum("ij,ij->i", normals[roots], outward[roots]) < 0.0, -1.0, 1.0)
    while (parent != count).any():
        signs, parent = signs * np.where(parent == count, 1.0, signs[parent]), parent[parent]
    return signs[:count]


def _part_centroids(points: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """(N, 3) centroid of the connected part of every point."""
    sums = np.stack([np.bincount(parts, points[:, axis]) for axis in range(3)], axis=1)
    return (sums / np.bincount(parts)[:, None])[parts]


def _outermost(outward: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Index of the point of every part that is farthest from the part's centroid; `outward` (N, 3) leads from there to each point."""
    ranked = np.lexsort((-np.linalg.norm(outward, axis=1), parts))
    return ranked[np.flatnonzero(np.diff(parts[ranked], prepend=-1))]
