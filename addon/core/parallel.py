"""Work that spreads over cores. Equal input gives equal bytes, serial or spread."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np


def in_chunks(function: Callable[[np.ndarray], np.ndarray], rows: np.ndarray, size: int) -> np.ndarray:
    """`function` applied to `rows` in runs of `size`, on all cores (NumPy lets go of the interpreter), results joined in order.

    `function` maps (K, ...) to (K, ...) row by row, so the result does not depend on the cutting.
    """
    parts = [rows[start : start + size] for start in range(0, max(len(rows), 1), size)]
    if len(parts) == 1:
        return function(parts[0])
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        return np.concatenate(list(threads.map(function, parts)))
