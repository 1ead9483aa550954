"""Work that spreads over cores and machines. Equal input gives equal bytes, serial or spread."""

import os
import re
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import Any, TypeVar

import numpy as np

try:
    from threadpoolctl import ThreadpoolController
except ImportError:  # a Blender without what our zip brings along: slower, with the same results
    ThreadpoolController = None

from .errors import FarfieldError, SettingsError

MOST_BY_ITSELF = 8  # processes that the word `processes` starts: each holds the scene, and so its memory
ANSWER = 5.0  # seconds within which a scheduler has to answer
MOST_AHEAD = 4  # threads of `mapped`: each holds what its item takes, and results wait besides
WORD = re.compile(r"(serial)|processes(?::([1-9]\d{0,3}))?|dask:(\w+://[^\s/]+:\d+)")

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_chunks(function: Callable[[np.ndarray], np.ndarray], rows: np.ndarray, size: int) -> np.ndarray:
    """`function` applied to `rows` in runs of `size`, on all cores (NumPy lets go of the interpreter), results joined in order.

    `function` maps (K, ...) to (K, ...) row by row, so the result does not depend on the cutting.
    """
    parts = [rows[start : start + size] for start in range(0, max(len(rows), 1), size)]
    if len(parts) == 1:
        return function(parts[0])
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        return np.concatenate(list(threads.map(function, parts)))


def slices(count: int, size: int) -> list[slice]:
    """`count` rows in runs of `size`; the last may reach beyond them, as slices may."""
    return [slice(start, start + size) for start in range(0, count, size)]


def mapped(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """`function` of each of `items` in their order, a few ahead of what is asked for, on MOST_AHEAD cores at most.

    What `function` raises passes on where its result would have come; items that are not asked for any more are dropped. NumPy lets go of
    the interpreter; its matrix products have one thread each meanwhile, in all of the process: theirs and ours would wait for each other.
    """
    count = min(os.cpu_count() or 1, MOST_AHEAD)
    waiting: deque[Future[Result]] = deque()
    threads = ThreadPoolExecutor(count, thread_name_prefix="farfield-mapped")
    with _products.in_one_thread():
        try:
            for item in items:
                waiting.append(threads.submit(function, item))
                if len(waiting) > count:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            threads.shutdown(wait=True, cancel_futures=True)


class _Products:
    """How many threads NumPy's matrix products have: one, as long as anyone wants it so."""

    def __init__(self) -> None:
        self._lock, self._users = Lock(), 0
        self._limit: Any = None

    @contextmanager
    def in_one_thread(self) -> Iterator[None]:
        """The first who comes sets the number, the last who leaves sets it back."""
        if ThreadpoolController is None:
            yield
            return
        with self._lock:
            if self._users == 0:
                self._limit = ThreadpoolController().select(user_api="blas").limit(limits=1)
            self._users += 1
        try:
            yield
        finally:
            with self._lock:
                self._users -= 1
                if self._users == 0:
                    self._limit.restore_original_limits()


_products = _Products()


@dataclass(frozen=True)
class Spread:
    """An executor and what it is like. Its tasks must wait for processes of their own: here they are threads.

    slots: tasks that run at a time. sharing: how many of these share a machine, at most. here: whether that is this machine; elsewhere a
    task is a function of the standard library, since nothing else need be there.
    """

    executor: Executor
    slots: int
    sharing: int
    here: bool


@dataclass(frozen=True)
class Word:
    """What a user's word for an executor means: so many processes of this machine, or the scheduler at an address."""

    processes: int
    scheduler: str | None


def read_word(word: str) -> Word:
    """The meaning of `serial`, `processes`, `processes:N` or `dask:tcp://HOST:PORT`.

    Raises:
        SettingsError: when `word` is none of these.
    """
    found = WORD.fullmatch(word.strip())
    if found is None:
        raise SettingsError(f'--executor is "{word}"; it must be serial, processes, processes:N with N from 1 on, or dask:tcp://HOST:PORT.')
    serial, count, scheduler = found.groups()
    by_itself = min(os.cpu_count() or 1, MOST_BY_ITSELF)
    return Word(1 if serial else int(count) if count else by_itself, scheduler)


@contextmanager
def open_executor(word: str) -> Iterator[Spread]:
    """The executor that `word` names, see `read_word`; tasks that have not begun when the block ends never will.

    Raises:
        SettingsError: when `word` has no meaning.
        FarfieldError: when Dask is not installed, or no scheduler with workers answers.
    """
    meaning = read_word(word)
    if meaning.scheduler is not None:
        with _client(meaning.scheduler) as client:
            threads = client.nthreads()
            machines = Counter()
            for address, count in threads.items():
                machines[address.rpartition(":")[0]] += count
            if not threads:
                raise FarfieldError(f'The Dask scheduler at "{meaning.scheduler}" has no workers; start some and bake again.')
            executor = client.get_executor(pure=False)
            try:
                yield Spread(executor, sum(threads.values()), max(machines.values()), here=False)
            finally:
                executor.shutdown(wait=False)  # which cancels
        return
    executor = ThreadPoolExecutor(meaning.processes, thread_name_prefix="farfield-task")
    try:
        yield Spread(executor, meaning.processes, meaning.processes, here=True)
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _client(address: str) -> Iterator[Any]:
    """A client of the Dask scheduler at `address`."""
    try:
        import distributed
    except ImportError:
        raise FarfieldError(
            "Dask is not installed for this Python; install the package distributed there, or use --executor processes."
        ) from None
    try:
        client = distributed.Client(address, timeout=ANSWER, set_as_default=False)
    except (OSError, ValueError) as error:
        raise FarfieldError(
            f'No Dask scheduler answers at "{address}" within {ANSWER:g} seconds; start one there, or use --executor processes.'
        ) from error
    try:
        yield client
    finally:
        client.close(timeout=ANSWER)
