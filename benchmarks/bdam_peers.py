"""Other programs that triangulate height fields, for `bench_bdam.py`. Runs in the environment of the reference tools.

Reads requests from the standard input, one JSON object per line, and answers each with one line of JSON:

    {"method": "pydelatin" or "pymartini", "input": FILE.npy, "max_error": E, "output": FILE.npz}

The input has heights (N, N) float32. The output has points (V, 2) int64, columns and rows, and counterclockwise triangles (T, 3) int32.
The answer has the seconds and the CPU seconds without input and output. pymartini measures a field once for all errors; each answer
contains the time for that.
"""

import json
import sys
import time
from typing import Any

import numpy as np
import pydelatin
import pymartini


class Peers:
    """Answers requests. The last field and its tile of pymartini are kept."""

    def __init__(self) -> None:
        self._path, self._heights = "", np.zeros((0, 0), np.float32)
        self._tile: Any = None
        self._tile_seconds = (0.0, 0.0)

    def answer(self, request: dict[str, Any]) -> dict[str, float]:
        """Do what one request asks."""
        if request["input"] != self._path:
            self._path, self._heights, self._tile = request["input"], np.load(request["input"], allow_pickle=False), None
        method = {"pydelatin": self._with_pydelatin, "pymartini": self._with_pymartini}[request["method"]]
        if request["method"] == "pymartini" and self._tile is None:
            started = now()
            self._tile = pymartini.Martini(len(self._heights)).create_tile(self._heights)
            self._tile_seconds = elapsed(started)
        started = now()
        points, triangles = method(request["max_error"])
        seconds = elapsed(started)
        if request["method"] == "pymartini":
            seconds = tuple(sum(pair) for pair in zip(seconds, self._tile_seconds, strict=True))
        corners = points[triangles]
        (x0, x1, x2), (y0, y1, y2) = corners.transpose(2, 1, 0)
        is_clockwise = (x1 - x0) * (y2 - y0) < (y1 - y0) * (x2 - x0)
        triangles[is_clockwise] = triangles[is_clockwise][:, ::-1]
        np.savez(request["output"], points=points, triangles=triangles)
        return {"seconds": seconds[0], "cpu_seconds": seconds[1]}

    def _with_pydelatin(self, max_error: float) -> tuple[np.ndarray, np.ndarray]:
        mesh = pydelatin.Delatin(self._heights[::-1], max_error=max_error)  # it turns rows upside down
        return mesh.vertices[:, :2].astype(np.int64), mesh.triangles.astype(np.int32)

    def _with_pymartini(self, max_error: float) -> tuple[np.ndarray, np.ndarray]:
        points, triangles = self._tile.get_mesh(max_error)
        return points.reshape(-1, 2).astype(np.int64), triangles.reshape(-1, 3).astype(np.int32)


def now() -> tuple[float, float]:
    """Return the wall clock and the CPU seconds of this process."""
    return time.perf_counter(), time.process_time()


def elapsed(started: tuple[float, float]) -> tuple[float, float]:
    """Return the seconds and the CPU seconds since `started`."""
    wall, cpu = now()
    return wall - started[0], cpu - started[1]


def main() -> None:
    """Answer requests until the standard input ends."""
    peers = Peers()
    for line in sys.stdin:
        print(json.dumps(peers.answer(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
