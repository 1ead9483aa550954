"""Seconds and memory of restorations, for `bench_restore.py`."""

import json
import subprocess
import sys
import tempfile
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from restore_cases import round_to_8_bits
from restore_holes import blob, scatter_holes
from restore_methods import Methods
from restore_textures import GENERATED, add_gradient

SMALL_SIZE, SMALL_FRACTION, SMALL_BOUND = (450, 600), 0.05, 3.0  # rows and columns, masked, seconds
LARGE_SIZE, LARGE_FRACTION, LARGE_HOLES = (4096, 4096), 0.02, 200
LARGE_BOUNDS = {"seconds": 60.0, "peak_memory_above_imports_mb": 1000.0}
LARGE_PEERS = ("telea", "navier-stokes", "biharmonic", "patchmatch-7")  # the others would take most of an hour or all memory
GROWTH_METHODS = ("farfield", "telea")
REPEATS = 3
HOLE_PIXELS = 1700  # Mean size of a hole where the number of holes grows.


def measure_times(given: Namespace, methods: Methods) -> Iterator[dict[str, Any]]:
    """Measure the seconds for a small image, the fastest of several runs of Farfield and one of each peer, and for a large one, with the
    peak memory of Farfield."""
    figures: dict[str, Any] = {"small": {}, "large": {}}
    for index, texture in enumerate(("granite", "masonry")):
        random = np.random.default_rng([given.seed, 100 + index])
        image, mask = draw_image(texture, SMALL_SIZE, random), blob(random, SMALL_SIZE, SMALL_FRACTION)
        figures["small"][texture] = {"masked": int(mask.sum()), "bound": SMALL_BOUND}
        for name in given.methods:
            runs = [time_method(name, image, mask, methods) for _ in range(REPEATS if name == "farfield" else 1)]
            figures["small"][texture][name] = runs[0] if len(runs) == 1 else {"best": min(runs, key=as_number), "runs": runs}
            yield report(figures, "time", f"{texture}, {name}", figures["small"][texture][name])
    random = np.random.default_rng([given.seed, 110])
    image = draw_image("fractal", LARGE_SIZE, random)
    mask = scatter_holes(random, LARGE_SIZE, LARGE_HOLES, LARGE_FRACTION * LARGE_SIZE[0] * LARGE_SIZE[1])
    figures["large"] = {"masked": int(mask.sum()), "bounds": LARGE_BOUNDS}
    for name in given.methods:
        if name == "farfield":
            figures["large"][name] = measure_in_process(image, mask)
        elif name in LARGE_PEERS:
            figures["large"][name] = time_method(name, image, mask, methods)
        else:
            figures["large"][name] = "not run: too slow or too large for this image"
        yield report(figures, "time", f"large, {name}", figures["large"][name])


def measure_growth(given: Namespace, methods: Methods) -> Iterator[dict[str, Any]]:
    """Measure the seconds by number of holes, by the size of one hole and by the size of the image, and the exponents of power laws."""
    figures: dict[str, Any] = {}
    names = [name for name in given.methods if name in GROWTH_METHODS]
    for series, variable, cases in build_series(np.random.default_rng([given.seed, 120])):
        figures[series] = {"variable": variable, "values": [], "seconds": {name: [] for name in names}, "exponents": {}}
        for image, mask in cases:
            figures[series]["values"].append(int(mask.sum()) if variable == "masked pixels" else mask.size)
            for name in names:
                figures[series]["seconds"][name].append(time_method(name, image, mask, methods))
            yield report(figures, "growth", f"{series}, {figures[series]['values'][-1]}", figures[series]["seconds"])
        for name in names:
            figures[series]["exponents"][name] = fit_exponents(figures[series]["values"], figures[series]["seconds"][name])
        yield figures


def build_series(random: np.random.Generator) -> Iterator[tuple[str, str, Iterator[tuple[np.ndarray, np.ndarray]]]]:
    """Yield the name of each series, the variable of its growth, and its images and masks."""
    image = draw_image("fractal", (2048, 2048), random)
    counts = (12, 25, 50, 100)
    yield "more holes", "masked pixels", ((image, scatter_holes(random, (2048, 2048), count, count * HOLE_PIXELS)) for count in counts)
    small = image[:1024, :1024]
    fractions = (0.002, 0.008, 0.032, 0.128)
    yield "a larger hole", "masked pixels", ((small, blob(random, (1024, 1024), fraction)) for fraction in fractions)
    hole = blob(random, (400, 400), 0.06)
    large = draw_image("fractal", (4096, 4096), random)
    sides = (512, 1024, 2048, 4096)
    yield "a larger image", "pixels", ((large[:side, :side], np.pad(hole, ((50, side - 450), (50, side - 450)))) for side in sides)


def draw_image(texture: str, shape: tuple[int, int], random: np.random.Generator) -> np.ndarray:
    """Return a generated texture (H, W, 3) under a gradient."""
    return round_to_8_bits(add_gradient(GENERATED[texture](random, shape), random, multiply=True))


def time_method(name: str, image: np.ndarray, mask: np.ndarray, methods: Methods) -> float | str:
    """Return the seconds of one restoration, or the error."""
    restored = methods.run(name, image, mask)
    return f"failed: {restored.error}" if restored.image is None else round(restored.seconds, 3)


def as_number(seconds: float | str) -> float:
    """Return the seconds, infinite where the method failed."""
    return np.inf if isinstance(seconds, str) else seconds


def measure_in_process(image: np.ndarray, mask: np.ndarray) -> dict[str, Any]:
    """Restore an image with Farfield in a fresh process: seconds and memory, or the error."""
    with tempfile.TemporaryDirectory(prefix="farfield-benchmark-") as folder:
        path = Path(folder) / "input.npz"
        np.savez(path, image=np.where(mask[..., None], np.float32(0.0), image), mask=mask)
        command = [sys.executable, str(Path(__file__).with_name("restore_measured.py")), str(path)]
        outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    return json.loads(outcome.stdout) if outcome.returncode == 0 else {"error": outcome.stderr.strip()}


def fit_exponents(values: list[int], seconds: list[float | str]) -> dict[str, float] | None:
    """Return the exponents of seconds = factor * value^exponent, fitted to all and between the last two; None if a run failed."""
    if any(isinstance(duration, str) for duration in seconds):
        return None
    x, y = np.log(np.asarray(values, float)), np.log(np.maximum(seconds, 1e-4))
    return {"fitted": round(float(np.polyfit(x, y, 1)[0]), 3), "last_two": round(float((y[-1] - y[-2]) / (x[-1] - x[-2])), 3)}


def report(figures: dict[str, Any], part: str, name: str, result: object) -> dict[str, Any]:
    """Print one result to stderr and return all."""
    print(f"{part} {name}: {json.dumps(result)}", file=sys.stderr, flush=True)
    return figures
