"""What benchmarks of several parts share: the choice of parts, and their figures as JSON."""

import json
import sys
from argparse import ArgumentDefaultsHelpFormatter, Namespace
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import command_line

Parts = Mapping[str, Callable[[Namespace], dict[str, Any]]]


def parser(prog: str, doc: str, parts: Parts) -> command_line.Parser:
    """Arguments that choose `parts` and name a report; `doc` is the docstring of the benchmark."""
    made = command_line.Parser(prog=prog, description=doc.split("\n")[0], formatter_class=ArgumentDefaultsHelpFormatter)
    made.add_argument("--only", nargs="+", choices=list(parts), default=list(parts), help="parts to measure")
    made.add_argument("--report", type=Path, help="a JSON file for the figures")
    return made


def measure(given: Namespace, parts: Parts) -> None:
    """Measure the parts that were chosen, and print all figures."""
    figures = {}
    for part in given.only:
        figures[part] = parts[part](given)
        print(f"{part}: {json.dumps(figures[part])}", file=sys.stderr)
    print(json.dumps(figures, indent=1))
    if given.report is not None:
        command_line.write_report(given.report.absolute(), figures)
