"""Zero crossings on a mesh, traced from coarse scales to the place of the structure that causes them.

A crossing moves away from its structure as the scale grows: the crossings next to a crease are one standard deviation from it. So each is
traced to the nearest one of the finer scale, and so on to the mesh, as in Witkin, "Scale-Space Filtering" (1983): a feature is identified
at a coarse scale and localized at the finest. There, a feature of the shape is the vertex with the strongest curvature among the one found
and its neighbors. Of several features that are closer together than their scale can tell apart, one persists.

The scale map has for each vertex the last scale at which it is a feature (section III.A of the TexMesh paper).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...geometry.edges import Edges

ROUNDING = 1e-6  # strength, relative to the range of the signal, of what owes its sign to rounding
MAX_NEIGHBORS, MAX_HALVINGS = 64, 40  # Neighbors of a point on average; the radius is halved until there are no more.


class FeatureTracer:
    """Finds the features of one scale after the other, in ascending order.

    features: what has been found. contrasts: (V,) largest difference of a signal at scale 0 to a neighbor.
    """

    def __init__(self, positions: np.ndarray, edges: Edges, raw: np.ndarray, noise: float) -> None:
        """positions: (V, 3). raw: (V, S) signals at scale 0, the first of which is curvature. noise: strength of the weakest feature."""
        self._positions, self._edges, self._noise = positions, edges, noise
        start, end = edges.ends.T
        self._lengths = np.linalg.norm(positions[start] - positions[end], axis=1)
        self.contrasts = _find_contrasts(raw, edges)
        self.features = LastFeatures(self.contrasts)
        self._curvature_peaks = _find_neighborhood_peaks(np.abs(raw[:, 0]), edges)
        self._finer: list[tuple[np.ndarray, np.ndarray]] = [(np.empty(0, np.int64),) * 2] * raw.shape[1]

    def add(self, scale: int, laplacians: np.ndarray) -> None:
        """Add the zero crossings of `laplacians` (V, S) as features of `scale`. Their gradients are the strengths."""
        origins, strengths = [], []
        for index, laplacian in enumerate(laplacians.T):
            vertices, strength = _find_crossings(laplacian, self._edges, self._lengths)
            origin = self._trace(index, vertices)
            self._finer[index] = (vertices, origin)
            is_strong = strength > self._noise
            origins.append(origin[is_strong])
            strengths.append(strength[is_strong])
        self.features.add(scale, np.concatenate(origins), np.concatenate(strengths))

    def _trace(self, index: int, vertices: np.ndarray) -> np.ndarray:
        """Return where the features of signal `index` at `vertices` (N,) are on the mesh, (N,)."""
        finer, origins = self._finer[index]
        if not len(vertices) or not len(finer):
            return self._curvature_peaks[vertices] if index == 0 else vertices
        return origins[cKDTree(self._positions[finer]).query(self._positions[vertices])[1]]


def _find_contrasts(values: np.ndarray, edges: Edges) -> np.ndarray:
    """Return the largest difference (V,) of any of `values` (V, S) between each vertex and its neighbors."""
    start, end = edges.ends.T
    differences = np.abs(values[start] - values[end]).max(axis=1)
    contrasts = np.zeros(len(values))
    np.maximum.at(contrasts, start, differences)
    np.maximum.at(contrasts, end, differences)
    return contrasts


def _find_neighborhood_peaks(values: np.ndarray, edges: Edges) -> np.ndarray:
    """Return for each vertex the one (V,) with the largest of `values` (V,) among itself and its neighbors."""
    start, end = edges.ends.T
    own = np.arange(len(values))
    vertices, candidates = np.concatenate([own, start, end]), np.concatenate([own, end, start])
    order = np.lexsort((values[candidates], vertices))
    is_last = np.append(np.diff(vertices[order]) != 0, True)
    return candidates[order[is_last]]


def _find_crossings(values: np.ndarray, edges: Edges, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices (N,) at sign changes of `values` (V,), the nearer end of each edge that has one, with the strengths (N,): the
    largest difference per length, above ROUNDING. Both ends count if they are equally near. lengths: (E,) of the edges."""
    start, end = edges.ends.T
    crossing = np.flatnonzero((values[start] < 0.0) != (values[end] < 0.0))
    start, end, length = start[crossing], end[crossing], lengths[crossing]
    strength = np.abs(values[start] - values[end]) / np.where(length > 0.0, length, 1.0)
    at_start, at_end = np.abs(values[start]), np.abs(values[end])
    strengths = np.zeros(len(values), np.float32)
    for vertices, is_nearer in ((start, at_start <= at_end), (end, at_end <= at_start)):
        used = is_nearer & (strength > ROUNDING)
        np.maximum.at(strengths, vertices[used], strength[used].astype(np.float32))
    found = np.flatnonzero(strengths)
    return found, strengths[found]


def thin_features(positions: np.ndarray, last_scales: np.ndarray, strengths: np.ndarray, sigmas: np.ndarray, spacing: float) -> np.ndarray:
    """Return the last scale (V,) int8 of each vertex at which no feature that is more persistent, or as persistent and stronger, is closer
    than `spacing` times the standard deviation. All features remain at scale 1.

    positions: (V, 3). last_scales: (V,) int8. strengths: (V,). sigmas: (21,), ascending, in the unit of the positions.
    """
    thinned = np.zeros_like(last_scales)
    order = np.lexsort((np.arange(len(positions)), strengths, last_scales))
    rank = np.empty(len(positions), np.int64)
    rank[order] = np.arange(len(positions))
    for scale in range(len(sigmas) - 1, 1, -1):
        radius = spacing * sigmas[scale]
        kept = np.flatnonzero(thinned > 0)
        candidates = np.flatnonzero((last_scales >= scale) & (thinned == 0))
        candidates = _drop_close(positions, candidates, kept, radius)
        thinned[candidates[_select_spaced(positions[candidates], rank[candidates], radius)]] = scale
    thinned[(last_scales > 0) & (thinned == 0)] = 1
    return thinned


