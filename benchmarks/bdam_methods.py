"""Methods that triangulate a height field, for `bench_bdam.py`, and the error that is measured in the same way for all of them."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bdam_collapses import halve_field
from bdam_terrains import write_grid

import reference_tools
from farfield.addon.core.bdam.building.height_grid import HeightGrid
from farfield.addon.core.bdam.building.vertical_errors import measure_triangles
from farfield.addon.core.errors import FarfieldError

MARTINI_BISECTIONS = 9
QUADRIC_TARGETS = (4, 8, 16, 32, 64, 128, 256, 512, 1024)  # samples per vertex
FOLDERS = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Triangulation:
    """Triangles of a field.

    error: meters, the largest vertical distance to a sample. vertices, triangles: their numbers. flipped: triangles that point downwards.
    """

    vertices: int
    triangles: int
    error: float
    seconds: float
    cpu_seconds: float
    flipped: int = 0

    def to_json(self) -> dict[str, float]:
        """Return the figures for reports."""
        flipped = {"flipped": self.flipped} if self.flipped else {}
        return {
            "vertices": self.vertices,
            "triangles": self.triangles,
            "error": round(self.error, 3),
            "seconds": round(self.seconds, 2),
            "cpu_seconds": round(self.cpu_seconds, 2),
        } | flipped


class Field:
    """A height field with the files that all methods read.

    heights: (H, W) float32, meters. steps: the same in steps. height_step: meters. cell_size: meters.
    """

    def __init__(self, heights: np.ndarray, height_step: float, cell_size: float, folder: Path, peers: "Peers | None") -> None:
        self.height_step, self.cell_size, self.folder, self.peers = height_step, cell_size, folder, peers
        self.steps = np.rint(heights / height_step).astype(np.float32)
        self.grid: HeightGrid = write_grid(heights, height_step, folder / "grid.raw")
        self.path = folder / "steps.npy"
        np.save(self.path, self.steps)

    def measure(self, points: np.ndarray, triangles: np.ndarray, z: np.ndarray | None = None, **seconds: float) -> Triangulation:
        """Measure triangles whose vertices are at points (V, 2), columns and rows; z: heights in steps, by default those of the samples."""
        z = self.steps[points[:, 1], points[:, 0]] if z is None else z
        corners = points[triangles]
        (x0, x1, x2), (y0, y1, y2) = corners.transpose(2, 1, 0)
        is_flipped = (x1 - x0) * (y2 - y0) < (y1 - y0) * (x2 - x0)
        errors = measure_triangles(corners[~is_flipped], z[triangles[~is_flipped]], self.grid).errors
        error = float(errors.max(initial=0.0)) * self.height_step
        return Triangulation(len(np.unique(triangles)), len(triangles), error, flipped=int(is_flipped.sum()), **seconds)

    def halve(self) -> Iterator[Triangulation]:
        """Yield the half-edge collapses of Farfield on the whole field as one domain, from half of the samples on."""
        y, x = np.mgrid[: self.steps.shape[0], : self.steps.shape[1]]
        points = np.stack([x.ravel(), y.ravel()], axis=1)
        for simplified in halve_field(self.steps):
            yield self.measure(points, simplified.triangles, seconds=simplified.seconds, cpu_seconds=simplified.cpu_seconds)

    def with_quadrics(self) -> Iterator[Triangulation]:
        """Yield meshes of quadric edge collapses for QUADRIC_TARGETS."""
        step = self.height_step / self.cell_size
        for samples_per_vertex in QUADRIC_TARGETS:
            target = 2 * self.steps.size // samples_per_vertex
            output = self.folder / "quadrics.npz"
            command = [sys.executable, str(FOLDERS / "bdam_quadrics.py"), str(self.path), str(target), str(step), str(output)]
            outcome = subprocess.run(command, capture_output=True, text=True, check=False)
            if outcome.returncode:
                raise FarfieldError(f"bdam_quadrics.py failed: {outcome.stderr}")
            with np.load(output, allow_pickle=False) as file:
                points, z, triangles = file["points"], file["heights"], file["triangles"]
            yield self.measure(points, triangles, z, **json.loads(outcome.stdout))

    def with_pydelatin(self, max_error: float) -> Triangulation:
        """Return the greedy insertion until the error is at most `max_error` meters."""
        return self._ask("pydelatin", max_error)

    def with_pymartini(self, max_error: float) -> Triangulation:
        """Return the right-triangulated mesh whose measured error is closest to `max_error` meters but no more.

        pymartini estimates errors at the midpoints of hypotenuses only; measured ones are larger.
        """
        best, low, high = self._ask("pymartini", 0.0), 0.0, max_error
        for _ in range(MARTINI_BISECTIONS):
            midpoints = 0.5 * (low + high)
            mesh = self._ask("pymartini", midpoints)
            if mesh.error <= max_error:
                low, best = midpoints, min(best, mesh, key=lambda each: each.vertices)
            else:
                high = midpoints
        return best

    def _ask(self, method: str, max_error: float) -> Triangulation:
        output = self.folder / "peer.npz"
        answer = self.peers.ask(
            {"method": method, "input": str(self.path), "max_error": max_error / self.height_step, "output": str(output)}
        )
        with np.load(output, allow_pickle=False) as file:
            return self.measure(file["points"], file["triangles"], **answer)


class Peers:
    """The process of pydelatin and pymartini."""

    def __init__(self, python: Path) -> None:
        command = [str(python), str(FOLDERS / "bdam_peers.py")]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ask(self, request: dict[str, Any]) -> dict[str, float]:
        """Return the answer to a request."""
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise FarfieldError("The process of pydelatin and pymartini has ended; see the lines above.")
        return json.loads(line)

    def close(self) -> None:
        """End the process."""
        self._process.stdin.close()
        self._process.wait()


@contextmanager
def open_field_for_methods(heights: np.ndarray, height_step: float, cell_size: float, python: Path | None = None) -> Iterator[Field]:
    """Yield a field for all methods. python: of the peers, by default that of the reference tools.

    Raises:
        FarfieldError: the reference tools are not installed.
    """
    python = python or reference_tools.find_python()
    if python is None:
        raise FarfieldError("pydelatin and pymartini are missing; install them with scripts/reference_tools.py.")
    with tempfile.TemporaryDirectory(prefix="farfield-benchmark-") as folder:
        peers = Peers(python)
        try:
            yield Field(heights, height_step, cell_size, Path(folder), peers)
        finally:
            peers.close()


def interpolate_vertices(curve: list[Triangulation], error: float) -> float | None:
    """Return how many vertices a method needs for an error, None if the errors of its meshes do not enclose it.

    The logarithms are interpolated between the coarsest mesh with a smaller error and the finest one with a larger error.
    """
    finer = [mesh for mesh in curve if mesh.error <= error]
    coarser = [mesh for mesh in curve if mesh.error > error]
    if not finer or not coarser:
        return None
    first, second = min(finer, key=lambda mesh: mesh.vertices), max(coarser, key=lambda mesh: mesh.vertices)
    if first.error <= 0.0 or second.vertices >= first.vertices:
        return float(first.vertices)
    fraction = np.log(error / first.error) / np.log(second.error / first.error)
    return float(np.exp(np.log(first.vertices) * (1.0 - fraction) + np.log(second.vertices) * fraction))
