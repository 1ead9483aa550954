"""The folder of a terrain is replaced safely: other files stay, links are followed, and whenever it is killed one terrain is there."""

import os
from pathlib import Path

import pytest

from farfield.addon.core.bdam.building import store_target
from farfield.addon.core.bdam.building.store_target import (
    check_target,
    delete_work_folder,
    recover_store,
    replace_store,
    work_folder_path,
)
from farfield.addon.core.bdam.store.structure import STRUCTURE_FILE
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.atomic_write import recorded_outputs

only_on_posix = pytest.mark.skipif(os.name == "nt", reason="links need a privilege on Windows")


class Killed(BaseException):
    """Stands for a process that is killed: no handler of errors sees it."""


def make_store(folder: Path, content: bytes) -> Path:
    """Write something with the names of a terrain."""
    (folder / "textures").mkdir(parents=True)
    (folder / STRUCTURE_FILE).write_bytes(content)
    (folder / "geometry.bdam").write_bytes(content)
    (folder / "textures" / "textures.tiles").write_bytes(content)
    return folder


def replace(out: Path, content: bytes) -> None:
    """Do what a build does."""
    check_target(out)
    recover_store(out)
    with replace_store(out) as new:
        make_store(new, content)


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def store(tmp_path) -> Path:
    return make_store(tmp_path / "store", b"old")


def test_a_terrain_is_one_of_the_outputs_of_a_run(tmp_path):
    with recorded_outputs() as outputs:
        replace(tmp_path / "store", b"new")
    assert outputs == [tmp_path / "store"]


def test_a_terrain_is_replaced(store):
    (store / ".DS_Store").touch()
    replace(store, b"new")
    assert (store / STRUCTURE_FILE).read_bytes() == b"new" and not (store / ".DS_Store").exists()
    assert names_in(store.parent) == ["store"]


@pytest.mark.parametrize("name", ["dem.npy", "precious.blend", "sub/x.txt", "textures/notes.txt", "geometry-backup.bdam/x"])
def test_a_folder_with_other_files_is_refused_and_unchanged(store, name):
    path = store / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"mine")
    with pytest.raises(FileError, match=r"contains other files \(.*choose an empty or a new folder"):
        replace(store, b"new")
    assert path.read_bytes() == b"mine" and (store / STRUCTURE_FILE).read_bytes() == b"old"


@pytest.mark.parametrize("name", ["terrain.new", "terrain.build", "terrain.build-finished", "terrain.old"])
def test_folders_with_similar_names_stay(tmp_path, name):
    other = make_store(tmp_path / name, b"another")
    (other / "precious.txt").touch()
    replace(tmp_path / "terrain", b"new")
    delete_work_folder_of(tmp_path / "terrain")
    assert (other / STRUCTURE_FILE).read_bytes() == b"another" and (other / "precious.txt").exists()
    assert names_in(tmp_path) == sorted(["terrain", name])


def delete_work_folder_of(out: Path) -> None:
    work = work_folder_path(out)
    work.mkdir()
    (work / "job.json").touch()
    check_target(out)
    delete_work_folder(work)
    assert not work.exists()


@only_on_posix
@pytest.mark.parametrize("exists", [True, False])
def test_links_are_followed(tmp_path, exists):
    place = tmp_path / "disk"
    place.mkdir()
    link = tmp_path / "link"
    link.symlink_to(place / "store")
    if exists:
        make_store(place / "store", b"old")
    replace(link, b"new")
    assert link.is_symlink() and (place / "store" / STRUCTURE_FILE).read_bytes() == b"new"
    assert names_in(place) == ["store"] and work_folder_path(link).parent == place


@only_on_posix
def test_a_work_folder_that_is_a_link_is_refused(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    work_folder_path(tmp_path / "store").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FileError, match="needs that folder"):
        check_target(tmp_path / "store")


@pytest.mark.parametrize("moment", range(4))
def test_whenever_it_is_killed_one_terrain_is_there_and_the_next_build_finishes(store, monkeypatch, moment):
    """Renames happen one after the other; each moment is before one of them."""
    rename, calls = Path.rename, []

    def rename_or_die(self, target):
        calls.append(self.name)
        if len(calls) > moment:
            raise Killed
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", rename_or_die)
    monkeypatch.setattr(store_target, "temporary_folder", keep_temporary_folder)
    died = False
    try:
        replace(store, b"new")
    except Killed:
        died = True
    assert died == (moment < 3), "there are three renames"
    monkeypatch.undo()
    before = names_in(store.parent)
    check_target(store)
    assert names_in(store.parent) == before, "a check renames nothing"
    recover_store(store)
    assert (store / STRUCTURE_FILE).read_bytes() == (b"old" if moment < 2 else b"new")
    replace(store, b"newer")
    assert (store / STRUCTURE_FILE).read_bytes() == b"newer"
    assert [name for name in names_in(store.parent) if not name.startswith(".kept")] == ["store"]


class keep_temporary_folder:
    """A temporary folder that nobody deletes, because the process was killed."""

    def __init__(self, parent: Path) -> None:
        self.path = parent / ".kept"

    def __enter__(self) -> Path:
        self.path.mkdir()
        return self.path

    def __exit__(self, *_: object) -> None:
        pass


def test_a_terrain_that_cannot_be_renamed_stays(store, monkeypatch):
    """On Windows a file in it may be open."""
    rename = Path.rename

    def refuse(self, target):
        if self.name == "store" and ".farfield-" in str(self.parent):
            raise PermissionError(13, "is open in another program")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(FileError, match="is open in another program"):
        replace(store, b"new")
    assert (store / STRUCTURE_FILE).read_bytes() == b"old" and names_in(store.parent) == ["store"]
