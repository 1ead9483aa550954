"""Local PCA: clusters of texels with a set of components each (Mueller, Meseth, Klein 2003; section 5.2 of the paper).

A texel belongs to the cluster whose components reconstruct it best, but few texels are known from every view. So all texels are first
factorized together, with more components than a cluster will have. These weights represent the complete rows, unknown entries included, and
are clustered. Then each cluster is factorized from the captured values as a matrix of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...jobs.progress import Progress, Steps, subprogress
from .als import ViewData, ViewMatrix
from .factors import Factors, factorize

GLOBAL_COMPONENTS = 3  # Components of the global factorization per component of a cluster.
RESTARTS = 3  # The clustering starts so often with different seed rows; the best result is kept.
MAX_ITERATIONS = 30  # Per restart.
MIN_ROWS_PER_COMPONENT = 3  # In views that show fewer rows of a cluster, its basis follows from the global factors.
MEMORY_BUDGET = 384e6  # Bytes of captured values in memory at once.
GLOBAL_END = 0.4  # End of the global factorization in the progress bar.
READ_FRACTION = 0.3  # Reading takes this fraction of the progress of clusters that are read together.


@dataclass(frozen=True)
class LocalFactors(Factors):
    """Factors with clusters: the values of row x in view v are about weights[x] @ basis[v, labels[x] * K : (labels[x] + 1) * K].

    weights (N, K) float32; basis (V, clusters * K, D) float32; labels (N,) int32: the cluster of each row.
    """

    labels: np.ndarray

    @property
    def clusters(self) -> int:
        """Number of sets of components. Every row uses one set."""
        return self.basis.shape[1] // self.components

    @property
    def nbytes(self) -> int:
        """Size as half floats, with one byte per label."""
        return super().nbytes + len(self.labels)

    def reconstruct(self, basis: np.ndarray) -> np.ndarray:
        """Return the values (N, D) of all rows for a `basis` (clusters * K, D), such as that of one view."""
        values = np.empty((len(self.weights), basis.shape[1]), np.result_type(self.weights, basis))
        for cluster, cluster_basis in enumerate(np.split(basis, self.clusters)):
            members = np.flatnonzero(self.labels == cluster)
            values[members] = self.weights[members] @ cluster_basis
        return values

    def dense_weights(self, rows: slice | np.ndarray) -> np.ndarray:
        """Return the weights (M, clusters * K) of `rows`; 0 for components of other clusters."""
        weights, labels = self.weights[rows], self.labels[rows]
        dense = np.zeros((len(weights), self.clusters, self.components), weights.dtype)
        dense[np.arange(len(weights)), labels] = weights
        return dense.reshape(len(weights), -1)

    def component_contribution(self, rows: np.ndarray, view: int, component: int) -> np.ndarray:
        """Return the contribution of one component to the values (M, D) of `rows` (M,) in a view."""
        return self.weights[rows, component, None] * self.basis[view, self.labels[rows] * self.components + component]


@dataclass(frozen=True)
class ClusterView:
    """The rows of a cluster in one view, in memory. rows (M,): indices within the cluster."""

    rows: np.ndarray
    values: np.ndarray

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and values; see `ViewData`."""
        return self.rows, self.values


