"""Entry script of a worker process: imports the extension that contains it under a private name, and calls one of its modules.

    python worker_start.py MODULE FOLDERS ARGUMENTS...
    blender --background --python worker_start.py -- MODULE FOLDERS ARGUMENTS...

FOLDERS is a JSON list of the folders that contain SciPy, which Blender does not find without its extensions, and Blender's own modules.
"""

import importlib
import importlib.util
import json
import os
import sys
import traceback
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "farfield_worker"
EXIT_FAILED = 1  # exit code of an exception

# NumPy's own threads wait for each other on cores that are busy with renders. Read when NumPy is loaded, so set first.
for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")


def main() -> None:
    """Load the package, call the module, and exit with the returned code."""
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    module, folders, *module_arguments = arguments
    sys.path += [folder for folder in json.loads(folders) if folder not in sys.path]  # last: NumPy must be Blender's own
    spec = importlib.util.spec_from_file_location(PACKAGE, ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    package = importlib.util.module_from_spec(spec)
    sys.modules[PACKAGE] = package
    spec.loader.exec_module(package)
    processes = importlib.import_module(f"{PACKAGE}.addon.bridge.worker_processes")
    code = EXIT_FAILED
    try:
        code = importlib.import_module(f"{PACKAGE}.{module}").main(module_arguments)
    finally:
        if sys.exc_info()[0] is not None:
            traceback.print_exc()  # here, since Blender would print it and exit with code 0
        processes.exit_process(code)


if __name__ == "__main__":
    main()
