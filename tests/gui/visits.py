"""Visits to a Blender window with this checkout installed."""

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import environment
from gui.blender_program import launcher

SECONDS = 400


def findings_of(visit: str, tmp_path_factory) -> dict:
    """What the visit in the file of that name saw; see hand.py."""
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
    result = findings / "seen.json"
    words = f"{log.stdout[-3000:]}\n{log.stderr[-3000:]}\n{_crash_report()}"
    assert result.exists(), f"Blender ended with {log.returncode} and left no findings:\n{words}"
    print(f"pictures and findings: {findings}")
    print(*(line for line in (log.stdout + log.stderr).splitlines() if "Error" in line or "Traceback" in line), sep="\n")
    return json.loads(result.read_text(encoding="utf-8"))


def _crash_report() -> str:
    """What Blender wrote about its crash, if it crashed."""
    path = Path(tempfile.gettempdir()) / "blender.crash.txt"
    return path.read_text(encoding="utf-8", errors="replace")[-6000:] if path.exists() else ""


def install(folder: Path) -> None:
    """Put this checkout where Blender looks for extensions."""
    folder.mkdir(parents=True)
    for name in ("__init__.py", "blender_manifest.toml"):
        shutil.copy(environment.ROOT / name, folder)
    shutil.copytree(environment.ROOT / "addon", folder / "addon", ignore=shutil.ignore_patterns("__pycache__"))
