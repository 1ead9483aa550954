"""Large terrain measured against the bounds of its design: `python3 benchmarks/bench_bdam.py [flags]`.

Prints JSON. Parts (`--only`): `simplifiers` (vertices at equal measured error: quadric collapses, half-edge collapses, greedy insertion
and right-triangulated meshes), `simplifier_alone` (against pydelatin), `uniform_cut`, `view_cut` and `cliffs` (against both peers),
`build` (time, memory and growth), `disk`, `extraction` (200 frames of a fly-over), `following` (CPU time of decoding, of the
first view and of moves, and slices of the main thread), `cracks`, `screen_error`, `seams` (of textures), `kill`
(kill -9 and resume), `flip` (flipped bytes are found), `geographic` (vertical distances in the local frame of a grid of degrees),
`full_grid` (the same terrain as a full grid in Cycles: time, memory and FLIP), `erosion` (time, memory, and measures of eroded and real
ground).
Each run draws other terrains and views; --seed repeats one. Settings may be tuned on `--set tuning`, so that nothing is concluded from it.
Vertical errors of all methods are measured by the same rasterizer. pydelatin, pymartini and FLIP are reference tools, see
scripts/reference_tools.py.
"""

import secrets
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import benchmark_cli
from bdam_builds import measure_build, measure_disk, measure_extraction, measure_kills
from bdam_checks import measure_cracks, measure_screen_error
from bdam_erosion import measure_erosion
from bdam_flips import measure_flips
from bdam_following import measure_following
from bdam_geographic import measure_geographic
from bdam_renders import measure_full_grid
from bdam_simplifiers import measure_cliffs, measure_simplifier_alone, measure_simplifiers, measure_uniform_cut, measure_view_cut
from bdam_stores import Workplace
from bdam_textures import measure_seams

from farfield.addon.core.errors import SettingsError
from lib import command_line

DATA = environment.ROOT.parent / "shared" / "data" / "dem"
SIZES = (129, 257, 513, 1025, 2049, 4097, 8193, 16385)
PARTS = {
    "simplifiers": measure_simplifiers,
    "simplifier_alone": measure_simplifier_alone,
    "uniform_cut": measure_uniform_cut,
    "view_cut": measure_view_cut,
    "cliffs": measure_cliffs,
    "build": measure_build,
    "disk": measure_disk,
    "extraction": measure_extraction,
    "following": measure_following,
    "cracks": measure_cracks,
    "screen_error": measure_screen_error,
    "seams": measure_seams,
    "kill": measure_kills,
    "flip": measure_flips,
    "geographic": measure_geographic,
    "full_grid": measure_full_grid,
    "erosion": measure_erosion,
}


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = benchmark_cli.build_parser("bench_bdam.py", __doc__, PARTS)
    parser.add_argument("--size", type=int, choices=SIZES, default=8193, help="samples per side of the largest terrain; parts use up to it")
    parser.add_argument("--set", choices=("judging", "tuning"), default="judging", help="the terrains of the comparisons")
    parser.add_argument("--seed", type=int, help="seed of terrains and views; a random one by default")
    parser.add_argument("--cameras", type=int, default=1000, help="random cameras of the search for cracks")
    parser.add_argument("--views", type=int, default=20, help="random views of the screen error")
    parser.add_argument("--kills", type=int, default=10, help="kills of a build")
    parser.add_argument("--flips", type=int, default=50, help="flipped bytes of each file of a store")
    parser.add_argument("--executor", default="processes", help="of the builds, see scripts/bdam.py")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the real elevation models")
    parser.add_argument("--work", type=Path, help="a folder that keeps terrains and stores; a temporary one by default")
    parser.add_argument("--peers-python", type=Path, help="a Python with pydelatin and pymartini instead of the reference tools")
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Measure and return the results as JSON; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    if given.work is not None and given.seed is None and given.work.exists():
        raise SettingsError("A folder with terrains of an earlier run needs the seed of that run; give --seed.")
    given.seed = secrets.randbits(31) if given.seed is None else given.seed
    line.clear()
    with tempfile.TemporaryDirectory(prefix="farfield-benchmark-") as temporary:
        folder = Path(temporary) if given.work is None else given.work.absolute()
        folder.mkdir(parents=True, exist_ok=True)
        workplace = Workplace(folder, given.executor)
        parts = {"run": lambda _: {"seed": given.seed, "size": given.size}} | {name: bind(PARTS[name], workplace) for name in PARTS}
        given.only = ["run", *given.only]
        return benchmark_cli.run_parts(given, parts)


def bind(measure: Callable[[Namespace, Workplace], dict[str, Any]], workplace: Workplace) -> Callable[[Namespace], dict[str, Any]]:
    """Return the function of a part with the seconds of the builds that it needed among its figures."""

    def run(given: Namespace) -> dict[str, Any]:
        workplace.costs.clear()
        figures = measure(given, workplace)
        return figures | ({"builds": dict(workplace.costs)} if workplace.costs else {})

    return run


if __name__ == "__main__":
    command_line.run(main)
