"""Worker processes without Blender: plain Python with NumPy and SciPy that runs one module of the core.

Such a process starts in a fraction of the time of a Blender process, and takes a fraction of its memory. Workers of both kinds report
errors by exit codes, and by an error message as one line on stderr.
"""

import json
import sys
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from ..errors import FarfieldError

START_SCRIPT = Path(__file__).with_name("core_worker_start.py")
WHEELS = ("scipy", "fast_simplification", "threadpoolctl", "tifffile", "xatlas")  # packages of the extension, which Blender's Python lacks
PACKAGE_PARTS = 4  # Parts of this module's name below the extension's package: addon.core.jobs.core_worker.


def core_command(module: str, arguments: list[str]) -> list[str]:
    """Return the command of a Python process that calls `main(arguments)` of a `module` of the extension, for instance
    `addon.core.jobs.task_worker`, and exits with the returned code. Neither the module nor anything that it imports may need bpy.

    A FarfieldError becomes a line on stderr and the exit code EXIT_ERROR, see `encode_error`. The process is the Python of pip's bpy or
    that of the Blender program, with the packages of the extension. Matrix products use one thread.

    Raises:
        FarfieldError: this Blender has no Python program.
    """
    flags = ["-P"]  # no module in the folder of the script hides another one
    # As this process: Blender ignores variables and folders that are meant for other Pythons.
    if sys.flags.ignore_environment:
        flags.append("-E")
    if sys.flags.no_user_site:
        flags.append("-s")
    if sys.flags.utf8_mode:
        flags += ["-X", "utf8"]
    return [_python_program(), *flags, str(START_SCRIPT), module, json.dumps(module_folders(*WHEELS)), *arguments]


def run_module(module: str, arguments: list[str]) -> int:
    """Call `main(arguments)` of a `module` of the extension; return the exit code of the process."""
    try:
        return import_extension_module(module).main(arguments)
    except FarfieldError as error:
        print(encode_error(error), file=sys.stderr, flush=True)
        return EXIT_ERROR


def import_extension_module(module: str):
    """Import a `module` below the package of the extension, whatever that is called in this process."""
    package = __name__.rsplit(".", PACKAGE_PARTS)[0]
    return import_module(f"{package}.{module}")


def _python_program() -> str:
    """Return the path of the Python program of this process. Inside Blender that is one of Blender's own files."""
    program = Path(sys.executable or "")
    if not program.name.lower().startswith("python"):
        raise FarfieldError("This Blender comes without a Python program for worker processes; set Executor to serial.")
    return str(program)


@lru_cache(maxsize=2)  # for workers with and without Blender
def module_folders(*names: str) -> list[str]:
    """Return the folders that hold modules and packages, of those that this process finds: a worker process may find others."""
    folders = set()
    for spec in filter(None, map(find_spec, names)):
        paths = spec.submodule_search_locations or [spec.origin]  # A package has folders, a module of one file has none.
        folders |= {str(Path(path).resolve().parent) for path in paths}
    return sorted(folders)


EXIT_EXCEPTION, EXIT_ERROR = 1, 2  # exit codes of a worker after any exception, and after it has printed an error message
ERROR_KEY = "farfield_error"  # key of the JSON line on stderr with that message


def encode_error(error: FarfieldError) -> str:
    """Return the line that a worker prints before it exits with EXIT_ERROR. ASCII only: stderr may have any encoding."""
    return json.dumps({ERROR_KEY: str(error)})


def failure_message(code: int, error_output: str, items: str) -> str:
    """Return the error message that a worker has printed, or a description of its second crash.

    code: its exit code, negative for the signal that killed it. items: what it worked on, in plural: "views".
    """
    lines = _lines(error_output)
    if code == EXIT_ERROR:
        for line in reversed(lines):
            if line.startswith("{") and ERROR_KEY in line:
                return json.loads(line)[ERROR_KEY]
    reason = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
    last_output = f', last output: "{lines[-1]}"' if lines else ""
    return (
        f"A worker process crashed twice at the same {items} ({reason}{last_output}), perhaps because memory ran out. "
        f"Finished {items} are kept; resume with fewer processes."
    )


def worker_exception(error_output: str, items: str) -> Exception:
    """Return the exception with which a worker has failed; its traceback becomes a note for the log of defects."""
    lines = _lines(error_output)
    last_output = lines[-1] if lines else "no output"
    if last_output.partition(":")[0].endswith("MemoryError"):
        return FarfieldError(f"A worker process ran out of memory; finished {items} are kept, so resume with fewer processes.")
    error = RuntimeError(f"in a worker process, {last_output}")
    error.add_note(error_output)
    return error


def _lines(error_output: str) -> list[str]:
    return [line.strip() for line in error_output.splitlines() if line.strip()]
