"""Sealed files appear complete or not at all, and damage to any byte is found."""

import errno
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.errors import FileError
from farfield.addon.core.files import sealed_files
from farfield.addon.core.files.sealed_files import is_valid, read_sealed, seal, unseal, validate_or_remove, write_sealed


@given(st.binary(max_size=200), st.data())
def test_a_flipped_bit_or_a_missing_end_is_found(content, data):
    sealed = seal(content)
    assert unseal(sealed) == content
    damaged = bytearray(sealed)
    damaged[data.draw(st.integers(0, len(sealed) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    assert unseal(bytes(damaged)) is None
    assert unseal(sealed[: data.draw(st.integers(0, len(sealed) - 1))]) is None
    assert unseal(sealed + b"\0") is None


@pytest.mark.parametrize("size", [0, 1, 32, sealed_files.CHUNK_BYTES - 1, 2 * sealed_files.CHUNK_BYTES + 5])
def test_files_round_trip(tmp_path, size):
    path, content = tmp_path / "Höhe.tile", os.urandom(size)
    write_sealed(path, content)
    assert is_valid(path) and validate_or_remove(path) and read_sealed(path, "start again") == content
    assert [item.name for item in tmp_path.iterdir()] == ["Höhe.tile"]
    first = path.read_bytes()
    write_sealed(path, content)
    assert path.read_bytes() == first


def test_damaged_and_missing_files_are_named(tmp_path):
    path = tmp_path / "a.tile"
    assert not is_valid(path) and not validate_or_remove(path)
    with pytest.raises(FileError, match=r'a\.tile" cannot be read: No such file or directory; start the build again\.$'):
        read_sealed(path, "start the build again")
    path.write_bytes(seal(b"content")[:-1])
    with pytest.raises(FileError, match=r'a\.tile" is damaged; start the build again\.$'):
        read_sealed(path, "start the build again")
    assert not is_valid(path) and path.exists()
    assert not validate_or_remove(path) and not path.exists()


def test_a_folder_in_the_place_of_a_file_is_named(tmp_path):
    (tmp_path / "a.tile" / "folder").mkdir(parents=True)
    assert not is_valid(tmp_path / "a.tile")
    with pytest.raises(FileError, match=r'a\.tile" is damaged and cannot be deleted'):
        validate_or_remove(tmp_path / "a.tile")
    with pytest.raises(FileError, match=r'a\.tile" cannot be saved'):
        write_sealed(tmp_path / "a.tile", b"content")


def test_a_full_disk_is_one_sentence(tmp_path, monkeypatch):
    def fail(path, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr(sealed_files, "write_bytes_atomically", fail)
    with pytest.raises(FileError, match=r'a\.tile" cannot be saved: No space left on device; free some space there\.$'):
        write_sealed(tmp_path / "a.tile", b"content")
