"""Factors of a matrix known in part: exact where the rank allows it, the best there is where not."""

import numpy as np
import pytest

from farfield.addon.core.btf import factors as factors_module
from farfield.addon.core.btf.alternation import Sampled
from farfield.addon.core.btf.columns import HeldColumns
from farfield.addon.core.btf.factors import factorise, factorise_columns
from farfield.addon.core.progress import finish
from known_views import Known, seen


def low_rank(rank: int, rows: int = 300, views: int = 10, columns: int = 12) -> np.ndarray:
    random = np.random.default_rng(3)
    return np.einsum("nk,vkd->vnd", random.random((rows, rank)), random.normal(size=(views, rank, columns))).astype(np.float32)


def fitted(values: np.ndarray, share: float, components: int, columns: np.ndarray | None = None):
    weights = np.ones(values.shape[2]) if columns is None else columns
    return finish(factorise(seen(values, share), values.shape[1], components, np.ones(len(values)), weights))


def relative(values: np.ndarray, factors) -> float:
    guess = np.einsum("nk,vkd->vnd", factors.weights, factors.basis)
    return float(np.linalg.norm(guess - values) / np.linalg.norm(values))


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_what_was_not_seen_follows_from_what_was(share):
    values = low_rank(3)
    assert relative(values, fitted(values, share, 3)) < 0.02


def test_fully_known_it_is_as_good_as_the_svd():
    random = np.random.default_rng(0)
    values = low_rank(3) + 0.3 * random.normal(size=(10, 300, 12)).astype(np.float32)
    flat = values.transpose(1, 0, 2).reshape(300, -1)
    strengths = np.linalg.svd(flat, compute_uv=False)
    best = np.sqrt((strengths[4:] ** 2).sum() / (strengths**2).sum())
    assert relative(values, fitted(values, 1.0, 4)) <= 1.03 * best


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_a_sample_of_the_rows_finds_what_all_of_them_do(share, monkeypatch):
    random = np.random.default_rng(5)
    values = low_rank(3, rows=2000) + 0.3 * random.normal(size=(10, 2000, 12)).astype(np.float32)
    of_all = relative(values, fitted(values, share, 3))
    monkeypatch.setattr(factors_module, "SAMPLE", 200)
    assert relative(values, fitted(values, share, 3)) < 1.01 * of_all


def test_sampled_views_know_what_the_views_know_of_the_sample():
    view = Known(np.array([1, 4, 5, 9]), np.arange(8.0, dtype=np.float32).reshape(4, 2))
    sampled = Sampled(view, np.array([0, 4, 8, 9]))
    for _ in range(2):
        index, values = sampled.read()
        np.testing.assert_array_equal(index, [1, 3])
        np.testing.assert_array_equal(values, view.values[[1, 3]])


def test_components_come_in_falling_energy_with_weights_up_to_one():
    factors = fitted(low_rank(5), 0.8, 5)
    np.testing.assert_allclose(np.abs(factors.weights).max(axis=0), 1.0, rtol=1e-5)
    spread = (factors.weights**2).sum(axis=0) * np.einsum("vkd,vkd->k", factors.basis, factors.basis)
    assert (np.diff(spread) <= 1e-3 * spread[0]).all()


def test_noise_is_averaged_out():
    clean = low_rank(2, rows=2000)
    noise = 0.5 * np.abs(clean).mean() * np.random.default_rng(1).normal(size=clean.shape).astype(np.float32)
    factors = fitted(clean + noise, 1.0, 2)
    assert relative(clean, factors) < 0.35 * np.linalg.norm(noise) / np.linalg.norm(clean)


def test_a_row_that_nobody_saw_is_empty_and_said_to_be():
    values = low_rank(2)
    views = [Known(np.arange(1, 300), view[1:]) for view in values]
    factors = finish(factorise(views, 300, 2, np.ones(10), np.ones(12)))
    assert not factors.known[0] and factors.known[1:].all()
    assert (factors.weights[0] == 0.0).all()


def test_heavier_columns_are_fitted_better():
    random = np.random.default_rng(2)
    values = random.normal(size=(4, 400, 6)).astype(np.float32)
    columns = np.array([100.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    guess = np.einsum("nk,vkd->vnd", *(getattr(fitted(values, 1.0, 5, columns), name) for name in ("weights", "basis")))
    errors = ((guess - values) ** 2).mean(axis=(0, 1))
    assert errors[0] < 0.2 * errors[1:].min()


def test_rows_are_fitted_where_they_count():
    """Two views that contradict each other: each row follows the one in which it counts."""
    random = np.random.default_rng(4)
    truth, other = random.normal(size=(2, 6, 300, 8)).astype(np.float32)
    basis = random.normal(size=(6, 2, 8)).astype(np.float32)
    rows = random.normal(size=(300, 2)).astype(np.float32)
    truth = np.einsum("nk,vkd->vnd", rows, basis)
    wrong = random.random((6, 300)) < 0.3
    values = np.where(wrong[..., None], other, truth)
    weights = np.where(wrong, 1e-6, 1.0)
    found = finish(factorise(seen(values, 1.0), 300, 2, weights, np.ones(8)))
    assert relative(truth, found) < 0.02 < 0.3 < relative(truth, fitted(values, 1.0, 2))


def test_nothing_but_zeros_stays_nothing():
    made = finish(factorise([Known(np.arange(5), np.zeros((5, 2), np.float32))] * 3, 5, 2, np.ones(3), np.ones(2)))
    assert not made.weights.any() or not made.basis.any()
    assert np.isfinite(made.weights).all() and np.isfinite(made.basis).all()


@pytest.mark.parametrize("rows", [300, 9000])
def test_one_column_a_view_is_factorised_as_any_matrix_is(rows):
    """By another way, which comes to the same errors, sampled rows (9,000 are more than a sample) and gaps included."""
    values = low_rank(3, rows=rows, views=40, columns=1)
    views = seen(values, 0.6)
    known = np.zeros(values.shape[:2], np.float32)
    for place, view in enumerate(views):
        known[place, view.index] = 1.0
    angles = np.linspace(0.5, 1.5, len(values))
    for components in (2, 3):
        of_any = finish(factorise(views, rows, components, angles, np.ones(1)))
        made = finish(factorise_columns(HeldColumns(values[..., 0], known * angles[:, None].astype(np.float32)), components))
        assert made.basis.shape == of_any.basis.shape
        np.testing.assert_array_equal(made.known, of_any.known)
        assert relative(values, made) == pytest.approx(relative(values, of_any), rel=0.02, abs=2e-3)


def test_columns_that_nobody_knows_are_empty():
    made = finish(factorise_columns(HeldColumns(*np.zeros((2, 5, 20), np.float32)), 2))
    assert not made.known.any() and not made.weights.any() and np.isfinite(made.basis).all()
