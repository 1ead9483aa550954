"""The scale map: for each vertex the last scale at which it is a feature (section III.A of the TexMesh paper)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..textured_mesh import TexturedMesh

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


class FeatureRecords(NamedTuple):
    """The priority queue in descending order of last scales: scales (V,) int8, texture coordinates (V, 2) and positions (V, 3)
    float64, and the vertices (V,) int32 that they belong to."""

    scales: np.ndarray
    uvs: np.ndarray
    positions: np.ndarray
    vertices: np.ndarray


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


def records(mesh: TexturedMesh, scale_map: ScaleMap) -> FeatureRecords:
    """Return the records (i, (tx, ty), (gx, gy, gz)) of all vertices of `mesh`, the most persistent and strongest features first. A vertex
    on a seam has the texture coordinates of its first wedge."""
    order = np.lexsort((-scale_map.strengths, -scale_map.last_scales.astype(np.int64)))
    first_wedges = np.full(len(mesh.vertices), len(mesh.uvs), np.int64)
    np.minimum.at(first_wedges, mesh.wedge_vertices, np.arange(len(mesh.uvs)))
    uvs = np.concatenate([mesh.uvs, np.zeros((1, 2))])[first_wedges]
    return FeatureRecords(scale_map.last_scales[order], uvs[order], mesh.vertices[order], order.astype(np.int32))
