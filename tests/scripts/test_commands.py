"""Every script of the checkout starts, prints its help, and refuses flags that it does not have in one sentence."""

import subprocess
import sys

import pytest

from lib import environment

# Runs the scripts in one process, because importing bpy takes longer than all of them. Every script imports the modules of the checkout
# itself, with the search path of a new process; those of the package are loaded once, but found only after `import_farfield`.
CHILD = """
import contextlib, io, runpy, sys
from pathlib import Path
import bpy

def run(script, flag):
    sys.argv, sys.path = [script, flag], [str(Path(script).parent), *search_path]
    output, errors = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
            runpy.run_path(script, run_name="__main__")
    except SystemExit as exit:
        return exit.code, output.getvalue(), errors.getvalue()
    except Exception as error:
        return repr(error), "", ""
    return None, "", ""

root, scripts, search_path, modules, failed = sys.argv[1], sys.argv[2:], list(sys.path), set(sys.modules), False
for script in scripts:
    code, output, _ = run(script, "--help")
    if code != 0 or f"usage: {Path(script).name}" not in output:
        print(script, "exits with", code, output[:200], file=sys.stderr)
        failed = True
    if Path(script).parent.name == "scripts":
        code, output, errors = run(script, "--magic")
        if code != 2 or output or len(errors.splitlines()) != 1:
            print(script, "--magic exits with", code, output[:200], errors[:200], file=sys.stderr)
            failed = True
    for name, module in list(sys.modules.items()):
        is_of_checkout = (getattr(module, "__file__", None) or "").startswith(root) and "site-packages" not in module.__file__
        if name not in modules and is_of_checkout and not name.startswith("farfield."):
            del sys.modules[name]
sys.exit(failed)
"""


@pytest.mark.parametrize("folder", ["scripts", *(pytest.param(name, marks=pytest.mark.slow) for name in ("benchmarks", "docs"))])
def test_all_scripts_start_print_their_help_and_refuse_unknown_flags(folder):
    paths = sorted((environment.ROOT / folder).glob("*.py"))
    scripts = [str(path) for path in paths if "command_line.run(main)" in path.read_text(encoding="utf-8")]
    assert len(scripts) > 3
    command = [sys.executable, "-c", CHILD, str(environment.ROOT), *scripts]
    outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
