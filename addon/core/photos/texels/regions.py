"""Regions of triangles from one photograph each, and the colors of vertices with which these regions meet.

The choice of a photograph for each triangle minimizes the sum of how much worse than the best each is, and of a penalty per pair of
neighbors with different photographs, by loopy belief propagation. Colors are then corrected at vertices by one sparse least squares over
all pairs of a vertex and a photograph: corrections make up for the differences at the vertices between regions, and vary little within
regions. It works on the mesh, so seams of the UV map do not matter (both as in Lempitsky and Ivanov, "Seamless Mosaicing of Image-Based
Texture Maps", 2007).
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import splu

from ...files.scratch import Scratch
from ...geometry.edges import Edges
from ...jobs.progress import Progress, Steps
from ..photographs.color_correction import ColorCorrection
from ..photographs.photograph import Photograph
from ..photographs.surface import Surface
from ..photographs.views import View

FACE_SAMPLES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])  # barycentric
LABEL = "Choosing photographs"
ITERATIONS = 60
DAMPING = 0.5
LABEL_PENALTY = 0.6  # for neighbors with different photographs; the loss of a photograph with half the resolution is 1
SMOOTHNESS = 0.1  # weight of differences of corrections along edges, relative to those at seams
REGULARIZATION = 1e-3  # weight of the corrections themselves


def rate_faces(surface: Surface, views: list[View], scratch: Scratch) -> Steps[np.ndarray]:
    """Return how well (T, K) float32 each of `views` shows each triangle, 0 if not all of it; `scratch` keeps their images."""
    samples = [surface.locate(barycentric) for barycentric in FACE_SAMPLES]
    qualities = np.zeros((len(surface.areas), len(views)), np.float32)
    for index, view in enumerate(views):
        yield Progress(index / len(views), LABEL)
        counts = np.zeros(len(qualities), np.int32)
        for points, normals in samples:
            seen = view.see(points, normals)
            counts[seen.indices] += 1
            qualities[seen.indices, index] += seen.weights / np.float32(len(FACE_SAMPLES))
        qualities[counts < len(FACE_SAMPLES), index] = 0.0
        scratch.release(index)
    return qualities


def choose_labels(qualities: np.ndarray, edges: Edges) -> Steps[np.ndarray]:
    """Return the photograph (T,) int32 of each triangle, -1 where none sees it.

    qualities: (T, K) float, how well each photograph shows each triangle, 0 where it does not.
    """
    best = qualities.max(axis=1, initial=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        losses = np.where(qualities > 0.0, np.log2(best[:, None] / qualities), np.inf)
    losses = np.where(np.isfinite(losses), np.minimum(losses, 20.0), 40.0)
    losses[best <= 0.0] = 0.0
    halfedges = edges.interior_halfedges // 3
    to, back = halfedges.T[::-1].ravel(), halfedges.T.ravel()
    reverse = np.roll(np.arange(len(to)), len(halfedges))
    messages = np.zeros((len(to), qualities.shape[1]), np.float32)
    order = np.argsort(to, kind="stable")
    starts = np.searchsorted(to[order], np.arange(len(qualities) + 1))
    for iteration in range(ITERATIONS):
        yield Progress(iteration / ITERATIONS, LABEL)
        outgoing = _beliefs(losses, messages, order, starts)[back] - messages[reverse]
        outgoing = np.minimum(outgoing, outgoing.min(axis=1, keepdims=True) + LABEL_PENALTY)
        outgoing -= outgoing.min(axis=1, keepdims=True)
        change = float(np.abs(outgoing - messages).max(initial=0.0))
        messages += (1.0 - DAMPING) * (outgoing - messages)
        if change < 0.01:
            break
    labels = _beliefs(losses, messages, order, starts).argmin(axis=1)
    return np.where(best > 0.0, labels, -1).astype(np.int32)


def _beliefs(losses: np.ndarray, messages: np.ndarray, order: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return the losses (T, K) plus the sums of the messages to each triangle."""
    sums = np.concatenate([np.zeros((1, messages.shape[1])), np.cumsum(messages[order], axis=0, dtype=np.float64)])
    return losses + (sums[starts[1:]] - sums[starts[:-1]])


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


