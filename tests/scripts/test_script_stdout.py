"""Scripts print one result line to stdout; `--verbose` adds the messages of Blender, and errors stay on stderr."""

import ctypes
import os
import subprocess
import sys

import pytest

from lib import environment
from lib.script_stdout import script_stdout
from script_runs import run_script

pytest.importorskip("bpy")

SCRIPT = """
import os, subprocess, sys
sys.path.insert(0, {scripts!r})
from lib import environment
farfield = environment.import_farfield()
farfield.register = farfield.unregister = lambda: None  # it uses no operator; importing them all takes most of the time
import bpy
from lib import command_line
from farfield.addon.core.errors import GeometryError

def main(arguments, line):
    parser = command_line.Parser(prog="script.py", description="Render a cube.")
    parser.add_argument("--fail", choices=["input", "defect", "exit"])
    given = parser.parse_args(arguments)
    bpy.ops.wm.save_as_mainfile(filepath="cube.blend", check_existing=False)
    bpy.ops.wm.open_mainfile(filepath="cube.blend")
    bpy.context.scene.render.resolution_x = bpy.context.scene.render.resolution_y = 4
    bpy.context.scene.render.engine, bpy.context.scene.cycles.samples = "CYCLES", 1
    bpy.context.scene.render.filepath = os.path.abspath("cube.png")
    bpy.ops.render.render(write_still=True)
    print("printed by an add-on")
    subprocess.run([sys.executable, "-c", "print('printed by a child process')"], check=True)
    if given.fail == "input":
        raise GeometryError("The cube is missing.")
    if given.fail == "defect":
        raise RuntimeError("a defect")
    if given.fail == "exit":
        sys.exit(7)
    return "1 cube: größe 樹"

command_line.run(main)
"""
MESSAGES = ("Saved: ", "printed by an add-on", "printed by a child process")


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory) -> dict[str, subprocess.CompletedProcess]:
    """What a script that renders a cube printed, by its arguments. The first run is a process of its own."""
    folder = tmp_path_factory.mktemp("script")
    script = folder / "script.py"
    script.write_text(SCRIPT.format(scripts=str(environment.ROOT / "scripts")), encoding="utf-8")
    variables = os.environ | {"PYTHONIOENCODING": "utf-8", "PWD": str(folder)}  # Blender prefers PWD to the working directory
    options = {"env": variables, "cwd": folder}
    alone = subprocess.run([sys.executable, str(script)], capture_output=True, encoding="utf-8", check=False, **options)
    runs = [["--verbose"], ["--fail", "input"], ["--fail", "defect"], ["--fail", "exit"], ["--help"]]
    return {"": alone} | {" ".join(run): outcome for run, outcome in zip(runs, run_script(script, *runs, **options), strict=True)}


@pytest.mark.slow
def test_stdout_is_the_result_line(outcomes):
    outcome = outcomes[""]
    assert (outcome.returncode, outcome.stdout) == (0, "1 cube: größe 樹\n"), outcome.stderr


@pytest.mark.slow
def test_verbose_adds_the_messages_of_blender(outcomes):
    outcome = outcomes["--verbose"]
    assert outcome.returncode == 0, outcome.stderr
    assert all(message in outcome.stdout for message in MESSAGES)
    assert outcome.stdout.endswith("\n1 cube: größe 樹\n")


@pytest.mark.slow
@pytest.mark.parametrize(("failure", "code", "message"), [("input", 2, "The cube is missing."), ("defect", 1, "RuntimeError: a defect")])
def test_error_messages_are_on_stderr(outcomes, failure, code, message):
    outcome = outcomes[f"--fail {failure}"]
    assert (outcome.returncode, outcome.stdout) == (code, "")
    assert message in outcome.stderr and outcome.stderr.strip().count("\n") == 0


@pytest.mark.slow
def test_exit_codes_are_kept(outcomes):
    outcome = outcomes["--fail exit"]
    assert (outcome.returncode, outcome.stdout) == (7, "")


@pytest.mark.slow
def test_help_is_printed(outcomes):
    outcome = outcomes["--help"]
    assert outcome.returncode == 0
    assert "Render a cube." in outcome.stdout and "--verbose" in outcome.stdout


def print_everywhere(text: str) -> None:
    """Print through Python, through C and through a child process."""
    print(f"python {text}")
    libc = ctypes.CDLL("ucrtbase" if os.name == "nt" else None)
    libc.printf(f"c {text}\n".encode())
    subprocess.run([sys.executable, "-c", f"print('child {text}')"], check=True)


@pytest.mark.parametrize("error", [None, RuntimeError, KeyboardInterrupt, SystemExit])
def test_stdout_is_restored(capfd, error):
    try:
        with script_stdout() as stdout:
            print_everywhere("inside")
            print("result", file=stdout)
            if error is not None:
                raise error
    except (RuntimeError, KeyboardInterrupt, SystemExit):
        pass
    assert capfd.readouterr().out == "result\n"
    print("python afterwards", flush=True)
    os.write(1, b"descriptor afterwards\n")
    assert capfd.readouterr().out == "python afterwards\ndescriptor afterwards\n"


def test_verbose_keeps_everything_and_the_result_is_last(capfd):
    with script_stdout(verbose=True) as stdout:
        print("result", file=stdout)
        print_everywhere("inside")
    lines = capfd.readouterr().out.splitlines()
    assert sorted(lines[:-1]) == ["c inside", "child inside", "python inside"] and lines[-1] == "result"
