"""Cost and quality of relightable textures: `python3 benchmarks/bench_btf.py [--only PART ...] [--models MODEL ...] [--work DIR]
[--sheets DIR] [--report R.json]`.

Prints JSON. Parts: `images` (scores relative to the source, also of PBR maps, an octahedral impostor of the same size in bytes, and a
decimated mesh with the same number of triangles, at the switch distance and half of it; compression, also with Local PCA), `time` (bakes
relative to Cycles alone, and executors), `memory` (60,000 texels, 4,160 renders), `noise` (effect of the compression on the noise of few
samples), `eevee` (relative to Cycles, for `images`). The meshes are in ../shared/data, next to the project, except for the tree
of the demo. FLIP needs the environment of scripts/reference_tools.py. With --work a cancelled run resumes.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

from btf_bakes import BenchmarkOptions, build_cloud, cloud_folder
from btf_costs import EXECUTORS, measure_memory, measure_times
from btf_images import RELIGHTABLE, SIZES, compare_images
from btf_models import DATA, MODELS
from btf_noise import measure_noise

from farfield.addon.core.jobs.progress import Progress, Steps, run_to_end, subprogress
from lib import command_line

EEVEE_SECONDS = 1800.0  # the first render includes shader compilation


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = command_line.Parser(prog="bench_btf.py", description="Measure relightable textures.")
    parser.add_argument("--only", nargs="+", choices=list(PARTS), default=list(PARTS), help="the parts to measure (default: all)")
    parser.add_argument("--models", nargs="+", choices=list(MODELS), default=list(MODELS), help="the models to measure (default: all)")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the meshes (default: ../shared/data next to the project)")
    parser.add_argument(
        "--work", type=Path, help="folder for clouds and finished views, so that a cancelled run can resume (default: none)"
    )
    parser.add_argument("--sheets", type=Path, help="folder for contact sheets")
    parser.add_argument("--report", type=Path, help="write the measurements to this JSON file")
    parser.add_argument("--no-lpca", dest="lpca", action="store_false", help="skip Local PCA, which takes longest to compress")
    parser.add_argument("--error", default="2%", help="error of the clouds (default: 2%%)")
    parser.add_argument("--sizes", nargs="+", choices=list(SIZES), default=list(SIZES), help="sizes of the compared renders (default: all)")
    parser.add_argument("--executors", nargs="+", choices=list(EXECUTORS), default=list(EXECUTORS), help="executors to time (default: all)")
    for name, default, what in (
        ("views-per-side", 8, "view directions along each side of their grid"),
        ("lights-per-side", 8, "light directions along each side of their grid"),
        ("capture-samples", 4, "Cycles samples of a bake"),
        ("pairs", 24, "held-out pairs of view and Sun"),
        ("samples", 64, "Cycles samples of the compared renders"),
        ("reference-samples", 256, "Cycles samples of the source in them"),
        ("repeats", 1, "bakes per executor in the part `time`"),
    ):
        parser.add_argument(f"--{name}", type=int, default=default, help=f"{what} (default: {default})")
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the benchmark and return its measurements as JSON; raises FarfieldError if a mesh is missing or a bake fails."""
    values = vars(build_parser().parse_args(arguments))
    parts, report, work, _ = (values.pop(name) for name in ("only", "report", "work", "files"))
    figures = {}
    with tempfile.TemporaryDirectory(prefix="farfield-benchmark-") as folder:
        options = BenchmarkOptions(**values, work=Path(folder) if work is None else work.absolute())
        for index, part in enumerate(parts):
            figures[part] = run_to_end(subprogress(PARTS[part](options), index / len(parts), (index + 1) / len(parts)), line.show)
    line.clear()
    if report is not None:
        command_line.write_report(report.absolute(), figures)
    return json.dumps(figures, indent=2)


def compare_eevee(options: BenchmarkOptions) -> Steps[dict[str, Any]]:
    """Compare EEVEE with Cycles in a separate process, which Blender aborts without OpenGL or Vulkan."""
    figures = {}
    for index, name in enumerate(options.models):
        yield Progress(index / len(options.models), f"Rendering {name} with EEVEE and Cycles")
        figures[name] = _eevee_figures(name, options)
    return figures


def _eevee_figures(name: str, options: BenchmarkOptions) -> dict[str, Any]:
    relit = cloud_folder(name, options, options.error) / RELIGHTABLE
    if not relit.exists():
        return _skip(name, "there is no relightable cloud yet; run the part `images` first, with the same --work.")
    report = relit.with_name("eevee.json")
    report.unlink(missing_ok=True)
    script = Path(__file__).with_name("bench_btf_eevee.py")
    command = [sys.executable, str(script), str(relit), "--report", str(report)]
    command += ["--upper-hemisphere"] if build_cloud(name, options, options.error).upper else []
    if options.sheets is not None:
        options.sheets.mkdir(parents=True, exist_ok=True)
        command += ["--sheet", str(options.sheets / f"{name} eevee.png")]
    try:
        subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=EEVEE_SECONDS, check=True)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        return _skip(name, f"EEVEE cannot render here: {error}")
    return json.loads(report.read_text(encoding="utf-8"))


def _skip(name: str, reason: str) -> dict[str, Any]:
    print(f"{name}: skipped. {reason}", file=sys.stderr)
    return {"skipped": reason}


PARTS: dict[str, Callable[[BenchmarkOptions], Steps[dict[str, Any]]]] = {
    "images": compare_images,
    "time": measure_times,
    "memory": measure_memory,
    "noise": measure_noise,
    "eevee": compare_eevee,
}

if __name__ == "__main__":
    command_line.run(main)
