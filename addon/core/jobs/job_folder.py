"""The folder of a job that an interrupted run resumes: a file in it tells which job the finished files belong to."""

import json
from contextlib import suppress
from pathlib import Path

from ..errors import FileError
from ..files.atomic_write import TEMPORARY_SUFFIX, write_bytes_atomically
from ..files.file_access import convert_os_errors

JOB_FILE = "job.json"


def open_job_folder(folder: Path, fingerprint: str, other_job: str) -> None:
    """Create the folder, or check that it belongs to the job with this `fingerprint`.

    fingerprint: of everything that the finished files depend on: input, settings and the version of their format. other_job: how the error
    message describes the contents of a folder with another fingerprint: "a bake of another cloud or with other settings".

    Raises:
        FileError: the folder belongs to another job or cannot be written.
    """
    job_path, content = folder / JOB_FILE, json.dumps({"fingerprint": fingerprint}).encode()
    with convert_os_errors(f'The work folder "{folder}" cannot be used'):
        folder.mkdir(parents=True, exist_ok=True)
        if not job_path.exists():
            write_bytes_atomically(job_path, content)
        is_same = job_path.stat().st_size == len(content) and job_path.read_bytes() == content
    if not is_same:
        raise FileError(f'The work folder "{folder}" contains {other_job}; choose another one or empty it.')


def remove_temporary_files(folder: Path) -> None:
    """Delete the unfinished files in `folder` of processes that were killed. No process may be writing to it."""
    for path in folder.glob(f"*{TEMPORARY_SUFFIX}"):
        with suppress(OSError):
            path.unlink()
