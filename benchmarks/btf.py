"""How good relightable textures are and what they cost: `python3 benchmarks/btf.py [--only PART ...] [--models MODEL ...] [--work DIR]
[--sheets DIR] [--report R.json]`.

Prints JSON. Parts: `pictures` (likeness to the original beside plain maps, an octahedral impostor of as many bytes and a decimated mesh of
as many triangles, at the switch size and twice that; compression, also of lpca), `time` (bakes against bare Cycles, and executors against
each other), `memory` (60,000 texels, 4,160 images), `noise` (what compression does to that of few samples), `eevee` (against Cycles, on
what `pictures` baked). The meshes are those beside the project, in ../shared/data, but for the tree of the demo. FLIP wants the environment
of scripts/peers.py. With --work a run that was stopped goes on.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

import environment

environment.ensure()

from btf_bakes import Effort, built_cloud, cloud_folder
from btf_costs import EXECUTORS, memory, times
from btf_models import DATA, MODELS
from btf_noise import noise
from btf_pictures import RELIGHTABLE, SIZES, pictures

import command_line
from farfield.addon.core.progress import Progress, Steps, finish, scaled

EEVEE_SECONDS = 1800.0  # the first picture waits for shaders


def parser() -> command_line.Parser:
    """All arguments of the benchmark."""
    made = command_line.Parser(prog="btf.py", description="Measure relightable textures.")
    made.add_argument("--only", nargs="+", choices=list(PARTS), default=list(PARTS), help="the parts to measure (default: all)")
    made.add_argument("--models", nargs="+", choices=list(MODELS), default=list(MODELS), help="what to measure on (default: all)")
    made.add_argument("--data", type=Path, default=DATA, help="the folder of the meshes (default: ../shared/data beside the project)")
    made.add_argument(
        "--work", type=Path, help="a folder for clouds and finished views, so that a stopped run goes on (default: none kept)"
    )
    made.add_argument("--sheets", type=Path, help="a folder for contact sheets")
    made.add_argument("--report", type=Path, help="a JSON file for the figures")
    made.add_argument("--no-lpca", dest="lpca", action="store_false", help="leave out the other codec, which takes longest to compress")
    made.add_argument("--error", default="2%", help="error of the clouds (default: 2%%)")
    made.add_argument("--sizes", nargs="+", choices=list(SIZES), default=list(SIZES), help="sizes of the pictures (default: all)")
    made.add_argument("--executors", nargs="+", choices=list(EXECUTORS), default=list(EXECUTORS), help="those to time (default: all)")
    for name, default, what in (
        ("views", 64, "views of a bake"),
        ("lights", 64, "lights of a bake, without the dome"),
        ("capture-samples", 4, "Cycles samples of a bake"),
        ("pairs", 24, "held-out pairs of view and sun"),
        ("samples", 64, "Cycles samples of the pictures that are compared"),
        ("reference-samples", 256, "Cycles samples of the original in them"),
        ("repeats", 1, "runs of each executor in the part time"),
    ):
        made.add_argument(f"--{name}", type=int, default=default, help=f"{what} (default: {default})")
    return made


def main(arguments: list[str], line: command_line.ProgressLine) -> None:
    """Measure, and print one JSON object; raises FarfieldError when the meshes are not there or a bake is refused."""
    given = vars(parser().parse_args(arguments))
    parts, report, work = given.pop("only"), given.pop("report"), given.pop("work")
    figures = {}
    with tempfile.TemporaryDirectory(prefix="farfield-benchmark-") as folder:
        effort = Effort(**given, work=Path(folder) if work is None else work.absolute())
        for number, part in enumerate(parts):
            figures[part] = finish(scaled(PARTS[part](effort), number / len(parts), (number + 1) / len(parts)), line.show)
    line.clear()
    print(json.dumps(figures, indent=2))
    if report is not None:
        command_line.write_report(report.absolute(), figures)


def eevee(effort: Effort) -> Steps[dict[str, Any]]:
    """EEVEE against Cycles, in a process of its own: without OpenGL or Vulkan, Blender ends it."""
    figures = {}
    for number, name in enumerate(effort.models):
        yield Progress(number / len(effort.models), f"Drawing {name} with EEVEE and Cycles")
        figures[name] = _eevee_figures(name, effort)
    return figures


def _eevee_figures(name: str, effort: Effort) -> dict[str, Any]:
    relit = cloud_folder(name, effort, effort.error) / RELIGHTABLE
    if not relit.exists():
        return _left_out(name, "there is no relightable cloud yet; measure the part pictures first, with the same --work.")
    report = relit.with_name("eevee.json")
    report.unlink(missing_ok=True)
    script = Path(__file__).with_name("btf_eevee.py")
    command = [sys.executable, str(script), str(relit), "--report", str(report)]
    command += ["--upper-hemisphere"] if built_cloud(name, effort, effort.error).upper else []
    if effort.sheets is not None:
        effort.sheets.mkdir(parents=True, exist_ok=True)
        command += ["--sheet", str(effort.sheets / f"{name} eevee.png")]
    try:
        subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=EEVEE_SECONDS, check=True)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        return _left_out(name, f"EEVEE does not draw here: {error}")
    return json.loads(report.read_text(encoding="utf-8"))


def _left_out(name: str, words: str) -> dict[str, Any]:
    print(f"{name}: left out. {words}", file=sys.stderr)
    return {"left_out": words}


PARTS: dict[str, Callable[[Effort], Steps[dict[str, Any]]]] = {
    "pictures": pictures,
    "time": times,
    "memory": memory,
    "noise": noise,
    "eevee": eevee,
}

if __name__ == "__main__":
    command_line.run(main)
