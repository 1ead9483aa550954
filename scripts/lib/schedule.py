"""Pytest plugin: measures the tests, and orders the files that parallel processes run. Option `-p lib.schedule`.

All processes are busy to the end, and each stays within one folder while it can.
"""

import os
from collections import Counter
from contextlib import suppress

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

from .durations import Durations, folder_of

DURATIONS = "farfield-durations"  # the name of a plugin
MAX_PROCESSES = 4


class LongestFirst(LoadFileScheduling):
    """Gives each process the longest file that is left of its folder, because the tests of a folder share data that takes long to make.

    When nothing is left there, it continues with the folder that has the most work left: if possible, one where no other process works.
    Files are not split, because their tests share fixtures.
    """

    def __init__(self, config: pytest.Config, log: Producer | None, durations: Durations) -> None:
        super().__init__(config, log)
        self._durations = durations
        self._seconds: dict[str, float] = {}
        self._folders: dict[WorkerController, str] = {}

    def _assign_work_unit(self, node: WorkerController) -> None:
        if not self._seconds:
            self._seconds = {file: self._durations.expect(tests) for file, tests in self.workqueue.items()}
        folders: Counter[str] = Counter()
        for file in self.workqueue:
            folders[folder_of(file)] += self._seconds[file]
        taken = {self._folders[other] for other in self.nodes if other is not node and other in self._folders}
        folder = self._folders.get(node)
        if folder not in folders:
            folder = max(folders, key=lambda name: (name not in taken, folders[name]))
        self._folders[node] = folder
        longest = max((file for file in self.workqueue if folder_of(file) == folder), key=self._seconds.__getitem__)
        self.workqueue.move_to_end(longest, last=False)
        with suppress(OSError):  # The process has crashed just now. xdist notices that next, and takes the file back.
            super()._assign_work_unit(node)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that writes how long the tests took."""
    parser.addoption("--record", action="store_true", help="write how long the tests took to tests/durations.json and docs/results")


def pytest_configure(config: pytest.Config) -> None:
    """Measure the tests, in the controlling process."""
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Durations(), DURATIONS)


@pytest.hookimpl(optionalhook=True, tryfirst=True)
def pytest_xdist_auto_num_workers() -> int:
    """Start one process more than there are cores, because some tests wait for other processes and for times to pass. Each process loads a
    Blender, so there are at most MAX_PROCESSES."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores + 1, MAX_PROCESSES)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LongestFirst:
    """Make parallel runs use this schedule."""
    return LongestFirst(config, log, config.pluginmanager.get_plugin(DURATIONS))
