"""Long tasks side by side in threads, as one task."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from threading import Event, Lock

from ..errors import Cancelled
from .chunks import MAX_THREADS, blas_thread_limit
from .progress import NOTHING_CHANGED, Progress, Result, Steps, run_to_end


def run_in_parallel(tasks: Sequence[Steps[Result]]) -> Steps[list[Result]]:
    """Run `tasks` that do not depend on each other, at most MAX_THREADS at once, and return their results in order.

    The first tasks begin first. NumPy releases the GIL; its matrix products use one thread meanwhile, see `map_ordered`. If this task is
    closed, or one of the tasks raises an exception, the others end before their next step.
    """
    if len(tasks) == 1:
        return [(yield from tasks[0])]
    fractions, lock, is_cancelled = [0.0] * len(tasks), Lock(), Event()
    messages: SimpleQueue[Progress | int] = SimpleQueue()  # progress, and the indices of tasks that have ended

    def run(index: int) -> Result:
        def report(progress: Progress) -> None:
            if is_cancelled.is_set():
                raise Cancelled(NOTHING_CHANGED)
            with lock:
                fractions[index] = progress.fraction
                messages.put(Progress(sum(fractions) / len(tasks), progress.label))

        try:
            return run_to_end(tasks[index], report)
        finally:
            fractions[index] = 1.0
            messages.put(index)

    threads = ThreadPoolExecutor(min(os.cpu_count() or 1, MAX_THREADS), thread_name_prefix="farfield-steps")
    with blas_thread_limit.limit_to_one():
        try:
            futures = [threads.submit(run, index) for index in range(len(tasks))]
            results = {}
            while len(results) < len(tasks):
                message = messages.get()
                if isinstance(message, int):
                    results[message] = futures[message].result()
                else:
                    yield message
            return [results[index] for index in range(len(tasks))]
        finally:
            is_cancelled.set()
            threads.shutdown(wait=True, cancel_futures=True)
            for task in tasks:
                task.close()
