"""The file that a worker process begins with: it makes the package that it lies in known under a private name, and calls a module of it.

    python worker_start.py MODULE FOLDER ARGUMENTS...
    blender --background --python worker_start.py -- MODULE FOLDER ARGUMENTS...

FOLDER holds SciPy, which a Blender program that knows no extensions does not find.
"""

import importlib
import importlib.util
import os
import sys
import traceback
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NAME = "farfield_worker"
FAILED = 1  # exit code where nothing else was said

# Threads of NumPy's own wait for each other on cores that renders keep busy; read when NumPy is loaded, so before all else.
for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")


def main() -> None:
    """Load the package, hand over, and end with the exit code that comes back."""
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    module, folder, *arguments = given
    if importlib.util.find_spec("scipy") is None:
        sys.path.append(folder)  # last: NumPy has to be Blender's own
    spec = importlib.util.spec_from_file_location(NAME, ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    package = importlib.util.module_from_spec(spec)
    sys.modules[NAME] = package
    spec.loader.exec_module(package)
    processes = importlib.import_module(f"{NAME}.addon.bridge.worker_processes")
    code = FAILED
    try:
        code = importlib.import_module(f"{NAME}.{module}").main(arguments)
    finally:
        if sys.exc_info()[0] is not None:
            traceback.print_exc()  # here, since a Blender program would print it and end as if nothing had happened
        processes.leave(code)


if __name__ == "__main__":
    main()
