"""Checks of paths: one sentence for every file that cannot be read or written."""

import errno
import os

import pytest

from farfield.addon.core.errors import FileError
from farfield.addon.core.files import file_access
from farfield.addon.core.files.file_access import (
    check_empty,
    check_readable,
    check_writable,
    check_writable_folder,
    error_reason,
    is_stream,
)

only_on_posix = pytest.mark.skipif(os.name == "nt", reason="Windows has no mode bits and no named pipes in folders")


def message(check, path):
    """Return the one sentence of the error that `check` raises."""
    with pytest.raises(FileError) as caught:
        check(path)
    text = str(caught.value)
    assert text.endswith(".") and "\n" not in text
    return text


def test_input_that_is_not_a_file(tmp_path):
    assert "does not exist" in message(check_readable, tmp_path / "none.obj")
    assert "is a folder" in message(check_readable, tmp_path)
    (tmp_path / "file").touch()
    check_readable(tmp_path / "file")
    assert "does not exist" in message(check_readable, tmp_path / "file" / "below")


@only_on_posix
def test_pipes_and_devices_are_named(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", file_access.Path(os.devnull)):
        assert "device or a pipe" in message(check_readable, path)
        assert "device or a pipe" in message(check_writable, path)
        assert is_stream(path)
    assert not is_stream(tmp_path / "none") and not is_stream(tmp_path)


@pytest.mark.parametrize("check", [check_readable, check_writable, check_writable_folder, check_empty, is_stream])
def test_a_name_that_is_too_long(check, tmp_path):
    assert "choose a shorter name" in message(check, tmp_path / ("a" * 300))


@only_on_posix
@pytest.mark.parametrize("check", [check_readable, check_writable, check_writable_folder, check_empty])
def test_a_folder_that_may_not_be_entered(check, tmp_path, monkeypatch):
    def deny(path, **_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(file_access.Path, "stat", deny)  # the superuser may enter every folder
    assert "permissions" in message(check, tmp_path / "locked" / "a.obj")


@pytest.mark.parametrize("check", [check_readable, check_writable, check_writable_folder, check_empty, is_stream])
def test_paths_that_are_no_text(check, tmp_path, monkeypatch):
    """Linux allows them, but Blender can neither read nor write them."""
    assert '\ufffd.obj" is not valid UTF-8 text; rename' in message(check, tmp_path / "\udcff.obj")
    assert "not valid UTF-8" in message(check, tmp_path / "a\0.obj")
    if os.name != "nt":
        (tmp_path / "\udcff").mkdir()
        monkeypatch.chdir(tmp_path / "\udcff")
        assert "not valid UTF-8" in message(check, file_access.Path("a.obj"))


@only_on_posix
def test_a_loop_of_links(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for check in (check_readable, check_writable, check_writable_folder):
        message(check, tmp_path / "loop")


@only_on_posix
def test_a_read_only_file_is_not_replaced_by_the_superuser_either(tmp_path):
    path = tmp_path / "a.blend"
    path.touch(mode=0o444)
    assert "read-only" in message(check_writable, path)
    path.chmod(0o644)
    check_writable(path)


def test_output_folders(tmp_path):
    (tmp_path / "file").touch()
    assert "is a file" in message(check_writable_folder, tmp_path / "file")
    assert "not empty" in message(check_writable_folder, tmp_path)
    assert "not a folder" in message(check_writable, tmp_path / "file" / "a.obj")
    check_writable_folder(tmp_path / "new" / "folder")


def test_the_reason_of_an_error_is_one_line():
    assert error_reason(OSError(errno.ENOSPC, "No space left on device")) == "No space left on device; free some space there"
    assert error_reason(OSError("first line.\nsecond line\n")) == "first line"
    assert error_reason(OSError()) == "OSError"
    assert "free" not in error_reason(IsADirectoryError(errno.EISDIR, "Is a directory"))
