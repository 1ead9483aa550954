"""Commands run in subprocesses, end with their block and leave no temporary files."""

import os
import sys
import tempfile
import time
from concurrent.futures import wait
from pathlib import Path

import pytest

from farfield.addon.core.errors import FarfieldError, FileError
from farfield.addon.core.jobs.subprocess_pool import open_subprocess_pool, wait_for_exit


def python(code: str, *arguments: str) -> list[str]:
    return [sys.executable, "-c", code, *arguments]


@pytest.mark.parametrize("slots", [1, 3])
def test_no_more_commands_run_than_there_are_slots(slots, tmp_path):
    code = "import pathlib, sys, time; p = pathlib.Path(sys.argv[1]); p.touch(); time.sleep(0.1); p.unlink()"
    with open_subprocess_pool(slots) as pool:
        pending = [pool.submit(python(code, str(tmp_path / str(index)))) for index in range(2 * slots)]
        max_running = 0
        while wait(pending, 0.01).not_done:
            max_running = max(max_running, len(list(tmp_path.iterdir())))
        assert [wait_for_exit(future)[0] for future in pending] == [0] * len(pending)
    assert pool.slots == slots and 1 <= max_running <= slots


def test_exit_codes_and_error_output_are_returned():
    with open_subprocess_pool(2) as pool:
        exited, killed = (
            pool.submit(python(code))
            for code in ("import sys; print('für alle', file=sys.stderr); sys.exit(7)", "import os; os.kill(os.getpid(), 9)")
        )
        assert wait_for_exit(exited)[0] == 7 and "r alle" in wait_for_exit(exited)[1]
        if os.name != "nt":
            assert wait_for_exit(killed)[0] == -9


def test_a_missing_program_is_named():
    with open_subprocess_pool(1) as pool, pytest.raises(FarfieldError, match="no-such-program"):
        wait_for_exit(pool.submit([str(Path("no-such-program"))]))


def test_the_end_of_the_block_kills_running_commands_and_drops_queued_ones(tmp_path):
    code = "import os, pathlib, sys, time; pathlib.Path(sys.argv[1]).write_text(str(os.getpid())); time.sleep(600)"
    started = time.monotonic()
    with open_subprocess_pool(2) as pool:
        pending = [pool.submit(python(code, str(tmp_path / f"{index}.pid"))) for index in range(4)]
        while len([path for path in tmp_path.iterdir() if path.stat().st_size]) < 2:
            assert time.monotonic() - started < 60.0
            time.sleep(0.02)
    assert all(future.done() for future in pending)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.pid", "1.pid"]
    if Path("/proc").is_dir():
        assert not [path for path in tmp_path.iterdir() if Path("/proc", path.read_text()).exists()]


def test_temporary_files_of_a_command_are_deleted():
    code = "import sys, tempfile; print(tempfile.mkdtemp(), file=sys.stderr)"
    with open_subprocess_pool(1) as pool:
        folder = Path(wait_for_exit(pool.submit(python(code)))[1].strip())
        assert folder.is_dir() and folder.parent != Path(tempfile.gettempdir())
    assert not folder.exists() and not folder.parent.exists()


def test_a_missing_temporary_folder_is_one_sentence(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(FileError, match="A temporary folder cannot be created: No such file or directory"), open_subprocess_pool(1):
        pass
