"""Run the benchmarks and write one page with their ratios: `python3 scripts/bench.py [TOOL ...] [--full] [--out build/bench]`.

Without --full each benchmark runs in minutes, with few models; the figures in docs/results come from complete runs. The folder gets
index.md, with the machine and the versions, and the JSON of each benchmark. Benchmarks read models in ../shared/data, and compare with the
tools of scripts/reference_tools.py where these are installed. One that fails is named on the page, and the exit code is 1.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from datetime import date
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parent))

from lib import environment

environment.ensure()

from lib.benchmark_ratios import Ratio, find_ratios

FOLDER = environment.ROOT / "benchmarks"
# The benchmarks of each tool, with the flags of a short run.
BENCHMARKS = {
    "distance": {"bench_distance.py": "--samples 8"},
    "billboards": {"bench_billboards.py": "--only ordinary --models colonnade"},
    "btf": {
        "bench_btf.py": "--only images --models spot --no-lpca --views-per-side 4 --lights-per-side 4 --pairs 4 --samples 8 "
        "--reference-samples 32 --sizes switch",
        "bench_relight.py": "--models spot --lights sun --errors 2% --pairs 4 --samples 8 --reference-samples 16",
    },
    "unwrap": {"bench_unwrap.py": "--only hard_surfaces"},
    "restore": {"bench_restore.py": "--quick --textures canvas marble twill --masks blob"},
    "photos": {"bench_photos.py": "--only synthetic --set tuning --size 256"},
    "clipbox": {
        "bench_clipbox.py": "--only extraction --repeats 1",
        "bench_clipbox_images.py": "--only uniform",
        "bench_landscapes.py": "--only shape",
        "bench_landscape_views.py": "--count 5",
    },
    "bdam": {"bench_bdam.py": "--only simplifier_alone --set tuning --size 257"},
    "texmesh": {"bench_texmesh.py": "--only refits --models spot"},
    "packages": {"bench_packages.py": "--only meshes --models spot"},
}
VERSIONS = ("bpy", "numpy", "scipy")
MAX_MESSAGE = 300  # characters of an error on the page


class Outcome(NamedTuple):
    """The run of one benchmark. failure: "" if it succeeded. skipped: why it did not run some parts."""

    script: str
    flags: str
    seconds: float
    ratios: list[Ratio]
    failure: str
    skipped: list[str]


def main() -> int:
    parser = argparse.ArgumentParser(description="Run the benchmarks and write one page with their ratios.")
    parser.add_argument("tools", nargs="*", metavar="TOOL", help=f"of {', '.join(BENCHMARKS)} (default: all)")
    parser.add_argument("--full", action="store_true", help="run all parts on all models, which takes hours")
    parser.add_argument("--out", type=Path, default=environment.ROOT / "build" / "bench", help="folder of the page (default: build/bench)")
    given = parser.parse_args()
    unknown = [tool for tool in given.tools if tool not in BENCHMARKS]
    if unknown:
        parser.error(f'there are no benchmarks of "{unknown[0]}"; choose from {", ".join(BENCHMARKS)}')
    given.out.mkdir(parents=True, exist_ok=True)
    outcomes = []
    try:
        for tool in given.tools or BENCHMARKS:
            for script, flags in BENCHMARKS[tool].items():
                outcomes.append(run_benchmark(script, "" if given.full else flags, given.out))
                (given.out / "index.md").write_text(write_page(outcomes), encoding="utf-8")  # after each, because all take long
    except KeyboardInterrupt:
        return 130
    print(given.out / "index.md")
    return int(any(outcome.failure for outcome in outcomes))


def run_benchmark(script: str, flags: str, out: Path) -> Outcome:
    """Run one benchmark, whose measurements become a JSON file in `out`."""
    report = out / Path(script).with_suffix(".json").name
    report.unlink(missing_ok=True)
    print(f"{script} {flags}", file=sys.stderr, flush=True)
    started = time.monotonic()
    command = [sys.executable, str(FOLDER / script), *flags.split(), "--report", str(report)]
    outcome = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace", check=False)
    seconds = time.monotonic() - started
    if outcome.returncode != 0:
        lines = outcome.stderr.strip().splitlines() or [f"exit code {outcome.returncode}"]
        return Outcome(script, flags, seconds, [], lines[-1][:MAX_MESSAGE], [])
    figures = json.loads(report.read_text(encoding="utf-8"))
    skipped = [f"{part} ({values['skipped']})" for part, values in figures.items() if isinstance(values, dict) and values.get("skipped")]
    return Outcome(script, flags, seconds, find_ratios(figures), "", skipped)


def write_page(outcomes: list[Outcome]) -> str:
    """Return the page."""
    versions = [f"{name} {metadata.version(name)}" for name in VERSIONS]
    system = [f"{os.cpu_count()} cores", f"{platform.system()} {platform.machine()}", f"Python {platform.python_version()}"]
    lines = [
        "# Benchmarks",
        ", ".join([str(date.today()), processor_name(), *system, *versions, f"revision {revision()}."]),
        "",
        "Ratios of Farfield to another program or to the original, by name: `a_over_b` is a divided by b. Mean: geometric.",
    ]
    for outcome in outcomes:
        name = Path(outcome.script).stem
        lines += ["", f"## {name.removeprefix('bench_')}", f"`{outcome.script} {outcome.flags}`, {outcome.seconds:.0f} s. ", ""]
        if outcome.skipped:
            lines += [f"Skipped: {', '.join(outcome.skipped)}.", ""]
        if outcome.failure:
            lines.append(f"**Failed**: {outcome.failure}")
        elif not outcome.ratios:
            lines.append(f"No ratios. All figures: [{name}.json]({name}.json).")
        else:
            lines += [
                f"All figures: [{name}.json]({name}.json).",
                "",
                "| part | ratio | values | mean | least | largest |",
                "|---|---|---|---|---|---|",
            ]
            lines += [
                f"| {item.part} | {item.name} | {item.count} | {item.mean:.3g} | {item.least:.3g} | {item.largest:.3g} |"
                for item in outcome.ratios
            ]
    return "\n".join([*lines, ""])


def processor_name() -> str:
    """Return the name of the processor, or of its architecture where the system does not tell."""
    info = Path("/proc/cpuinfo")
    names = (
        [line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")] if info.exists() else []
    )
    return names[0] if names else platform.processor() or platform.machine()


def revision() -> str:
    """Return the commit of the checkout, "unknown" outside of Git."""
    command = ["git", "-C", str(environment.ROOT), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


if __name__ == "__main__":
    sys.exit(main())
