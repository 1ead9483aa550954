"""Fixtures of all tests, the order of the tests, and the list of skipped tests."""

import gc
import os
import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import compress
from pathlib import Path

import hypothesis
import pytest

from lib import blender_window, environment
from programs import describe_missing
from shared_results import FOLDER_VARIABLE

NEEDS_MORE_THAN_CORE = re.compile(r"\b(bpy|empty_scene|environment|extension|gui|scheduler|subprocess)\b")

# Before bpy is imported: tests neither read nor change the settings of an installed Blender, and parallel test processes have separate
# temporary folders.
TEMPORARY_FOLDER = tempfile.mkdtemp(prefix="farfield-tests-")
os.environ["BLENDER_USER_RESOURCES"] = TEMPORARY_FOLDER
os.environ[blender_window.CACHE_VARIABLE] = os.environ["LOCALAPPDATA"] = TEMPORARY_FOLDER
for variable in ("TMPDIR", "TEMP", "TMP"):
    os.environ[variable] = tempfile.tempdir = TEMPORARY_FOLDER

os.environ.setdefault(FOLDER_VARIABLE, TEMPORARY_FOLDER)  # the folder of the process that starts the others

environment.import_farfield()
environment.find_blender_modules()
# Machines are shared: no test fails for being slow.
hypothesis.settings.register_profile("no_deadline", hypothesis.settings.default, deadline=None)
hypothesis.settings.load_profile("no_deadline")
# Of collections of garbage, one in 70 is left. The collection of the tests and the syntax trees of all files otherwise take twice as long.
gc.set_threshold(50_000, 20, 20)
# Without --all, a test takes this fraction of the random examples that it asks for, but MIN_EXAMPLES if it asks for as many.
EXAMPLES_FRACTION, MIN_EXAMPLES = 0.1, 5


@pytest.fixture(scope="session")
def extension() -> Iterator:
    """The package `farfield`, registered in Blender once for the whole session. At the end it is unregistered, or Blender 4.5 hangs.

    Colors of clouds are fitted to fewer and smaller renders than usual, except in `test_luminance_fit`: 45 renders of a box would take
    three quarters of the time of its build. The nodes of the ground are made once per run: they would take most of the time of a small
    terrain.
    """
    package = environment.import_farfield()
    pytest.importorskip("bpy")
    package.register()
    from farfield.addon.bridge.billboards import luminance_fit
    from kept_ground import keep_ground_group

    with pytest.MonkeyPatch.context() as patch:
        keep_ground_group(patch)
        patch.setattr(luminance_fit, "VIEW_COUNT", 8)
        patch.setattr(luminance_fit, "RESOLUTION", 32)
        yield package
    package.unregister()


@pytest.fixture
def empty_scene(extension):
    """An empty scene, with Farfield registered. Preferences stay those of the factory unless a test changes them: loading these again would
    take five times as long, for each of a thousand tests."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return bpy.context.scene


@pytest.fixture(scope="module")
def few_samples() -> Iterator[None]:
    """Fit levels to few points, and compare few, for promises that do not depend on how near they are to their source."""
    from farfield.addon.core.texmesh import corner_attributes
    from farfield.addon.core.texmesh.refitting import comparison, refit

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(refit, "TUNING", replace(refit.TUNING, min_samples=2000))
        patch.setattr(comparison, "SAMPLES", 4000)
        patch.setattr(corner_attributes, "MIN_SAMPLES", 2000)
        yield


@pytest.fixture(scope="module")
def coarse_packing() -> Iterator[None]:
    """Pack UV islands in few cells, which takes a tenth of the time: how densely they are packed is a promise of `test_packing`."""
    from farfield.addon.core.unwrap import raster_packing

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(raster_packing, "GRID_SIDE", 96)
        yield


@pytest.fixture
def scheduler(tmp_path) -> Iterator:
    """A new Dask scheduler on this machine, see `dask_farm.Farm`; the test is skipped if Dask is not installed."""
    pytest.importorskip("distributed")
    from dask_farm import DaskFarm

    farm = DaskFarm(tmp_path)
    yield farm
    farm.close()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options that include tests marked `slow`, and also variants marked `exhaustive`."""
    parser.addoption("--slow", action="store_true", dest="slow", help="also run the tests marked slow")
    parser.addoption("--all", action="store_true", dest="exhaustive", help="also run the tests marked slow or exhaustive")


def pytest_report_header(config: pytest.Config) -> list[str]:
    """Say at the top which tests will be skipped because a program is missing, and how to install it."""
    paths = {Path(config.invocation_params.dir, argument.partition("::")[0]) for argument in config.args}
    return list(describe_missing(paths))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator:
    """Let every second process import the test files in reverse order. In a new checkout each compiles half of them, and finds the others
    compiled."""
    report = yield
    if isinstance(collector, pytest.Directory) and os.environ.get("PYTEST_XDIST_WORKER", "gw0")[-1] in "13579":
        report.result.reverse()
    return report


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Run tests in a window last, and those of a file in its order; in parallel runs, `lib.schedule` orders the files. Files that need
    nothing outside the core get the marker `core`. Tests marked `slow` need an option or must be named; those marked `exhaustive`, and many
    random examples, need the option --all."""
    if not config.option.exhaustive:
        is_named = any("::" in argument for argument in config.args)
        markers = {"exhaustive"} if config.option.slow or is_named else {"exhaustive", "slow"}
        is_left_out = [bool(markers & {marker.name for marker in item.iter_markers()}) for item in items]
        config.hook.pytest_deselected(items=list(compress(items, is_left_out)))
        items[:] = [item for item, is_out in zip(items, is_left_out, strict=True) if not is_out]
        for test in {item.function for item in items}:
            take_fewer_examples(test)
    is_core = {path: not NEEDS_MORE_THAN_CORE.search(path.read_text(encoding="utf-8")) for path in {item.path for item in items}}
    for item in items:
        if is_core[item.path]:
            item.add_marker("core")
    items.sort(key=lambda item: item.path)  # as if no process had imported them in reverse order
    items.sort(key=lambda item: item.get_closest_marker("gui") is not None)


def pytest_collection_finish() -> None:
    """Let the garbage collector ignore the objects that the collection has made, a quarter of a million."""
    gc.freeze()


def take_fewer_examples(test: Callable) -> None:
    """Reduce the number of random examples. Hypothesis has no public way to do so once the test is decorated."""
    if hypothesis.is_hypothesis_test(test):
        settings = test._hypothesis_internal_use_settings
        fewer = max(int(EXAMPLES_FRACTION * settings.max_examples), min(settings.max_examples, MIN_EXAMPLES))
        test._hypothesis_internal_use_settings = hypothesis.settings(settings, max_examples=fewer)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the number of skipped tests and the reasons above the last line."""
    reasons = Counter(_reason(report) for report in terminalreporter.stats.get("skipped", []))
    if not reasons:
        terminalreporter.write_sep("=", "no tests were skipped", green=True)
        return
    terminalreporter.write_sep("=", f"SKIPPED: {sum(reasons.values())} tests", yellow=True, bold=True)
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f"{count:5d}  {reason}", yellow=True)


def pytest_unconfigure() -> None:
    """Remove the temporary folder of the tests."""
    shutil.rmtree(TEMPORARY_FOLDER, ignore_errors=True)


def _reason(report: pytest.TestReport | pytest.CollectReport) -> str:
    location, _, reason = report.longrepr if isinstance(report.longrepr, tuple) else (report.nodeid, 0, str(report.longrepr))
    return f"{reason.removeprefix('Skipped: ')} ({os.path.relpath(location, environment.ROOT)})"
