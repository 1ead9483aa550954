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
from lib import command_line, environment

pytest.importorskip("bpy")
CHILD = """
import json, sys, time
from pathlib import Path
sys.path.insert(0, sys.argv.pop(1))
from lib import environment
environment.ensure()
environment.import_farfield()
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.temporary_folders import temporary_folder
from farfield.addon.core.jobs.progress import Progress
from lib import command_line

def main(arguments, line):
    parser = command_line.Parser("child.py", "")
    parser.add_argument("what")
    parser.add_argument("--path", type=command_line.parse_path)
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


def command(*arguments):
    return [sys.executable, "-c", CHILD, str(environment.ROOT / "scripts"), *map(str, arguments)]


def variables():
    """The environment without what Blender has set in this process; a new one would print it."""
    return {name: value for name, value in os.environ.items() if name != "OCIO"}


def run(*arguments):
    """Run a script that does what its first argument says."""
    return subprocess.run(command(*arguments), capture_output=True, text=True, check=False, env=variables())


def test_a_defect_is_one_sentence_with_a_private_log():
    outcome = run("defect")
    assert outcome.returncode == 1 and outcome.stdout == ""
    message = outcome.stderr.strip()
    assert "\n" not in message and "defect" in message and "KeyError" in message and message.endswith(".")
    log = Path(re.search(r'"([^"]+\.log)"', message)[1])
    assert stat.S_IMODE(log.stat().st_mode) == 0o600 or os.name == "nt"
    text = log.read_text(encoding="utf-8")
    assert "Traceback" in text and "in main" in text and "Blender" in text and "Arguments: ['defect']" in text
    assert "Traceback" in run("defect", "--verbose").stderr


def test_names_do_not_break_lines():
    outcome = run("names")
    assert (outcome.stdout, outcome.stderr) == ('"line break \ufffd": 2 quads.\n', "Skipped: line break \ufffd (no faces).\n")
    assert run("json").stdout == '{\n "name": "line\\nbreak"\n}\n'
    outcome = run("input")
    assert (outcome.returncode, outcome.stderr) == (2, '"line break" is empty.\n')


@pytest.mark.once
@pytest.mark.skipif(os.name == "nt", reason="Windows has neither")
@pytest.mark.parametrize("flags", [[], ["--verbose"], ["--help"]])
def test_nobody_reads_the_result(flags):
    reader, writer = os.pipe()
    os.close(reader)
    outcome = subprocess.run(command("x", *flags), stdout=writer, stderr=subprocess.PIPE, text=True, check=False, env=variables())
    os.close(writer)
    assert (outcome.returncode, outcome.stderr) == (0, "")


@pytest.mark.once
@pytest.mark.skipif(os.name == "nt", reason="Windows has neither")
def test_standard_output_that_is_closed_or_full():
    options = {"stderr": subprocess.PIPE, "text": True, "check": False, "env": variables()}
    outcome = subprocess.run(["sh", "-c", 'exec "$@" >&-', "sh", *command("x")], **options)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    if Path("/dev/full").is_char_device():
        with Path("/dev/full").open("w") as full:
            outcome = subprocess.run(command("x"), stdout=full, **options)
        assert outcome.returncode == 2 and "Cannot write to the standard output: No space left" in outcome.stderr
        assert outcome.stderr.count("\n") == 1


def test_too_little_memory_is_invalid_input():
    outcome = run("memory")
    assert outcome.returncode == 2 and "memory" in outcome.stderr and outcome.stderr.strip().count("\n") == 0


@pytest.mark.once
@pytest.mark.skipif(os.name == "nt", reason="Windows sends no signals to one process")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", None)])
def test_signals_cancel_and_clean_up(number, tmp_path):
    place, temporary = tmp_path / "place", tmp_path / "temporary"
    for folder in (place, temporary):
        folder.mkdir()
    place_of_folders = dict.fromkeys(("TMPDIR", "TMP", "TEMP"), str(temporary))
    options = {"stderr": subprocess.PIPE, "text": True, "env": variables() | place_of_folders}
    inherited = signal.signal(number, signal.SIG_DFL)  # scripts ignore signals that they are started to ignore, as under nohup
    try:
        process = subprocess.Popen(command("wait", "--path", place), **options)
    finally:
        signal.signal(number, inherited)
    with process:
        assert process.stderr.readline() == "ready\n"
        assert len(list(place.iterdir())) == 1 and list(temporary.glob("farfield-*"))
        process.send_signal(number)
        assert process.communicate(timeout=60)[1] == "Cancelled.\n"
    assert process.returncode == 130
    assert not list(place.iterdir()) and not list(temporary.glob("farfield-*"))


@pytest.mark.once
@pytest.mark.skipif(not Path("/proc/self/ns/pid").exists(), reason="the process is found by its number elsewhere too, but slower")
def test_the_next_run_cleans_up_after_a_killed_one(tmp_path):
    with subprocess.Popen(command("wait", "--path", tmp_path), stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr.readline() == "ready\n"
        process.kill()
    assert len(list(tmp_path.iterdir())) == 1
    with temporary_folder(tmp_path) as folder:
        assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.once
@pytest.mark.skipif(os.name == "nt", reason="Windows has no such devices")
class TestReport:
    """--report on devices, pipes and open files."""

    def test_standard_output(self, tmp_path):
        expected = '{\n  "number": 1\n}\ndone\n'
        assert run("report", "--path", "/dev/stdout").stdout == expected
        assert run("report", "--path=/dev/fd/1").stdout == expected
        with (tmp_path / "out.txt").open("w") as file:
            subprocess.run(command("report", "--path", "/dev/stdout"), stdout=file, check=True, env=variables())
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
    parser.add_argument("--path", type=command_line.parse_path)
    with pytest.raises(SystemExit) as caught:
        parser.parse_args(arguments)
    errors = capsys.readouterr().err
    assert caught.value.code == 2 and message in errors and errors.count("\n") == 1
