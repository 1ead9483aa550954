"""Decimates a mesh by batches of independent halfedge collapses, so that it can be parameterized with few triangles and then refined.

A collapse moves a vertex into one of its neighbors. Other vertices never move, so the vertices of every coarser mesh are vertices of the
finest one. The collapses of a batch share no triangle and are undone together: a vertex is inserted into the polygon that its triangles
had left (Hormann, Greiner, Campagna: Hierarchical parametrization of triangulated surfaces, 1999).
"""

from dataclasses import dataclass

import numpy as np

from ...geometry.collapses import creates_existing_edge, creates_repeated_edge, measure_quality, select_independent
from ...geometry.edges import Edges, find_edges
from ...geometry.proximity import encode_pairs
from ...jobs.chunks import map_chunks
from ...jobs.progress import Progress, Steps, subprogress

MAX_VALENCE = 10  # Vertices with more triangles around them are not removed.
MIN_QUALITY = 0.05  # Triangles are no thinner after a collapse; 1 is equilateral.
MIN_NORMAL_COSINE = 0.2  # Cosine between the normals of a triangle before and after a collapse.
CANDIDATE_FRACTION, MIN_CANDIDATES = 0.7, 64  # The cheapest of all collapses, which a batch tests.
MAX_JITTER = 3.0  # Largest random factor of the squared length.
SELECTION_PASSES = 3
CHUNK_SIZE = 1 << 14  # collapses


@dataclass(frozen=True)
class CollapseBatch:
    """N collapses that are performed together.

    triangles (T, 3) int32: the mesh before the collapses. removed (N,), kept (N,) int32: the removed vertices and the neighbors that they
    were moved into. links (N, L, 2) int32: links of the removed vertices, see `vertex_links`.
    """

    triangles: np.ndarray
    removed: np.ndarray
    kept: np.ndarray
    links: np.ndarray

    def subset(self, rows: slice) -> "CollapseBatch":
        """Return the batch with some of the collapses; they do not depend on each other."""
        return CollapseBatch(self.triangles, self.removed[rows], self.kept[rows], self.links[rows])


def decimate(
    vertices: np.ndarray, triangles: np.ndarray, target: int, is_kept: np.ndarray
) -> Steps[tuple[np.ndarray, list[CollapseBatch]]]:
    """Decimate a mesh to about `target` vertices; return its triangles and the batches in order.

    Ends early where no collapse is left that preserves shape and topology.

    Args:
        vertices: (V, 3) float64.
        triangles: (T, 3) int32, a manifold.
        is_kept: (V,) bool, vertices that are never removed.
    """
    batches: list[CollapseBatch] = []
    count = int(np.count_nonzero(np.bincount(triangles.ravel())))
    initial_count = count
    while count > target:
        fraction = (initial_count - count) / (initial_count - target)
        steps = _next_batch(vertices, triangles, is_kept, count - target, len(batches))
        batch = yield from subprogress(steps, fraction, fraction)
        if len(batch.removed) == 0:
            break
        batches.append(batch)
        triangles = _apply(batch)
        count -= len(batch.removed)
    return triangles, batches


def vertex_links(triangles: np.ndarray, selected: np.ndarray, vertex_count: int) -> np.ndarray:
    """Return the links (N, L, 2) of the vertices `selected` (N,): the edges opposite to them in their triangles, counter-clockwise.

    -1 where a vertex has fewer than L triangles.
    """
    index = np.full(vertex_count, -1)
    index[selected] = np.arange(len(selected))
    corners = np.flatnonzero(index[triangles.ravel()] >= 0)
    owner = index[triangles.ravel()[corners]]
    order = np.argsort(owner, kind="stable")
    corners, owner = corners[order], owner[order]
    slot = np.arange(len(owner)) - np.searchsorted(owner, owner)
    links = np.full((len(selected), int(slot.max(initial=0)) + 1, 2), -1, np.int32)
    triangle, corner = corners // 3, corners % 3
    links[owner, slot, 0] = triangles[triangle, (corner + 1) % 3]
    links[owner, slot, 1] = triangles[triangle, (corner + 2) % 3]
    return links