@dataclass(frozen=True)
class StreamedClusterView:
    """The rows of a cluster in one view, read again on every access. labels (N,), member_indices (N,): cluster of every row and its index
    within the cluster."""

    view: ViewData
    cluster: int
    labels: np.ndarray
    member_indices: np.ndarray

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and values; see `ViewData`."""
        rows, values = self.view.read()
        is_member = self.labels[rows] == self.cluster
        return self.member_indices[rows[is_member]], values[is_member]


def factorize_lpca(matrix: ViewMatrix, clusters: int, components: int, seed: int = 0) -> Steps[LocalFactors]:
    """Cluster the rows of `matrix` and factorize each cluster. With one cluster the result equals that of `factorize`.

    Memory: about MEMORY_BUDGET for captured values, that of `factorize` with GLOBAL_COMPONENTS times the components, and a few whole views.
    All views are read once more for every MEMORY_BUDGET of their total size.
    """
    if clusters == 1:
        factors = yield from factorize(matrix, components, seed)
        return LocalFactors(factors.weights, factors.basis, factors.known, np.zeros(matrix.row_count, np.int32))
    steps = factorize(matrix, GLOBAL_COMPONENTS * components, seed)
    global_factors = yield from subprogress(steps, 0.0, GLOBAL_END)
    yield Progress(GLOBAL_END, "Clustering")
    row_weights = matrix.row_weights
    codes = _compute_codes(global_factors, row_weights.mean(axis=1), matrix.column_weights)
    labels = cluster_subspaces(codes, clusters, components, seed)
    basis = np.zeros((len(matrix.views), clusters, components, len(matrix.column_weights)), np.float32)
    weights = np.zeros((matrix.row_count, components), np.float32)
    cluster_fraction = (1.0 - GLOBAL_END) / clusters
    member_indices = _index_members(labels, clusters)
    for batch, fits_in_memory in _split_batches(matrix.views, labels, clusters):
        start, read_fraction = GLOBAL_END + cluster_fraction * batch[0], READ_FRACTION * cluster_fraction * len(batch)
        cluster_views = {
            cluster: [StreamedClusterView(view, cluster, labels, member_indices) for view in matrix.views] for cluster in batch
        }
        if fits_in_memory:
            steps = _read_batch(matrix.views, batch, labels, member_indices)
            cluster_views = yield from subprogress(steps, start, start + read_fraction)
        for index, cluster in enumerate(batch):
            views, members = cluster_views.pop(cluster), np.flatnonzero(labels == cluster)
            if len(members) == 0:
                continue
            progress = [start + read_fraction + (1.0 - READ_FRACTION) * cluster_fraction * end for end in (index, index + 1)]
            cluster_matrix = replace(matrix, views=views, row_count=len(members), weights=row_weights[:, members])
            factors = yield from subprogress(factorize(cluster_matrix, components, seed), *progress)
            weights[members], basis[:, cluster] = factors.weights, _complete_basis(factors, views, global_factors, members)
    return LocalFactors(weights, basis.reshape(len(matrix.views), -1, len(matrix.column_weights)), global_factors.known, labels)


def _complete_basis(factors: Factors, views: Sequence[ViewData], global_factors: Factors, members: np.ndarray) -> np.ndarray:
    """Return the basis (V, K, D) of a cluster. In views that show too few of its rows, it is fitted to the global factors."""
    min_rows = MIN_ROWS_PER_COMPONENT * factors.components
    to_cluster = (np.linalg.pinv(factors.weights.astype(np.float64), rcond=1e-4) @ global_factors.weights[members]).astype(np.float32)
    basis = factors.basis.copy()
    for view, data in enumerate(views):
        if len(data.read()[0]) < min_rows:
            basis[view] = to_cluster @ global_factors.basis[view]
    return basis


def cluster_subspaces(codes: np.ndarray, clusters: int, components: int, seed: int) -> np.ndarray:
    """Assign each of `codes` (N, R) to the nearest of `clusters` linear subspaces of dimension `components`; return labels (N,) int32.

    Alternates between fitting the subspaces and assigning the codes. Deterministic for equal input and seed.
    """
    random = np.random.default_rng(seed)
    best_labels, best_error = np.zeros(len(codes), np.int32), np.inf
    for _ in range(RESTARTS):
        subspaces = _seed_subspaces(codes, clusters, components, random)
        labels, errors = _assign(codes, subspaces)
        for _ in range(MAX_ITERATIONS):
            previous_labels = labels
            subspaces = [_fit_subspace(_members(codes, labels, errors, cluster, components), components) for cluster in range(clusters)]
            labels, errors = _assign(codes, subspaces)
            if np.array_equal(labels, previous_labels):
                break
        if errors.sum() < best_error:
            best_labels, best_error = labels, errors.sum()
    return best_labels


def _compute_codes(factors: Factors, view_weights: np.ndarray, column_weights: np.ndarray) -> np.ndarray:
    """Return codes (N, R) float32 of the rows, whose distances are the weighted distances of their values in all views."""
    basis_gram = np.einsum("v,vkd,d,vld->kl", view_weights, factors.basis, column_weights, factors.basis, optimize=True).astype(np.float64)
    values, vectors = np.linalg.eigh(basis_gram)
    return factors.weights @ (vectors * np.sqrt(np.maximum(values, 0.0))).astype(np.float32)


def _seed_subspaces(codes: np.ndarray, clusters: int, components: int, random: np.random.Generator) -> list[np.ndarray]:
    """Return initial subspaces. Each is fitted to a row that the previous ones approximate badly and the rows most parallel to it."""
    lengths = np.linalg.norm(codes, axis=1)
    errors = lengths.astype(np.float64) ** 2
    subspaces = []
    for _ in range(clusters):
        row = random.choice(len(codes), p=errors / errors.sum()) if errors.sum() > 0.0 else 0
        similarity = np.abs(codes @ codes[row]) / np.where(lengths > 0.0, lengths, 1.0)
        count = min(2 * components, len(codes))
        subspaces.append(_fit_subspace(codes[np.argpartition(-similarity, count - 1)[:count]], components))
        errors = np.minimum(errors, _assign(codes, subspaces[-1:])[1])
    return subspaces


def _members(codes: np.ndarray, labels: np.ndarray, errors: np.ndarray, cluster: int, components: int) -> np.ndarray:
    """Return the codes of a cluster, or, if it is empty, those with the largest errors."""
    members = codes[labels == cluster]
    return members if len(members) else codes[np.argsort(-errors, kind="stable")[:components]]


def _fit_subspace(rows: np.ndarray, components: int) -> np.ndarray:
    """Return an orthonormal basis (R, components) of the linear subspace nearest to `rows` (M, R)."""
    rows = rows.astype(np.float64)
    _, vectors = np.linalg.eigh(rows.T @ rows)
    return vectors[:, -components:].astype(np.float32)


def _assign(codes: np.ndarray, subspaces: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest of `subspaces` (N,) int32 of every code, and its squared distance (N,)."""
    labels, min_errors = np.zeros(len(codes), np.int32), np.full(len(codes), np.inf)
    squared_lengths = np.einsum("nr,nr->n", codes, codes, dtype=np.float64)
    for index, subspace in enumerate(subspaces):
        errors = np.maximum(squared_lengths - ((codes @ subspace) ** 2).sum(axis=1), 0.0)
        is_nearer = errors < min_errors
        labels[is_nearer], min_errors[is_nearer] = index, errors[is_nearer]
    return labels, min_errors


