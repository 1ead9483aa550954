"""Factors of a partially known matrix: exact for low rank, otherwise as good as the SVD."""

import numpy as np
import pytest

from farfield.addon.core.btf.factorization import factors as factors_module
from farfield.addon.core.btf.factorization.als import SampledView, ViewMatrix
from farfield.addon.core.btf.factorization.als_scalar import InMemoryScalarData
from farfield.addon.core.btf.factorization.factors import factorize, factorize_scalar
from farfield.addon.core.jobs.progress import run_to_end
from synthetic_views import InMemoryView, sample_views


def low_rank(rank: int, rows: int = 300, views: int = 10, columns: int = 12) -> np.ndarray:
    random = np.random.default_rng(3)
    return np.einsum("nk,vkd->vnd", random.random((rows, rank)), random.normal(size=(views, rank, columns))).astype(np.float32)


def factorize_views(views, row_count: int, components: int, weights: np.ndarray, column_weights: np.ndarray):
    return run_to_end(factorize(ViewMatrix(views, row_count, weights, column_weights), components))


def fit(values: np.ndarray, fraction: float, components: int, column_weights: np.ndarray | None = None):
    """Factorize the values (V, N, D), of which each view knows a `fraction` of the rows."""
    column_weights = np.ones(values.shape[2]) if column_weights is None else column_weights
    return factorize_views(sample_views(values, fraction), values.shape[1], components, np.ones(len(values)), column_weights)


def relative_error(values: np.ndarray, factors) -> float:
    reconstruction = np.einsum("nk,vkd->vnd", factors.weights, factors.basis)
    return float(np.linalg.norm(reconstruction - values) / np.linalg.norm(values))


@pytest.mark.parametrize("fraction", [pytest.param(1.0, marks=pytest.mark.exhaustive), 0.6])
def test_unknown_entries_of_low_rank_matrices_are_recovered(fraction):
    values = low_rank(3)
    assert relative_error(values, fit(values, fraction, 3)) < 0.02


def test_factors_of_a_fully_known_matrix_are_as_good_as_the_svd():
    random = np.random.default_rng(0)
    values = low_rank(3) + 0.3 * random.normal(size=(10, 300, 12)).astype(np.float32)
    flat = values.transpose(1, 0, 2).reshape(300, -1)
    singular_values = np.linalg.svd(flat, compute_uv=False)
    best = np.sqrt((singular_values[4:] ** 2).sum() / (singular_values**2).sum())
    assert relative_error(values, fit(values, 1.0, 4)) <= 1.03 * best


@pytest.mark.parametrize("fraction", [pytest.param(1.0, marks=pytest.mark.exhaustive), 0.6])
def test_sampling_rows_hardly_increases_the_error(fraction, monkeypatch):
    random = np.random.default_rng(5)
    values = low_rank(3, rows=2000) + 0.3 * random.normal(size=(10, 2000, 12)).astype(np.float32)
    error = relative_error(values, fit(values, fraction, 3))
    monkeypatch.setattr(factors_module, "SAMPLE_ROWS", 200)
    assert relative_error(values, fit(values, fraction, 3)) < 1.01 * error


def test_sampled_views_contain_the_known_rows_of_the_sample():
    view = InMemoryView(np.array([1, 4, 5, 9]), np.arange(8.0, dtype=np.float32).reshape(4, 2))
    sampled = SampledView(view, np.array([0, 4, 8, 9]))
    for _ in range(2):
        rows, values = sampled.read()
        np.testing.assert_array_equal(rows, [1, 3])
        np.testing.assert_array_equal(values, view.values[[1, 3]])


def test_components_have_decreasing_energy_and_weights_up_to_one():
    factors = fit(low_rank(5), 0.8, 5)
    np.testing.assert_allclose(np.abs(factors.weights).max(axis=0), 1.0, rtol=1e-5)
    energy = (factors.weights**2).sum(axis=0) * np.einsum("vkd,vkd->k", factors.basis, factors.basis)
    assert (np.diff(energy) <= 1e-3 * energy[0]).all()


