"""A heartbeat file that shows that a run is alive. Its workers, on any machine, watch the file and exit when the run ends.

A run touches its file regularly, deletes it at the end, and deletes the files of earlier runs in the same folder. So no worker outlives a
run that was cancelled, killed or replaced for long, not even on another machine that shares nothing but the folder. Of several runs
that start in a folder at the same time, no two continue.
"""

import os
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ..errors import FileError
from ..files.file_access import convert_os_errors
from ..files.temporary_folders import folder_prefix, is_owner_running

FILE_SUFFIX = ".heartbeat"
POLL_SECONDS = 0.25  # between two checks of the file
TIMEOUT_SECONDS = 60.0  # without a touch until a run counts as dead
EXIT_RUN_GONE = 3  # exit code of a worker whose run has ended


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
            raise _other_run_error(self.path.parent) from None
        except OSError:
            return  # a network drive may fail briefly: the next call tries again

    def close(self) -> None:
        """Delete the file: the run has ended."""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)


def take_over(folder: Path) -> Heartbeat:
    """Start a run in `folder`: create its heartbeat file and delete those of earlier runs.

    Raises:
        FileError: the folder is not writable, or another run starts there at the same time.
    """
    path = folder / f"{folder_prefix()}{uuid.uuid4().hex}{FILE_SUFFIX}"
    with convert_os_errors(f'Cannot write in the folder "{folder}"'):
        _delete_others(path)
        path.touch()
        if min(folder.glob(f"*{FILE_SUFFIX}"), default=path) != path:  # created at the same time
            path.unlink(missing_ok=True)
            raise _other_run_error(folder)
        _delete_others(path)
    return Heartbeat(path)


def is_alive(folder: Path) -> bool:
    """Whether a run in `folder` goes on: its process runs or, on another machine, has touched its heartbeat file recently."""
    return any(_is_going_on(path) for path in folder.glob(f"*{FILE_SUFFIX}"))


def _is_going_on(path: Path) -> bool:
    is_running = is_owner_running(path.name)
    if is_running is not None:
        return is_running
    try:
        return time.time() - path.stat().st_mtime < TIMEOUT_SECONDS
    except OSError:
        return False


def watch(path: Path, on_end: Callable[[], None]) -> None:
    """Call `on_end` from a new thread once the file at `path` is deleted or no longer touched, or the parent process has died."""
    threading.Thread(target=_watch, args=(path, os.getppid(), on_end), name="farfield-heartbeat", daemon=True).start()


def exit_when_run_ends(path: Path) -> None:
    """End this process, in any state, when the run with the heartbeat file at `path` ends."""
    watch(path, lambda: os._exit(EXIT_RUN_GONE))


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


def _delete_others(path: Path) -> None:
    """Delete the heartbeat files of all runs in the folder of `path`, except `path`. Raises OSError."""
    for other in path.parent.glob(f"*{FILE_SUFFIX}"):
        if other != path:
            other.unlink(missing_ok=True)


def _other_run_error(folder: Path) -> FileError:
    return FileError(f'Another run has started in "{folder}", so this one stops; let one of them finish.')
