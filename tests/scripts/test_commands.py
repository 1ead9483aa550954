"""Every script of the checkout starts and prints its help."""

import subprocess
import sys

from lib import environment

SCRIPTS = [
    path
    for folder in ("benchmarks", "docs", "scripts")
    for path in sorted((environment.ROOT / folder).glob("*.py"))
    if "command_line.run(main)" in path.read_text(encoding="utf-8")
]
# Runs the scripts in one process, because importing bpy takes longer than all of them. Every script imports the modules of the checkout
# itself, with the search path of a new process; those of the package are loaded once, but found only after `import_farfield`.
CHILD = """
import contextlib, io, runpy, sys
from pathlib import Path
import bpy

root, scripts, search_path, modules, failed = sys.argv[1], sys.argv[2:], list(sys.path), set(sys.modules), False
for script in scripts:
    sys.argv, sys.path = [script, "--help"], [str(Path(script).parent), *search_path]
    output, code = io.StringIO(), None
    try:
        with contextlib.redirect_stdout(output):
            runpy.run_path(script, run_name="__main__")
    except SystemExit as exit:
        code = exit.code
    except Exception as error:
        code = repr(error)
    if code != 0 or f"usage: {Path(script).name}" not in output.getvalue():
        print(script, "exits with", code, output.getvalue()[:200], file=sys.stderr)
        failed = True
    for name, module in list(sys.modules.items()):
        is_of_checkout = (getattr(module, "__file__", None) or "").startswith(root) and "site-packages" not in module.__file__
        if name not in modules and is_of_checkout and not name.startswith("farfield."):
            del sys.modules[name]
sys.exit(failed)
"""


def test_all_scripts_start_and_print_their_help():
    assert len(SCRIPTS) > 10
    command = [sys.executable, "-c", CHILD, str(environment.ROOT), *map(str, SCRIPTS)]
    outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
