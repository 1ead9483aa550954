"""A Dask scheduler and workers as processes on this machine, started like a user would."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

START_SECONDS = 60.0  # timeout


class DaskFarm:
    """One scheduler on a free port of 127.0.0.1, without workers at first."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "scheduler.json"
        self._folder = folder
        self._processes: list[subprocess.Popen] = []
        self._start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(self._file))
        self.address = self._wait(lambda: json.loads(self._file.read_text())["address"])

    def start_workers(self, count: int) -> None:
        """Start `count` workers of one thread each, and wait until they are connected."""
        from distributed import Client

        for _ in range(count):
            self._start(
                "worker", "--scheduler-file", str(self._file), "--nthreads", "1", "--no-nanny", "--local-directory", str(self._folder)
            )
        with Client(self.address, timeout=START_SECONDS, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=START_SECONDS)

    def close(self) -> None:
        """Kill the scheduler and all workers."""
        for process in self._processes:
            process.kill()
            process.wait()
        self._processes.clear()

    def _start(self, command_name: str, *arguments: str) -> None:
        command = [sys.executable, "-m", f"distributed.cli.dask_{command_name}", *arguments, "--no-dashboard"]
        environment = os.environ | {"DASK_DISTRIBUTED__WORKER__MEMORY__TERMINATE": "False"}
        self._processes.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment))

    def _wait(self, read):
        started = time.monotonic()
        while True:
            try:
                return read()
            except (OSError, ValueError, KeyError):
                assert time.monotonic() - started < START_SECONDS, "the scheduler has not started"
                time.sleep(0.05)
