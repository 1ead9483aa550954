"""Build a billboard cloud from a file: `python3 scripts/billboards.py INPUT --out OUT.blend [flags]`.

INPUT is a .blend, .obj, .ply, .stl, .glb, .gltf, .fbx or .usd file; a .ply may be a point cloud. All objects that are visible in renders,
or those of --collection, become one cloud. The extension of --out selects the output: .blend (the whole scene with the cloud), .obj or .glb
(the cloud's levels with their textures). `blender --background --python scripts/billboards.py -- INPUT --out OUT` does the same.
"""

import math
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from lib import environment

environment.ensure(exits_on_signals=True)
environment.import_farfield()

import bpy

from farfield.addon.bridge.billboards.exports import write_glb, write_obj
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud, read_cloud
from farfield.addon.bridge.cameras import read_scene_camera
from farfield.addon.bridge.geometry.meshes import may_have_surface
from farfield.addon.core.billboards.cloud import Level
from farfield.addon.core.billboards.settings import BillboardSettings, BuildOptions, CrossfadeSettings
from farfield.addon.core.errors import FileError, GeometryError
from farfield.addon.core.files.filenames import material_path
from farfield.addon.core.files.outputs import Output, check_outputs, is_named_by
from farfield.addon.core.jobs.progress import StageClock, run_to_end
from farfield.addon.core.messages import join_sentences
from farfield.addon.core.settings import add_flags
from farfield.addon.operators.billboards.job import BillboardJob, prepare_job
from farfield.addon.operators.job_run import run_job
from lib import command_line, run_files, scene_files
from lib.atomic_output import atomic_folder
from lib.run_files import obj_materials