def _index_members(labels: np.ndarray, clusters: int) -> np.ndarray:
    """Return the index (N,) int64 of every row within its cluster."""
    indices = np.empty(len(labels), np.int64)
    for cluster in range(clusters):
        members = np.flatnonzero(labels == cluster)
        indices[members] = np.arange(len(members))
    return indices


def _split_batches(views: Sequence[ViewData], labels: np.ndarray, clusters: int) -> list[tuple[list[int], bool]]:
    """Split the clusters into batches whose values fit into MEMORY_BUDGET. The flag is False for a single cluster that does not fit."""
    sizes = np.zeros(clusters)
    for view in views:
        rows, values = view.read()
        sizes += values.itemsize * values.shape[1] * np.bincount(labels[rows], minlength=clusters)
    batches: list[list[int]] = [[]]
    for cluster in range(clusters):
        if batches[-1] and sizes[[*batches[-1], cluster]].sum() > MEMORY_BUDGET:
            batches.append([])
        batches[-1].append(cluster)
    return [(batch, sizes[batch].sum() <= MEMORY_BUDGET) for batch in batches]


def _read_batch(
    views: Sequence[ViewData], batch: list[int], labels: np.ndarray, member_indices: np.ndarray
) -> Steps[dict[int, list[ViewData]]]:
    """Read all views of the clusters of a batch into memory."""
    cluster_views: dict[int, list[ViewData]] = {cluster: [] for cluster in batch}
    for index, view in enumerate(views):
        yield Progress(index / len(views), f"Reading clusters {batch[0] + 1} to {batch[-1] + 1}")
        rows, values = view.read()
        row_labels = labels[rows]
        for cluster, in_memory in cluster_views.items():
            is_member = row_labels == cluster
            in_memory.append(ClusterView(member_indices[rows[is_member]], values[is_member]))
    return cluster_views
