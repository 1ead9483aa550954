"""Work in chunks is the work as a whole, on any number of cores."""

import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.parallel import in_chunks


def squares(rows: np.ndarray) -> np.ndarray:
    return rows**2


@given(st.integers(0, 40), st.integers(1, 50))
def test_any_cutting_gives_the_same(count, size):
    rows = np.arange(3.0 * count).reshape(count, 3)
    np.testing.assert_array_equal(in_chunks(squares, rows, size), squares(rows))


@pytest.mark.parametrize("cores", [1, 2, 7])
def test_any_number_of_cores_gives_equal_bytes(cores, monkeypatch):
    rows = np.random.default_rng(0).normal(size=(1000, 4))
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    assert in_chunks(np.sin, rows, 64).tobytes() == np.sin(rows).tobytes()


def test_an_error_in_one_chunk_comes_out():
    def refuse_large(rows: np.ndarray) -> np.ndarray:
        if rows.max() > 50:
            raise ValueError("too large")
        return rows

    with pytest.raises(ValueError, match="too large"):
        in_chunks(refuse_large, np.arange(100), 10)
