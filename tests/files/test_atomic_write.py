"""Atomic output: the old file stays, or the new one is complete and on the disk."""

import errno
import os

import pytest

from farfield.addon.core.errors import FileError
from farfield.addon.core.files import atomic_write as module
from farfield.addon.core.files.atomic_write import atomic_folder, atomic_write, recorded_outputs, write_bytes_atomically

only_on_posix = pytest.mark.skipif(os.name == "nt", reason="links and mode bits are those of POSIX")


@pytest.fixture
def calls(monkeypatch):
    """Record what is synced and renamed, in order, by file names; a synced descriptor is looked up by its inode."""
    recorded = []
    fsync, replace = os.fsync, module.Path.replace

    def record_fsync(descriptor):
        recorded.append(("sync", os.fstat(descriptor).st_ino))
        fsync(descriptor)

    def record_replace(self, target):
        recorded.append(("replace", self.stat().st_ino))
        return replace(self, target)

    monkeypatch.setattr(module.os, "fsync", record_fsync)
    monkeypatch.setattr(module.Path, "replace", record_replace)
    return recorded


@only_on_posix
def test_files_are_on_the_disk_before_they_replace_anything(tmp_path, calls):
    with atomic_write(tmp_path / "one") as path:
        path.write_text("x")
    write_bytes_atomically(tmp_path / "two.bin", b"y")
    folder = tmp_path.stat().st_ino
    one, two = (tmp_path / "one").stat().st_ino, (tmp_path / "two.bin").stat().st_ino
    assert calls == [(word, inode) for file in (one, two) for word, inode in (("sync", file), ("replace", file), ("sync", folder))]


@only_on_posix
def test_every_file_of_a_folder_is_on_the_disk_before_it_appears(tmp_path, calls):
    with atomic_write(tmp_path / "images") as path:
        (path / "below").mkdir(parents=True)
        for name in ("a", "b", "below/c"):
            (path / name).touch()
    synced = {inode for word, inode in calls[: [word for word, _ in calls].index("replace")]}
    assert synced == {path.stat().st_ino for path in (tmp_path / "images").rglob("*")} | {(tmp_path / "images").stat().st_ino}
    calls.clear()
    with atomic_folder(tmp_path) as path:
        (path / "d").touch()
        (path / "e").touch()
    assert [word for word, _ in calls] == ["sync", "sync", "replace", "replace", "sync"]


def test_outputs_that_appear_are_recorded_in_their_order(tmp_path):
    with recorded_outputs() as outputs:
        with atomic_write(tmp_path / "one") as path:
            path.touch()
        with atomic_folder(tmp_path) as folder:
            (folder / "two").touch()
            assert outputs == [tmp_path / "one"]
        with pytest.raises(ValueError, match="fails"), atomic_write(tmp_path / "three"):
            raise ValueError("fails")
        write_bytes_atomically(tmp_path / "four", b"of a work folder")
    with atomic_write(tmp_path / "five") as path:
        path.touch()
    assert outputs == [tmp_path / "one", tmp_path / "two"]


@pytest.mark.parametrize("write", [atomic_write, lambda target: atomic_folder(target.parent)])
@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), KeyboardInterrupt()])
def test_an_error_keeps_the_old_file(tmp_path, write, error):
    old = tmp_path / "report.json"
    old.write_text("old")
    with pytest.raises(FileError if isinstance(error, OSError) else KeyboardInterrupt), write(old) as temporary:
        (temporary / "new" if temporary.is_dir() else temporary).write_text("half")
        raise error
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"] and old.read_text() == "old"


def test_a_disk_that_is_full_when_the_file_is_flushed(tmp_path, monkeypatch):
    def fail(_descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "a").write_text("old")
    monkeypatch.setattr(module.os, "fsync", fail)
    with pytest.raises(FileError, match="free some space"), atomic_write(tmp_path / "a") as path:
        path.write_text("new")
    assert (tmp_path / "a").read_text() == "old" and len(list(tmp_path.iterdir())) == 1


@only_on_posix
@pytest.mark.parametrize("write", [atomic_write, lambda target: atomic_folder(target.parent)])
def test_a_link_stays_and_its_target_is_replaced(tmp_path, write):
    (tmp_path / "store").mkdir()
    (tmp_path / "store" / "real").write_text("old")
    link = tmp_path / "a.txt"
    link.symlink_to("store/real")
    with write(link) as path:
        (path / link.name if path.is_dir() else path).write_text("new")
    assert link.is_symlink() and (tmp_path / "store" / "real").read_text() == "new"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a.txt", "real", "store"]


@only_on_posix
@pytest.mark.parametrize("write", [atomic_write, lambda target: atomic_folder(target.parent)])
def test_a_broken_link_is_written_through(tmp_path, write):
    link = tmp_path / "a.txt"
    link.symlink_to("new")
    with write(link) as path:
        (path / link.name if path.is_dir() else path).write_text("new")
    assert link.is_symlink() and (tmp_path / "new").read_text() == "new"


@only_on_posix
def test_a_link_to_another_disk(tmp_path, monkeypatch):
    replace = module.Path.replace

    def refuse_other_disk(self, target):
        if target.parent.name == "disk" and self.parent.parent.name != "disk":
            raise OSError(errno.EXDEV, os.strerror(errno.EXDEV))
        return replace(self, target)

    (tmp_path / "disk").mkdir()
    (tmp_path / "a.txt").symlink_to("disk/real")
    monkeypatch.setattr(module.Path, "replace", refuse_other_disk)
    with atomic_folder(tmp_path) as folder:
        (folder / "a.txt").write_text("new")
    assert (tmp_path / "disk" / "real").read_text() == "new" and (tmp_path / "a.txt").is_symlink()


@only_on_posix
def test_what_cannot_be_replaced_is_rejected(tmp_path):
    (tmp_path / "locked").touch(mode=0o444)
    for target in (tmp_path / "locked", module.Path(os.devnull)):
        with pytest.raises(FileError), atomic_write(target):
            raise AssertionError("never entered")
    with pytest.raises(FileError, match="read-only"), atomic_folder(tmp_path) as folder:
        for name in ("first", "locked"):
            (folder / name).write_text("new")
    assert [path.name for path in tmp_path.iterdir()] == ["locked"]
