"""Part `sending` of bench_packages.py: packages over 200 replayed traces, by clients with and without time compensation.

Every other package is a real one, built once into the folder for temporary files; the others are synthetic, with states of textures like
those of real ones: each replaces 20 to 60 % of the tiles of the one before, the last one has 1 to 4 MB, a mesh 100 to 600 KB.
"""

import json
import tempfile
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from packages_bytes import build
from reference.streaming_state import Span, TransferPlan, add_table
from sending.network import Connection
from sending.simulation import CLIENTS, StreamedPackage, StreamingReport, build_streamed_package, simulate
from sending.traces import MEGABIT, Trace, burst_trace, cellular_trace, ramp_trace, read_trace, step_trace
from texmesh_models import open_textured

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.packages.files import read_package, write_package
from farfield.addon.core.packages.increments import Increments
from farfield.addon.core.packages.manifest import MESH, TEXTURES, VERSION
from farfield.addon.core.packages.planning import ErrorTable

REAL_MODELS = ("spot", "blub", "planet:7")  # the last one has a texture of 2048 x 2048
MODEL_SEED = 7
TABLE_BYTES = 6  # Bytes of the table of increments, per increment.
KINDS = ("step", "ramp", "burst", "3G", "4G")
MIRROR_CASES = ("fine", "pause", "down", "loss")
MIN_MIRRORED = 200_000  # bytes of the textures of packages with mirrors: smaller ones need a single server
TRACES = 40  # Traces of each kind.
PATIENCE = 1e9  # seconds
BOUNDS = {"step": 0.01, "ramp": 0.01, "burst": 0.03, "3G": 0.03, "4G": 0.03}  # lateness that 95 % must not exceed, fractions of the limit


def open_packages(data: Path) -> list[StreamedPackage]:
    """Return the packages of REAL_MODELS; those that are missing in the folder for temporary files are built."""
    packages = []
    for name in REAL_MODELS:
        folder = Path(tempfile.gettempdir()) / f"farfield-benchmark-packages-{VERSION}" / name.replace(":", "-")
        if not folder.is_dir():
            folder.parent.mkdir(exist_ok=True)
            package = build(open_textured(data, name, MODEL_SEED), name)
            write_package(package.manifest, package.contents, folder)
        content = read_package(folder)
        packages.append(build_streamed_package(content.manifest, content.increments))
    return packages


def make_package(rng: np.random.Generator) -> StreamedPackage:
    """Return a plausible package."""
    level_count = int(rng.integers(4, 9))
    growth = rng.uniform(1.5, 2.5) ** np.arange(level_count) * rng.uniform(0.8, 1.2, level_count)
    mesh_ends = np.cumsum((rng.uniform(1e5, 6e5) * growth / growth.sum()).astype(int)).tolist()
    total, state_count = rng.uniform(1e6, 4e6), int(rng.integers(18, 27))
    state_sizes = total * 1.45 ** np.arange(1.0 - state_count, 1.0)
    sizes, firsts, lasts = [], [], []
    alive = np.zeros(0, np.int64)  # increments of the present state
    for state, wanted in enumerate(state_sizes):
        replaced = rng.random(len(alive)) < rng.uniform(0.2, 0.6)  # by four or one
        for index in alive[replaced]:
            lasts[index] = state - 1
        kept = alive[~replaced] if state else alive
        rest = max(wanted - sum(sizes[index] for index in kept), 0.1 * wanted)
        added = max(min(int(rest / rng.uniform(1500.0, 6000.0)), 250), 1)
        parts = np.maximum(rng.dirichlet(np.full(added, 2.0)) * rest, 20.0).astype(int).tolist()
        alive = np.concatenate([kept, np.arange(len(sizes), len(sizes) + added)])
        sizes += parts
        firsts += [state] * added
        lasts += [state_count - 1] * added
    texture_errors = np.geomspace(rng.uniform(0.4, 0.7), rng.uniform(0.007, 0.04), state_count)
    level_errors = np.append(rng.uniform(0.1, 0.3) * rng.uniform(0.4, 0.6) ** np.arange(level_count - 1), 0.0)
    table = ErrorTable(level_errors, np.arange(state_count), texture_errors, float(rng.uniform(1.0, 4.0)), 0.0)
    levels = tuple(Span(MESH, start, end) for start, end in pairwise([0, *mesh_ends]))
    table_size = TABLE_BYTES * len(sizes)
    plan = TransferPlan(
        (levels[0], Span(TEXTURES, 0, table_size)), levels, table.predict(texture_errors).tabulate(), table_size + 4 * len(sizes)
    )
    zeros = np.zeros(len(sizes), np.int64)
    increments = Increments(zeros, np.arange(len(sizes)), zeros, np.array(sizes), np.array(firsts), np.array(lasts))
    return StreamedPackage(add_table(plan, sizes, firsts, lasts), increments, 8000)


def make_trace(rng: np.random.Generator, kind: str, limit: float, rate: float) -> Trace:
    """Return a trace of a kind, around `rate` bytes per second."""
    duration = 1.5 * limit
    if kind in ("3G", "4G"):
        return cellular_trace(rng, duration, int(kind[0]), rate)
    return {"step": step_trace, "ramp": ramp_trace, "burst": burst_trace}[kind](rng, duration, rate)


