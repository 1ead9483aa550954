"""Local PCA: texels in clusters, each with components of its own (Mueller, Meseth, Klein 2003; the paper's section 5.2).

The errors of every texel under the components of every cluster tell which it belongs to, and few texels are known from every view. So all
are factorised together first, with more components than a cluster will have: those weights stand for the whole row, what was not seen
included, and in them clusters are found. Then each cluster is factorised from what was captured, as a matrix of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..progress import Progress, Steps, scaled
from .alternation import ViewData, of_all_rows
from .factors import Factors, factorise

CODES = 3  # components of all rows together for each one that a cluster has
TRIES = 3  # to cluster, from other rows each; the best is taken
ROUNDS = 30  # of each, at most
SEEN = 3  # rows for each component: from views that show fewer of a cluster its basis is that of all rows together
BUDGET = 384e6  # bytes of captured values in memory at once
TOGETHER = 0.4  # of the bar
READ = 0.3  # of the bar of clusters that are read at once


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

    @property
    def bytes(self) -> int:
        """What it takes as half floats, the number of a cluster as a byte."""
        return super().bytes + len(self.labels)

    def applied(self, basis: np.ndarray) -> np.ndarray:
        """The values (N, D) of all rows with `basis` (clusters * K, D), that of a view for instance."""
        values = np.empty((len(self.weights), basis.shape[1]), np.result_type(self.weights, basis))
        for cluster, own in enumerate(np.split(basis, self.clusters)):
            members = np.flatnonzero(self.labels == cluster)
            values[members] = self.weights[members] @ own
        return values

    def spread(self, rows: slice | np.ndarray) -> np.ndarray:
        """The weights (M, clusters * K) of some rows, 0 for the components of other clusters than their own."""
        weights, labels = self.weights[rows], self.labels[rows]
        wide = np.zeros((len(weights), self.clusters, self.components), weights.dtype)
        wide[np.arange(len(weights)), labels] = weights
        return wide.reshape(len(weights), -1)

    def part(self, rows: np.ndarray, view: int, number: int) -> np.ndarray:
        """What component `number` alone adds to the values (M, D) of `rows` (M,) in a view."""
        return self.weights[rows, number, None] * self.basis[view, self.labels[rows] * self.components + number]


@dataclass(frozen=True)
class Held:
    """What one view knows of a cluster, in memory; rows are numbered within it."""

    index: np.ndarray
    values: np.ndarray

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """See `ViewData`."""
        return self.index, self.values


@dataclass(frozen=True)
class Within:
    """What one view knows of a cluster, read anew each time. labels (N,), numbers (N,): of every row its cluster and its number in it."""

    view: ViewData
    cluster: int
    labels: np.ndarray
    numbers: np.ndarray

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """See `ViewData`."""
        index, values = self.view.read()
        own = self.labels[index] == self.cluster
        return self.numbers[index[own]], values[own]


def factorise_locally(
    views: Sequence[ViewData],
    rows: int,
    clusters: int,
    components: int,
    weights: np.ndarray,
    column_weights: np.ndarray,
    seed: int = 0,
) -> Steps[LocalFactors]:
    """Clusters of the rows of a matrix that `views` know, and factors of each; see `factorise`. With one cluster the same as that.

    Memory: about BUDGET for captured values, what `factorise` takes for CODES times the components, and a few whole views at a time. Views
    are read once more for every BUDGET that they hold.
    """
    if clusters == 1:
        whole = yield from factorise(views, rows, components, weights, column_weights, seed)
        return LocalFactors(whole.weights, whole.basis, whole.known, np.zeros(rows, np.int32))
    steps = factorise(views, rows, CODES * components, weights, column_weights, seed)
    together = yield from scaled(steps, 0.0, TOGETHER)
    yield Progress(TOGETHER, "Finding clusters")
    counting = of_all_rows(weights, rows)
    labels = clustered(_codes(together, counting.mean(axis=1), column_weights), clusters, components, seed)
    basis = np.zeros((len(views), clusters, components, len(column_weights)), np.float32)
    found = np.zeros((rows, components), np.float32)
    share = (1.0 - TOGETHER) / clusters
    numbers = _numbers(labels, clusters)
    for batch, fits in _batches(views, labels, clusters):
        first, reading = TOGETHER + share * batch[0], READ * share * len(batch)
        parts = {cluster: [Within(view, cluster, labels, numbers) for view in views] for cluster in batch}
        if fits:
            parts = yield from scaled(_held(views, batch, labels, numbers), first, first + reading)
        for place, cluster in enumerate(batch):
            known, members = parts.pop(cluster), np.flatnonzero(labels == cluster)
            if len(members) == 0:
                continue
            start, stop = (first + reading + (1.0 - READ) * share * at for at in (place, place + 1))
            steps = factorise(known, len(members), components, counting[:, members], column_weights, seed)
            own = yield from scaled(steps, start, stop)
            found[members], basis[:, cluster] = own.weights, _completed(own, known, together, members)
    return LocalFactors(found, basis.reshape(len(views), -1, len(column_weights)), together.known, labels)


def _completed(own: Factors, known: Sequence[ViewData], together: Factors, members: np.ndarray) -> np.ndarray:
    """The basis (V, K, D) of a cluster; from views that hardly show it, what fits best to the factors of all rows together."""
    least = SEEN * own.components
    turn = (np.linalg.pinv(own.weights.astype(np.float64), rcond=1e-4) @ together.weights[members]).astype(np.float32)
    basis = own.basis.copy()
    for view, part in enumerate(known):
        if len(part.read()[0]) < least:
            basis[view] = turn @ together.basis[view]
    return basis


def clustered(codes: np.ndarray, clusters: int, components: int, seed: int) -> np.ndarray:
    """The cluster (N,) int32 of each of `codes` (N, R): that whose subspace of `components` dimensions through the origin is nearest.

    Subspaces and clusters are found in turn. Equal input and seed give equal clusters.
    """
    random = np.random.default_rng(seed)
    best, least = np.zeros(len(codes), np.int32), np.inf
    for _ in range(TRIES):
        subspaces = _seeds(codes, clusters, components, random)
        labels, errors = _nearest(codes, subspaces)
        for _ in range(ROUNDS):
            before = labels
            subspaces = [_subspace(_members(codes, labels, errors, cluster, components), components) for cluster in range(clusters)]
            labels, errors = _nearest(codes, subspaces)
            if np.array_equal(labels, before):
                break
        if errors.sum() < least:
            best, least = labels, errors.sum()
    return best


def _codes(together: Factors, view_weights: np.ndarray, column_weights: np.ndarray) -> np.ndarray:
    """Codes (N, R) float32 of rows, whose distances are those of their values from all views."""
    energy = np.einsum("v,vkd,d,vld->kl", view_weights, together.basis, column_weights, together.basis, optimize=True).astype(np.float64)
    values, vectors = np.linalg.eigh(energy)
    return together.weights @ (vectors * np.sqrt(np.maximum(values, 0.0))).astype(np.float32)


def _seeds(codes: np.ndarray, clusters: int, components: int, random: np.random.Generator) -> list[np.ndarray]:
    """Subspaces to begin with: each around a row that those before fit badly, and the rows that point its way."""
    lengths = np.linalg.norm(codes, axis=1)
    errors = lengths.astype(np.float64) ** 2
    subspaces = []
    for _ in range(clusters):
        row = random.choice(len(codes), p=errors / errors.sum()) if errors.sum() > 0.0 else 0
        alike = np.abs(codes @ codes[row]) / np.where(lengths > 0.0, lengths, 1.0)
        count = min(2 * components, len(codes))
        subspaces.append(_subspace(codes[np.argpartition(-alike, count - 1)[:count]], components))
        errors = np.minimum(errors, _nearest(codes, subspaces[-1:])[1])
    return subspaces


def _members(codes: np.ndarray, labels: np.ndarray, errors: np.ndarray, cluster: int, components: int) -> np.ndarray:
    """The rows of a cluster; where it is empty, those that are fitted worst."""
    own = codes[labels == cluster]
    return own if len(own) else codes[np.argsort(-errors, kind="stable")[:components]]


def _subspace(rows: np.ndarray, components: int) -> np.ndarray:
    """An orthonormal basis (R, components) of the subspace nearest to `rows` (M, R)."""
    rows = rows.astype(np.float64)
    _, vectors = np.linalg.eigh(rows.T @ rows)
    return vectors[:, -components:].astype(np.float32)


def _nearest(codes: np.ndarray, subspaces: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The nearest of `subspaces` (N,) int32 for every row, and the squared distance (N,) to it."""
    labels, least = np.zeros(len(codes), np.int32), np.full(len(codes), np.inf)
    squares = np.einsum("nr,nr->n", codes, codes, dtype=np.float64)
    for number, subspace in enumerate(subspaces):
        errors = np.maximum(squares - ((codes @ subspace) ** 2).sum(axis=1), 0.0)
        nearer = errors < least
        labels[nearer], least[nearer] = number, errors[nearer]
    return labels, least


