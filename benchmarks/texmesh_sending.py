"""Part `sending` of bench_texmesh.py: packages over 200 replayed traces, by clients with and without time compensation.

Packages are synthetic: sizes of tiles are lognormal, a texture of 4096 x 4096 has 1 to 4 MB, a mesh 100 to 600 KB.
"""

import sys
from argparse import Namespace
from typing import Any

import numpy as np

from farfield.addon.core.texmesh.streaming.manifest import MESH, TEXTURES
from farfield.addon.core.texmesh.streaming.sending_state import Job, Span
from farfield.addon.core.texmesh.streaming.simulated_network import Line
from farfield.addon.core.texmesh.streaming.simulation import CLIENTS, SendingReport, SentPackage, simulate
from farfield.addon.core.texmesh.streaming.traces import MEGABIT, Trace, burst_trace, cellular_trace, ramp_trace, step_trace

KINDS = ("step", "ramp", "burst", "3G", "4G")
TRACES = 40  # of each kind
BOUNDS = {"step": 0.01, "ramp": 0.01, "burst": 0.03, "3G": 0.03, "4G": 0.03}  # lateness that 95 % must not exceed, fractions of the limit


def make_package(rng: np.random.Generator) -> SentPackage:
    """Return a plausible package."""
    mesh_total, texture_total = rng.uniform(1e5, 6e5), rng.uniform(1e6, 4e6)
    levels = int(rng.integers(4, 8))
    sizes = np.maximum((mesh_total * 0.5 ** np.arange(levels)[::-1] / 2.0 * rng.uniform(0.8, 1.2, levels)).astype(int), 200)
    added, corners, offset = [], [], 0
    for level in range(levels):
        added.append((Span(MESH, offset, offset + int(sizes[level])),))
        offset += int(sizes[level])
        corners.append((Span(MESH, offset, offset + int(0.9 * sizes[: level + 1].sum())),))
        offset = corners[-1][-1].end
    count, tiles = 256 * 7, np.tile(np.arange(256), 7)
    scan_sizes = rng.lognormal(0.0, 0.8, 256)[tiles] * np.repeat([1.0, 0.7, 0.8, 1.0, 1.4, 2.0, 3.0], 256) * rng.lognormal(0.0, 0.3, count)
    scan_sizes = np.maximum((scan_sizes * texture_total / scan_sizes.sum()).astype(int), 20)
    slopes = np.repeat([1.0, 0.4, 0.2, 0.1, 0.05, 0.025, 0.01], 256) * rng.lognormal(0.0, 0.6, count)
    order = np.argsort(-slopes, kind="stable")
    gains = (slopes * scan_sizes)[order]
    gains *= rng.uniform(0.2, 0.4) / gains.sum()
    table = 6 * count
    ends = table + 4 * count + np.cumsum(scan_sizes[order])
    level_errors = 0.005 + rng.uniform(0.1, 0.3) * rng.uniform(0.35, 0.5) ** np.arange(levels)
    job = Job(
        (*added[0], *corners[0], Span(TEXTURES, 0, table)),
        tuple(added),
        tuple(corners),
        tuple((level, count, float(error)) for level, error in enumerate(level_errors)),
        table + 4 * count,
        tuple(ends.tolist()),
    )
    package = SentPackage(job, gains, tiles[order], 8000)
    rows = [package.best(size) for size in np.geomspace(0.1 * mesh_total, 1.2 * (mesh_total * 2 + texture_total), 80)]
    plan = tuple(dict.fromkeys(row for row in rows if row[0] >= 0))
    return SentPackage(Job(job.first, job.added, job.corners, plan, job.begin, job.ends), gains, tiles[order], 8000)


def make_trace(rng: np.random.Generator, kind: str, limit: float, rate: float) -> Trace:
    """Return a trace of a kind, around `rate` bytes per second."""
    duration = 1.5 * limit
    if kind in ("3G", "4G"):
        return cellular_trace(rng, duration, int(kind[0]), rate)
    return {"step": step_trace, "ramp": ramp_trace, "burst": burst_trace}[kind](rng, duration, rate)


def run_clients(rng: np.random.Generator, kind: str, mirrors: int = 0) -> dict[str, SendingReport]:
    """Return what the clients get of a new package over a new line; with mirrors only that with compensation."""
    package = make_package(rng)
    total = package.job.ends[-1] + package.job.corners[-1][-1].end
    limit = float(rng.uniform(3.0, 10.0))
    rate = min(rng.uniform(0.15, 0.9) * total / limit, {"3G": 3.0, "4G": 30.0}.get(kind, 100.0) * MEGABIT)
    delay = float(rng.uniform(0.02, 0.06) if kind != "3G" else rng.uniform(0.06, 0.12))
    count = mirrors or 1
    parts = rng.dirichlet(np.full(count, 3.0))
    lines = [Line(make_trace(rng, kind, limit, rate * float(part)), delay) for part in parts]
    history = rate * float(rng.lognormal(0.0, 0.4))
    seed = int(rng.integers(10**9))
    names = ("compensating",) if mirrors else CLIENTS
    return {name: simulate(package, tuple(lines), limit, name, history / count, seed=seed, patience=1e9) for name in names}


def measure_sending(given: Namespace) -> dict[str, Any]:
    """Return the distribution of lateness and quality."""
    rng = np.random.default_rng(given.seed)
    figures: dict[str, Any] = {}
    for kind in KINDS:
        runs = [run_clients(rng, kind) for _ in range(TRACES)]
        figures[kind] = {name: summarize([run[name] for run in runs], BOUNDS[kind]) for name in CLIENTS}
        print(kind, figures[kind], file=sys.stderr)
    return figures


def summarize(reports: list[SendingReport], bound: float) -> dict[str, Any]:
    """Return the distribution of lateness, of how early, and of errors beside the oracle's."""
    late = np.array([report.lateness for report in reports])
    early = np.array([-min(report.deviation, 0.0) / report.limit for report in reports if not report.is_complete])
    ratios = np.array([report.error / report.oracle_error for report in reports])
    used = np.array([report.useful_bytes / max(report.oracle_bytes, 1.0) for report in reports])
    return {
        "within_bound": float((late <= bound).mean()),
        "late_percent": [round(100.0 * float(value), 2) for value in np.quantile(late, [0.5, 0.95, 1.0])],
        "early_percent": [round(100.0 * float(value), 2) for value in np.quantile(early, [0.5, 0.95, 1.0])] if len(early) else [],
        "error_ratio": [round(float(value), 3) for value in np.quantile(ratios, [0.5, 0.95, 1.0])],
        "used": [round(float(value), 3) for value in np.quantile(used, [0.0, 0.05, 0.5])],
        "seen": round(float(np.quantile([report.first_seen for report in reports], 0.95)), 2),
        "complete": sum(report.is_complete for report in reports),
        "aborted": sum(report.aborted for report in reports),
        "requests": float(np.median([report.requests for report in reports])),
    }
