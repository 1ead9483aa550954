"""Visits to a Blender window with this checkout installed."""

import json
import os
import shutil
import signal
import subprocess
import tempfile
import warnings
from pathlib import Path

import environment
from gui.blender_program import launcher

SECONDS = 400
CRASHED = (-signal.SIGSEGV, 128 + signal.SIGSEGV, -signal.SIGABRT, 128 + signal.SIGABRT)


def findings_of(visit: str, tmp_path_factory) -> dict:
    """What the visit in the file of that name saw; see hand.py.

    A Blender that ends in a crash is visited once more, and what it wrote of the crash is among the warnings: one visit in dozens crashed
    through software OpenGL, for a reason that is not known yet. The second crash fails.
    """
    result, log = _visited(visit, tmp_path_factory)
    if not result.exists() and log.returncode in CRASHED:
        warnings.warn(f"Blender crashed during {visit} and was started once more.\n{_words(log)}", stacklevel=2)
        result, log = _visited(visit, tmp_path_factory)
    assert result.exists(), f"Blender ended with {log.returncode} and left no findings:\n{_words(log)}"
    print(f"pictures and findings: {result.parent}")
    print(*(line for line in (log.stdout + log.stderr).splitlines() if "Error" in line or "Traceback" in line), sep="\n")
    return json.loads(result.read_text(encoding="utf-8"))


def _visited(visit: str, tmp_path_factory) -> tuple[Path, subprocess.CompletedProcess]:
    """Where the findings of a visit are, if it came to its end, and how Blender ended."""
    resources, findings = tmp_path_factory.mktemp("blender"), tmp_path_factory.mktemp("seen")
    install(resources / "extensions" / "user_default" / "farfield")
    for name in (visit, "hand.py"):
        shutil.copy(Path(__file__).with_name(name), resources)
    command = [launcher(), "run", "-s", "1400x1000", "-t", str(SECONDS), "--", "--factory-startup", "--enable-event-simulate"]
    log = subprocess.run(
        [*command, "--python", resources / visit, "--", findings],
        cwd=environment.ROOT,
        env=os.environ | {"BLENDER_USER_RESOURCES": str(resources)},
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    return findings / "seen.json", log


def _words(log: subprocess.CompletedProcess) -> str:
    """The last words of a Blender, with what it wrote of a crash."""
    report = Path(tempfile.gettempdir()) / "blender.crash.txt"
    crash = report.read_text(encoding="utf-8", errors="replace")[-6000:] if report.exists() else ""
    return f"{log.stdout[-3000:]}\n{log.stderr[-3000:]}\n{crash}"


def install(folder: Path) -> None:
    """Put this checkout where Blender looks for extensions."""
    folder.mkdir(parents=True)
    for name in ("__init__.py", "blender_manifest.toml"):
        shutil.copy(environment.ROOT / name, folder)
    shutil.copytree(environment.ROOT / "addon", folder / "addon", ignore=shutil.ignore_patterns("__pycache__"))
