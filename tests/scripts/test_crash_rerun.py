"""`scripts/test.py` after a crash of a test process: files without a result run again, and other failures remain failures."""

import os
import subprocess
import sys

import pytest

from lib import environment

pytestmark = pytest.mark.once

CRASHES = """
import os, pathlib
ALIVE = pathlib.Path(__file__).with_name("crashes-left")

def test_before():
    record("before")

def test_crashes():
    left = int(ALIVE.read_text())
    ALIVE.write_text(str(left - 1))
    if left > 0:
        os._exit(139)
    record("crashes")

def test_after():
    record("after")

def record(name):
    with pathlib.Path(__file__).with_name("log").open("a") as log:
        log.write(name + "\\n")
"""
LONGER = """
import pathlib, pytest

@pytest.mark.parametrize("number", range(5))
def test_in_a_file_that_runs_first(number):
    assert number not in FAILING
    with pathlib.Path(__file__).with_name("log").open("a") as log:
        log.write("passes\\n")
"""


@pytest.fixture
def run(tmp_path):
    """A function that runs scripts/test.py on a file whose second test crashes a number of times, and on other files."""

    def run(crashes: int, **files: str) -> tuple[subprocess.CompletedProcess, list[str]]:
        (tmp_path / "crashes-left").write_text(str(crashes))
        for name, text in (files | {"test_crash": CRASHES}).items():
            (tmp_path / f"{name}.py").write_text(text)
        temporary = tmp_path / "temporary"
        temporary.mkdir()
        variables = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST", "FARFIELD_TESTS"))}
        variables |= {"TMPDIR": str(temporary), "PYTHONDONTWRITEBYTECODE": "1"}
        paths = [str(path) for path in sorted(tmp_path.glob("test_*.py"))]
        command = [sys.executable, str(environment.ROOT / "scripts" / "test.py"), "-c", str(environment.ROOT / "pyproject.toml"), *paths]
        options = ["--rootdir", str(tmp_path), "-n", "1", "-q", "-p", "no:cacheprovider"]
        done = subprocess.run([*command, *options], capture_output=True, encoding="utf-8", env=variables, timeout=120, check=False)
        log = tmp_path / "log"
        assert not list(temporary.glob("farfield-*")), "the runs leave no temporary files"
        return done, log.read_text().split() if log.exists() else []

    return run


@pytest.mark.slow
def test_a_file_that_crashed_once_runs_again_in_a_new_process(run):
    done, log = run(1, test_a=LONGER.replace("FAILING", "[]"))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "BLENDER CRASHED in" in done.stdout and "3 tests without a result are run again" in done.stdout
    assert [name for name in log if name != "passes"] == ["before", "before", "crashes", "after"]
    assert log.count("passes") == 5, "files with a result do not run again"


@pytest.mark.exhaustive
def test_two_crashes_fail(run):
    done, _ = run(2)
    assert done.returncode != 0
    assert done.stdout.count("BLENDER CRASHED") == 1, "there is no third run"


@pytest.mark.exhaustive
def test_a_failure_before_the_crash_is_not_forgotten(run):
    done, _ = run(1, test_a=LONGER.replace("FAILING", "[3]"))
    assert done.returncode != 0
    assert "Before the crash these tests failed" in done.stdout and "test_a.py::test_in_a_file_that_runs_first[3]" in done.stdout


@pytest.mark.exhaustive
def test_without_a_crash_nothing_runs_twice_and_all_runs_in_the_checkout(run):
    text = f"import pathlib\ndef test_folder():\n    assert pathlib.Path.cwd() == pathlib.Path({str(environment.ROOT)!r})\n"
    done, log = run(0, test_folder=text)
    assert done.returncode == 0, done.stdout + done.stderr
    assert log == ["before", "crashes", "after"] and "CRASHED" not in done.stdout
