"""Logs of defects: the traceback of an error that Farfield did not expect, for a report."""

import os
import platform
import tempfile
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from .filenames import safe_filename


def write_defect_log(tool: str, error: BaseException, details: Sequence[str] = ()) -> Path | None:
    """Write the traceback of `error` to a new file in the system's temporary folder that only this user can read, and return its path.

    tool: what failed, for instance a script or an operator. details: further lines, for instance the version of Blender.

    Returns None if the file cannot be written.
    """
    lines = [f"Farfield: {tool}", time.strftime("%Y-%m-%d %H:%M:%S %z"), platform.platform()]
    lines += [f"Python {platform.python_version()}, NumPy {np.__version__}", *details, ""]
    content = "\n".join(lines) + "\n" + "".join(traceback.format_exception(error))
    path = None
    try:
        descriptor, name = tempfile.mkstemp(prefix=f"farfield-defect-{safe_filename(tool)}-", suffix=".log")
        path = Path(name)
        with os.fdopen(descriptor, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(content)
    except OSError:
        if path is not None:
            with suppress(OSError):
                path.unlink()
        return None
    return path


def defect_message(tool: str, error: BaseException, log: Path | None) -> str:
    """Return one sentence about a defect: what failed, the error, and where its log is, as `write_defect_log` returned it."""
    words = " ".join(str(error).split())
    reason = f"{type(error).__name__}: {words}" if words else type(error).__name__
    place = f'with the log "{log}"' if log is not None else "(its log could not be written)"
    return f"{tool} failed because of a defect of Farfield ({reason.rstrip('.')}); please report it {place}."
