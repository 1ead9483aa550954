"""Random input for the scripts and operators of all tools: `python3 benchmarks/campaign_fuzz.py [flags]`.

Prints JSON. Each case draws its input from the seed: meshes with defects, scenes, damaged files, odd paths, valid and invalid flags,
outputs that exist, or a sequence of operators. A script must end with exit code 0, with 2 and one sentence, or, after Ctrl+C, with 130;
its outputs are complete or untouched, and nothing else is left behind. An operator must finish, or report one sentence and leave the scene
unchanged. FARFIELD_BPY selects the Blender.
`--tool btf --case 17` with the seed that was printed repeats one case; `--keep` keeps its files.
"""

import json
import secrets
import shutil
import sys
import tempfile
import time
from argparse import ArgumentDefaultsHelpFormatter, Namespace
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()
sys.path.append(str(environment.ROOT / "tests"))

import bpy
from campaign_batches import BatchOptions, run_cases
from campaign_checks import Problem

from farfield.addon.core.jobs.progress import Progress
from lib import command_line

CASE_SECONDS = dict.fromkeys(("billboards", "unwrap", "clipbox", "restore", "bdam"), 60.0) | dict.fromkeys(
    ("btf", "photos", "texmesh", "packages"), 180.0
)
MAX_REFUSALS = 40  # different messages of runs with exit code 2 in the report
MAX_EXAMPLES = 3  # The report has at most this many cases of each finding.


@dataclass
class Tally:
    """What happened in the cases of one tool. findings: problems by their signature, each with a number and examples."""

    cases: int = 0
    scripts: int = 0
    operators: int = 0
    operator_calls: Counter = field(default_factory=Counter)
    exit_codes: Counter = field(default_factory=Counter)
    refusals: Counter = field(default_factory=Counter)
    importer_crashes: Counter = field(default_factory=Counter)
    findings: dict[str, dict[str, Any]] = field(default_factory=dict)
    seconds: float = 0.0
    slowest: list[tuple[float, int]] = field(default_factory=list)

    def add(self, tool: str, seed: int, result: dict[str, Any]) -> None:
        """Count the result of one case."""
        self.cases += 1
        self.scripts += result["kind"] == "script"
        self.operators += result["kind"] == "operators"
        self.operator_calls.update({name: result[name] for name in ("finished", "refused") if name in result})
        if "code" in result:
            self.exit_codes[str(result["code"])] += 1
        if result.get("code") == 2:
            self.refusals[Problem("", result["stderr"]).signature.removeprefix(": ")] += 1
        self.slowest = sorted([*self.slowest, (result.get("seconds", 0.0), result["case"])], reverse=True)[:MAX_EXAMPLES]
        for kind, text in result["problems"]:
            problem = Problem(kind, text)
            if result.get("is_importer"):
                self.importer_crashes[problem.text] += 1
                continue
            finding = self.findings.setdefault(problem.signature, {"count": 0, "examples": []})
            finding["count"] += 1
            if len(finding["examples"]) < MAX_EXAMPLES:
                repeat = f"python3 benchmarks/campaign_fuzz.py --tool {tool} --seed {seed} --case {result['case']} --keep"
                example = {"repeat": repeat, "text": text, "steps": result.get("steps", [])}
                finding["examples"].append(
                    example | {name: result[name] for name in ("code", "stderr", "stacks", "alone") if name in result}
                )

    def figures(self) -> dict[str, Any]:
        """Return everything as JSON."""
        names = ("cases", "scripts", "operators", "operator_calls", "exit_codes", "importer_crashes")
        refusals = dict(self.refusals.most_common(MAX_REFUSALS))
        slowest = [{"seconds": seconds, "case": case} for seconds, case in self.slowest]
        return {name: getattr(self, name) for name in names} | {
            "refusals": refusals,
            "seconds": round(self.seconds, 1),
            "slowest": slowest,
            "findings": self.findings,
        }


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the campaign."""
    parser = command_line.Parser(prog="campaign_fuzz.py", description=__doc__.split("\n")[0], formatter_class=ArgumentDefaultsHelpFormatter)
    parser.add_argument("--tool", nargs="+", choices=list(CASE_SECONDS), default=list(CASE_SECONDS), help="tools to test")
    parser.add_argument("--count", type=int, default=2000, help="cases per tool")
    parser.add_argument("--seed", type=int, help="seed of all cases (default: a random one)")
    parser.add_argument("--case", type=int, nargs="+", help="only these cases")
    parser.add_argument("--minutes", type=float, default=600.0, help="time limit of all tools together")
    parser.add_argument("--case-seconds", type=float, help=f"time limit of one case (default: {CASE_SECONDS})")
    parser.add_argument("--memory-gb", type=float, default=8.0, help="address space of a worker process, in GiB")
    parser.add_argument("--keep", action="store_true", help="keep the files of cases with findings")
    parser.add_argument("--report", type=Path, help="a JSON file for the results")
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the campaign and return the results as JSON; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    seed = secrets.randbelow(2**31) if given.seed is None else given.seed
    print(f"Seed: {seed}", file=sys.stderr)
    sandbox = Path(tempfile.mkdtemp(prefix="farfield-campaign-"))
    results = {"seed": seed, "blender": bpy.app.version_string, "tools": {}}
    try:
        _run_tools(given, seed, sandbox, results, line)
    except KeyboardInterrupt:
        results["ended"] = "cancelled"
    finally:
        if (sandbox / "kept").is_dir():
            print(f"Files of cases with findings: {sandbox / 'kept'}", file=sys.stderr)
        else:
            shutil.rmtree(sandbox, ignore_errors=True)
    if given.report is not None:
        command_line.write_report(given.report.absolute(), results)
    return json.dumps(results, indent=1)


def _run_tools(given: Namespace, seed: int, sandbox: Path, results: dict[str, Any], line: command_line.ProgressLine) -> None:
    """Run the cases of all tools, and add to `results` what was done, also when the user or the time limit ends it."""
    cases = list(range(given.count)) if given.case is None else given.case
    end = time.monotonic() + 60.0 * given.minutes
    for position, tool in enumerate(given.tool):
        options, tally, start = (
            BatchOptions(seed, sandbox, given.case_seconds or CASE_SECONDS[tool], given.memory_gb, given.keep),
            Tally(),
            time.monotonic(),
        )

        def show(tool: str = tool, tally: Tally = tally, position: int = position) -> None:
            fraction = (position + tally.cases / max(1, len(cases))) / len(given.tool)
            line.show(Progress(min(fraction, 1.0), f"{tool}: {tally.cases} cases, {len(tally.findings)} findings"))

        try:
            for result in run_cases(tool, cases, options, show):
                if result["kind"] == "crash" and not result["is_importer"] and len(cases) > 1:
                    alone = next(iter(run_cases(tool, [result["case"]], options, show)))
                    result["alone"] = "crashes again" if alone["kind"] == "crash" else "does not crash"
                tally.add(tool, seed, result)
                if time.monotonic() > end:
                    results["ended"] = "time limit"
                    return
        finally:
            tally.seconds = time.monotonic() - start
            results["tools"][tool] = tally.figures()
            print(f"{tool}: {tally.cases} cases, exit codes {dict(tally.exit_codes)}, {len(tally.findings)} findings", file=sys.stderr)


if __name__ == "__main__":
    command_line.run(main)
