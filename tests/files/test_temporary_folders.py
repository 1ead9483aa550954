"""Temporary folders: those of dead processes are removed by the next run, and no others."""

import os
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from farfield.addon.core.errors import FileError
from farfield.addon.core.files import temporary_folders
from farfield.addon.core.files.file_access import check_empty
from farfield.addon.core.files.temporary_folders import folder_prefix, remove_abandoned_folders, temporary_folder

CHILD = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from lib import environment
environment.import_farfield()
from farfield.addon.core.files.temporary_folders import temporary_folder
with temporary_folder(Path(sys.argv[2])) as folder:
    (folder / "file").touch()
    print(folder.name, flush=True)
    time.sleep(60)
"""


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_is_private_and_disappears(tmp_path):
    for parent, place in ((tmp_path, tmp_path), (None, Path(tempfile.gettempdir()))):
        with temporary_folder(parent) as folder:
            assert folder.parent == place and folder.name.startswith("farfield-" if parent is None else ".farfield-")
            assert os.name == "nt" or stat.S_IMODE(folder.stat().st_mode) == 0o700
            remove_abandoned_folders(place)
            assert folder.is_dir()
        assert not folder.exists()


def test_the_next_run_removes_the_folder_of_a_killed_one(tmp_path):
    scripts = Path(__file__).parents[2] / "scripts"
    with subprocess.Popen([sys.executable, "-c", CHILD, str(scripts), str(tmp_path)], stdout=subprocess.PIPE, text=True) as process:
        name = process.stdout.readline().strip()
        with temporary_folder(tmp_path):
            assert (tmp_path / name / "file").exists(), "the process runs"
        with pytest.raises(FileError, match="is not empty"):
            check_empty(tmp_path)
        process.kill()
    assert names(tmp_path) == [name]
    copy = tmp_path / "copy" / name
    copy.mkdir(parents=True)
    check_empty(copy.parent)
    copy.parent.rmdir()
    with temporary_folder(tmp_path) as folder:
        assert names(tmp_path) == [folder.name]


def test_folders_of_others_stay(tmp_path, monkeypatch):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    process = folder_prefix().split("-")[2]
    gone = folder_prefix().replace(f"-{process}-", f"-{dead.pid}-")
    other_machine = gone.replace(gone.split("-")[1], "00000000")
    kept = [f".{folder_prefix()}a", f".{other_machine}a", ".farfield-abc", "farfield-btf-0123456789abcdef", "farfield-notes"]
    for name in [*kept, f".{gone}a", f"{gone}b"]:
        (tmp_path / name).mkdir()
    (tmp_path / f"{gone}file").touch()
    remove_abandoned_folders(tmp_path)
    assert names(tmp_path) == sorted([*kept, f"{gone}file"])


@pytest.mark.skipif(os.name == "nt", reason="Windows has no links without a privilege")
def test_links_and_folders_of_other_users_stay(tmp_path, monkeypatch):
    monkeypatch.setattr(temporary_folders, "_is_running", lambda *_: False)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / f"{folder_prefix()}link").symlink_to(tmp_path / "elsewhere")
    remove_abandoned_folders(tmp_path)
    assert len(names(tmp_path)) == 2
    (tmp_path / f"{folder_prefix()}a").mkdir()
    monkeypatch.setattr(temporary_folders.os, "geteuid", lambda: os.getuid() + 1)
    remove_abandoned_folders(tmp_path)
    assert len(names(tmp_path)) == 3


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell when a process started")
def test_a_process_number_that_is_used_again_is_another_process():
    assert temporary_folders._is_running(os.getpid(), temporary_folders._start_time(os.getpid()))
    assert not temporary_folders._is_running(os.getpid(), 1)


@pytest.mark.skipif(os.name == "nt", reason="signal 0 is of POSIX")
def test_without_start_times_the_process_number_decides(monkeypatch):
    monkeypatch.setattr(temporary_folders, "_start_time", lambda _: None)
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    assert temporary_folders._is_running(os.getpid(), 0) and not temporary_folders._is_running(dead.pid, 0)
