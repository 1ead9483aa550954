"""A task pool of processes on this machine that live over several runs; see `task_pool`."""

import json
import os
import subprocess
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..errors import Cancelled, FarfieldError
from ..files.file_access import error_reason
from .core_worker import EXIT_ERROR, EXIT_EXCEPTION, failure_message, worker_exception
from .heartbeat import Heartbeat
from .progress import Progress, Steps
from .subprocess_pool import NO_WINDOW, TEMPORARY_FOLDER_VARIABLES
from .task_worker import read_reply

POLL_SECONDS = 0.1  # between two progress updates
EXIT_SECONDS = 10.0  # from the end of the output of a process until it is killed
MAX_BATCH_ITEMS = 32  # per request: the last requests of a run have one item, so that all processes end at the same time
BATCHES_PER_PROCESS = 4  # that the remaining items are enough for


class ProcessTaskPool:
    """Gives items to up to `slots` processes that run `command`; see `TaskPool`. Each has a thread of this process while it works."""

    def __init__(self, command: list[str], slots: int, held: Heartbeat, temporary_folder: Path, items_name: str) -> None:
        self._command, self._slots, self._held = command, slots, held
        self._folder, self._items_name = temporary_folder, items_name
        self._lock = threading.Lock()
        self._workers: set[_Worker] = set()  # all that have not ended
        self._idle: list[_Worker] = []
        self._started_count = 0
        self._is_stopping = False

    def run(self, items: Sequence[Any], label: str) -> Steps[list[Any]]:
        """Give the items to the processes; see `TaskPool.run`."""
        replies: dict[int, Any] = {}
        is_finished = False
        threads = ThreadPoolExecutor(self._slots, thread_name_prefix="farfield-task")
        try:
            pending = {
                threads.submit(self._run_batch, {index: items[index] for index in batch}, replies)
                for batch in split_into_batches(len(items), self._slots)
            }
            while pending:
                self._held.renew()
                yield Progress(len(replies) / len(items), label)
                done, pending = wait(pending, POLL_SECONDS, FIRST_EXCEPTION)
                for future in done:
                    future.result()
            is_finished = True
        finally:
            if not is_finished:
                self._stop(threads)
            threads.shutdown(wait=True)
        return [replies[index] for index in range(len(items))]

    def close(self) -> None:
        """Kill the processes and start no more."""
        with self._lock:
            self._is_stopping = True
            for worker in self._workers:
                worker.process.kill()
        for worker in list(self._workers):
            self._end(worker)

    def _run_batch(self, batch: dict[int, Any], replies: dict[int, Any]) -> None:
        """Have a process reply to the items in `batch`, and another one to the remaining items if it crashes. Called in a thread."""
        suspect = None  # the item at which the last process crashed
        while batch:
            worker = self._take_worker()
            for index, line in zip(list(batch), worker.exchange(list(batch.values())), strict=False):
                replies[index] = read_reply(line)
                del batch[index]
            if not batch:
                self._idle.append(worker)
                return
            code, error_output = self._end(worker)
            if self._is_stopping:
                raise Cancelled("Cancelled before it was finished.")
            self._held.renew()  # first: workers also exit when another run has taken over
            if code == EXIT_EXCEPTION:
                raise worker_exception(error_output, self._items_name)
            first = next(iter(batch))
            if code == EXIT_ERROR or first == suspect:
                raise FarfieldError(failure_message(code, error_output, self._items_name))
            suspect = first

    def _take_worker(self) -> "_Worker":
        """Return an idle process, or start one."""
        with self._lock:  # also because a process on Windows may inherit the pipes of another one that is started at the same time
            if self._is_stopping:
                raise Cancelled("Cancelled before it was started.")
            while self._idle:
                worker = self._idle.pop()
                if worker.process.poll() is None:
                    return worker
                self._workers.discard(worker)  # it has ended by itself, for instance because nobody renewed the heartbeat between two runs
                worker.wait_for_exit()
            worker = _Worker(self._command, self._folder / f"worker-{self._started_count}")
            self._started_count += 1
            self._workers.add(worker)
            return worker

    def _stop(self, threads: ThreadPoolExecutor) -> None:
        """Kill the processes, and wait for the threads that use them. The next run starts new processes."""
        self.close()
        threads.shutdown(wait=True, cancel_futures=True)
        self._is_stopping = False

    def _end(self, worker: "_Worker") -> tuple[int, str]:
        """Wait for a process that ends or was killed. Return its exit code and its output on stderr."""
        outcome = worker.wait_for_exit()
        with self._lock:
            self._workers.discard(worker)
            if worker in self._idle:
                self._idle.remove(worker)
        return outcome


class _Worker:
    """A process, and the file that its stderr goes to."""

    def __init__(self, command: list[str], folder: Path) -> None:
        """Start the process; its temporary files and its messages go to the new `folder`. Raises FarfieldError."""
        self._error_path = folder / "stderr"
        try:
            folder.mkdir()
            with self._error_path.open("wb") as error_stream:
                self.process = subprocess.Popen(
                    command,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=error_stream,
                    env=os.environ | dict.fromkeys(TEMPORARY_FOLDER_VARIABLES, str(folder)),
                    creationflags=NO_WINDOW,
                )
        except OSError as error:
            raise FarfieldError(f"A worker process cannot be started: {error_reason(error)}.") from error

    def exchange(self, items: list[Any]) -> Iterator[bytes]:
        """Send the items; yield a line per reply. Fewer lines than items: the process has ended."""
        try:
            self.process.stdin.write(json.dumps(items).encode() + b"\n")
            self.process.stdin.flush()
        except OSError:  # the pipe is broken
            return
        for _ in items:
            line = self.process.stdout.readline()
            if not line.endswith(b"\n"):
                return
            yield line

    def wait_for_exit(self) -> tuple[int, str]:
        """Wait for a process that has been killed or has closed its stdout. Return its exit code and its output on stderr."""
        try:
            code = self.process.wait(EXIT_SECONDS)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = self.process.wait()
        self.process.stdout.close()
        with suppress(OSError):  # unsent bytes
            self.process.stdin.close()
        return code, self._error_path.read_bytes().decode("utf-8", errors="replace")


def split_into_batches(count: int, slots: int) -> list[range]:
    """Split the indices 0..count-1 into batches in order, long ones first: many short items cost few exchanges, and few long items are
    spread evenly."""
    batches, start = [], 0
    while start < count:
        size = min(max((count - start) // (BATCHES_PER_PROCESS * slots), 1), MAX_BATCH_ITEMS)
        batches.append(range(start, start + size))
        start += size
    return batches
