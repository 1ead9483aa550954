"""Part `sending` of bench_texmesh.py: packages over 200 replayed traces, by clients with and without time compensation.

Packages are synthetic: sizes of tiles are lognormal, a texture of 4096 x 4096 has 1 to 4 MB, a mesh 100 to 600 KB.
"""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from farfield.addon.core.texmesh.streaming.manifest import MESH, TEXTURES
from farfield.addon.core.texmesh.streaming.sending_state import Job, Span
from farfield.addon.core.texmesh.streaming.simulated_network import Line
from farfield.addon.core.texmesh.streaming.simulation import CLIENTS, SendingReport, SentPackage, simulate
from farfield.addon.core.texmesh.streaming.traces import MEGABIT, Trace, burst_trace, cellular_trace, ramp_trace, step_trace

KINDS = ("step", "ramp", "burst", "3G", "4G")
MIRROR_CASES = ("fine", "pause", "down", "loss")
TRACES = 40  # of each kind
PATIENCE = 1e9  # seconds
BOUNDS = {"step": 0.01, "ramp": 0.01, "burst": 0.03, "3G": 0.03, "4G": 0.03}  # lateness that 95 % must not exceed, fractions of the limit


def make_package(rng: np.random.Generator) -> SentPackage:
    """Return a plausible package."""
    mesh_total, texture_total = rng.uniform(1e5, 6e5), rng.uniform(1e6, 4e6)
    levels = int(rng.integers(4, 8))
    sizes = np.maximum((mesh_total * 0.5 ** np.arange(levels)[::-1] / 2.0 * rng.uniform(0.8, 1.2, levels)).astype(int), 200)
    ends_of_levels = np.cumsum(sizes).tolist()
    spans = tuple((Span(MESH, end - size, end),) for end, size in zip(ends_of_levels, sizes.tolist(), strict=True))
    count, tiles = 256 * 7, np.tile(np.arange(256), 7)
    scan_sizes = rng.lognormal(0.0, 0.8, 256)[tiles] * np.repeat([1.0, 0.7, 0.8, 1.0, 1.4, 2.0, 3.0], 256) * rng.lognormal(0.0, 0.3, count)
    scan_sizes = np.maximum((scan_sizes * texture_total / scan_sizes.sum()).astype(int), 20)
    ratios = np.repeat([1.0, 0.4, 0.2, 0.1, 0.05, 0.025, 0.01], 256) * rng.lognormal(0.0, 0.6, count)
    order = np.argsort(-ratios, kind="stable")
    gains = (ratios * scan_sizes)[order]
    gains *= rng.uniform(0.2, 0.4) / gains.sum()
    table = 6 * count
    ends = table + 4 * count + np.cumsum(scan_sizes[order])
    level_errors = 0.005 + rng.uniform(0.1, 0.3) * rng.uniform(0.35, 0.5) ** np.arange(levels)
    job = Job(
        (*spans[0], Span(TEXTURES, 0, table)),
        spans,
        tuple((level, count, float(error)) for level, error in enumerate(level_errors)),
        table + 4 * count,
        tuple(ends.tolist()),
    )
    package = SentPackage(job, gains, tiles[order], 8000)
    rows = [package.best(size) for size in np.geomspace(0.1 * mesh_total, 1.2 * (mesh_total + texture_total), 80)]
    plan = tuple(dict.fromkeys(row for row in rows if row[0] >= 0))
    return SentPackage(Job(job.first, job.levels, plan, job.begin, job.ends), gains, tiles[order], 8000)


def make_trace(rng: np.random.Generator, kind: str, limit: float, rate: float) -> Trace:
    """Return a trace of a kind, around `rate` bytes per second."""
    duration = 1.5 * limit
    if kind in ("3G", "4G"):
        return cellular_trace(rng, duration, int(kind[0]), rate)
    return {"step": step_trace, "ramp": ramp_trace, "burst": burst_trace}[kind](rng, duration, rate)


def run_clients(rng: np.random.Generator, kind: str, package: SentPackage | None = None) -> dict[str, SendingReport]:
    """Return what each client gets of a package, a new one by default, over a new line. `waiting` is the client with compensation that
    waits after the limit for all that it has asked for."""
    package = package or make_package(rng)
    limit, rate, delay = draw_line(rng, kind, package)
    line = Line(make_trace(rng, kind, limit, rate), delay)
    history, seed = rate * float(rng.lognormal(0.0, 0.4)), int(rng.integers(10**9))
    reports = {name: simulate(package, (line,), limit, name, history, seed=seed) for name in CLIENTS}
    return reports | {"waiting": simulate(package, (line,), limit, rate=history, patience=PATIENCE, seed=seed)}


def draw_line(rng: np.random.Generator, kind: str, package: SentPackage) -> tuple[float, float, float]:
    """Return a limit (s), a mean rate (bytes/s) that brings 15 to 90 % of `package` before it, and a delay (s)."""
    limit = float(rng.uniform(3.0, 10.0))
    total = package.job.ends[-1] + package.job.levels[-1][-1].end
    fastest = {"3G": 3.0, "4G": 30.0}.get(kind, 100.0) * MEGABIT
    rate = float(min(rng.uniform(0.15, 0.9) * total / limit, fastest))
    return limit, rate, float(rng.uniform(0.06, 0.12) if kind == "3G" else rng.uniform(0.02, 0.06))


def run_mirrors(rng: np.random.Generator, case: str) -> SendingReport:
    """Return what the client gets from two to four mirrors, of which none is down, one is down for a while or for good, or which lose 2 %
    of the responses."""
    package = make_package(rng)
    kind = str(rng.choice(["step", "ramp", "burst"]))
    limit, rate, delay = draw_line(rng, kind, package)
    parts = rng.dirichlet(np.full(int(rng.integers(2, 5)), 3.0))
    lines = [Line(make_trace(rng, kind, limit, rate * float(part)), delay) for part in parts]
    begin = float(rng.uniform(0.0, 0.7)) * limit
    down = {"pause": (begin, begin + 0.2 * limit), "down": (begin, 1e9)}
    if case in down:
        lines[-1] = replace(lines[-1], down=down[case])
    elif case == "loss":
        lines = [replace(line, loss=0.02) for line in lines]
    return simulate(package, tuple(lines), limit, rate=rate / len(lines), seed=int(rng.integers(10**9)))


def measure_sending(given: Namespace) -> dict[str, Any]:
    """Return the distributions of lateness and quality of all clients over all kinds of traces, and over mirrors."""
    rng = np.random.default_rng(given.seed)
    figures: dict[str, Any] = {}
    for kind in KINDS:
        runs = [run_clients(rng, kind) for _ in range(TRACES)]
        figures[kind] = {name: summarize([run[name] for run in runs], BOUNDS[kind]) for name in runs[0]}
    for case in MIRROR_CASES:
        figures[f"mirrors {case}"] = {"compensating": summarize([run_mirrors(rng, case) for _ in range(TRACES)], 0.01)}
    ours = [figures[kind]["compensating"] for kind in KINDS]  # what the page does; `waiting` shows what would come too late
    figures["is_on_time"] = all(item["within_bound"] >= 0.95 for item in ours)
    figures["is_within_twice_the_oracle"] = all(item["within_twice_the_oracle"] >= 0.95 for item in ours)
    return figures


def summarize(reports: list[SendingReport], bound: float) -> dict[str, Any]:
    """Return how late and how early (percent of the limit; median, 95 % and worst; early without packages that came wholly), errors beside
    those of an oracle, used bytes beside those that the line carried (worst, 5 % and median), and when the mesh was seen (s, 95 %)."""
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
