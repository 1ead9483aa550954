"""Scratch arrays keep their values, in memory or in files, and leave nothing behind."""

import shutil
import tempfile
from collections import namedtuple

import numpy as np
import pytest

from farfield.addon.core.errors import FileError
from farfield.addon.core.files import scratch as scratch_module
from farfield.addon.core.files.scratch import Scratch


@pytest.fixture(autouse=True)
def temporary(tmp_path, monkeypatch):
    """The folder of temporary files, empty at first."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_arrays_stay_in_memory_up_to_the_limit_and_are_mapped_beyond(temporary):
    first, second = np.arange(100, dtype=np.uint8), np.random.default_rng(0).normal(size=(7, 5, 3)).astype(np.float32)
    with Scratch(max_memory=100) as scratch:
        assert scratch.keep(first, 0) is first
        assert not list(temporary.iterdir())
        kept = scratch.keep(second, 1)
        assert isinstance(kept, np.memmap) and kept.dtype == np.float32
        assert np.array_equal(kept, second)
        kept[0] = 5.0
        scratch.release(1)
        scratch.release(7)
        assert (kept[0] == 5.0).all() and np.array_equal(kept[1:], second[1:])
        assert len(list(temporary.iterdir())) == 1
        del kept
    assert not list(temporary.iterdir())


def test_empty_arrays_and_masks_are_kept():
    with Scratch(max_memory=0) as scratch:
        assert scratch.keep(np.zeros((0, 3)), 0).shape == (0, 3)
        assert scratch.keep(np.array([True, False]), 0).tolist() == [True, False]


def test_nothing_is_left_after_an_error(temporary):
    with pytest.raises(ZeroDivisionError), Scratch(max_memory=0) as scratch:
        scratch.keep(np.ones(10), 0)
        raise ZeroDivisionError
    assert not list(temporary.iterdir())


def test_too_little_space_is_said_before_writing(monkeypatch, temporary):
    usage = namedtuple("usage", "total used free")(10**9, 10**9, scratch_module.MIN_FREE)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with Scratch(max_memory=0) as scratch, pytest.raises(FileError, match="has only 268 MB left; free some space, or use fewer"):
        scratch.keep(np.ones(10), 0)
    assert not list(temporary.iterdir())


def test_a_failed_write_is_one_sentence(monkeypatch):
    def fail(*_arguments, **_keywords):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "memmap", fail)
    with Scratch(max_memory=0) as scratch, pytest.raises(FileError, match="cannot be written"):
        scratch.keep(np.ones(10), 0)
