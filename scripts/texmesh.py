"""Perceptual levels of textured meshes: `python3 scripts/texmesh.py levels INPUT --out OUT [flags]`, and `analyze INPUT`.

INPUT is a .blend, .obj, .ply, .stl, .glb, .gltf, .fbx or .usd file; each mesh that is visible in renders gets levels. The extension of
--out selects the output: .blend (the whole scene with the levels), or .glb (one file per level, OUT-L0.glb and so on; with --one-file a
single one). `--number`, `--max-triangles`, `--max-size`, `--max-pixels` or `--ratios` without `--levels` imply it.
`analyze` finds the features of the meshes at 21 scales, for --report and --plot.
`blender --background --python scripts/texmesh.py -- levels INPUT --out OUT` does the same.
"""

import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from lib import environment

environment.ensure(exits_on_signals=True)
environment.import_farfield()

import bpy

from farfield.addon.bridge.overlays.line_chart import draw_line_chart
from farfield.addon.bridge.texmesh.glb_levels import level_outputs, write_levels
from farfield.addon.bridge.texmesh.level_sets import read_level_set
from farfield.addon.core.jobs.progress import StageClock, run_to_end
from farfield.addon.core.messages import join_sentences
from farfield.addon.core.settings import add_flags
from farfield.addon.core.texmesh.scale_space.features import ScaleMap
from farfield.addon.core.texmesh.settings import AnalysisSettings, ExportSettings, SceneSettings, TexmeshSettings
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.texmesh.job import AnalysisJob, LevelsJob, describe_chain, prepare_analysis, prepare_levels
from lib import command_line, run_files, scene_files
from lib.atomic_output import atomic_file
from lib.contact_sheet import write_png
from lib.script_stdout import mute_stderr
from lib.texmesh_inputs import add_answers_flag, open_objects, read_level_settings

EXTENSIONS = (".blend", ".glb")


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the script."""
    parser = command_line.Parser(prog="texmesh.py", description="Make levels of detail of textured meshes that look the same.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="levels|analyze")
    levels = commands.add_parser("levels", description="Make levels of detail.")
    analyze = commands.add_parser("analyze", description="Find the features of meshes at 21 scales.")
    for command in (levels, analyze):
        command.add_argument("input", type=run_files.INPUT, help="a .blend .obj .ply .stl .glb .gltf .fbx or .usd file")
        command.add_argument("--report", type=run_files.REPORT, help="write a report of the run to this JSON file")
    levels.add_argument(
        "--out", type=run_files.OUTPUT_SCENE.ending_in(*EXTENSIONS), required=True, help="the file to write: .blend or .glb"
    )
    add_answers_flag(levels)
    analyze.add_argument(
        "--plot", type=run_files.OUTPUT.ending_in(".png"), help="draw features and ranges of the largest mesh to this PNG file"
    )
    for settings_type in (TexmeshSettings, SceneSettings, ExportSettings):
        add_flags(levels, settings_type)
    add_flags(analyze, AnalysisSettings)
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the script and return the summary; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    return analyze(given, line) if given.command == "analyze" else make_levels(given, line)


def make_levels(given: Namespace, line: command_line.ProgressLine) -> str:
    """Make levels and write them."""
    settings, others = read_level_settings(given), command_line.read_settings(given, SceneSettings, ExportSettings)
    out = given.out.absolute()
    if out.suffix.lower() == ".glb" and not others[ExportSettings].one_file:
        given.files.check(level_outputs(out, [output.path.absolute() for output in given.files.outputs]))
    clock = StageClock()
    with clock.stage("read"):
        objects, moved = open_objects(given)
        job = prepare_levels(bpy.context, objects, settings, others[SceneSettings])
        job.skipped.extend(scene_files.describe_missing())
    with clock.stage("levels"):
        summary = run_to_end(run_job(job), line.show)
    line.clear()
    with clock.stage("write"):
        sentences = write_output(job, out, others[ExportSettings])
    write_report(given, [{"name": name, **describe_chain(chain)} for name, chain in named_chains(job)], job.skipped, clock)
    return join_sentences([summary, moved, *sentences])


def analyze(given: Namespace, line: command_line.ProgressLine) -> str:
    """Find features, and write report and plot."""
    settings = command_line.read_settings(given, AnalysisSettings)[AnalysisSettings]
    clock = StageClock()
    with clock.stage("read"):
        objects, moved = open_objects(given)
        job = prepare_analysis(bpy.context, objects, settings)
        job.skipped.extend(scene_files.describe_missing())
    with clock.stage("analyze"):
        summary = run_to_end(run_job(job), line.show)
    line.clear()
    if given.plot is not None:
        write_plot(job, given.plot.absolute())
    write_report(given, [describe_map(name, scale_map) for name, scale_map in job.results], job.skipped, clock)
    return join_sentences([summary, moved])


def write_output(job: LevelsJob, out: Path, settings: ExportSettings) -> list[str]:
    """Write the scene, or the levels as .glb, depending on the extension of `out`. Return sentences about the output."""
    if out.suffix.lower() == ".blend":
        scene_files.save_scene(out)
        return []
    with mute_stderr():  # libraries print about damaged images, which a sentence names
        _, sentences = write_levels([read_level_set(bpy.data.collections[name]) for name in job.chains], out, settings)
    return sentences


def named_chains(job: LevelsJob) -> list[tuple[str, Any]]:
    """Return the names of the objects and their levels."""
    return [(placement.label, chain) for (_, placement), chain in zip(job.placed, job.chains.values(), strict=True)]


def describe_map(name: str, scale_map: ScaleMap) -> dict[str, Any]:
    """Return the figures of one analyzed mesh."""
    return {
        "name": name,
        "vertices": len(scale_map.last_scales),
        "features": [int(count) for count in scale_map.counts],
        "sigmas": [float(sigma) for sigma in scale_map.sigmas],
        "ranges": [float(value) for value in scale_map.ranges],
        "losses": scale_map.losses,
    }


def write_plot(job: AnalysisJob, path: Path) -> None:
    """Draw the features and the ranges (Figure 10) of the mesh with the most vertices."""
    name, scale_map = max(job.results, key=lambda result: len(result[1].last_scales))
    counts = [(float(scale), float(count / scale_map.counts[0])) for scale, count in enumerate(scale_map.counts)]
    ranges = [(float(scale), float(value)) for scale, value in enumerate(scale_map.ranges)]
    chart = draw_line_chart(name, "scale", {"features / vertices": counts, "relative range": ranges})
    with atomic_file(path) as temporary:
        write_png(temporary, chart)


def write_report(given: Namespace, objects: list[dict[str, Any]], skipped: list[str], clock: StageClock) -> None:
    """Write the report of the run, if it is wanted."""
    if given.report is None:
        return
    report = {
        "objects": objects,
        "skipped": skipped,
        "seconds": {stage: round(duration, 4) for stage, duration in clock.seconds.items()},
        "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
    }
    command_line.write_report(given.report.absolute(), report)


if __name__ == "__main__":
    command_line.run(main)
