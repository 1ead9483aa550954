"""The borders of charts: loops of edges that belong to one triangle only."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..spatial import keys_of


def border_edges(triangles: np.ndarray) -> np.ndarray:
    """Edges (B, 2) of one triangle only, from start to end as their triangles go round: the inside is to the left."""
    starts, ends = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    keys = keys_of(starts, ends, int(triangles.max(initial=-1)) + 1)
    order = np.argsort(keys)
    new = np.append(np.diff(keys[order], prepend=-1) != 0, True)
    alone = np.sort(order[new[:-1] & new[1:]])
    return np.stack([starts[alone], ends[alone]], axis=1)


def border_loops(triangles: np.ndarray, vertices: np.ndarray) -> list[np.ndarray]:
    """The loops of a mesh's border, each the numbers of its vertices in order, the longest on the surface first.

    triangles: (T, 3) of `vertices` (V, 3), in which no vertex belongs to two loops.
    """
    edges = border_edges(triangles)
    following = np.full(len(vertices), -1)
    following[edges[:, 0]] = edges[:, 1]
    count, label = connected_components(coo_array((np.ones(len(edges), bool), tuple(edges.T)), shape=(len(vertices),) * 2), directed=False)
    lengths = np.bincount(label[edges[:, 0]], np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1), count)
    first = np.full(count, -1)
    first[label[edges[::-1, 0]]] = edges[::-1, 0]
    return [_loop(following, int(first[number])) for number in np.argsort(-lengths, kind="stable") if first[number] >= 0]


def _loop(following: np.ndarray, start: int) -> np.ndarray:
    found = [start]
    while following[found[-1]] != start:
        found.append(int(following[found[-1]]))
    return np.array(found)


def filled(vertices: np.ndarray, triangles: np.ndarray, holes: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with a further vertex in the middle of each of `holes`, loops of its border, and further triangles from there to the rim."""
    middles = [vertices[hole].mean(axis=0)[None] for hole in holes]
    fans = [np.column_stack([np.roll(hole, -1), hole, np.full(len(hole), len(vertices) + number)]) for number, hole in enumerate(holes)]
    return np.concatenate([vertices, *middles]), np.concatenate([triangles, *fans]).astype(np.int32)
