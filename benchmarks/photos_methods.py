"""The methods that `bench_photos.py` compares: Farfield with several settings, and the peers, which run in processes of their own."""

import json
import os
import resource
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

import reference_tools
from farfield.addon.core.errors import FarfieldError
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.photographs.photograph import Photograph
from farfield.addon.core.photos.settings import METHODS, PhotosSettings

PEERS = ("lagrange", "pymeshlab")
QT_PLUGINS = Path("/usr/lib/x86_64-linux-gnu/qt5/plugins")  # PyMeshLab's wheel has none for X11
TIMEOUT = 1800.0
MAX_MEMORY = 18 << 30  # bytes of address space of a peer


class Textured(NamedTuple):
    """A texture (S, S, 3) float32 encoded, row 0 at the bottom, None after an error; the photograph (S, S) of each texel, the fraction of
    texels that no photograph shows and the seconds of each stage, of Farfield alone."""

    colors: np.ndarray | None
    seconds: float = 0.0
    source: np.ndarray | None = None
    holes: float | None = None
    stages: dict[str, float] | None = None
    error: str | None = None


def run_method(name: str, mesh: TriangleMesh, corner_uvs: np.ndarray, photographs: list[Photograph], size: int) -> Textured:
    """Make a texture by the method of this name: one of Farfield, or a peer."""
    if name in PEERS:
        return _run_peer(name, mesh, corner_uvs, photographs, size)
    settings = PhotosSettings(size=size) if name == "farfield" else PhotosSettings(size=size, method=name)
    started = time.perf_counter()
    try:
        result = run_to_end(merge(mesh, corner_uvs, photographs, settings))
    except FarfieldError as error:
        return Textured(None, error=str(error))
    seconds = time.perf_counter() - started
    covered = np.count_nonzero(result.holes | (result.source >= 0))
    rounded = np.rint(255.0 * result.colors).astype(np.float32) / np.float32(255.0)
    stages = {stage: round(value, 2) for stage, value in result.seconds.items()}
    return Textured(rounded, seconds, result.source, round(float(np.count_nonzero(result.holes) / covered), 4), stages)


FARFIELD = ("farfield", *METHODS)


def _run_peer(name: str, mesh: TriangleMesh, corner_uvs: np.ndarray, photographs: list[Photograph], size: int) -> Textured:
    lenses = [photograph.camera.lens for photograph in photographs]
    if any(lens.model not in ("SIMPLE_PINHOLE", "PINHOLE") for lens in lenses):
        raise FarfieldError("The peers need photographs without distortion.")
    arrays = {
        "pixels": np.stack([photograph.pixels[::-1] for photograph in photographs]),
        "rotations": np.stack([photograph.camera.rotation for photograph in photographs]),
        "translations": np.stack([photograph.camera.translation for photograph in photographs]),
        "focal": np.array([np.mean(lens.focal) for lens in lenses]),
        "centers": np.array([lens.center for lens in lenses]),
    }
    return _call_peer(name, mesh, corner_uvs, size, arrays)


def fill_with_lagrange(mesh: TriangleMesh, corner_uvs: np.ndarray, texture: np.ndarray, known: np.ndarray) -> Textured:
    """Fill a texture (S, S, 3) where it is not `known` (S, S) bool by a peer."""
    pixels = np.rint(255.0 * np.clip(texture, 0.0, 1.0)).astype(np.uint8)
    return _call_peer("lagrange-fill", mesh, corner_uvs, len(texture), {"texture": pixels, "known": known})


def _call_peer(name: str, mesh: TriangleMesh, corner_uvs: np.ndarray, size: int, arrays: dict[str, np.ndarray]) -> Textured:
    """Run `photos_peers.py` with a mesh and other arrays; raises FarfieldError if the peers are not installed."""
    python = reference_tools.find_python(reference_tools.TEXTURE_TOOLS)
    if python is None:
        raise FarfieldError("The peers are not installed; run python3 scripts/reference_tools.py texture-tools.")
    command = [str(python), str(Path(__file__).with_name("photos_peers.py")), name]
    variables = dict(os.environ)
    if name == "pymeshlab" and "DISPLAY" not in os.environ:
        if shutil.which("xvfb-run") is None:
            return Textured(None, error="PyMeshLab needs a display with OpenGL; install xvfb-run")
        command = ["xvfb-run", "-a", *command]
        variables["QT_PLUGIN_PATH"] = str(QT_PLUGINS)
    with tempfile.TemporaryDirectory(prefix="farfield-benchmark-") as folder:
        source, target = Path(folder) / "input.npz", Path(folder) / "output.npy"
        np.savez(source, vertices=mesh.vertices, triangles=mesh.triangles, corner_uvs=corner_uvs, size=size, **arrays)
        try:
            outcome = subprocess.run(
                [*command, str(source), str(target)],
                env=variables,
                capture_output=True,
                text=True,
                check=False,
                timeout=TIMEOUT,
                preexec_fn=_limit_memory,
            )
        except subprocess.TimeoutExpired:
            return Textured(None, error=f"no result within {TIMEOUT:g} s")
        if outcome.returncode != 0 or not target.exists():
            return Textured(None, error=f"the process ended with code {outcome.returncode}: {outcome.stderr.strip()[-300:]}")
        colors = np.load(target, allow_pickle=False).astype(np.float32) / np.float32(255.0)
        return Textured(colors, json.loads(outcome.stdout.splitlines()[-1])["seconds"])


def _limit_memory() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, MAX_MEMORY))
