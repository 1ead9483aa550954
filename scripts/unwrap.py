"""Unwrap the meshes of a file: `python3 scripts/unwrap.py INPUT --out OUT.blend [flags]`.

INPUT is a .blend, .obj, .ply, .stl, .glb, .gltf, .fbx or .usd file. Each mesh that is visible in renders gets its own UV map, and its own
texture unless `--combine-selected` packs all into one. The extension of --out selects the output: .blend (the whole scene), .obj or .glb
(all objects). `--direction` without `--importance` implies `--importance direction`.
`blender --background --python scripts/unwrap.py -- INPUT --out OUT` does the same.
"""

import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from lib import environment

environment.ensure(exits_on_signals=True)
environment.import_farfield()

import bpy

from farfield.addon.bridge.unwrap.stretch_display import save_stretch_image
from farfield.addon.core.jobs.progress import StageClock, run_to_end
from farfield.addon.core.messages import join_sentences
from farfield.addon.core.settings import add_flags
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.unwrap.job import UnwrapJob, prepare
from lib import command_line, run_files, scene_files
from lib.atomic_output import atomic_file
from lib.script_stdout import mute_stderr

EXTENSIONS = (".blend", ".obj", ".glb")
STRETCH_IMAGE_RESOLUTION = 2048  # pixels per side


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the script."""
    parser = command_line.Parser(
        prog="unwrap.py", description="Create low-stretch UV maps with more texels in important areas for the meshes of a file."
    )
    parser.add_argument("input", type=run_files.INPUT, help="a .blend .obj .ply .stl .glb .gltf .fbx or .usd file")
    parser.add_argument(
        "--out", type=run_files.OUTPUT_SCENE.ending_in(*EXTENSIONS), required=True, help="the file to write: .blend, .obj or .glb"
    )
    parser.add_argument("--report", type=run_files.REPORT, help="write a report of the run to this JSON file")
    parser.add_argument(
        "--image", type=run_files.OUTPUT.ending_in(".png"), help="write the UV map of the first mesh, colored by stretch, to this PNG file"
    )
    add_flags(parser, UnwrapSettings)
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the script and return the summary; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    if given.direction is not None and given.importance is None:
        given.importance = "direction"
    settings = command_line.read_settings(given, UnwrapSettings)[UnwrapSettings]
    out = given.out.absolute()
    clock = StageClock()
    with clock.stage("read"):
        moved = scene_files.describe_moved(scene_files.open_near_origin(given.input.absolute(), given.files))
        scene_files.objects_in_renders(given.input, scene_files.is_mesh)
        shapes = scene_files.find_bone_shapes()
        job = prepare(bpy.context, [item for item in bpy.context.scene.objects if not item.hide_render and item not in shapes], settings)
    job.skipped.extend(scene_files.describe_missing())
    for reason in job.skipped:
        command_line.print_message(f"Skipped: {reason}.")
    summary = run_to_end(run_job(job), line.show)
    line.clear()
    with clock.stage("write"):
        lacking = write_output(out)
        if given.image is not None:
            first_target, _ = job.results[0]
            with atomic_file(given.image.absolute()) as temporary:
                save_stretch_image(bpy.data.objects[first_target.object_name], temporary, STRETCH_IMAGE_RESOLUTION)
    if given.report is not None:
        command_line.write_report(given.report.absolute(), build_report(job, clock))
    return join_sentences([summary, moved, lacking])


def write_output(out: Path) -> str:
    """Write the scene, or all its meshes, depending on the extension of `out`. Return a sentence about what it lacks, or nothing."""
    extension = out.suffix.lower()
    if extension == ".blend":
        scene_files.save_scene(out)
        return ""
    with atomic_file(out) as temporary, mute_stderr():  # the exporters print the tracebacks of errors that they also raise
        if extension == ".obj":
            scene_files.save_obj(temporary)
        else:
            bpy.ops.export_scene.gltf(filepath=str(temporary), export_format="GLB", export_apply=False)
    meshes = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    lacking = ["materials"] if extension == ".obj" and any(item.data.materials for item in meshes) else []
    lacking += ["the effect of modifiers"] if any(modifier.show_render for item in meshes for modifier in item.modifiers) else []
    return f"The {extension} lacks {' and '.join(lacking)}." if lacking else ""


def build_report(job: UnwrapJob, clock: StageClock) -> dict[str, Any]:
    """Return the report of the run: the metrics of the mesh with the most triangles, and of every mesh."""
    seconds = dict(clock.seconds)
    objects = []
    for target, result in job.results:
        metrics = replace_infinite(asdict(result.metrics))
        objects.append({"name": target.object_name, "triangles": len(target.loops), **result.counts, **metrics})
        for stage, duration in result.seconds.items():
            seconds[stage] = seconds.get(stage, 0.0) + duration
    largest = max(objects, key=lambda figures: figures["triangles"])
    return {
        **{key: figure for key, figure in largest.items() if key != "name"},
        "objects": objects,
        "skipped": job.skipped,
        "seconds": {stage: round(duration, 4) for stage, duration in seconds.items()},
        "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
    }


def replace_infinite(figures: dict[str, Any]) -> dict[str, Any]:
    """Return `figures` with None for infinite stretch, which JSON cannot store."""
    return {name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in figures.items()}


if __name__ == "__main__":
    command_line.run(main)
