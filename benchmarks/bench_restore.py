"""Restored images compared with those of other programs: `python3 benchmarks/bench_restore.py [flags]`.

Prints JSON. Parts (`--only`): `quality` (textures with three masks each: patch distributions and seams), `gradients` (the same under a
gradient of intensity, and the low frequencies), `pictures` (photographs and rendered scenes with objects: contours, FLIP, false edges),
`kappa` (automatic, none and all sub-bands on those), `time` (an image of 600 x 450, and one of 4096 x 4096 with 200 holes, with memory),
`growth` (seconds by masked pixels and by pixels). Each run draws other textures and masks; --seed repeats one. Settings may be tuned on
`--set tuning`, so that nothing is concluded from it; `--quick` compares on it with two peers.
"""

import json
import secrets
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import benchmark_cli
from restore_cases import (
    Case,
    Change,
    Comparison,
    Score,
    apply_gradient,
    build_cases,
    build_picture_cases,
    compare,
    keep,
    score_picture,
    score_texture,
)
from restore_costs import measure_growth, measure_times
from restore_holes import MASKS
from restore_methods import FARFIELD, PEERS, Methods
from restore_pictures import PICTURES
from restore_sheets import write_sheets
from restore_summaries import Cases, summarize_gradients, summarize_kappa, summarize_pictures, summarize_quality
from restore_textures import TEXTURES

from farfield.addon.core.jobs.progress import Progress
from lib import command_line

PHOTOGRAPHS = environment.ROOT.parent / "shared" / "data" / "ordinary" / "photographs"
DATA = environment.ROOT.parent / "shared" / "data" / "sceaux" / "images"
QUICK_PEERS = ("telea", "patchmatch-7")

Part = Callable[[Namespace, Methods], Iterator[dict[str, Any]]]


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = benchmark_cli.build_parser("bench_restore.py", __doc__, PARTS)
    textures = [*TEXTURES["judging"], *TEXTURES["tuning"]]
    parser.add_argument("--set", choices=list(TEXTURES), default="judging", help="the set of textures")
    parser.add_argument("--textures", nargs="+", choices=textures, help="textures, instead of a set")
    parser.add_argument("--masks", nargs="+", choices=list(MASKS), default=list(MASKS), help="shapes of masks")
    parser.add_argument("--methods", nargs="+", choices=["farfield", *PEERS], default=["farfield", *PEERS], help="methods to compare")
    parser.add_argument("--quick", action="store_true", help="compare the quality on the tuning set, with two peers")
    parser.add_argument("--seed", type=int, help="seed of textures, masks and scores; a random one by default")
    parser.add_argument("--timeout", type=float, default=600.0, help="seconds that a peer may take for one image")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the photographs of Sceaux")
    parser.add_argument("--pictures", type=Path, default=PHOTOGRAPHS, help="folder of other photographs")
    parser.add_argument("--sheets", type=Path, help="folder for contact sheets")
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Measure and return the results as JSON; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    if given.quick:
        given.only, given.set, given.methods = ["quality"], "tuning", ["farfield", *QUICK_PEERS]
    given.seed = secrets.randbelow(2**31) if given.seed is None else given.seed
    given.textures = list(given.textures or TEXTURES[given.set])
    figures: dict[str, Any] = {"seed": given.seed, "methods": given.methods}
    with Methods(given.timeout) as methods:
        for index, part in enumerate(given.only):
            for so_far in PARTS[part](given, methods):
                figures[part] = so_far
                line.show(Progress(index / len(given.only), part))
                if given.report is not None:  # after each step, because all of them take long
                    command_line.write_report(given.report.absolute(), figures)
            print(f"{part}: {json.dumps(figures[part].get('summary', figures[part]))}", file=sys.stderr, flush=True)
    return json.dumps(figures, indent=1)


def measure_quality(given: Namespace, methods: Methods) -> Iterator[dict[str, Any]]:
    """Compare patch distributions and seams on textures as they are."""
    return measure_textures(given, methods, "quality", given.methods, keep, summarize_quality)


def measure_gradients(given: Namespace, methods: Methods) -> Iterator[dict[str, Any]]:
    """Compare on textures under a gradient."""
    return measure_textures(given, methods, "gradients", given.methods, apply_gradient, summarize_gradients)


def measure_kappa(given: Namespace, methods: Methods) -> Iterator[dict[str, Any]]:
    """Compare the automatic number of sub-bands with none and with all of them on textures under a gradient."""
    return measure_textures(given, methods, "kappa", list(FARFIELD), apply_gradient, summarize_kappa)


def measure_textures(
    given: Namespace, methods: Methods, part: str, names: list[str], change: Change, summarize: Callable[[Cases], dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """Restore every texture with every mask by the named methods."""
    groups = {texture: build_cases(texture, given, methods, change) for texture in given.textures}
    return measure(given, methods, part, names, groups, score_texture, summarize)


def measure_pictures(given: Namespace, methods: Methods) -> Iterator[dict[str, Any]]:
    """Compare contours, perceived differences and false edges on pictures with objects."""
    groups = {name: build_picture_cases(name, given, methods) for name in PICTURES[given.set]}
    return measure(given, methods, "pictures", given.methods, groups, score_picture, summarize_pictures)


def measure(
    given: Namespace,
    methods: Methods,
    part: str,
    names: list[str],
    groups: dict[str, Iterator[Case]],
    score: Score,
    summarize: Callable[[Cases], dict[str, Any]],
) -> Iterator[dict[str, Any]]:
    """Restore the cases of each group by the named methods; yields the scores and the summary of all cases so far."""
    cases: Cases = {}
    for group, members in groups.items():
        comparisons: list[Comparison] = []
        for case in members:
            comparisons.append(compare(case, names, methods, score))
            cases[case.name] = comparisons[-1].scores
            print(f"{part} {case.name}: {json.dumps(cases[case.name])}", file=sys.stderr, flush=True)
            yield {"summary": summarize(cases), "cases": cases}
        if given.sheets is not None:
            write_sheets(given.sheets, f"{part} {group}", comparisons, names)


PARTS: dict[str, Part] = {
    "quality": measure_quality,
    "gradients": measure_gradients,
    "kappa": measure_kappa,
    "pictures": measure_pictures,
    "time": measure_times,
    "growth": measure_growth,
}

if __name__ == "__main__":
    command_line.run(main)
