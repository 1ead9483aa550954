"""Work in chunks gives the same result as without chunks, on any number of cores."""

import os
from threading import Barrier

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info, threadpool_limits

from farfield.addon.core.jobs import chunks
from farfield.addon.core.jobs.chunks import MAX_THREADS, map_chunks, map_ordered


def squares(rows: np.ndarray) -> np.ndarray:
    return rows**2


@given(st.integers(0, 40), st.integers(1, 50))
def test_any_chunk_size_gives_the_same_result(count, size):
    rows = np.arange(3.0 * count).reshape(count, 3)
    np.testing.assert_array_equal(map_chunks(squares, rows, size), squares(rows))


@pytest.mark.parametrize("cores", [1, 2, 7])
def test_any_number_of_cores_gives_the_same_bytes(cores, monkeypatch):
    rows = np.random.default_rng(0).normal(size=(1000, 4))
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    assert map_chunks(np.sin, rows, 64).tobytes() == np.sin(rows).tobytes()


def test_an_exception_in_one_chunk_propagates():
    def reject_large(rows: np.ndarray) -> np.ndarray:
        if rows.max() > 50:
            raise ValueError("too large")
        return rows

    with pytest.raises(ValueError, match="too large"):
        map_chunks(reject_large, np.arange(100), 10)


@given(st.integers(0, 60))
def test_map_ordered_keeps_the_order(count):
    assert list(map_ordered(lambda value: value**2, range(count))) == [value**2 for value in range(count)]


def test_map_ordered_runs_ahead_but_not_far():
    started = []
    results = map_ordered(started.append, range(1000))
    for _ in range(3):
        next(results)
    results.close()
    assert len(started) <= 3 + MAX_THREADS + 1


def test_map_ordered_runs_several_items_at_once(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    barrier = Barrier(2, timeout=30)
    assert sorted(map_ordered(lambda _: barrier.wait(), range(2))) == [0, 1]


def test_map_ordered_raises_an_exception_in_place_of_its_result():
    def reject(value):
        if value == 5:
            raise ValueError("five")
        return value

    results = []
    with pytest.raises(ValueError, match="five"):
        for result in map_ordered(reject, range(10)):
            results.append(result)
    assert results == list(range(5))


def test_map_ordered_restores_the_threads_of_numpy():
    def threads() -> list[int]:
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    with threadpool_limits(2, "blas"):
        before = threads()
        first, second = (map_ordered(lambda value: value, range(100)) for _ in range(2))
        next(first), next(second)
        assert threads() == [1] * len(before)
        first.close()  # the one that set the limit
        assert threads() == [1] * len(before)
        second.close()
        assert threads() == before


def test_map_ordered_works_without_threadpoolctl(monkeypatch):
    monkeypatch.setattr(chunks, "ThreadpoolController", None)
    assert list(map_ordered(lambda value: value + 1, range(20))) == list(range(1, 21))
