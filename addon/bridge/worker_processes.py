"""Blender processes that run one module of Farfield: how they are started, and what they see of their run."""

import os
import shutil
import sys
from pathlib import Path

import bpy
import scipy

from ..core import lease

START = Path(__file__).with_name("worker_start.py")
ABANDONED = 3  # exit code of a worker whose run has gone


def worker_command(module: str, arguments: list[str]) -> list[str]:
    """The command line of a process like this one, that calls `main(arguments)` of a `module` below the extension, such as
    `addon.bridge.btf_worker`, and ends with the code that it returns. A Blender program starts itself, Python under pip's bpy Python."""
    given = [module, str(Path(scipy.__file__).resolve().parents[1]), *arguments]
    if bpy.app.module:
        return [sys.executable, str(START), *given]
    return [bpy.app.binary_path, "--background", "--factory-startup", "--python", str(START), "--", *given]


def end_with(path: Path) -> None:
    """End this process when the run that holds the lease at `path` does, whatever it is at."""
    lease.watch(path, lambda: os._exit(ABANDONED))


def leave(code: int) -> None:
    """End this process with the exit code `code`, at once: Blender 4.5 as a Python module hangs while it is being taken down."""
    shutil.rmtree(bpy.app.tempdir, ignore_errors=True)  # as Blender would
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
