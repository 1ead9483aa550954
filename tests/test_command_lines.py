"""Command lines run where a word says, end with their block, and leave nothing in the temporary folder."""

import os
import sys
import tempfile
import time
from concurrent.futures import wait
from pathlib import Path

import pytest

from farfield.addon.core import parallel
from farfield.addon.core.commands import open_commands, outcome
from farfield.addon.core.errors import FarfieldError, SettingsError


def python(code: str, *arguments: str) -> list[str]:
    return [sys.executable, "-c", code, *arguments]


@pytest.mark.parametrize(
    ("word", "processes", "scheduler"),
    [("serial", 1, None), ("processes:1", 1, None), ("processes:12", 12, None), (" serial ", 1, None)],
)
def test_words_name_processes(word, processes, scheduler):
    assert parallel.read_word(word) == parallel.Word(processes, scheduler)


def test_processes_alone_are_as_many_as_cores_but_not_too_many(monkeypatch):
    for cores, processes in ((1, 1), (2, 2), (64, parallel.MOST_BY_ITSELF), (None, 1)):
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        assert parallel.read_word("processes").processes == processes


def test_a_scheduler_has_an_address():
    assert parallel.read_word("dask:tcp://farm-7.example:8786").scheduler == "tcp://farm-7.example:8786"


@pytest.mark.parametrize(
    "word", ["", "threads", "processes:0", "processes:-2", "processes:two", "dask", "dask:", "dask:localhost", "serial:2"]
)
def test_other_words_are_refused(word):
    with pytest.raises(SettingsError, match="must be serial"):
        parallel.read_word(word)


@pytest.mark.parametrize(("word", "slots"), [("serial", 1), ("processes:3", 3)])
def test_so_many_run_at_a_time(word, slots, tmp_path):
    code = "import pathlib, sys, time; p = pathlib.Path(sys.argv[1]); p.touch(); time.sleep(0.3); p.unlink()"
    with open_commands(word) as commands:
        pending = [commands.submit(python(code, str(tmp_path / str(number)))) for number in range(2 * slots)]
        most = 0
        while wait(pending, 0.01).not_done:
            most = max(most, len(list(tmp_path.iterdir())))
        assert [outcome(each)[0] for each in pending] == [0] * len(pending)
    assert commands.spread.slots == slots and 1 <= most <= slots


def test_codes_and_words_come_back():
    with open_commands("processes:2") as commands:
        ended, killed = (
            commands.submit(python(code))
            for code in ("import sys; print('für alle', file=sys.stderr); sys.exit(7)", "import os; os.kill(os.getpid(), 9)")
        )
        assert outcome(ended)[0] == 7 and "r alle" in outcome(ended)[1]
        if os.name != "nt":
            assert outcome(killed)[0] == -9


def test_a_program_that_is_not_there_is_named():
    with open_commands("serial") as commands, pytest.raises(FarfieldError, match="no-such-program"):
        outcome(commands.submit([str(Path("no-such-program"))]))


def test_the_end_of_the_block_ends_what_runs_and_what_waits(tmp_path):
    code = "import os, pathlib, sys, time; pathlib.Path(sys.argv[1]).write_text(str(os.getpid())); time.sleep(600)"
    started = time.monotonic()
    with open_commands("processes:2") as commands:
        pending = [commands.submit(python(code, str(tmp_path / f"{number}.pid"))) for number in range(4)]
        while len([path for path in tmp_path.iterdir() if path.stat().st_size]) < 2:
            assert time.monotonic() - started < 60.0
            time.sleep(0.02)
    assert all(each.done() for each in pending)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.pid", "1.pid"]
    if Path("/proc").is_dir():
        assert not [path for path in tmp_path.iterdir() if Path("/proc", path.read_text()).exists()]


def test_temporary_files_of_a_command_go_with_it():
    code = "import sys, tempfile; print(tempfile.mkdtemp(), file=sys.stderr)"
    with open_commands("serial") as commands:
        left = Path(outcome(commands.submit(python(code)))[1].strip())
        assert left.is_dir() and left.parent != Path(tempfile.gettempdir())
    assert not left.exists() and not left.parent.exists()


def test_without_dask_a_scheduler_is_out_of_reach(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(FarfieldError, match="Dask is not installed"), parallel.open_executor("dask:tcp://127.0.0.1:9"):
        pass


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(parallel, "ANSWER", 0.5)
    silence = pytest.raises(FarfieldError, match=r"No Dask scheduler answers at .tcp://127\.0\.0\.1:9")
    with silence, parallel.open_executor("dask:tcp://127.0.0.1:9"):
        pass


def test_a_scheduler_without_workers_is_refused(scheduler):
    with pytest.raises(FarfieldError, match="has no workers"), parallel.open_executor(f"dask:{scheduler.address}"):
        pass


def test_dask_runs_commands_without_farfield(scheduler):
    scheduler.start_workers(2)
    with open_commands(f"dask:{scheduler.address}") as commands:
        assert (commands.spread.slots, commands.spread.sharing) == (2, 2)
        pending = [commands.submit(python(f"import sys; print({number}, file=sys.stderr); sys.exit({number})")) for number in range(4)]
        assert [outcome(each) for each in pending] == [(number, f"{number}\n") for number in range(4)]
        with pytest.raises(FarfieldError, match="cannot be started"):
            outcome(commands.submit(["no-such-program"]))


def test_a_scheduler_that_goes_is_reported(scheduler):
    scheduler.start_workers(1)
    with open_commands(f"dask:{scheduler.address}") as commands:
        pending = commands.submit(python("import time; time.sleep(20)"))
        time.sleep(0.5)
        scheduler.close()
        with pytest.raises(FarfieldError, match="scheduler has gone"):
            outcome(pending)
