"""A Dask scheduler and workers as processes on this machine, started as a user would."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

SECONDS = 60.0  # that starting may take


class Farm:
    """One scheduler on a free port of 127.0.0.1, without workers at first."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "scheduler.json"
        self._folder = folder
        self._processes: list[subprocess.Popen] = []
        self._start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(self._file))
        self.address = self._wait(lambda: json.loads(self._file.read_text())["address"])

    def start_workers(self, count: int) -> None:
        """Start so many workers of one thread each, and wait until they are there."""
        from distributed import Client

        for _ in range(count):
            self._start(
                "worker", "--scheduler-file", str(self._file), "--nthreads", "1", "--no-nanny", "--local-directory", str(self._folder)
            )
        with Client(self.address, timeout=SECONDS, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=SECONDS)

    def close(self) -> None:
        """End all of it."""
        for process in self._processes:
            process.kill()
            process.wait()
        self._processes.clear()

    def _start(self, what: str, *arguments: str) -> None:
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", *arguments, "--no-dashboard"]
        variables = os.environ | {"DASK_DISTRIBUTED__WORKER__MEMORY__TERMINATE": "False"}
        self._processes.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=variables))

    def _wait(self, look):
        started = time.monotonic()
        while True:
            try:
                return look()
            except (OSError, ValueError, KeyError):
                assert time.monotonic() - started < SECONDS, "the scheduler does not start"
                time.sleep(0.05)
