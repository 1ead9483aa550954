"""Work in chunks is the work as a whole, on any number of cores."""

import os
from threading import Barrier

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from farfield.addon.core import parallel
from farfield.addon.core.parallel import MOST_AHEAD, in_chunks, mapped


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


@given(st.integers(0, 60))
def test_mapped_results_come_in_order(count):
    assert list(mapped(lambda number: number**2, range(count))) == [number**2 for number in range(count)]


def test_mapped_works_ahead_but_not_far():
    begun = []
    results = mapped(begun.append, range(1000))
    for _ in range(3):
        next(results)
    results.close()
    assert len(begun) <= 3 + MOST_AHEAD + 1


def test_mapped_works_on_several_items_at_a_time(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    meeting = Barrier(2, timeout=30)
    assert sorted(mapped(lambda _: meeting.wait(), range(2))) == [0, 1]


def test_mapped_passes_an_error_on_where_its_result_would_have_come():
    def refuse(number):
        if number == 5:
            raise ValueError("five")
        return number

    got = []
    with pytest.raises(ValueError, match="five"):
        for result in mapped(refuse, range(10)):
            got.append(result)
    assert got == list(range(5))


def test_mapped_leaves_the_threads_of_numpy_as_they_were():
    def threads() -> list[int]:
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    with threadpool_limits(2, "blas"):
        before = threads()
        first, second = (mapped(lambda number: number, range(100)) for _ in range(2))
        next(first), next(second)
        assert threads() == [1] * len(before)
        first.close()  # the one that was there first
        assert threads() == [1] * len(before)
        second.close()
        assert threads() == before


def test_mapped_does_without_what_tells_numpy(monkeypatch):
    monkeypatch.setattr(parallel, "ThreadpoolController", None)
    assert list(mapped(lambda number: number + 1, range(20))) == list(range(1, 21))
