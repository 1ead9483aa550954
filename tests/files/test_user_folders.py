"""Private folders are entered by their owner only, and the cache is where the platform keeps caches."""

import os
import stat
import sys
from pathlib import Path

import pytest

from farfield.addon.core.errors import FileError
from farfield.addon.core.files import user_folders
from farfield.addon.core.files.user_folders import check_owner, open_private_folder, user_cache_folder

posix_only = pytest.mark.skipif(os.name == "nt", reason="Windows has access control lists instead of owners and modes")


def test_the_cache_is_where_the_platform_keeps_caches(monkeypatch):
    absolute, home = Path("C:/caches" if os.name == "nt" else "/caches"), Path("C:/me" if os.name == "nt" else "/me")
    monkeypatch.setattr(Path, "home", lambda: home)
    for platform, variable, default in (
        ("linux", "XDG_CACHE_HOME", home / ".cache"),
        ("win32", "LOCALAPPDATA", home / "AppData" / "Local"),
        ("darwin", None, home / "Library" / "Caches"),
    ):
        monkeypatch.setattr(sys, "platform", platform)
        if variable is not None:
            monkeypatch.setenv(variable, str(absolute))
            assert user_cache_folder() == absolute / "farfield"
            monkeypatch.setenv(variable, "relative")  # to be ignored by the XDG specification
        assert user_cache_folder() == default / "farfield"


def test_a_user_without_home_gets_a_sentence(monkeypatch):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", no_home)
    for variable in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(FileError, match="no home folder"):
        user_cache_folder()


@posix_only
@pytest.mark.parametrize("mode", [None, 0o755, 0o777, 0o700])
def test_only_the_owner_may_enter_a_private_folder(tmp_path, mode):
    folder = tmp_path / "a" / "b"
    if mode is not None:
        folder.mkdir(parents=True)
        folder.chmod(mode)
    open_private_folder(folder)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


@posix_only
def test_a_link_is_rejected_and_what_it_refers_to_stays(tmp_path):
    target = tmp_path / "target"
    target.mkdir()
    target.chmod(0o755)
    (tmp_path / "link").symlink_to(target)
    with pytest.raises(FileError, match="is a link"):
        open_private_folder(tmp_path / "link")
    (tmp_path / "dangling").symlink_to(tmp_path / "missing")
    with pytest.raises(FileError, match="is a link"):
        open_private_folder(tmp_path / "dangling")
    assert stat.S_IMODE(target.stat().st_mode) == 0o755 and not (tmp_path / "missing").exists()


@posix_only
def test_a_folder_of_another_user_is_rejected(tmp_path, monkeypatch):
    other = os.geteuid() + 1
    monkeypatch.setattr(user_folders.os, "geteuid", lambda: other)
    for check in (open_private_folder, check_owner):
        with pytest.raises(FileError, match="belongs to another user; choose a folder of your own"):
            check(tmp_path)


def test_a_file_and_a_place_that_cannot_be_used_are_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match="is a file"):
        open_private_folder(tmp_path / "file")
    with pytest.raises(FileError, match="Cannot use the folder"):
        open_private_folder(tmp_path / "file" / "below")
    with pytest.raises(FileError, match="Cannot use the folder"):
        check_owner(tmp_path / "missing")
