"""Entry script of a worker process without Blender: imports the core of the extension that contains it, and calls one of its modules.

    python core_worker_start.py MODULE FOLDERS ARGUMENTS...

FOLDERS is a JSON list of the folders that contain the packages of the extension, which Blender's own Python does not find.
"""

import importlib
import json
import os
import sys
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = "farfield_worker"
# One thread for matrix products: the workers use all cores already, each thread takes memory, and sums depend on the number of threads.
# Read when NumPy is loaded, so set first.
THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def main() -> int:
    """Load the core, call the module, and return its exit code."""
    module, folders, *arguments = sys.argv[1:]
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    sys.path += [folder for folder in json.loads(folders) if folder not in sys.path]  # last: NumPy must be Blender's own
    package = ModuleType(PACKAGE)  # without running the extension's __init__.py
    package.__path__ = [str(ROOT)]
    sys.modules[PACKAGE] = package
    return importlib.import_module(f"{PACKAGE}.addon.core.jobs.core_worker").run_module(module, arguments)


if __name__ == "__main__":
    sys.exit(main())
