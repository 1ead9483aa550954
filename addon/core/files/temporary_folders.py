"""Temporary folders whose names tell which process created them, so that the next run can remove those of processes that were killed."""

import hashlib
import os
import platform
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

NAME_PATTERN = re.compile(r"\.?farfield-(?P<machine>[0-9a-f]{8})-(?P<process>\d+)-(?P<start>\d+)-")
STILL_ACTIVE = 259  # the exit code of a running process on Windows
QUERY_LIMITED_INFORMATION = 0x1000  # an access right on Windows


@contextmanager
def temporary_folder(parent: Path | None = None) -> Iterator[Path]:
    """Yield a new folder that only this user can read, and delete it at the end of the block.

    parent: where to create it, with a hidden name; the system's temporary folder if it is None. Folders that dead processes left there are
    deleted first.

    Raises:
        OSError: the folder cannot be created.
    """
    folder = create_temporary_folder(parent)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def create_temporary_folder(parent: Path | None = None) -> Path:
    """Return a new folder as `temporary_folder` does; the caller deletes it. Raises OSError."""
    place = Path(tempfile.gettempdir()) if parent is None else parent
    remove_abandoned_folders(place)
    return Path(tempfile.mkdtemp(prefix=folder_prefix() if parent is None else f".{folder_prefix()}", dir=place))


def folder_prefix() -> str:
    """Return the beginning of the names of this process's temporary folders: farfield-MACHINE-PROCESS-START-."""
    process = os.getpid()
    return f"farfield-{_machine_id()}-{process}-{_start_time(process) or 0}-"


def remove_abandoned_folders(parent: Path) -> None:
    """Delete the temporary folders in `parent` that belong to this user and to processes of this machine that no longer run."""
    with suppress(OSError):  # a folder that cannot be listed
        for entry in os.scandir(parent):
            if is_owner_running(entry.name) is False and _is_own_folder(entry):
                shutil.rmtree(entry.path, ignore_errors=True)


def is_owner_running(name: str) -> bool | None:
    """Return whether the process runs whose `folder_prefix` begins a name; None if it is on another machine, or there is none."""
    match = NAME_PATTERN.match(name)
    if match is None or match["machine"] != _machine_id():
        return None
    return _is_running(int(match["process"]), int(match["start"]))


def _machine_id() -> str:
    """Return 8 hexadecimal digits that differ between machines, and between containers that count processes on their own."""
    namespace = 0
    with suppress(OSError):
        namespace = os.stat("/proc/self/ns/pid").st_ino  # noqa: PTH116 - not a file
    return hashlib.sha256(f"{platform.node()} {namespace}".encode()).hexdigest()[:8]


def _is_own_folder(entry: os.DirEntry) -> bool:
    try:
        status = entry.stat(follow_symlinks=False)
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and (not hasattr(os, "getuid") or status.st_uid == os.geteuid())


def _is_running(process: int, start: int) -> bool:
    """Whether the process with this number and start time runs; a start time of 0 is unknown."""
    if _start_time(os.getpid()) is not None:  # this system tells start times
        current = _start_time(process)
        return current is not None and start in (0, current)
    return _is_running_on_windows(process) if os.name == "nt" else _is_running_on_posix(process)


def _start_time(process: int) -> int | None:
    """Return when a process started, in clock ticks since the system's start. None if it has ended or where there is no /proc."""
    if sys.platform != "linux":
        return None
    try:
        content = Path(f"/proc/{process}/stat").read_bytes()
    except OSError:
        return None
    fields = content.rpartition(b")")[2].split()  # the name in parentheses may contain spaces
    return None if fields[0] in (b"Z", b"X") else int(fields[19])


def _is_running_on_posix(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _is_running_on_windows(process: int) -> bool:
    import ctypes
    from ctypes import wintypes

    kernel = ctypes.windll.kernel32
    kernel.OpenProcess.restype = wintypes.HANDLE
    handle = wintypes.HANDLE(kernel.OpenProcess(QUERY_LIMITED_INFORMATION, False, process))
    if not handle:
        return False
    code = wintypes.DWORD()
    try:
        return not kernel.GetExitCodeProcess(handle, ctypes.byref(code)) or code.value == STILL_ACTIVE
    finally:
        kernel.CloseHandle(handle)
