"""Memory that is not used any more goes back to the system."""

import sys
from pathlib import Path

import numpy as np
import pytest

from farfield.addon.core.jobs.memory import release_memory

SIZE, COUNT = 100_000, 3000  # Bytes of an array, below those that the system gives and takes one by one, and their number.


def read_resident_bytes() -> int:
    return 4096 * int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])


@pytest.mark.skipif(sys.platform != "linux", reason="other allocators give memory back by themselves")
def test_memory_between_arrays_that_stay_is_given_back():
    arrays = [np.ones(SIZE, np.uint8) for _ in range(COUNT)]
    kept = arrays[::30]
    del arrays
    before = read_resident_bytes()
    release_memory()
    assert before - read_resident_bytes() > 0.5 * SIZE * COUNT and all(array.all() for array in kept)


def test_other_systems_need_no_help(monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    release_memory()
