"""Runs of a script, several in one process: starting Blender takes longer than what most of them do.

For each script at least one test starts a process for a single run.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

SEPARATOR = "\x1e"  # the record separator of ASCII, which no message contains
RUNNER = f"""
import json, runpy, sys
from pathlib import Path

script = sys.argv[1]
sys.path[0] = str(Path(script).parent)
for arguments in json.loads(sys.argv[2]):
    sys.argv = [script, *arguments]
    code = 0
    try:
        runpy.run_path(script, run_name="__main__")
    except SystemExit as exit:
        code = exit.code or 0
    for stream in (sys.stdout, sys.stderr):
        stream.write(f"{SEPARATOR}{{code}}{SEPARATOR}")
        stream.flush()
"""


def runs_command(script: Path, runs: Sequence[Sequence[str | Path]]) -> list[str]:
    """Return the command that runs `script` once for each list of arguments.

    After each run it writes its exit code between two separators to both standard streams.
    """
    arguments = [[str(argument) for argument in run] for run in runs]
    return [sys.executable, "-c", RUNNER, str(script), json.dumps(arguments)]


def run_script(script: Path, *runs: Sequence[str | Path], **options: Any) -> list[subprocess.CompletedProcess]:
    """Run `script` once for each list of arguments, in one process; return the exit codes and the texts of the standard streams.

    Args:
        script: a file that ends with `sys.exit`, or at its end.
        runs: the arguments of each run.
        options: for `subprocess.run`.
    """
    options = {"encoding": "utf-8", "errors": "surrogateescape", "check": False, **options}
    done = subprocess.run(runs_command(script, runs), capture_output=True, **options)
    assert done.returncode == 0, done.stderr
    parts = [text.split(SEPARATOR)[:-1] for text in (done.stdout, done.stderr)]
    assert len(parts[0]) == len(parts[1]) == 2 * len(runs), done.stderr
    return [
        subprocess.CompletedProcess([str(script), *map(str, run)], int(parts[0][2 * index + 1]), parts[0][2 * index], parts[1][2 * index])
        for index, run in enumerate(runs)
    ]
