"""Clouds and their relightable textures, made by the scripts as a user would, each in a process of its own."""

import hashlib
import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from btf_models import MODELS, save_model

import environment
from farfield.addon.core.errors import FarfieldError


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    data: the folder of the meshes. work: keeps clouds and finished views. error: of the clouds, as --error takes it. capture_samples:
    Cycles samples of every render of a bake. pairs: held-out views and suns. sizes: of the pictures that are compared. samples,
    reference_samples: of these pictures, and of the original in them. executors, repeats: whose bakes are timed, and how often each. lpca:
    whether to try that codec. sheets: a folder for contact sheets.
    """

    models: list[str]
    data: Path
    work: Path
    error: str
    views: int
    lights: int
    capture_samples: int
    pairs: int
    sizes: list[str]
    samples: int
    reference_samples: int
    executors: list[str]
    repeats: int
    lpca: bool
    sheets: Path | None


@dataclass(frozen=True)
class Cloud:
    """A file with a model and its cloud of one level, in a folder of its own. report: see scripts/billboards.py."""

    path: Path
    upper: bool
    report: dict[str, Any]


def cloud_folder(name: str, effort: Effort, error: str) -> Path:
    """Where the cloud of a model and all that is made of it lie."""
    return effort.work / f"{name} {error}"


def built_cloud(name: str, effort: Effort, error: str) -> Cloud:
    """The cloud of a model. One that stands in the work folder is taken as it is, since the finished views beside it are its own.

    Raises:
        FarfieldError: when a script refuses.
    """
    folder = cloud_folder(name, effort, error)
    path, report = folder / "cloud.blend", folder / "cloud.json"
    if not report.exists():
        folder.mkdir(parents=True, exist_ok=True)
        save_model(MODELS[name], folder / "original.blend", effort.data)
        run_script("billboards.py", folder / "original.blend", "--out", path, "--error", error, "--levels", 1, "--report", report)
    return Cloud(path, MODELS[name].upper, json.loads(report.read_text(encoding="utf-8")))


def baked(cloud: Cloud, name: str, work: Path, effort: Effort, *flags: str) -> dict[str, Any]:
    """Bake `cloud` into the file `name` beside it, finished views in `work`; the report, with the wall time of the whole script.

    What the same code has made from the same cloud with the same flags, and still stands, is taken as it is.

    Raises:
        FarfieldError: when the script refuses.
    """
    out = cloud.path.with_name(f"{name}.blend")
    report = out.with_suffix(".json")
    given = ["--views", effort.views, "--lights", effort.lights, "--samples", effort.capture_samples]
    given += ["--upper-hemisphere"] if cloud.upper else []
    arguments = ["--work", str(work), *map(str, given), *flags]
    stamp = out.with_suffix(".stamp")
    if not stamp.exists() or stamp.read_text(encoding="utf-8") != _stamp(arguments):
        stamp.unlink(missing_ok=True)
        started = time.perf_counter()
        run_script("btf.py", cloud.path, "--out", out, "--report", report, *arguments)
        wall = time.perf_counter() - started
        figures = {**json.loads(report.read_text(encoding="utf-8")), "wall_seconds": round(wall, 1)}
        report.write_text(json.dumps(figures), encoding="utf-8")
        stamp.write_text(_stamp(arguments), encoding="utf-8")
    return json.loads(report.read_text(encoding="utf-8"))


def _stamp(arguments: list[str]) -> str:
    """What tells bakes apart: the code of the extension, and how the script was called."""
    digest = hashlib.sha256(repr(arguments).encode())
    for path in sorted((environment.ROOT / "addon").rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def run_script(name: str, *arguments: object) -> None:
    """Run a script of the project.

    Raises:
        FarfieldError: with the last words of the script, when it does not come to its end.
    """
    command = [sys.executable, str(environment.ROOT / "scripts" / name), *map(str, arguments)]
    outcome = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace", check=False)
    if outcome.returncode:
        words = outcome.stderr.strip().splitlines() or ["it said nothing"]
        raise FarfieldError(f"scripts/{name} ended with code {outcome.returncode}: {words[-1]}")
