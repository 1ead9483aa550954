"""Shared by benchmarks that consist of parts: the flags that select parts, and the results as JSON."""

import json
import sys
from argparse import ArgumentDefaultsHelpFormatter, Namespace
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from lib import command_line

BenchmarkParts = Mapping[str, Callable[[Namespace], dict[str, Any]]]


def build_parser(prog: str, doc: str, parts: BenchmarkParts) -> command_line.Parser:
    """Build a parser with flags that select `parts` and name a report; `doc` is the docstring of the benchmark."""
    parser = command_line.Parser(prog=prog, description=doc.split("\n")[0], formatter_class=ArgumentDefaultsHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(parts), default=list(parts), help="parts to measure")
    parser.add_argument("--report", type=Path, help="a JSON file for the measurements")
    return parser


def run_parts(given: Namespace, parts: BenchmarkParts) -> str:
    """Measure the selected parts, write the report, and return all measurements as JSON."""
    figures = {}
    for part in given.only:
        figures[part] = parts[part](given)
        print(f"{part}: {json.dumps(figures[part])}", file=sys.stderr)
    if given.report is not None:
        command_line.write_report(given.report.absolute(), figures)
    return json.dumps(figures, indent=1)
