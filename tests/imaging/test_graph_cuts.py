"""Minimal cuts are the minima of their energies."""

from itertools import product

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.imaging.graph_cuts import minimize_binary


def energy(values, linear, first, second, weights):
    return (linear * values).sum() + (weights * ~values[first] * values[second]).sum()


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(1, 7), st.integers(0, 12))
def test_the_result_is_the_minimum_over_all_values(seed, count, pairs):
    random = np.random.default_rng(seed)
    linear = random.integers(-20, 21, count).astype(float)
    first, second = random.integers(0, count, pairs), random.integers(0, count, pairs)
    differs = first != second
    first, second = first[differs], second[differs]
    weights = random.integers(0, 15, len(first)).astype(float)
    result = minimize_binary(linear, first, second, weights)
    lowest = min(energy(np.array(values), linear, first, second, weights) for values in product([False, True], repeat=count))
    assert energy(result, linear, first, second, weights) == lowest


def test_nothing_is_set_without_a_gain():
    assert not minimize_binary(np.array([0.0, 3.0]), np.array([0]), np.array([1]), np.array([2.0])).any()


def test_huge_terms_do_not_overflow():
    result = minimize_binary(np.array([-1e30, 1e30]), np.array([1, 0]), np.array([0, 1]), np.array([1.0, 1e30]))
    assert result.tolist() == [True, False]
