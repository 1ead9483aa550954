"""Time and memory of a task of `bench_texmesh.py`."""

import time
from collections.abc import Callable
from typing import Any, TypeVar

from lib import command_line

Result = TypeVar("Result")


def measure_cost(run: Callable[[], Result], max_seconds: float, max_memory_mb: float) -> tuple[Result, dict[str, Any]]:
    """Return the result of `run`, and its seconds, CPU seconds of all threads and peak memory, beside their bounds. The memory is that of
    the process."""
    before = command_line.peak_memory_mb()
    started, cpu_started = time.perf_counter(), time.process_time()
    result = run()
    return result, {
        "seconds": round(time.perf_counter() - started, 1),
        "cpu_seconds": round(time.process_time() - cpu_started, 1),
        "max_seconds": max_seconds,
        "peak_memory_mb": round(command_line.peak_memory_mb()),
        "peak_memory_before_mb": round(before),
        "max_memory_mb": max_memory_mb,
    }
