"""A run owns its work folder and leaves only finished views in it. Old folders are removed, and those in use are not."""

import os
import time

import pytest

from farfield.addon.core.btf.capture import capture_run
from farfield.addon.core.btf.capture.capture_run import MAX_AGE_DAYS, SECONDS_PER_DAY, CaptureRun, remove_expired
from farfield.addon.core.errors import FileError
from farfield.addon.core.jobs import heartbeat


def make_old(folder, days: float) -> None:
    """Set the times of everything in `folder`, and of itself, to `days` ago."""
    moment = time.time() - days * SECONDS_PER_DAY
    for path in (*folder.rglob("*"), folder):
        os.utime(path, (moment, moment))


def test_a_run_leaves_only_finished_views(tmp_path):
    (tmp_path / "level-0").mkdir()
    run = CaptureRun(tmp_path)
    (run.snapshot_folder / "snapshot.blend").touch()
    run.close()
    run.close()
    assert [path.name for path in tmp_path.iterdir()] == ["level-0"]
    run = CaptureRun(tmp_path)
    del run
    assert [path.name for path in tmp_path.iterdir()] == ["level-0"]


def test_a_run_removes_the_snapshots_of_killed_runs(tmp_path):
    (tmp_path / "killed.snapshot").mkdir()
    (tmp_path / "killed.snapshot" / "snapshot.blend").touch()
    (tmp_path / "killed.heartbeat").touch()
    run = CaptureRun(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {run.heartbeat.path.name, run.snapshot_folder.name}


def test_a_run_without_room_for_its_snapshot_ends(tmp_path, monkeypatch):
    def fail(folder):
        raise FileError(f'Cannot use the folder "{folder}".')

    monkeypatch.setattr(capture_run, "open_private_folder", fail)
    with pytest.raises(FileError, match="Cannot use"):
        CaptureRun(tmp_path)
    assert not list(tmp_path.iterdir())


def test_only_folders_that_no_run_has_used_for_long_are_removed(tmp_path):
    cache = tmp_path / "cache"
    for name in ("expired", "recent", "used", "running", "target"):
        (cache / name / "level-0").mkdir(parents=True)
        (cache / name / "killed.snapshot").mkdir()
        (cache / name / "level-0" / "view-0000.shard").touch()
        make_old(cache / name, 2.0 * MAX_AGE_DAYS)
    make_old(cache / "recent", 0.5 * MAX_AGE_DAYS)
    os.utime(cache / "used" / "level-0")  # a view was finished there
    held = heartbeat.take_over(cache / "running")
    (cache / "target").rename(tmp_path / "target")
    if os.name != "nt":
        (cache / "link").symlink_to(tmp_path / "target")
    (cache / "file").touch()
    make_old(cache / "file", 2.0 * MAX_AGE_DAYS)
    remove_expired(cache)
    assert {path.name for path in cache.iterdir()} >= {"recent", "used", "running", "file"}
    assert not (cache / "expired").exists() and (tmp_path / "target" / "level-0" / "view-0000.shard").exists()
    for name in ("recent", "used", "running"):
        assert (cache / name / "level-0" / "view-0000.shard").exists()
        assert (cache / name / "killed.snapshot").exists() == (name == "running")
    held.close()
    remove_expired(tmp_path / "missing")
