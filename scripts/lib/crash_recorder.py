"""Which tests must run again after a test process has crashed."""

import pytest

SELECTION_VARIABLE = "FARFIELD_TESTS_TO_RUN"  # the path of a JSON list of test IDs; without it, all tests are selected


class CrashRecorder:
    """Records, in the controlling process, the tests that crashed and those that have no result because of it."""

    def __init__(self) -> None:
        self.crashed: list[str] = []
        self.failed: set[str] = set()
        self._collected: dict[str, None] = {}
        self._finished: set[str] = set()

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self, ids: list[str]) -> None:
        """Record the tests of a worker; all workers collect the same."""
        self._collected.update(dict.fromkeys(ids))

    @pytest.hookimpl(optionalhook=True)
    def pytest_handlecrashitem(self, crashitem: str) -> None:
        """Record a test in which a worker crashed."""
        self.crashed.append(crashitem)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Record the result of a test."""
        if report.when == "teardown":
            self._finished.add(report.nodeid)
        if report.failed:
            self.failed.add(report.nodeid)

    @property
    def other_failures(self) -> set[str]:
        """The tests that failed without a crash."""
        return self.failed - set(self.crashed)

    def tests_to_repeat(self) -> list[str]:
        """Return all tests of files that have a test without a result: the tests of a file share fixtures."""
        without_result = {_file(test) for test in self._collected if test not in self._finished} | {_file(test) for test in self.crashed}
        return [test for test in self._collected if _file(test) in without_result]


def _file(test: str) -> str:
    return test.partition("::")[0]
