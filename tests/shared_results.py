"""Data that takes long to make and that tests only read: the processes of a run make it once, and find it in a folder that they share."""

import os
import shutil
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

FOLDER_VARIABLE = "FARFIELD_SHARED_TEST_DATA"  # conftest.py sets it; the processes of a run inherit it
MAX_WAIT_SECONDS = 120.0  # After that a process makes the data itself: the one that it waits for may have crashed.


def make_once(name: str, make: Callable[[Path], None]) -> Path:
    """Return a file or folder of the run, which `make` has written to the path that it got, here or in another process.

    `name` must differ where the data differs.
    """
    path = Path(os.environ[FOLDER_VARIABLE], name)
    lock, deadline = path.with_name(f"{name}.lock"), time.monotonic() + MAX_WAIT_SECONDS
    while not (path.exists() or _create(lock) or time.monotonic() > deadline):
        time.sleep(0.05)
    if not path.exists():
        work = Path(tempfile.mkdtemp(prefix="unfinished-", dir=path.parent))
        try:
            make(work / name)
            with suppress(OSError):  # Another process was faster.
                (work / name).rename(path)
        finally:
            shutil.rmtree(work)
            with suppress(OSError):
                lock.rmdir()
    return path


def _create(lock: Path) -> bool:
    """Return whether this process has created the folder `lock`, which no other process has then."""
    try:
        lock.mkdir()
    except FileExistsError:
        return False
    return True
