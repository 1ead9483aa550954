"""Blender worker processes that run one module of Farfield: how to start them, and how they end."""

import json
import os
import shutil
import sys
from pathlib import Path

import bpy

from ..core.jobs.core_worker import module_folders

START_SCRIPT = Path(__file__).with_name("worker_start.py")
MODULES = ("scipy", "openvdb")  # that workers may not find: Blender has the first one by its extensions, pip's bpy the second by scripts


def worker_command(module: str, arguments: list[str], *, has_preferences: bool = False) -> list[str]:
    """Return the command of a process like this one that calls `main(arguments)` of a `module` of the extension, for instance
    `addon.bridge.btf.capture.worker`, and exits with the returned code. Blender starts itself; Python with pip's bpy starts Python.

    has_preferences: whether Blender has the preferences and add-ons of the user, on which devices and engines of renders depend.
    """
    worker_arguments = [module, json.dumps(module_folders(*MODULES)), *arguments]
    if bpy.app.module:
        return [sys.executable, str(START_SCRIPT), *worker_arguments]
    startup = [] if has_preferences else ["--factory-startup"]
    return [bpy.app.binary_path, "--background", *startup, "--python", str(START_SCRIPT), "--", *worker_arguments]


def exit_process(code: int) -> None:
    """End this process with the exit code `code` immediately: Blender 4.5 as a Python module hangs during shutdown."""
    shutil.rmtree(bpy.app.tempdir, ignore_errors=True)  # as Blender would
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
