"""A heartbeat file that shows that a run is alive. Its workers, on any machine, watch the file and exit when the run ends.

A run touches its file regularly, deletes it at the end, and deletes the files of earlier runs in the same folder. So no worker outlives a
run that was cancelled, killed or replaced for long, not even on another machine that shares nothing but the folder.
"""

import os
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..errors import FileError

FILE_SUFFIX = ".heartbeat"
POLL_SECONDS = 0.25  # between two checks of the file
TIMEOUT_SECONDS = 60.0  # without a touch until a run counts as dead


@dataclass(frozen=True)
class Heartbeat:
    """The heartbeat file of a current run."""

    path: Path

    def renew(self) -> None:
        """Touch the file.

        Raises:
            FileError: another run has taken over the folder.
        """
        try:
            os.utime(self.path)
        except FileNotFoundError:
            raise FileError(f'Another run has started in "{self.path.parent}", so this one stops; let one of them finish.') from None
        except OSError:
            return  # a network drive with a hiccup: the next call tries again


@contextmanager
def hold(folder: Path) -> Iterator[Heartbeat]:
    """Keep a heartbeat file in `folder` during the block, and delete those of earlier runs.

    Raises:
        FileError: the folder is not writable.
    """
    path = folder / f"{uuid.uuid4().hex}{FILE_SUFFIX}"
    try:
        for earlier in folder.glob(f"*{FILE_SUFFIX}"):
            earlier.unlink(missing_ok=True)
        path.touch()
    except OSError as error:
        raise FileError(
            f'The folder "{folder}" cannot be written: {error.strerror}. Free some space there or choose another one.'
        ) from error
    try:
        yield Heartbeat(path)
    finally:
        path.unlink(missing_ok=True)


def watch(path: Path, on_end: Callable[[], None]) -> None:
    """Call `on_end` from a new thread once the file at `path` is deleted or no longer touched, or the parent process has died."""
    threading.Thread(target=_watch, args=(path, os.getppid(), on_end), name="farfield-heartbeat", daemon=True).start()


def _watch(path: Path, parent: int, on_end: Callable[[], None]) -> None:
    last_touch, last_change = None, time.monotonic()
    while os.getppid() == parent:
        try:
            touch = path.stat().st_mtime_ns
            if touch != last_touch:
                last_touch, last_change = touch, time.monotonic()
        except FileNotFoundError:
            break
        except OSError:
            pass  # not readable at the moment
        if time.monotonic() - last_change > TIMEOUT_SECONDS:
            break
        time.sleep(POLL_SECONDS)
    on_end()
