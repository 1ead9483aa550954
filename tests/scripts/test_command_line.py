"""The command line of all scripts: every end is an exit code and one sentence."""

import json
import os
import re
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from farfield.addon.core.errors import FileError
from farfield.addon.core.files.temporary_folders import temporary_folder
from lib import command_line, environment, run_files
from script_runs import SEPARATOR, run_script, runs_command

pytest.importorskip("bpy")
SCRIPT = """
import json, sys, time
from pathlib import Path
sys.path.insert(0, SCRIPTS)
from lib import environment
environment.ensure()
farfield = environment.import_farfield()
farfield.register = farfield.unregister = lambda: None  # it uses no operator; importing them all takes most of the time
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.temporary_folders import temporary_folder
from farfield.addon.core.jobs.progress import Progress
from lib import command_line, run_files

def main(arguments, line):
    parser = command_line.Parser("child.py", "")
    parser.add_argument("what")
    parser.add_argument("--path", type=run_files.parse_path)
    given = parser.parse_args(arguments)
    if given.what == "defect":
        return {}["first\\nsecond"]
    if given.what == "names":
        command_line.print_message("Skipped: line\\nbreak \\udcff (no faces).")
        return '"line\\nbreak \\udcff": 2 quads.'
    if given.what == "json":
        return json.dumps({"name": "line\\nbreak"}, indent=1)
    if given.what == "input":
        raise FileError('"line\\nbreak" is empty.')
    if given.what in ("full", "cancel"):
        with temporary_folder() as folder:
            command_line.write_report(folder / "temporary.json", {"number": 1})
        for name in ("out.blend", "inner/report.json"):
            command_line.write_report(given.path / name, {"number": 1})
        if given.what == "cancel":
            raise KeyboardInterrupt
        raise FileError("The disk is full.")
    if given.what == "memory":
        raise MemoryError
    if given.what == "report":
        command_line.write_report(given.path, {"number": 1})
    if given.what == "wait":
        with temporary_folder(given.path), temporary_folder():
            print("ready", file=sys.stderr, flush=True)
            for _ in range(600):
                time.sleep(0.1)
                line.show(Progress(0.5, "Waiting"))
    return "done"

command_line.run(main)
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory) -> Path:
    """A script that does what its first argument says."""
    path = tmp_path_factory.mktemp("script") / "child.py"
    path.write_text(SCRIPT.replace("SCRIPTS", repr(str(environment.ROOT / "scripts"))), encoding="utf-8")
    return path


def variables():
    """The environment without what Blender has set in this process; a new one would print it."""
    return {name: value for name, value in os.environ.items() if name != "OCIO"}


def run(script: Path, *runs: list[str]) -> list[subprocess.CompletedProcess]:
    """Run the script once for each list of arguments."""
    return run_script(script, *runs, env=variables())


def test_a_process_ends_with_the_code_and_one_sentence(script):
    outcome = subprocess.run([sys.executable, script, "memory"], capture_output=True, text=True, check=False, env=variables())
    assert outcome.returncode == 2 and "memory" in outcome.stderr and outcome.stderr.strip().count("\n") == 0
    assert outcome.stdout == ""


@pytest.mark.slow
def test_a_defect_is_one_sentence_with_a_private_log(script):
    outcome, verbose = run(script, ["defect"], ["defect", "--verbose"])
    assert outcome.returncode == 1 and outcome.stdout == ""
    message = outcome.stderr.strip()
    assert "\n" not in message and "defect" in message and "KeyError" in message and message.endswith(".")
    log = Path(re.search(r'"([^"]+\.log)"', message)[1])
    assert stat.S_IMODE(log.stat().st_mode) == 0o600 or os.name == "nt"
    text = log.read_text(encoding="utf-8")
    assert "Traceback" in text and "in main" in text and "Blender" in text and "Arguments: ['defect']" in text
    assert "Traceback" in verbose.stderr


@pytest.mark.slow
def test_an_error_after_some_outputs_names_them(script, tmp_path):
    """A bake that took hours stays although an export of it fails."""
    outcomes = run(script, *([what, "--path", str(tmp_path / what)] for what in ("full", "cancel")))
    for outcome, what, message in zip(outcomes, ("full", "cancel"), ("The disk is full.", "Cancelled."), strict=True):
        paths = [tmp_path / what / "out.blend", tmp_path / what / "inner" / "report.json"]
        assert outcome.stderr == f'{message} Already saved: "{paths[0]}", "{paths[1]}".\n'
        assert sorted(path for path in (tmp_path / what).rglob("*") if path.is_file()) == sorted(paths)


@pytest.mark.slow
def test_names_do_not_break_lines(script):
    names, report, wrong_input = run(script, ["names"], ["json"], ["input"])
    assert (names.stdout, names.stderr) == ('"line break \ufffd": 2 quads.\n', "Skipped: line break \ufffd (no faces).\n")
    assert report.stdout == '{\n "name": "line\\nbreak"\n}\n'
    assert (wrong_input.returncode, wrong_input.stderr) == (2, '"line break" is empty.\n')


@pytest.mark.slow
@pytest.mark.once
@pytest.mark.skipif(os.name == "nt", reason="Windows has neither")
@pytest.mark.parametrize("flags", [[], *(pytest.param([flag], marks=pytest.mark.exhaustive) for flag in ("--verbose", "--help"))])
def test_nobody_reads_the_result(script, flags):
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, script, "x", *flags]
    outcome = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False, env=variables())
    os.close(writer)
    assert (outcome.returncode, outcome.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.once
@pytest.mark.skipif(os.name == "nt", reason="Windows has neither")
def test_standard_output_that_is_closed_or_full(script):
    options = {"stderr": subprocess.PIPE, "text": True, "check": False, "env": variables()}
    command = [sys.executable, str(script), "x"]
    outcome = subprocess.run(["sh", "-c", 'exec "$@" >&-', "sh", *command], **options)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    if Path("/dev/full").is_char_device():
        with Path("/dev/full").open("w") as full:
            outcome = subprocess.run(command, stdout=full, **options)
        assert outcome.returncode == 2 and "Cannot write to the standard output: No space left" in outcome.stderr
        assert outcome.stderr.count("\n") == 1


@pytest.mark.slow
@pytest.mark.once
@pytest.mark.skipif(os.name == "nt", reason="Windows sends no signals to one process")
def test_signals_cancel_and_clean_up(script, tmp_path):
    place, temporary = tmp_path / "place", tmp_path / "temporary"
    for folder in (place, temporary):
        folder.mkdir()
    place_of_folders = dict.fromkeys(("TMPDIR", "TMP", "TEMP"), str(temporary))
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "env": variables() | place_of_folders}
    numbers = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
    # scripts ignore signals that they are started to ignore, as under nohup
    inherited = {number: signal.signal(number, signal.SIG_DFL) for number in numbers}
    try:
        process = subprocess.Popen(runs_command(script, [["wait", "--path", str(place)]] * len(numbers)), **options)
    finally:
        for number, handler in inherited.items():
            signal.signal(number, handler)
    end = f"{SEPARATOR}130{SEPARATOR}"
    with process:
        for index, number in enumerate(numbers):
            assert process.stderr.readline() == f"{end if index > 0 else ''}ready\n"
            assert len(list(place.iterdir())) == 1 and len(list(temporary.glob("farfield-*"))) == 1, "the former run has cleaned up"
            process.send_signal(number)
            assert process.stderr.readline() == "Cancelled.\n"
        assert (process.stdout.read(), process.stderr.read()) == (end * len(numbers), end)
    assert not list(place.iterdir()) and not list(temporary.glob("farfield-*"))


@pytest.mark.once
@pytest.mark.skipif(not Path("/proc/self/ns/pid").exists(), reason="the process is found by its number elsewhere too, but slower")
def test_the_next_run_cleans_up_after_a_killed_one(script, tmp_path):
    command = [sys.executable, script, "wait", "--path", tmp_path]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr.readline() == "ready\n"
        process.kill()
    assert len(list(tmp_path.iterdir())) == 1
    with temporary_folder(tmp_path) as folder:
        assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.once
@pytest.mark.skipif(os.name == "nt", reason="Windows has no such devices")
class TestReport:
    """--report on devices, pipes and open files."""

    @pytest.mark.slow
    def test_standard_output(self, script, tmp_path):
        expected = '{\n  "number": 1\n}\ndone\n'
        outcomes = run(script, ["report", "--path", "/dev/stdout"], ["report", "--path=/dev/fd/1"])
        assert [outcome.stdout for outcome in outcomes] == [expected, expected]
        with (tmp_path / "out.txt").open("w") as file:
            subprocess.run([sys.executable, script, "report", "--path", "/dev/stdout"], stdout=file, check=True, env=variables())
        assert (tmp_path / "out.txt").read_text() == expected

    def test_a_pipe_and_devices(self, tmp_path):
        os.mkfifo(tmp_path / "pipe")
        with subprocess.Popen(["cat", str(tmp_path / "pipe")], stdout=subprocess.PIPE, text=True) as reader:
            command_line.write_report(tmp_path / "pipe", {"number": 1})
            assert json.loads(reader.communicate()[0]) == {"number": 1}
        command_line.write_report(Path(os.devnull), {})
        assert Path(os.devnull).is_char_device()
        if Path("/dev/full").is_char_device():
            with pytest.raises(FileError, match="No space left"):
                command_line.write_report(Path("/dev/full"), {})
            assert Path("/dev/full").is_char_device()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["x", "--path", ""], "the path is empty"),
        (["a\udcff"], "not valid UTF-8"),
        (["x", "--path", "\udcff.stl"], 'the path "\ufffd.stl" is not valid UTF-8'),
        (["x", "line\nbreak"], "unrecognized arguments: line break"),
    ],
)
def test_arguments_that_mean_nothing(arguments, message, capsys):
    parser = command_line.Parser("x.py", "")
    parser.add_argument("what")
    parser.add_argument("--path", type=run_files.parse_path)
    with pytest.raises(SystemExit) as caught:
        parser.parse_args(arguments)
    errors = capsys.readouterr().err
    assert caught.value.code == 2 and message in errors and errors.count("\n") == 1