class VertexColors(NamedTuple):
    """Encoded colors of vertices.

    colors: (V, 3), 0 where no photograph shows the vertex. bound: (V,) bool, where one does. corrections: (P, 3) float32, which are added
    to the colors of the photograph of each of P pairs of a vertex and a photograph.
    """

    colors: np.ndarray
    bound: np.ndarray
    corrections: np.ndarray


def color_vertices(
    surface: Surface,
    pairs: VertexLabels,
    photographs: list[Photograph],
    views: list[View],
    color_corrections: list[ColorCorrection],
    scratch: Scratch,
    *,
    is_leveled: bool,
) -> Steps[VertexColors]:
    """Return the colors of vertices, from the photographs of the regions around them or otherwise from all that show them; `is_leveled`:
    corrected at the borders of regions so that these meet in the same color."""
    count = len(surface.mesh.vertices)
    corrections = np.zeros((len(pairs.keys), 3), np.float32)
    pair_colors, is_visible = np.zeros((len(pairs.keys), 3), np.float32), np.zeros(len(pairs.keys), bool)
    sums, weights = np.zeros((count, 3)), np.zeros(count)
    for index, (photograph, view, correction) in enumerate(zip(photographs, views, color_corrections, strict=True)):
        yield Progress(index / len(views), LABEL)
        seen = view.see(surface.mesh.vertices, surface.normals)
        smooth, is_seen = np.zeros((count, 3), np.float32), np.zeros(count, bool)
        smooth[seen.indices] = correction.apply(photograph.smoothed().sample(seen.positions), seen.positions)
        is_seen[seen.indices] = True
        sums[seen.indices] += seen.weights[:, None] * smooth[seen.indices]
        weights[seen.indices] += seen.weights
        own = np.flatnonzero(pairs.photographs == index)
        pair_colors[own], is_visible[own] = smooth[pairs.vertices[own]], is_seen[pairs.vertices[own]]
        scratch.release(index)
    if is_leveled and len(pairs.keys):
        corrections = solve_corrections(pairs, pair_colors, is_visible, surface.edges)
    colors = np.where(weights[:, None] > 0.0, sums / np.maximum(weights, 1e-30)[:, None], 0.0)
    shown = pairs.weights * is_visible
    totals = np.bincount(pairs.vertices, shown, count)
    has_label = totals > 0.5
    for channel in range(3):
        leveled = np.bincount(pairs.vertices, shown * (pair_colors + corrections)[:, channel], count)
        colors[has_label, channel] = leveled[has_label] / totals[has_label]
    return VertexColors(colors, weights > 0.0, corrections)


def solve_corrections(pairs: VertexLabels, colors: np.ndarray, is_visible: np.ndarray, edges: Edges) -> np.ndarray:
    """Return the corrections (P, 3) float32 that are added to the colors of each pair.

    colors: (P, 3), what the photograph of each pair shows at its vertex, where `is_visible` (P,) bool.
    """
    count = len(pairs.keys)
    comparisons = []
    used = np.flatnonzero(is_visible & (pairs.weights > 0.0))
    for step in range(1, pairs.photograph_count):
        first, second = used[:-step], used[step:]
        same = pairs.vertices[first] == pairs.vertices[second]
        if not same.any():
            break
        first, second = first[same], second[same]
        comparisons.append((first, second, np.ones(len(first)), colors[second] - colors[first]))
    for photograph in range(pairs.photograph_count):
        ends = pairs.find(edges.ends, photograph)
        ends = ends[(ends >= 0).all(axis=1)]
        comparisons.append((*ends.T, np.full(len(ends), SMOOTHNESS), np.zeros((len(ends), 3))))
    first, second, weight, difference = (np.concatenate(values) for values in zip(*comparisons, strict=True))
    weighted = (difference * weight[:, None]).T
    right_side = np.stack([np.bincount(first, each, count) - np.bincount(second, each, count) for each in weighted], axis=1)
    links = coo_matrix((weight, (first, second)), shape=(count, count))
    diagonal = np.bincount(first, weight, count) + np.bincount(second, weight, count) + REGULARIZATION
    factor = splu((diags(diagonal) - links - links.T).tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    return factor.solve(right_side).astype(np.float32)
