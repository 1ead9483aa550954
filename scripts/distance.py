"""Make a scene ready for any distance: `python3 scripts/distance.py INPUT --out OUT.blend [flags]`.

INPUT is a .blend, .obj, .ply, .stl, .glb, .gltf, .fbx or .usd file; all its objects that are visible in renders, instances included, show
levels of detail by their distance to the active camera. `blender --background --python scripts/distance.py -- INPUT --out OUT.blend` does
the same.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from lib import environment

environment.ensure(exits_on_signals=True)
environment.import_farfield()

import bpy

from farfield.addon.bridge.distance.assets import visible_objects
from farfield.addon.core.distance.settings import DistanceSettings
from farfield.addon.core.jobs.progress import StageClock, run_to_end
from farfield.addon.core.messages import join_sentences
from farfield.addon.core.settings import add_flags
from farfield.addon.operators.distance.job import describe_chain, prepare
from farfield.addon.operators.job_run import run_job
from lib import command_line, run_files, scene_files


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the script."""
    parser = command_line.Parser(
        prog="distance.py", description="Show levels of detail by distance to the camera at all places of a scene."
    )
    parser.add_argument("input", type=run_files.INPUT, help="a .blend .obj .ply .stl .glb .gltf .fbx or .usd file")
    parser.add_argument("--out", type=run_files.OUTPUT_SCENE.ending_in(".blend"), required=True, help="the .blend file to write")
    parser.add_argument("--report", type=run_files.REPORT, help="write a report of the run to this JSON file")
    add_flags(parser, DistanceSettings)
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the script and return the summary; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    settings = command_line.read_settings(given, DistanceSettings)[DistanceSettings]
    clock = StageClock()
    with clock.stage("read"):
        moved = scene_files.describe_moved(scene_files.open_near_origin(given.input.absolute(), given.files))
        shapes = scene_files.find_bone_shapes()
        objects = [item for item in visible_objects(bpy.context.scene, bpy.context.view_layer, ()) if item not in shapes]
        job = prepare(bpy.context.scene, objects, settings)
        job.skipped.extend(scene_files.describe_missing())
    with clock.stage("levels"):
        summary = run_to_end(run_job(job), line.show)
    line.clear()
    with clock.stage("write"):
        scene_files.save_scene(given.out.absolute())
    if given.report is not None:
        report = {
            "objects": [describe_chain(*item) for item in job.chains],
            "skipped": job.skipped,
            "seconds": {stage: round(duration, 4) for stage, duration in clock.seconds.items()},
            "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
        }
        command_line.write_report(given.report.absolute(), report)
    return join_sentences([summary, moved])


if __name__ == "__main__":
    command_line.run(main)
