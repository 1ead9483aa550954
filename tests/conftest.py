"""Fixtures of all tests, the order in which tests run, and the list of what was left out."""

import os
import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator

import hypothesis
import pytest

import environment

BEYOND_CORE = re.compile(r"\b(bpy|empty_scene|environment|extension|gui|scheduler|subprocess)\b")

# Before anything imports bpy: tests neither read nor change the settings of the Blender on this machine, and those that run side by side
# have temporary folders of their own.
OWN_FOLDER = tempfile.mkdtemp(prefix="farfield-tests-")
os.environ["BLENDER_USER_RESOURCES"] = OWN_FOLDER
for variable in ("TMPDIR", "TEMP", "TMP"):
    os.environ[variable] = tempfile.tempdir = OWN_FOLDER

environment.import_farfield()
hypothesis.settings.register_profile("patient", hypothesis.settings.default, deadline=None)  # machines are shared: no test fails on time
hypothesis.settings.load_profile("patient")


@pytest.fixture(scope="session")
def extension() -> Iterator:
    """The package `farfield`, registered in Blender once for the whole run. Taken back at the end, or Blender 4.5 hangs on leaving."""
    package = environment.import_farfield()
    pytest.importorskip("bpy")
    package.register()
    yield package
    package.unregister()


@pytest.fixture
def empty_scene(extension):
    """An empty scene in factory settings, with Farfield registered."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


@pytest.fixture
def scheduler(tmp_path) -> Iterator:
    """A Dask scheduler of one's own on this machine, see `dask_farm.Farm`; the test is skipped where Dask is not installed."""
    pytest.importorskip("distributed")
    from dask_farm import Farm

    farm = Farm(tmp_path)
    yield farm
    farm.close()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Fast tests first: who runs the suite sees what is broken soon. Side by side, files begin in that order and stay whole, for the
    fixtures that their tests share. Files that ask for nothing outside the core get its mark."""
    of_core = {path: not BEYOND_CORE.search(path.read_text(encoding="utf-8")) for path in {item.path for item in items}}
    for item in items:
        if of_core[item.path]:
            item.add_marker("core")
    items.sort(key=lambda item: 2 if item.get_closest_marker("gui") else 1 if item.get_closest_marker("slow") else 0)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say aloud what was left out and why, above the last line."""
    reasons = Counter(_reason(report) for report in terminalreporter.stats.get("skipped", []))
    if not reasons:
        terminalreporter.write_sep("=", "nothing was left out", green=True)
        return
    terminalreporter.write_sep("=", f"LEFT OUT: {sum(reasons.values())} tests", yellow=True, bold=True)
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f"{count:5d}  {reason}", yellow=True)


def pytest_unconfigure() -> None:
    """Remove the tests' own folder."""
    shutil.rmtree(OWN_FOLDER, ignore_errors=True)


def _reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    where, _, reason = report.longrepr if isinstance(report.longrepr, tuple) else (report.nodeid, 0, str(report.longrepr))
    return f"{reason.removeprefix('Skipped: ')} ({os.path.relpath(where, environment.ROOT)})"