def test_noise_is_averaged_out():
    clean = low_rank(2, rows=2000)
    noise = 0.5 * np.abs(clean).mean() * np.random.default_rng(1).normal(size=clean.shape).astype(np.float32)
    factors = fit(clean + noise, 1.0, 2)
    assert relative_error(clean, factors) < 0.35 * np.linalg.norm(noise) / np.linalg.norm(clean)


def test_rows_without_data_are_zero_and_unknown():
    values = low_rank(2)
    views = [InMemoryView(np.arange(1, 300), view[1:]) for view in values]
    factors = factorize_views(views, 300, 2, np.ones(10), np.ones(12))
    assert not factors.known[0] and factors.known[1:].all()
    assert (factors.weights[0] == 0.0).all()


def test_columns_with_larger_weights_have_smaller_errors():
    random = np.random.default_rng(2)
    values = random.normal(size=(4, 400, 6)).astype(np.float32)
    column_weights = np.array([100.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    factors = fit(values, 1.0, 5, column_weights)
    reconstruction = np.einsum("nk,vkd->vnd", factors.weights, factors.basis)
    errors = ((reconstruction - values) ** 2).mean(axis=(0, 1))
    assert errors[0] < 0.2 * errors[1:].min()


def test_rows_follow_the_views_in_which_they_have_weight():
    """Some entries contradict the others, but have almost no weight."""
    random = np.random.default_rng(4)
    truth, outliers = random.normal(size=(2, 6, 300, 8)).astype(np.float32)
    basis = random.normal(size=(6, 2, 8)).astype(np.float32)
    rows = random.normal(size=(300, 2)).astype(np.float32)
    truth = np.einsum("nk,vkd->vnd", rows, basis)
    is_outlier = random.random((6, 300)) < 0.3
    values = np.where(is_outlier[..., None], outliers, truth)
    weights = np.where(is_outlier, 1e-6, 1.0)
    factors = factorize_views(sample_views(values, 1.0), 300, 2, weights, np.ones(8))
    assert relative_error(truth, factors) < 0.02 < 0.3 < relative_error(truth, fit(values, 1.0, 2))


def test_a_zero_matrix_has_finite_factors_with_product_zero():
    factors = factorize_views([InMemoryView(np.arange(5), np.zeros((5, 2), np.float32))] * 3, 5, 2, np.ones(3), np.ones(2))
    assert not factors.weights.any() or not factors.basis.any()
    assert np.isfinite(factors.weights).all() and np.isfinite(factors.basis).all()


@pytest.mark.slow
@pytest.mark.parametrize("row_count", [300, 9000])
def test_scalar_factorization_matches_the_general_one(row_count):
    """Also with unknown entries and with sampled rows (9,000 are more than a sample)."""
    values = low_rank(3, rows=row_count, views=40, columns=1)
    views = sample_views(values, 0.6)
    known = np.zeros(values.shape[:2], np.float32)
    for index, view in enumerate(views):
        known[index, view.rows] = 1.0
    view_weights = np.linspace(0.5, 1.5, len(values))
    for components in (2, 3):
        general = factorize_views(views, row_count, components, view_weights, np.ones(1))
        data = InMemoryScalarData(values[..., 0], known * view_weights[:, None].astype(np.float32))
        scalar = run_to_end(factorize_scalar(data, components))
        assert scalar.basis.shape == general.basis.shape
        np.testing.assert_array_equal(scalar.known, general.known)
        assert relative_error(values, scalar) == pytest.approx(relative_error(values, general), rel=0.02, abs=2e-3)


def test_scalar_data_without_known_entries_has_zero_weights():
    factors = run_to_end(factorize_scalar(InMemoryScalarData(*np.zeros((2, 5, 20), np.float32)), 2))
    assert not factors.known.any() and not factors.weights.any() and np.isfinite(factors.basis).all()
