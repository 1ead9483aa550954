"""Local PCA: texels in clusters, each with components of its own (Mueller, Meseth, Klein 2003; the paper's section 5.2)."""

from dataclasses import dataclass

import numpy as np

from .factors import Factors


@dataclass(frozen=True)
class LocalFactors(Factors):
    """Values of view v and row x are about weights[x] @ basis[v, labels[x] * K : (labels[x] + 1) * K].

    weights (N, K) float32; basis (V, clusters * K, D) float32; labels (N,) int32, the cluster of each row.
    """

    labels: np.ndarray

    @property
    def clusters(self) -> int:
        """How many sets of components there are; every row has those of one."""
        return self.basis.shape[1] // self.components

    def applied(self, basis: np.ndarray) -> np.ndarray:
        """The values (N, D) of all rows with `basis` (clusters * K, D), that of a view for instance."""
        values = np.empty((len(self.weights), basis.shape[1]), np.result_type(self.weights, basis))
        for cluster, own in enumerate(np.split(basis, self.clusters)):
            members = np.flatnonzero(self.labels == cluster)
            values[members] = self.weights[members] @ own
        return values

    def spread(self, rows: slice) -> np.ndarray:
        """The weights (M, clusters * K) of some rows, 0 for the components of other clusters than their own."""
        weights, labels = self.weights[rows], self.labels[rows]
        wide = np.zeros((len(weights), self.clusters, self.components), weights.dtype)
        wide[np.arange(len(weights)), labels] = weights
        return wide.reshape(len(weights), -1)

    def part(self, rows: np.ndarray, view: int, number: int) -> np.ndarray:
        """What component `number` alone adds to the values (M, D) of `rows` (M,) in a view."""
        return self.weights[rows, number, None] * self.basis[view, self.labels[rows] * self.components + number]
