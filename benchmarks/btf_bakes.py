"""Clouds and relightable textures, created by the scripts in separate processes, as by a user."""

import hashlib
import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from btf_models import MODELS, save_model

from farfield.addon.core.btf.settings import EMISSION
from farfield.addon.core.errors import FarfieldError
from lib import environment


@dataclass(frozen=True)
class BenchmarkOptions:
    """The extent of a benchmark.

    data: folder of the meshes. work: folder for clouds and finished views. error: of the clouds, as for --error. capture_samples: Cycles
    samples of every render of a bake. pairs: number of held-out pairs of view and Sun. sizes: of the compared renders. samples,
    reference_samples: of these renders, and of the source in them. executors, repeats: executors whose bakes are timed, and how often.
    lpca: whether to measure Local PCA. sheets: folder for contact sheets.
    """

    models: list[str]
    data: Path
    work: Path
    error: str
    views_per_side: int
    lights_per_side: int
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
class BenchmarkCloud:
    """A file with a model and its cloud with one level, in its own folder. report: see scripts/billboards.py."""

    path: Path
    upper: bool
    report: dict[str, Any]


class CloudOptions(Protocol):
    """What clouds of benchmarks depend on, see `BenchmarkOptions`."""

    data: Path
    work: Path


def cloud_folder(name: str, options: CloudOptions, error: str) -> Path:
    """Return the folder for the cloud of a model and everything derived from it."""
    return options.work / f"{name} {error}"


def build_cloud(name: str, options: CloudOptions, error: str) -> BenchmarkCloud:
    """Return the cloud of a model. An existing one in the work folder is reused, so that the finished views next to it stay valid.

    Raises:
        FarfieldError: if a script fails.
    """
    folder = cloud_folder(name, options, error)
    path, report = folder / "cloud.blend", folder / "cloud.json"
    if not report.exists():
        folder.mkdir(parents=True, exist_ok=True)
        save_model(MODELS[name], folder / "source.blend", options.data)
        flags = ("--error", error, "--levels", 1, "--keep-original-visible", "--report", report)
        run_script("billboards.py", folder / "source.blend", "--out", path, *flags)
    return BenchmarkCloud(path, MODELS[name].upper, json.loads(report.read_text(encoding="utf-8")))


def bake(cloud: BenchmarkCloud, name: str, work: Path, options: BenchmarkOptions, *flags: str) -> dict[str, Any]:
    """Bake `cloud` with the model *emission* into the file `name` next to it, with finished views in `work`. Return the report
    and the wall time of the script.

    An existing result of the same code with the same cloud and flags is reused.

    Raises:
        FarfieldError: if the script fails.
    """
    out = cloud.path.with_name(f"{name}.blend")
    report = out.with_suffix(".json")
    bake_flags = [
        "--model",
        EMISSION,
        "--views-per-side",
        options.views_per_side,
        "--lights-per-side",
        options.lights_per_side,
        "--samples",
        options.capture_samples,
    ]
    bake_flags += ["--upper-hemisphere"] if cloud.upper else []
    arguments = ["--work", str(work), *map(str, bake_flags), *flags]
    stamp = out.with_suffix(".stamp")
    if not stamp.exists() or stamp.read_text(encoding="utf-8") != _bake_fingerprint(arguments):
        stamp.unlink(missing_ok=True)
        started = time.perf_counter()
        run_script("btf.py", cloud.path, "--out", out, "--report", report, *arguments)
        wall = time.perf_counter() - started
        figures = {**json.loads(report.read_text(encoding="utf-8")), "wall_seconds": round(wall, 1)}
        report.write_text(json.dumps(figures), encoding="utf-8")
        stamp.write_text(_bake_fingerprint(arguments), encoding="utf-8")
    return json.loads(report.read_text(encoding="utf-8"))


def _bake_fingerprint(arguments: list[str]) -> str:
    """Return a digest of the code of the extension and the arguments of the script."""
    digest = hashlib.sha256(repr(arguments).encode())
    for path in sorted((environment.ROOT / "addon").rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def run_script(name: str, *arguments: object) -> None:
    """Run a script of the project.

    Raises:
        FarfieldError: with the last line of the script's stderr, if it fails.
    """
    command = [sys.executable, str(environment.ROOT / "scripts" / name), *map(str, arguments)]
    completed = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace", check=False)
    if completed.returncode:
        lines = completed.stderr.strip().splitlines() or ["no output"]
        raise FarfieldError(f"scripts/{name} failed with exit code {completed.returncode}: {lines[-1]}")
