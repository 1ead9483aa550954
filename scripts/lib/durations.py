"""How long the tests take: what a run measured, and what the next one may expect.

The cache of pytest keeps the seconds of each test. For a checkout that has none, `tests/durations.json` has those of the slowest files.
`scripts/test.py --record` writes this table and the page `docs/results/tests.md`.
"""

import json
import os
import platform
import time
from collections import Counter
from collections.abc import Collection
from datetime import date
from typing import NamedTuple

import pytest

from . import environment

TABLE = environment.ROOT / "tests" / "durations.json"
PAGE = environment.ROOT / "docs" / "results" / "tests.md"
CACHE_KEY = "farfield/durations"
UNKNOWN_SECONDS = 0.05  # A test that no run has measured is expected to take this long.
MIN_TABLE_SECONDS = 1.0  # Shorter files are not in the table.
SLOWEST_TESTS, SLOWEST_FOLDERS = 20, 12  # These many are on the page.


class Measurement(NamedTuple):
    """What a run needed.

    Attributes:
        tests: seconds by ID.
        wall_seconds: from its start to its end.
        processor_seconds: the sum of all processes.
        idle_seconds: between the last test of the process that ended first and that of the one that ended last.
        processes: their number.
        skipped: the number of skipped tests.
    """

    tests: dict[str, float]
    wall_seconds: float
    processor_seconds: float
    idle_seconds: float
    processes: int
    skipped: int


class Durations:
    """Measures the tests of a run, and estimates those of the next one."""

    def __init__(self) -> None:
        self._expected: dict[str, float] = {}
        self._expected_of_files: dict[str, float] = json.loads(TABLE.read_text(encoding="utf-8")) if TABLE.is_file() else {}
        self._measured: Counter[str] = Counter()
        self._ends: dict[str, float] = {}
        self._skipped: set[str] = set()
        self._start = time.monotonic()

    def pytest_configure(self, config: pytest.Config) -> None:
        """Read what earlier runs measured."""
        if hasattr(config, "cache"):  # -p no:cacheprovider turns it off
            self._expected = config.cache.get(CACHE_KEY, {})

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add the duration of a test, its setup or its teardown."""
        self._measured[report.nodeid] += report.duration
        self._ends[getattr(report, "worker_id", "")] = time.monotonic()
        if report.skipped:
            self._skipped.add(report.nodeid)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Keep what was measured for the next run."""
        if hasattr(session.config, "cache"):
            session.config.cache.set(CACHE_KEY, self._expected | {test: round(seconds, 3) for test, seconds in self._measured.items()})

    def pytest_unconfigure(self, config: pytest.Config) -> None:
        """Write the table and the page. The other processes have ended, so that their processor time is known."""
        if config.option.record and self._measured:
            TABLE.write_text(to_table(self._measured), encoding="utf-8")
            PAGE.write_text(to_page(self.measurement()), encoding="utf-8")

    def expect(self, tests: Collection[str]) -> float:
        """Return the seconds that tests of one file will probably take."""
        known = [self._expected[test] for test in tests if test in self._expected]
        unknown = UNKNOWN_SECONDS * (len(tests) - len(known))
        return sum(known) + unknown if known else self._expected_of_files.get(file_of(next(iter(tests))), unknown)

    def measurement(self) -> Measurement:
        """Return what this run has needed so far."""
        times = os.times()
        processor_seconds = times.user + times.system + times.children_user + times.children_system
        idle_seconds = max(self._ends.values()) - min(self._ends.values())
        wall_seconds = time.monotonic() - self._start
        return Measurement(dict(self._measured), wall_seconds, processor_seconds, idle_seconds, len(self._ends), len(self._skipped))


def file_of(test: str) -> str:
    """Return the file of a test, by its ID."""
    return test.partition("::")[0]


def folder_of(test: str) -> str:
    """Return the folder of a test or of its file, at most two levels deep."""
    return "/".join(file_of(test).split("/")[:-1][:2])


def to_table(tests: dict[str, float]) -> str:
    """Return the seconds of the slowest files as JSON, longest first."""
    files: Counter[str] = Counter()
    for test, seconds in tests.items():
        files[file_of(test)] += seconds
    return json.dumps({file: round(seconds, 1) for file, seconds in files.most_common() if seconds >= MIN_TABLE_SECONDS}, indent=1) + "\n"


def to_page(run: Measurement) -> str:
    """Return the page of the results in Markdown."""
    folders, counts = Counter[str](), Counter[str]()
    for test, seconds in run.tests.items():
        folders[folder_of(test)] += seconds
        counts[folder_of(test)] += 1
    machine = f"{run.processes} processes on {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"
    lines = [
        "# Results: Tests",
        f"`python3 scripts/test.py --record` on {date.today()}: {machine}. CONTRIBUTING.md says how to run them.",
        "",
        "| | |",
        "|---|---|",
        f"| tests, skipped | {len(run.tests):,}, {run.skipped:,} |",
        f"| time | {run.wall_seconds:.0f} s |",
        f"| processor time of all processes | {run.processor_seconds:.0f} s |",
        f"| a process was idle at the end for | {run.idle_seconds:.1f} s |",
        "",
        "## Slowest tests",
        "",
        "| seconds | test |",
        "|---|---|",
        *(f"| {seconds:.1f} | `{test}` |" for test, seconds in Counter(run.tests).most_common(SLOWEST_TESTS)),
        "",
        "## Folders",
        "",
        "| folder | tests | seconds |",
        "|---|---|---|",
        *(f"| `{folder}` | {counts[folder]:,} | {seconds:.0f} |" for folder, seconds in folders.most_common(SLOWEST_FOLDERS)),
    ]
    return "\n".join(lines) + "\n"
