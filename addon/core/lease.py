"""A file that says that a run is alive. Its workers, wherever they are, see it and end when the run does.

A run touches its lease every now and then, takes it away when it ends, and takes away those of runs before it. So no worker of a run that
was stopped, killed or replaced goes on for long, also on another machine that sees nothing but the folder.
"""

import os
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from .errors import FileError

ENDING = ".lease"
LOOK = 0.25  # seconds between two looks at it
PATIENCE = 60.0  # seconds without a touch after which the run counts as dead


@dataclass(frozen=True)
class Lease:
    """The lease of a run under way."""

    path: Path

    def renew(self) -> None:
        """Say that the run is alive.

        Raises:
            FileError: when another run has taken over the folder.
        """
        try:
            os.utime(self.path)
        except FileNotFoundError:
            raise FileError(f'Another run has begun in "{self.path.parent}", and this one ends; let one of them finish.') from None
        except OSError:
            return  # a network drive that hiccups: the next look will tell


@contextmanager
def held(folder: Path) -> Iterator[Lease]:
    """The lease of a run in `folder`; runs before it have none from now on.

    Raises:
        FileError: when the folder takes no file.
    """
    path = folder / f"{uuid.uuid4().hex}{ENDING}"
    try:
        for old in folder.glob(f"*{ENDING}"):
            old.unlink(missing_ok=True)
        path.touch()
    except OSError as error:
        raise FileError(
            f'The folder "{folder}" cannot be written: {error.strerror}. Free some space there or choose another one.'
        ) from error
    try:
        yield Lease(path)
    finally:
        path.unlink(missing_ok=True)


def watch(path: Path, end: Callable[[], None]) -> None:
    """Call `end` from a thread of its own once the lease at `path` has gone or nobody touches it, or the parent process has died."""
    threading.Thread(target=_watch, args=(path, os.getppid(), end), name="farfield-lease", daemon=True).start()


def _watch(path: Path, parent: int, end: Callable[[], None]) -> None:
    touched, seen = None, time.monotonic()
    while os.getppid() == parent:
        try:
            now = path.stat().st_mtime_ns
            if now != touched:
                touched, seen = now, time.monotonic()
        except FileNotFoundError:
            break
        except OSError:
            pass  # no news
        if time.monotonic() - seen > PATIENCE:
            break
        time.sleep(LOOK)
    end()