def _next_batch(vertices: np.ndarray, triangles: np.ndarray, is_kept: np.ndarray, max_count: int, seed: int) -> Steps[CollapseBatch]:
    """Return the next batch, of at most `max_count` collapses.

    Random priorities keep rows of similar vertices from waiting for each other.
    """
    progress = Progress(0.0, "Decimating")
    yield progress
    edges = find_edges(triangles, len(vertices))
    yield progress
    removed, kept, squared_lengths = _candidates(vertices, triangles, is_kept, edges)
    yield progress
    priority = squared_lengths * np.random.default_rng(seed).uniform(1.0, MAX_JITTER, len(squared_lengths))
    order = np.argsort(priority, kind="stable")
    order = order[: max(int(CANDIDATE_FRACTION * len(order)), min(len(order), MIN_CANDIDATES))]
    removed, kept = removed[order], kept[order]
    corners = np.ascontiguousarray(triangles.T, np.intp)
    independent = select_independent(removed, np.arange(len(removed)), corners, len(vertices), SELECTION_PASSES)
    selected = np.flatnonzero(np.isin(removed, independent))
    removed, kept = removed[selected], kept[selected]
    yield progress
    links = vertex_links(triangles, removed, len(vertices))
    yield progress
    is_valid = map_chunks(
        lambda rows: _is_valid(vertices, edges, links[rows], removed[rows], kept[rows]), np.arange(len(removed)), CHUNK_SIZE
    )
    yield progress
    selected = np.flatnonzero(is_valid)[:max_count]
    selected = selected[~creates_repeated_edge(*_new_edges(links[selected], kept[selected], edges), len(selected))]
    return CollapseBatch(triangles, removed[selected].astype(np.int32), kept[selected].astype(np.int32), links[selected])


def _apply(batch: CollapseBatch) -> np.ndarray:
    """Return the triangles (T', 3) after the collapses of a batch."""
    new_index = np.arange(int(batch.triangles.max()) + 1, dtype=np.int32)
    new_index[batch.removed] = batch.kept
    triangles = new_index[batch.triangles]
    return triangles[(triangles != np.roll(triangles, -1, axis=1)).all(axis=1)]


def _candidates(
    vertices: np.ndarray, triangles: np.ndarray, is_kept: np.ndarray, edges: Edges
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the shortest halfedge of every removable vertex: the vertex (C,), its neighbor (C,), the squared length (C,).

    Boundary vertices only move along the boundary.
    """
    valence = np.bincount(triangles.ravel(), minlength=edges.vertex_count)
    removed, kept = np.concatenate([edges.ends, edges.ends[:, ::-1]]).T
    is_candidate = (valence[removed] <= MAX_VALENCE) & ~is_kept[removed]
    is_candidate &= np.tile(edges.face_counts == 1, 2) | ~edges.boundary_vertices[removed]
    removed, kept = removed[is_candidate], kept[is_candidate]
    squared_lengths = ((vertices[removed] - vertices[kept]) ** 2).sum(axis=1)
    order = np.argsort(squared_lengths, kind="stable")
    _, first = np.unique(removed[order], return_index=True)
    return removed[order[first]], kept[order[first]], squared_lengths[order[first]]


def _is_valid(vertices: np.ndarray, edges: Edges, links: np.ndarray, removed: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Return which collapses (C,) bool preserve the topology, fold no triangle over and create no new sliver."""
    is_used = links[:, :, 0] >= 0
    remains = is_used & (links != kept[:, None, None]).all(axis=2)
    old, new = (_fan(vertices, links, center) for center in (removed, kept))
    old_quality, new_quality = (
        measure_quality(np.sqrt(np.einsum("csk,csk->cs", normals, normals)), squares) for squares, normals in (old, new)
    )
    dots = np.einsum("csk,csk->cs", old[1], new[1])
    lengths = np.sqrt(np.einsum("csk,csk->cs", old[1], old[1]) * np.einsum("csk,csk->cs", new[1], new[1]))
    min_quality = np.minimum(MIN_QUALITY, np.where(is_used, old_quality, 1.0).min(axis=1))
    is_good = ~remains | ((dots >= MIN_NORMAL_COSINE * lengths) & (new_quality >= min_quality[:, None]))
    breaks_topology = creates_existing_edge(*_new_edges(links, kept, edges), edges.keys, len(kept))
    return is_good.all(axis=1) & remains.any(axis=1) & ~breaks_topology


def _fan(vertices: np.ndarray, links: np.ndarray, centers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return sums of squared side lengths (C, L) and normals (C, L, 3), twice the area long, of the triangles from `centers` to `links`."""
    center = vertices[centers][:, None]
    first, second = vertices[links[:, :, 0]] - center, vertices[links[:, :, 1]] - center
    opposite = second - first
    return sum(np.einsum("csk,csk->cs", side, side) for side in (first, second, opposite)), np.cross(first, second)


def _new_edges(links: np.ndarray, kept: np.ndarray, edges: Edges) -> tuple[np.ndarray, np.ndarray]:
    """Return pairs of a collapse and the key of an edge that it creates: to a vertex that was no neighbor of the kept one in the star."""
    contains_kept = (links == kept[:, None, None]).any(axis=2)
    neighbors = np.where(contains_kept[:, :, None], links, -1).reshape(len(links), 2 * links.shape[1])
    known = np.sort(neighbors, axis=1)[:, -4:]  # the kept vertex at most twice, and its neighbors on the link
    collapse, slot, end = np.nonzero((links >= 0) & (links[..., None] != known[:, None, None, :]).all(axis=3))
    return collapse, encode_pairs(kept[collapse], links[collapse, slot, end], edges.vertex_count)
