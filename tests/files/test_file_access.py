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
    exists,
    is_file,
    is_folder,
    is_stream,
    read_file,
)

only_on_posix = pytest.mark.skipif(os.name == "nt", reason="Windows has no mode bits and no named pipes in folders")

PLACES = {  # whether there is a file, a folder, or anything
    ".": (False, True, True),
    "file": (True, False, True),
    "link": (True, False, True),
    "dangling": (False, False, False),
    "none": (False, False, False),
    "file/below": (False, False, False),
    "pipe": (False, False, True),
}


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


@pytest.mark.parametrize(
    "check", [check_readable, check_writable, check_writable_folder, check_empty, is_stream, is_file, is_folder, exists]
)
@pytest.mark.parametrize("length", [300, 100_000])
def test_a_name_that_is_too_long(check, tmp_path, length):
    sentence = message(check, tmp_path / ("a" * length))
    assert "choose a shorter name" in sentence and len(sentence) < 1100


@only_on_posix
def test_what_lies_at_a_path(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to(tmp_path / "file")
    (tmp_path / "dangling").symlink_to(tmp_path / "none")
    os.mkfifo(tmp_path / "pipe")
    found = {name: (is_file(path), is_folder(path), exists(path)) for name in PLACES for path in [tmp_path / name]}
    assert found == PLACES
    for check in (is_file, is_folder, exists):
        assert "not valid UTF-8" in message(check, tmp_path / "a\0")


@only_on_posix
def test_no_more_of_a_file_is_read_than_is_allowed(tmp_path):
    (tmp_path / "file").write_bytes(b"12345")
    assert read_file(tmp_path / "file", 5) == b"12345"
    assert "more than 4 bytes" in message(lambda path: read_file(path, 4), tmp_path / "file")
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", file_access.Path("/dev/zero")):
        assert "device or a pipe" in message(lambda path: read_file(path, 4), path)


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