def _numbers(labels: np.ndarray, clusters: int) -> np.ndarray:
    """The number (N,) int64 of every row within its cluster."""
    numbers = np.empty(len(labels), np.int64)
    for cluster in range(clusters):
        members = np.flatnonzero(labels == cluster)
        numbers[members] = np.arange(len(members))
    return numbers


def _batches(views: Sequence[ViewData], labels: np.ndarray, clusters: int) -> list[tuple[list[int], bool]]:
    """Clusters one after the other, as many at once as BUDGET holds, and whether it does: one that is larger comes alone."""
    sizes = np.zeros(clusters)
    for view in views:
        index, values = view.read()
        sizes += values.itemsize * values.shape[1] * np.bincount(labels[index], minlength=clusters)
    batches: list[list[int]] = [[]]
    for cluster in range(clusters):
        if batches[-1] and sizes[[*batches[-1], cluster]].sum() > BUDGET:
            batches.append([])
        batches[-1].append(cluster)
    return [(batch, sizes[batch].sum() <= BUDGET) for batch in batches]


def _held(views: Sequence[ViewData], batch: list[int], labels: np.ndarray, numbers: np.ndarray) -> Steps[dict[int, list[ViewData]]]:
    """What all views know of each cluster of a batch, in memory."""
    parts: dict[int, list[ViewData]] = {cluster: [] for cluster in batch}
    for place, view in enumerate(views):
        yield Progress(place / len(views), f"Reading clusters {batch[0] + 1} to {batch[-1] + 1}")
        index, values = view.read()
        of_row = labels[index]
        for cluster, known in parts.items():
            own = of_row == cluster
            known.append(Held(numbers[index[own]], values[own]))
    return parts
