"""Local PCA recovers clusters and has smaller errors than one set of components for all rows."""

import numpy as np
import pytest

from farfield.addon.core.btf.factorization import lpca
from farfield.addon.core.btf.factorization.als import ViewMatrix
from farfield.addon.core.btf.factorization.factors import error_by_components, factorize
from farfield.addon.core.btf.factorization.lpca import cluster_subspaces, factorize_lpca
from farfield.addon.core.jobs.progress import run_to_end
from synthetic_views import InMemoryView, sample_views

VIEWS, ROWS, COLUMNS = 10, 600, 15


def clustered_values(clusters: int, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Return values (V, N, D) of rows in clusters of low rank, and the cluster of each row."""
    random = np.random.default_rng(3)
    labels = random.integers(clusters, size=ROWS)
    weights = random.normal(size=(ROWS, rank))
    basis = random.normal(size=(clusters, VIEWS, rank, COLUMNS))
    return np.einsum("nk,nvkd->vnd", weights, basis[labels]).astype(np.float32), labels


def matrix_of(views: list[InMemoryView]) -> ViewMatrix:
    return ViewMatrix(views, ROWS, np.ones(len(views)), np.ones(COLUMNS))


def fit(views: list[InMemoryView], clusters: int, components: int):
    return run_to_end(factorize_lpca(matrix_of(views), clusters, components))


def relative_error(values: np.ndarray, factors) -> float:
    reconstruction = np.stack([factors.reconstruct(basis) for basis in factors.basis])
    return float(np.linalg.norm(reconstruction - values) / np.linalg.norm(values))


def agreement(labels: np.ndarray, true_labels: np.ndarray) -> float:
    """Return the mean fraction of each true cluster that is in the same found cluster."""
    found = [labels[true_labels == label] for label in np.unique(true_labels)]
    return float(np.mean([(members == np.bincount(members).argmax()).mean() for members in found]))


@pytest.mark.parametrize("fraction", [1.0, 0.7])
def test_clusters_of_low_rank_are_recovered(fraction):
    values, labels = clustered_values(clusters=3, rank=3)
    views = sample_views(values, fraction)
    factors = fit(views, 3, 3)
    assert factors.clusters == 3 and factors.weights.shape == (ROWS, 3)
    assert agreement(factors.labels, labels) > 0.98
    assert relative_error(values, factors) < 0.15
    global_factors = run_to_end(factorize(matrix_of(views), 3))
    assert relative_error(values, global_factors) > 0.5, "the test needs values that one set of components cannot represent"


def test_one_cluster_equals_global_factors():
    values, _ = clustered_values(clusters=2, rank=2)
    views = sample_views(values, 0.8)
    local_factors, global_factors = fit(views, 1, 4), run_to_end(factorize(matrix_of(views), 4))
    np.testing.assert_array_equal(local_factors.weights, global_factors.weights)
    np.testing.assert_array_equal(local_factors.basis, global_factors.basis)
    assert local_factors.clusters == 1 and not local_factors.labels.any()


@pytest.mark.slow
def test_factors_are_deterministic_for_any_memory_budget(monkeypatch):
    values, _ = clustered_values(clusters=3, rank=2)
    views = sample_views(values, 0.8)
    first = fit(views, 4, 2)
    for budget in (1.0, 60e3):
        monkeypatch.setattr(lpca, "MEMORY_BUDGET", budget)
        second = fit(views, 4, 2)
        for name in ("weights", "basis", "labels", "known"):
            np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_a_view_without_a_cluster_takes_its_basis_from_the_global_factors():
    values, labels = clustered_values(clusters=2, rank=1)
    views = sample_views(values, 1.0)
    # A copy of the first view in which one cluster is unknown; only the global factors determine its basis.
    visible = np.flatnonzero(labels == 0)
    views.append(InMemoryView(visible, values[0, visible]))
    factors = fit(views, 2, 1)
    assert agreement(factors.labels, labels) == 1.0
    reconstruction = factors.reconstruct(factors.basis[-1])
    np.testing.assert_allclose(reconstruction[visible], values[0, visible], rtol=0.05, atol=0.05)
    assert np.isfinite(factors.basis).all()
    assert np.abs(reconstruction[labels == 1]).max() < 3.0 * np.abs(values).max()


def test_more_clusters_than_needed_are_allowed():
    values, _ = clustered_values(clusters=1, rank=1)
    factors = fit(sample_views(values, 1.0), 8, 1)
    assert np.isfinite(factors.weights).all() and np.isfinite(factors.basis).all()
    assert relative_error(values, factors) < 0.05


def test_rows_without_data_are_zero_and_unknown():
    values, _ = clustered_values(clusters=2, rank=2)
    views = [InMemoryView(np.arange(1, ROWS), view[1:]) for view in values]
    factors = fit(views, 2, 2)
    assert not factors.known[0] and factors.known[1:].all()
    assert (factors.weights[0] == 0.0).all()


def test_clusters_are_linear_subspaces():
    random = np.random.default_rng(0)
    labels = np.repeat([0, 1], 200)
    codes = np.zeros((400, 4), np.float32)
    codes[labels == 0, :2], codes[labels == 1, 2:] = random.normal(size=(200, 2)), random.normal(size=(200, 2))
    assert agreement(cluster_subspaces(codes, 2, 2, 0), labels) == 1.0
    np.testing.assert_array_equal(cluster_subspaces(codes, 2, 2, 7), cluster_subspaces(codes, 2, 2, 7))


def test_error_by_components_uses_the_components_of_each_cluster():
    values, _ = clustered_values(clusters=2, rank=2)
    views = sample_views(values, 1.0)
    factors = fit(views, 2, 2)
    errors = run_to_end(error_by_components(matrix_of(views), factors, np.ones((ROWS, 3))))
    assert [error.components for error in errors] == [0, 1, 2]
    assert errors[2].rms == pytest.approx(relative_error(values, factors) * np.sqrt((values**2).mean()), rel=1e-3)
    assert errors[2].rms < errors[1].rms < errors[0].rms
