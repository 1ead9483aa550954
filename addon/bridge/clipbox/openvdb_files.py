"""OpenVDB volumes, read in a separate process: the library trusts the numbers in a file; a damaged one crashes it or fills the memory."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np

from ...core.clipbox.files.file_data import Voxels
from ...core.errors import FileError
from ...core.files.temporary_folders import temporary_folder
from ...core.jobs.subprocess_pool import NO_WINDOW, TEMPORARY_FOLDER_VARIABLES
from ..worker_processes import worker_command
from . import openvdb_worker

TIMEOUT_SECONDS = 120.0  # 2 GiB of values take less than a minute; in some damaged files the library never finds the end


def read_vdb(path: Path) -> Voxels:
    """Read the first grid of numbers or booleans. The inside of a level set is solid.

    Raises:
        FileError: there is no such grid, it is damaged or too large, or Blender lacks the module openvdb.
    """
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        raise FileError(f'The path of "{path}" is not valid UTF-8, which OpenVDB needs; rename the file.') from None
    with temporary_folder() as folder:
        outcome = _run_worker(path, folder)
        if outcome.returncode == openvdb_worker.EXIT_ERROR:
            raise FileError(json.loads(_last_line(outcome.stderr)))
        if outcome.returncode == openvdb_worker.EXIT_MEMORY:
            limit = openvdb_worker.MAX_MEMORY_BYTES / 2**30
            raise FileError(f'"{path}" is damaged, or needs more than {limit:g} GiB of memory; save it again, with fewer voxels.')
        if outcome.returncode != 0:
            raise FileError(f'"{path}" cannot be read as an OpenVDB file: it is damaged or has another format; save it again.')
        outside = json.loads((folder / openvdb_worker.OUTSIDE_FILE).read_text(encoding="utf-8"))
        return Voxels(np.load(folder / openvdb_worker.VALUES_FILE, allow_pickle=False), outside=outside)


def _run_worker(path: Path, folder: Path) -> subprocess.CompletedProcess:
    """Run the worker. Its own temporary files are in `folder` as well."""
    environment = os.environ | dict.fromkeys(TEMPORARY_FOLDER_VARIABLES, str(folder)) | openvdb_worker.ENVIRONMENT
    try:
        return subprocess.run(
            worker_command("addon.bridge.clipbox.openvdb_worker", [str(path), str(folder)]),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env=environment,
            timeout=TIMEOUT_SECONDS,
            creationflags=NO_WINDOW,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise FileError(f'"{path}" was not read within {TIMEOUT_SECONDS:g} s; it is damaged or too large, so save it again.') from None
    except OSError as error:
        raise FileError(f'"{path}" cannot be read: no process can be started for it: {error.strerror or error}.') from error


def _last_line(output: bytes) -> str:
    return output.decode("utf-8", errors="replace").strip().rpartition("\n")[2]
