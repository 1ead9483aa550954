"""Quadric edge collapses of a height field by fast-simplification in a process of its own, for `bench_bdam.py`.

    bdam_quadrics.py INPUT.npy TARGET STEP OUTPUT.npz

The input has heights (N, N) in steps of STEP cells; TARGET is a number of triangles. The package has global state, holds the interpreter
lock, and compares errors with absolute thresholds, for which a cell is scaled to UNITS_PER_CELL. Walls below the border of the field
keep the border in place. Positions are rounded to a lattice of 1/8 cell along both axes and of 1/8 step, so that patches could weld. The
output has points (V, 2) float64, heights (V,) float64 and triangles (T, 3) int32. Prints the seconds and CPU seconds without input and
output as JSON.
"""

import json
import sys
import time

import fast_simplification
import numpy as np

LATTICE = 8  # points per cell
# Of 0.3, 1, 3 and 10, this gave the smallest vertical errors; flattened heights gave larger ones.
UNITS_PER_CELL = 10.0
WALL = 25.0  # height of the walls in cells


def triangulate_with_walls(heights: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices (V, 3), in cells, and triangles (T, 3) of a field with walls."""
    rows, columns = heights.shape
    y, x = np.mgrid[:rows, :columns]
    numbers = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, 1:], numbers[1:, :-1]
    is_even = ((x + y)[:-1, :-1] % 2 == 0)[..., None]
    first = np.where(is_even, np.stack([a, b, c], axis=-1), np.stack([a, b, d], axis=-1))
    second = np.where(is_even, np.stack([a, c, d], axis=-1), np.stack([b, c, d], axis=-1))
    top = np.stack([x, y, step * heights], axis=-1).reshape(-1, 3)
    ring = np.concatenate([numbers[0, :-1], numbers[:-1, -1], numbers[-1, :0:-1], numbers[:0:-1, 0]])
    bottom = top[ring] - [0.0, 0.0, WALL]
    following = np.roll(np.arange(len(ring)), -1)
    below = len(top) + np.arange(len(ring))
    walls = np.concatenate([np.stack([ring, below, below[following]], 1), np.stack([ring, below[following], ring[following]], 1)])
    return np.concatenate([top, bottom]), np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3), walls])


def simplify(heights: np.ndarray, target: int, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points, heights and triangles of about `target` triangles."""
    rows, columns = heights.shape
    vertices, triangles = triangulate_with_walls(heights, step)
    vertices, triangles = fast_simplification.simplify(UNITS_PER_CELL * vertices, triangles, target_count=target)
    vertices = vertices / UNITS_PER_CELL
    points = np.clip(np.rint(LATTICE * vertices[:, :2]) / LATTICE, 0.0, [columns - 1.0, rows - 1.0])
    (x0, x1, x2), (y0, y1, y2) = points[triangles].transpose(2, 1, 0)
    area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
    z = np.rint(LATTICE * vertices[:, 2] / step) / LATTICE
    return points, z, triangles[area != 0.0].astype(np.int32)


def main() -> None:
    """Answer the request of the command line."""
    source, target, step, output = sys.argv[1:]
    heights = np.load(source, allow_pickle=False)
    started = time.perf_counter(), time.process_time()
    points, z, triangles = simplify(heights, int(target), float(step))
    seconds = time.perf_counter() - started[0], time.process_time() - started[1]
    np.savez(output, points=points, heights=z, triangles=triangles)
    print(json.dumps({"seconds": seconds[0], "cpu_seconds": seconds[1]}))


if __name__ == "__main__":
    main()