EXTENSIONS = (".blend", ".obj", ".glb")


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the script."""
    parser = command_line.Parser(prog="billboards.py", description="Build a billboard cloud: a few textured triangles that replace a mesh.")
    parser.add_argument(
        "input", type=run_files.INPUT, help="a .blend .obj .ply .stl .glb .gltf .fbx or .usd file; a .ply may be a point cloud"
    )
    parser.add_argument(
        "--out", type=run_files.OUTPUT_SCENE.ending_in(*EXTENSIONS), required=True, help="the file to write: .blend, .obj or .glb"
    )
    parser.add_argument("--collection", metavar="NAME", help="use only the objects of this collection, and of those inside it")
    parser.add_argument("--report", type=run_files.REPORT, help="write a report of the run to this JSON file")
    add_flags(parser, BillboardSettings)
    add_flags(parser, BuildOptions, ["keep_original_visible"])
    parser.add_argument("--cross-fade", action="store_true", help="cross-fade the levels and the source for the file's active camera")
    add_flags(parser, CrossfadeSettings)
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the script and return the summary; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    settings = command_line.read_settings(given, BillboardSettings, BuildOptions, CrossfadeSettings)
    out = given.out.absolute()
    if given.cross_fade and out.suffix.lower() != ".blend":
        raise FileError(f'--cross-fade needs shader nodes, which "{given.out}" cannot store; --out must end in .blend.')
    given.files.check(obj_materials(out, material_path(out)))
    clock = StageClock()
    with clock.stage("read"):
        moved = scene_files.describe_moved(scene_files.open_near_origin(given.input.absolute(), given.files))
        if given.cross_fade and read_scene_camera(bpy.context.scene) is None:
            raise GeometryError("--cross-fade needs an active camera, and the file has none; add a camera, or omit --cross-fade.")
        options = replace(settings[BuildOptions], combine_selected=True)
        job = prepare_input(given.input, settings[BillboardSettings], options, given.collection)
    for reason in job.skipped:
        command_line.print_message(f"Skipped: {reason}.")
    summary = run_to_end(run_job(job), line.show)
    line.clear()
    with clock.stage("write"):
        for cloud in read_built_clouds(job) if given.cross_fade else []:
            cloud.add_crossfade(bpy.context, settings[CrossfadeSettings].fade_range)
        lacking = write_output(out, job)
    if given.report is not None:
        command_line.write_report(given.report.absolute(), build_report(job, clock))
    return join_sentences([summary, moved, *lacking])


def prepare_input(path: Path | None, settings: BillboardSettings, options: BuildOptions, collection: str | None = None) -> BillboardJob:
    """Return the job for all objects of the open scene, read from `path` if it is given, that are visible in renders; only for those of
    the collection named `collection` if that is given. A cloud of several objects has the name of the collection or of the file.

    Raises:
        GeometryError: there are none, or no cloud can be built from any of them.
        FileError: an image file of a material is missing.
    """
    scene = bpy.context.scene.collection
    members = set((scene if collection is None else _find_collection(scene, collection)).all_objects)
    candidates = [item for item in members if may_have_surface(item)]
    if collection is not None and not candidates:
        raise GeometryError(f'No object in the collection "{collection}" has a surface; name another one after --collection.')
    objects = scene_files.objects_in_renders(path, lambda item: item in members and may_have_surface(item))
    job = prepare_job(bpy.context, objects, settings, options, collection or (path.stem if path is not None else ""))
    job.skipped.extend(scene_files.describe_missing())
    job.skipped.extend(sorted(f"{item.name} (disabled in renders)" for item in candidates if item.hide_render))
    return job


def _find_collection(scene: bpy.types.Collection, name: str) -> bpy.types.Collection:
    """Return the collection called `name` within that of the scene. Raises GeometryError if there is none."""
    found = {item.name: item for item in scene.children_recursive}
    if name not in found:
        listed = f"it has {', '.join(found)}" if found else "it has none"
        raise GeometryError(f'The scene has no collection "{name}"; {listed}. Correct --collection.')
    return found[name]


def write_output(out: Path, job: BillboardJob) -> list[str]:
    """Write the scene, or only the levels, depending on the extension of `out`. Return sentences about what it lacks."""
    extension = out.suffix.lower()
    if extension == ".blend":
        scene_files.save_scene(out)
        return []
    levels = [level for cloud in read_built_clouds(job) for level in cloud.levels]
    with atomic_folder(out.parent) as folder:
        if extension == ".obj":
            write_obj(levels, folder / out.name)
            is_ours = partial(is_named_by, material_path(out))
            check_outputs([Output("an image of --out", out.with_name(path.name), is_ours=is_ours) for path in folder.glob("*.png")], [])
            return []
        return write_glb(levels, folder / out.name)


def read_built_clouds(job: BillboardJob) -> list[SceneCloud]:
    """Return the clouds in the scene that `job` built."""
    return [read_cloud(bpy.data.collections[name]) for name, _ in job.built_clouds]


def build_report(job: BillboardJob, clock: StageClock) -> dict[str, Any]:
    """Return the report of the run; several clouds are summed per level. Lengths are in scene units."""
    clouds = [cloud for _, cloud in job.built_clouds]
    level_objects = [cloud.levels for cloud in read_built_clouds(job)]
    levels = [
        build_level_report([cloud.levels[index] for cloud in clouds], [objects[index] for objects in level_objects])
        for index in range(len(level_objects[0]))
    ]
    for index, level in enumerate(levels):
        found = next((item for item in job.comparisons[0] if item.level == index), None) if len(clouds) == 1 else None
        differences = (None, None) if found is None else (found.cloud.visible, None if found.decimate is None else found.decimate.visible)
        for key, value in zip(("visible_difference", "decimate_visible_difference"), differences, strict=True):
            level[key] = None if value is None else round(value, 4)
    seconds = dict(clock.seconds)
    for stages in (*(cloud.seconds for cloud in clouds), job.seconds):
        for stage, duration in stages.items():
            seconds[stage] = seconds.get(stage, 0.0) + duration
    return {
        "source_triangles": sum(cloud.source_triangles for cloud in clouds),
        "dropped_triangles": sum(cloud.dropped_triangles for cloud in clouds),
        **{key: levels[0][key] for key in ("triangles", "mesh_triangles", "quads", "texels")},
        "levels": levels,
        "max_plane_distance": max(cloud.max_plane_distance for cloud in clouds),
        "faces_beyond_normal_bound": sum(cloud.faces_beyond_normal_bound for cloud in clouds),
        "uncovered_faces": sum(cloud.uncovered_faces for cloud in clouds),
        "notes": [note for cloud in clouds for note in cloud.notes],
        "skipped": job.skipped,
        "seconds": {stage: round(duration, 4) for stage, duration in seconds.items()},
        "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
    }


def build_level_report(levels: list[Level], objects: list[bpy.types.Object]) -> dict[str, Any]:
    """Return the report of one level of all clouds. switch_distance is null for an orthographic camera that always shows the error."""
    distance = max(item["farfield_switch_distance"] for item in objects)
    return {
        "error": max(level.error for level in levels),
        "triangles": sum(level.triangle_count for level in levels),
        "mesh_triangles": sum(level.chart_triangle_count for level in levels),
        "quads": sum(len(level.quads) for level in levels),
        "texels": sum(level.texel_count for level in levels),
        "atlas_use": round(sum(level.texel_count for level in levels) / sum(math.prod(level.atlas.size) for level in levels), 4),
        "switch_distance": distance if math.isfinite(distance) else None,
    }


if __name__ == "__main__":
    command_line.run(main)
