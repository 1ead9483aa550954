"""Accidents and long sessions: `python3 benchmarks/campaign_faults.py [flags]`.

Prints JSON. Parts (`--only`): `disk` (every writer of every script with room for 0, 1, ... 10 tenths of its output), `kill` (runs of every
tool killed at random moments), `memory` (runs of every tool in one session of Blender: the memory after the tenth and at the end),
`crashes` (builds in processes of their own and in one process: crashes, core dumps, threads). Uses /proc and signals: only for Linux.
FARFIELD_BPY selects the Blender.
"""

import json
import secrets
import shutil
import sys
import tempfile
import time
from argparse import ArgumentDefaultsHelpFormatter, Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()
sys.path.append(str(environment.ROOT / "tests"))

import bpy
import campaign_projects
import campaign_runs
from campaign_disk import measure_full_disks
from campaign_kills import measure_kills
from campaign_runs import BUILD_FLAGS, Campaign, TimeLimitReached, script

from farfield.addon.core.jobs.progress import Progress
from lib import command_line

SESSION = Path(__file__).with_name("campaign_session.py")
MEMORY_KINDS = ("builds", "terrains", "unwraps", "restorations", "levels", "packages", "photo textures", "large terrains", "bakes")
FIRST_RUN = 10  # memory is compared with that after this run: until then caches fill
MAX_GROWTH = 0.05


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the campaign."""
    parser = command_line.Parser(
        prog="campaign_faults.py", description=__doc__.split("\n")[0], formatter_class=ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=list(PARTS), default=list(PARTS), help="parts to run")
    parser.add_argument("--kills", type=int, default=200, help="killed runs of the part kill")
    parser.add_argument("--runs", type=int, default=200, help="runs of each kind of the part memory")
    parser.add_argument("--kinds", nargs="+", choices=MEMORY_KINDS, default=MEMORY_KINDS, help="kinds of runs of the part memory")
    parser.add_argument("--processes", type=int, default=300, help="builds of the part crashes, in processes and once more in one process")
    parser.add_argument("--seed", type=int, help="seed of the random moments (default: a random one)")
    parser.add_argument("--minutes", type=float, default=600.0, help="time limit of all parts together")
    parser.add_argument("--report", type=Path, help="a JSON file for the results")
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the campaign and return the results as JSON; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    seed = secrets.randbelow(2**31) if given.seed is None else given.seed
    print(f"Seed: {seed}", file=sys.stderr)
    sandbox, start = Path(tempfile.mkdtemp(prefix="farfield-campaign-")), time.monotonic()

    def show(label: str) -> None:
        line.show(Progress(min((time.monotonic() - start) / (60.0 * given.minutes), 1.0), label))

    campaign = Campaign(sandbox, start + 60.0 * given.minutes, show, seed)
    results: dict[str, Any] = {"seed": seed, "blender": bpy.app.version_string, "findings": campaign.findings}
    try:
        for part in given.only:
            results[part], part_start = {}, time.monotonic()
            try:
                PARTS[part](campaign, results[part], given)
            finally:
                results[part]["seconds"] = round(time.monotonic() - part_start, 1)
                print(f"{part}: {json.dumps(results[part])}, {len(campaign.findings)} findings", file=sys.stderr)
    except TimeLimitReached:
        results["ended"] = "time limit"
    except KeyboardInterrupt:
        results["ended"] = "cancelled"
    finally:
        shutil.rmtree(sandbox, ignore_errors=True)
    if given.report is not None:
        command_line.write_report(given.report.absolute(), results)
    return json.dumps(results, indent=1)


def measure_disk(campaign: Campaign, figures: dict[str, Any], _given: Namespace) -> None:
    """Run every writer on full disks."""
    measure_full_disks(campaign, figures)


def measure_kill(campaign: Campaign, figures: dict[str, Any], given: Namespace) -> None:
    """Kill runs at random moments."""
    measure_kills(campaign, figures, given.kills)


def measure_memory(campaign: Campaign, figures: dict[str, Any], given: Namespace) -> None:
    """Measure the memory after the tenth and after the last run of each kind in one session."""
    runs: list[dict[str, Any]] = []
    try:
        _run_session(campaign, dict.fromkeys(given.kinds, given.runs), runs)
    finally:
        for kind in dict.fromkeys(run["kind"] for run in runs):
            figures[kind] = _compare_memory(campaign, kind, [run["memory_mb"] for run in runs if run["kind"] == kind])


def _compare_memory(campaign: Campaign, kind: str, memory: list[float]) -> dict[str, Any]:
    """Return the memory after the first, tenth and last run of one kind, and how much it grew from the tenth to the last."""
    shown = sorted({0, min(FIRST_RUN, len(memory)) - 1, len(memory) - 1})
    figures: dict[str, Any] = {"runs": len(memory), "memory_mb": {str(index + 1): memory[index] for index in shown}}
    if len(memory) > FIRST_RUN:
        growth = memory[-1] / memory[FIRST_RUN - 1] - 1.0
        figures |= {"growth": round(growth, 4), "bound": MAX_GROWTH}
        if growth > MAX_GROWTH:
            campaign.add_finding(
                "memory", f"{kind}: {memory[FIRST_RUN - 1]} MB after run {FIRST_RUN}, {memory[-1]} MB after run {len(memory)}"
            )
    return figures


def measure_crashes(campaign: Campaign, figures: dict[str, Any], given: Namespace) -> None:
    """Count crashes of builds in processes of their own and in one process, and the threads that builds leave in the latter."""
    cube, codes = campaign_runs.write_cube(campaign.sandbox / "crash input"), {}
    figures["processes"] = {"exit_codes": codes, "core_dumps": 0}
    command = script("billboards", cube, "--out", campaign.sandbox / "crash input" / "out.blend", *BUILD_FLAGS)
    for index in range(given.processes):
        outcome = campaign.run(f"build {index + 1} in a process", command, before_exec=_allow_core_dumps)
        codes[str(outcome.code)] = codes.get(str(outcome.code), 0) + 1
        figures["processes"]["core_dumps"] = len(list(campaign.sandbox.glob("core*")))
        if outcome.code != 0:
            campaign.add_finding("crashes", f"exit code {outcome.code}: {outcome.stderr}", command)
    runs: list[dict[str, Any]] = []
    try:
        _run_session(campaign, {"builds": given.processes}, runs)
    finally:
        threads = [run["threads"] for run in runs]
        figures["one_process"] = {"runs": len(runs), "threads_after_first": threads[:1], "max_threads": max(threads, default=None)}
    if max(threads) > threads[0]:
        campaign.add_finding("crashes", f"{threads[0]} threads after the first build, later up to {max(threads)}")


def _run_session(campaign: Campaign, counts: dict[str, int], runs: list[dict[str, Any]]) -> None:
    """Run one session and append its runs to `runs` as they end. A session that dies is a finding."""
    log = campaign.sandbox / "session.jsonl"
    cloud = campaign_runs.create_cloud(campaign, campaign.sandbox / "session input")
    project = campaign.sandbox / "session project"
    if not project.exists():
        campaign_projects.write_photo_project(project)
    log.write_bytes(b"")
    arguments = [f"{kind}={count}" for kind, count in counts.items() if count]
    with campaign.start(
        [sys.executable, str(SESSION), str(log), str(cloud), str(project), *arguments], before_exec=_allow_core_dumps
    ) as process:
        for run in campaign_runs.follow_log(campaign, "one session", process, log):
            runs.append(run)
        outcome = process.outcome()
    if outcome.code != 0:
        campaign.add_finding("session", f"exit code {outcome.code} after {len(runs)} runs: {outcome.stderr}")


def _allow_core_dumps() -> None:
    import resource

    _, maximum = resource.getrlimit(resource.RLIMIT_CORE)
    resource.setrlimit(resource.RLIMIT_CORE, (maximum, maximum))


PARTS: dict[str, Callable[[Campaign, dict[str, Any], Namespace], None]] = {
    "disk": measure_disk,
    "kill": measure_kill,
    "memory": measure_memory,
    "crashes": measure_crashes,
}

if __name__ == "__main__":
    command_line.run(main)
