"""The file that a worker process begins with: it makes the package that it lies in known under a private name, and calls a module of it.

    python worker_start.py MODULE FOLDER ARGUMENTS...
    blender --background --python worker_start.py -- MODULE FOLDER ARGUMENTS...

FOLDER holds SciPy, which a Blender program that knows no extensions does not find.
"""

import importlib
import importlib.util
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NAME = "farfield_worker"


def main() -> int:
    """Load the package and hand over; returns the exit code."""
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    module, folder, *arguments = given
    if importlib.util.find_spec("scipy") is None:
        sys.path.append(folder)  # last: NumPy has to be Blender's own
    spec = importlib.util.spec_from_file_location(NAME, ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    package = importlib.util.module_from_spec(spec)
    sys.modules[NAME] = package
    spec.loader.exec_module(package)
    return importlib.import_module(f"{NAME}.{module}").main(arguments)


if __name__ == "__main__":
    sys.exit(main())
