"""Work on many rows in chunks, on all CPU cores. The results do not depend on the number of cores."""

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from itertools import chain, islice
from threading import Lock
from typing import Any, TypeVar

import numpy as np

try:
    from threadpoolctl import ThreadpoolController
except ImportError:  # a Blender without the wheels of the extension: slower, with the same results
    ThreadpoolController = None

MAX_THREADS = 4  # Each thread holds the memory of its item, and finished results are queued as well.

Item = TypeVar("Item")
Result = TypeVar("Result")


def slices(count: int, size: int) -> list[slice]:
    """Return slices of `size` rows that cover `count` rows; the last one may extend past the end."""
    return [slice(start, start + size) for start in range(0, count, size)]


def map_chunks(function: Callable[[np.ndarray], np.ndarray], rows: np.ndarray, size: int) -> np.ndarray:
    """Apply `function` to chunks of `size` rows on all cores (NumPy releases the GIL) and concatenate the results in order.

    `function` maps (K, ...) to (K, ...) row by row, so the result does not depend on the chunks.
    """
    chunks = [rows[chunk] for chunk in slices(max(len(rows), 1), size)]
    if len(chunks) == 1:
        return function(chunks[0])
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        return np.concatenate(list(threads.map(function, chunks)))


def map_ordered(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield `function(item)` for each of `items` in order, computed a few items ahead by at most MAX_THREADS threads.

    An exception of `function` is raised in place of its result; items not yet requested are then dropped. NumPy releases the GIL. Its
    matrix products use one thread meanwhile, in the whole process: BLAS threads and these threads would wait for each other.
    """
    count = min(os.cpu_count() or 1, MAX_THREADS)
    remaining = iter(items)
    first = list(islice(remaining, 2))
    if len(first) < 2:  # not worth a thread
        with blas_thread_limit.limit_to_one():
            yield from map(function, first)
        return
    pending: deque[Future[Result]] = deque()
    threads = ThreadPoolExecutor(count, thread_name_prefix="farfield-map")
    with blas_thread_limit.limit_to_one():
        try:
            for item in chain(first, remaining):
                pending.append(threads.submit(function, item))
                if len(pending) > count:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            threads.shutdown(wait=True, cancel_futures=True)


@lru_cache(maxsize=1)
def _thread_pools(_loaded_module_count: int) -> Any:
    """Return the thread pools of the loaded libraries. Finding them takes 2 ms; more of them come only with modules loaded later."""
    return ThreadpoolController()


class BlasThreadLimit:
    """Limits the matrix products of NumPy to one thread while at least one user asks for it."""

    def __init__(self) -> None:
        self._lock, self._users = Lock(), 0
        self._limit: Any = None

    @contextmanager
    def limit_to_one(self) -> Iterator[None]:
        """Limit BLAS to one thread. The first user sets the limit, the last one restores it."""
        if ThreadpoolController is None:
            yield
            return
        with self._lock:
            if self._users == 0:
                self._limit = _thread_pools(len(sys.modules)).select(user_api="blas").limit(limits=1)
            self._users += 1
        try:
            yield
        finally:
            with self._lock:
                self._users -= 1
                if self._users == 0:
                    self._limit.restore_original_limits()


blas_thread_limit = BlasThreadLimit()  # one for the process, as the limit is