def rank_coverage(positions: np.ndarray, last_scales: np.ndarray, contrasts: np.ndarray, sigmas: np.ndarray, spacing: float) -> np.ndarray:
    """Return strengths (V,) of the vertices that are no features: the number of the scale up to which they are a sample of the surface
    between features, `spacing` standard deviations from each other and from all features, plus a part below 1 that grows with `contrasts`
    (V,). 0 for features.

    Arguments as for `thin_features`, except that last_scales is its result.
    """
    strengths = np.where(last_scales > 0, 0.0, contrasts / (1.0 + contrasts))
    rank = np.argsort(np.lexsort((np.arange(len(positions)), contrasts)), kind="stable")
    features, samples = np.flatnonzero(last_scales > 0), np.flatnonzero(last_scales == 0)
    for scale in range(1, len(sigmas)):
        samples = _drop_close(positions, samples, features, spacing * sigmas[scale])
        samples = samples[_select_spaced(positions[samples], rank[samples], spacing * sigmas[scale])]
        strengths[samples] += 1.0
    return strengths


def _drop_close(positions: np.ndarray, candidates: np.ndarray, kept: np.ndarray, radius: float) -> np.ndarray:
    """Return those of `candidates` (N,), indices into positions, that are at least `radius` from all `kept` (K,)."""
    if not len(candidates) or not len(kept):
        return candidates
    return candidates[cKDTree(positions[kept]).query(positions[candidates], distance_upper_bound=radius)[0] >= radius]


def _select_spaced(positions: np.ndarray, rank: np.ndarray, radius: float, depth: int = 0) -> np.ndarray:
    """Return the indices of points that are at least `radius` apart, those of higher `rank` (N,) first, as if chosen one after the other.
    Points that are much denser than that are first thinned to half the radius."""
    if not len(positions) or radius <= 0.0:
        return np.arange(len(positions))
    tree = cKDTree(positions)
    if depth < MAX_HALVINGS and tree.count_neighbors(tree, radius) > MAX_NEIGHBORS * len(positions):
        finer = _select_spaced(positions, rank, 0.5 * radius, depth + 1)
        return finer[_select_spaced(positions[finer], rank[finer], radius, MAX_HALVINGS)]
    first, second = tree.query_pairs(radius, output_type="ndarray").T
    lower, upper = np.where(rank[first] < rank[second], (first, second), (second, first))
    is_open, is_selected = np.ones(len(positions), bool), np.zeros(len(positions), bool)
    while is_open.any():
        is_beaten = np.zeros(len(positions), bool)
        is_beaten[lower[is_open[upper]]] = True
        is_selected |= is_open & ~is_beaten
        is_open &= is_beaten
        is_open[lower[is_selected[upper]]] = False
        used = is_open[lower] & is_open[upper]
        lower, upper = lower[used], upper[used]
    return np.flatnonzero(is_selected)


SCALES = 21  # scale 0 is the mesh itself


@dataclass(frozen=True)
class ScaleMap:
    """At which scales the V vertices of a mesh are features.

    Attributes:
        last_scales: (V,) int8, 0 to 20, the last scale at which each vertex is a feature. At scale 0 all are.
        strengths: (V,) float32 of their features, comparable only among vertices with the same last scale.
        sigmas: (21,) float64, the standard deviation of the filter at each scale, ascending from 0, in the unit of the mesh.
        counts: (21,) int64, vertices whose last scale is at least i.
        ranges: (21,) float64, the largest minus the smallest filtered value at each scale (Figure 10), relative to its maximum.
        losses: a sentence about what the analysis could not represent, "" for nothing.
    """

    last_scales: np.ndarray
    strengths: np.ndarray
    sigmas: np.ndarray
    counts: np.ndarray
    ranges: np.ndarray
    losses: str


class LastFeatures:
    """Collects the features of one scale after the other, in ascending order.

    last_scales: (V,) int8. strengths: (V,) float32, at the last scale.
    """

    def __init__(self, strengths: np.ndarray) -> None:
        """strengths: (V,) at scale 0, where all vertices are features."""
        self.last_scales = np.zeros(len(strengths), np.int8)
        self.strengths = strengths.astype(np.float32)

    def add(self, scale: int, vertices: np.ndarray, strengths: np.ndarray) -> None:
        """Record that `vertices` (N,) are features at `scale`; of several `strengths` (N,) of a vertex the largest counts."""
        self.last_scales[vertices] = scale
        self.strengths[vertices] = 0.0
        np.maximum.at(self.strengths, vertices, strengths.astype(np.float32))

    def to_scale_map(self, sigmas: np.ndarray, ranges: np.ndarray, losses: str = "") -> ScaleMap:
        """Return the scale map."""
        counts = np.bincount(self.last_scales, minlength=SCALES)[::-1].cumsum()[::-1]
        return ScaleMap(self.last_scales, self.strengths, sigmas, counts, ranges, losses)
