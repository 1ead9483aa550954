"""Local factors find the clusters that were put in, and are never worse where one set of components has to serve all."""

import numpy as np
import pytest

from farfield.addon.core.btf import lpca
from farfield.addon.core.btf.factors import factorise
from farfield.addon.core.btf.lpca import clustered, factorise_locally
from farfield.addon.core.btf.quality import quality
from farfield.addon.core.progress import finish
from known_views import Known, seen

VIEWS, ROWS, COLUMNS = 10, 600, 15


def patchwork(clusters: int, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Values (V, N, D) of rows in clusters, each of low rank, and the cluster of each row."""
    random = np.random.default_rng(3)
    labels = random.integers(clusters, size=ROWS)
    weights = random.normal(size=(ROWS, rank))
    basis = random.normal(size=(clusters, VIEWS, rank, COLUMNS))
    return np.einsum("nk,nvkd->vnd", weights, basis[labels]).astype(np.float32), labels


def fitted(views: list[Known], clusters: int, components: int):
    return finish(factorise_locally(views, ROWS, clusters, components, np.ones(VIEWS), np.ones(COLUMNS)))


def relative(values: np.ndarray, factors) -> float:
    guess = np.stack([factors.applied(basis) for basis in factors.basis])
    return float(np.linalg.norm(guess - values) / np.linalg.norm(values))


def agreement(found: np.ndarray, meant: np.ndarray) -> float:
    """The share of rows whose cluster is the one that most rows of their true cluster are in."""
    return float(np.mean([(found[meant == each] == np.bincount(found[meant == each]).argmax()).mean() for each in np.unique(meant)]))


@pytest.mark.parametrize("share", [1.0, 0.7])
def test_clusters_of_low_rank_are_recovered(share):
    values, labels = patchwork(clusters=3, rank=3)
    factors = fitted(seen(values, share), 3, 3)
    assert factors.clusters == 3 and factors.weights.shape == (ROWS, 3)
    assert agreement(factors.labels, labels) > 0.98
    assert relative(values, factors) < 0.15
    together = finish(factorise(seen(values, share), ROWS, 3, np.ones(VIEWS), np.ones(COLUMNS)))
    assert relative(values, together) > 0.5, "one set of as many components must not do for the test to say something"


def test_one_cluster_is_the_factors_of_all():
    values, _ = patchwork(clusters=2, rank=2)
    views = seen(values, 0.8)
    local, together = fitted(views, 1, 4), finish(factorise(views, ROWS, 4, np.ones(VIEWS), np.ones(COLUMNS)))
    np.testing.assert_array_equal(local.weights, together.weights)
    np.testing.assert_array_equal(local.basis, together.basis)
    assert local.clusters == 1 and not local.labels.any()


def test_equal_input_gives_equal_factors_however_much_is_held_at_once(monkeypatch):
    values, _ = patchwork(clusters=3, rank=2)
    views = seen(values, 0.8)
    first = fitted(views, 4, 2)
    for budget in (1.0, 60e3):
        monkeypatch.setattr(lpca, "BUDGET", budget)
        again = fitted(views, 4, 2)
        for name in ("weights", "basis", "labels", "known"):
            np.testing.assert_array_equal(getattr(first, name), getattr(again, name))


def test_a_view_that_does_not_show_a_cluster_takes_its_basis_from_the_others():
    values, labels = patchwork(clusters=2, rank=1)
    views = seen(values, 1.0)
    # A view like the first, from which nothing is seen of one cluster but what the factors of all rows say.
    others = np.flatnonzero(labels == 0)
    views.append(Known(others, values[0, others]))
    factors = finish(factorise_locally(views, ROWS, 2, 1, np.ones(VIEWS + 1), np.ones(COLUMNS)))
    assert agreement(factors.labels, labels) == 1.0
    np.testing.assert_allclose(factors.applied(factors.basis[-1])[others], values[0, others], rtol=0.05, atol=0.05)
    assert np.isfinite(factors.basis).all()
    unseen = factors.applied(factors.basis[-1])[labels == 1]
    assert np.abs(unseen).max() < 3.0 * np.abs(values).max()


def test_more_clusters_than_there_are_kinds_of_rows_do_no_harm():
    values, _ = patchwork(clusters=1, rank=1)
    factors = fitted(seen(values, 1.0), 8, 1)
    assert np.isfinite(factors.weights).all() and np.isfinite(factors.basis).all()
    assert relative(values, factors) < 0.05


def test_rows_that_nobody_saw_are_empty_and_said_to_be():
    values, _ = patchwork(clusters=2, rank=2)
    views = [Known(np.arange(1, ROWS), view[1:]) for view in values]
    factors = fitted(views, 2, 2)
    assert not factors.known[0] and factors.known[1:].all()
    assert (factors.weights[0] == 0.0).all()


def test_clusters_are_subspaces_not_distances():
    random = np.random.default_rng(0)
    labels = np.repeat([0, 1], 200)
    codes = np.zeros((400, 4), np.float32)
    codes[labels == 0, :2], codes[labels == 1, 2:] = random.normal(size=(200, 2)), random.normal(size=(200, 2))
    assert agreement(clustered(codes, 2, 2, 0), labels) == 1.0
    np.testing.assert_array_equal(clustered(codes, 2, 2, 7), clustered(codes, 2, 2, 7))


def test_quality_is_measured_with_the_components_of_each_cluster():
    values, _ = patchwork(clusters=2, rank=2)
    views = seen(values, 1.0)
    factors = fitted(views, 2, 2)
    fits = finish(quality(views, factors, np.ones((ROWS, 3)), np.ones(VIEWS), np.ones(COLUMNS)))
    assert [fit.components for fit in fits] == [0, 1, 2]
    assert fits[2].rms == pytest.approx(relative(values, factors) * np.sqrt((values**2).mean()), rel=1e-3)
    assert fits[2].rms < fits[1].rms < fits[0].rms