def run_clients(rng: np.random.Generator, kind: str, package: StreamedPackage) -> dict[str, StreamingReport]:
    """Return what each client gets of a package over a new connection. `waiting` is the client with compensation that waits after the limit
    for all that it has asked for."""
    limit, rate, delay = draw_connection(rng, kind, package)
    connection = Connection(make_trace(rng, kind, limit, rate), delay)
    history, seed = rate * float(rng.lognormal(0.0, 0.4)), int(rng.integers(10**9))
    reports = {name: simulate(package, (connection,), limit, name, history, seed=seed) for name in CLIENTS}
    return reports | {"waiting": simulate(package, (connection,), limit, rate=history, patience=PATIENCE, seed=seed)}


def draw_connection(rng: np.random.Generator, kind: str, package: StreamedPackage) -> tuple[float, float, float]:
    """Return a limit (s), a mean rate (bytes/s) that brings 20 to 150 % of `package` before it, and a delay (s)."""
    wanted = float(rng.uniform(0.2, 1.5)) * (
        package.manifest_size + package.plan.levels[-1].end + package.plan.first[-1].end + package.plan.sizes[-1]
    )
    fastest = {"3G": 3.0, "4G": 30.0}.get(kind, 100.0) * MEGABIT
    limit = max(float(rng.uniform(3.0, 10.0)), wanted / fastest)
    return limit, wanted / limit, float(rng.uniform(0.06, 0.12) if kind == "3G" else rng.uniform(0.02, 0.06))


def run_mirrors(rng: np.random.Generator, case: str, package: StreamedPackage) -> StreamingReport:
    """Return what the client gets from two to four mirrors, of which none is down, one is down for a while or for good, or which lose 2 %
    of the responses."""
    kind = str(rng.choice(["step", "ramp", "burst"]))
    limit, rate, delay = draw_connection(rng, kind, package)
    parts = rng.dirichlet(np.full(int(rng.integers(2, 5)), 3.0))
    connections = [Connection(make_trace(rng, kind, limit, rate * float(part)), delay) for part in parts]
    begin = float(rng.uniform(0.0, 0.7)) * limit
    down = {"pause": (begin, begin + 0.2 * limit), "down": (begin, 1e9)}
    if case in down:
        connections[-1] = replace(connections[-1], down=down[case])
    elif case == "loss":
        connections = [replace(connection, loss=0.02) for connection in connections]
    return simulate(package, tuple(connections), limit, rate=rate / len(connections), seed=int(rng.integers(10**9)))


def replay_trace(given: Namespace) -> dict[str, Any]:
    """Return what each client gets of one package over one connection.

    Raises:
        FileError: package or trace cannot be read. SettingsError: there is no trace.
    """
    if given.trace is None:
        raise SettingsError("--package needs the file of a connection; add --trace.")
    content, trace = read_package(given.package.absolute()), read_trace(given.trace.absolute())
    package, limit = build_streamed_package(content.manifest, content.increments), content.manifest.time_limit
    return {name: json.loads(simulate(package, (Connection(trace),), limit, name, seed=given.seed).to_json()) for name in CLIENTS}


def measure_sending(given: Namespace) -> dict[str, Any]:
    """Return the distributions of lateness and quality of all clients over all kinds of traces, and over mirrors; see also --package."""
    if given.package is not None:
        return replay_trace(given)
    rng = np.random.default_rng(given.seed)
    figures: dict[str, Any] = {}
    real = open_packages(given.data)
    packages = [real[index // 2 % len(real)] if index % 2 else make_package(rng) for index in range(TRACES)]
    for kind in KINDS:
        runs = [run_clients(rng, kind, package) for package in packages]
        figures[kind] = {name: summarize([run[name] for run in runs], BOUNDS[kind]) for name in runs[0]}
    packages = [package for package in packages if package.plan.sizes[-1] >= MIN_MIRRORED]
    for case in MIRROR_CASES:
        figures[f"mirrors {case}"] = {"compensating": summarize([run_mirrors(rng, case, package) for package in packages], 0.01)}
    ours = [figures[kind][name] for kind in KINDS for name in ("compensating", "waiting")]
    figures["is_on_time"] = all(item["within_bound"] >= 0.95 for item in ours)
    figures["is_within_twice_the_oracle"] = all(item["within_twice_the_oracle"] >= 0.95 for item in ours)
    return figures


def summarize(reports: list[StreamingReport], bound: float) -> dict[str, Any]:
    """Return how late and how early (percent of the limit; median, 95 % and worst; early without packages that came wholly), errors
    relative to those of an oracle, used bytes relative to those that the connection carried (worst, 5 %
    and median), and when the mesh was seen (s, 95 %)."""
    early = [max(-report.deviation, 0.0) / report.limit for report in reports if not report.is_complete]
    ratios = np.array([report.error / report.oracle_error for report in reports])
    return {
        "within_bound": float(np.mean([report.lateness <= bound for report in reports])),
        "late_percent": quantiles([100.0 * report.lateness for report in reports], 0.5, 0.95, 1.0),
        "early_percent": quantiles([100.0 * value for value in early], 0.5, 0.95, 1.0),
        "within_twice_the_oracle": float((ratios <= 2.0).mean()),
        "error_ratio": quantiles(ratios, 0.5, 0.95, 1.0),
        "used": quantiles([report.useful_bytes / max(report.oracle_bytes, 1.0) for report in reports], 0.0, 0.05, 0.5),
        "difference_ms": quantiles([1000.0 * report.mean_difference for report in reports], 0.5, 0.95),
        "seen": quantiles([report.first_seen for report in reports], 0.5, 0.95),
        "complete": sum(report.is_complete for report in reports),
        "requests": quantiles([report.requests for report in reports], 0.5)[0],
    }


def quantiles(values: Sequence[float], *fractions: float) -> list[float]:
    """Return quantiles, rounded; none of no values."""
    return [round(float(value), 3) for value in np.quantile(values, fractions)] if len(values) else []
