"""Make a billboard cloud of a file: `python3 scripts/billboards.py INPUT --out OUT.blend [flags]`.

INPUT is .blend .obj .ply .stl .glb .gltf .fbx .usd, or a .ply point cloud; all its visible objects become one cloud. The ending of --out
chooses what is written: .blend (the whole scene and the cloud), .obj or .glb (the cloud's levels with their textures).
`blender --background --python scripts/billboards.py -- INPUT --out OUT` does the same.
"""

import math
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

import environment

environment.ensure()

import bpy

import command_line
import scene_files
from farfield.addon.bridge.cameras import scene_camera
from farfield.addon.bridge.exports import write_glb, write_obj
from farfield.addon.core.billboards.cloud import Level
from farfield.addon.core.billboards.settings import BillboardSettings, FadeSettings
from farfield.addon.core.errors import FileError, GeometryError
from farfield.addon.core.progress import StageClock, finish
from farfield.addon.core.settings import add_flags, describe, from_flags
from farfield.addon.operators.billboards_clouds import StandingCloud, cloud_of
from farfield.addon.operators.billboards_job import BillboardJob, BuildOptions, may_have_surface, prepare
from farfield.addon.operators.long_work import whole
from whole_files import check_writable, quiet_operators, whole_folder

ENDINGS = (".blend", ".obj", ".glb")


def parser() -> command_line.Parser:
    """All arguments of the script."""
    made = command_line.Parser(prog="billboards.py", description="Make a billboard cloud: few textured quads for a mesh, in levels.")
    made.add_argument("input", type=Path, help="a .blend .obj .ply .stl .glb .gltf .fbx or .usd file; a .ply may be a point cloud")
    made.add_argument("--out", type=Path, required=True, help="the file to write: .blend, .obj or .glb")
    made.add_argument("--report", type=Path, help="a JSON file for the figures of the run")
    add_flags(made, BillboardSettings)
    hide = next(item for item in describe(BuildOptions) if item.name == "hide_source_from_render")
    made.add_argument(hide.flag, action="store_true", help=hide.help)
    made.add_argument("--cross-fade", action="store_true", help="let original and levels fade into each other for the file's camera")
    add_flags(made, FadeSettings)
    return made


def main(arguments: list[str], line: command_line.ProgressLine) -> None:
    """Run the script; raises FarfieldError when the input is bad."""
    given = parser().parse_args(arguments)
    settings, fading = from_flags(BillboardSettings, given), from_flags(FadeSettings, given)
    out = given.out.absolute()
    if out.suffix.lower() not in ENDINGS:
        raise FileError(f'--out is "{given.out}"; it must end in one of {", ".join(ENDINGS)}.')
    if given.cross_fade and out.suffix.lower() != ".blend":
        raise FileError(f'--cross-fade needs nodes, which "{given.out}" cannot hold; let --out end in .blend.')
    check_writable(out, given.report)
    clock = StageClock()
    with clock.stage("read"):
        scene_files.open_scene(given.input.absolute())
        if given.cross_fade and scene_camera(bpy.context.scene) is None:
            raise GeometryError("The file has no camera to fade for; add one, or leave out --cross-fade.")
        job = prepare_input(settings, BuildOptions(together=True, hide_source_from_render=given.hide_source_from_render))
    for reason in job.skipped:
        print(f"Skipped: {reason}.", file=sys.stderr)
    finish(whole(job), line.show)
    line.clear()
    with clock.stage("write"):
        for cloud in standing(job) if given.cross_fade else []:
            cloud.fade(bpy.context, fading.fade_range)
        write(out, job)
    if given.report is not None:
        command_line.write_report(given.report.absolute(), report(job, clock))


def prepare_input(settings: BillboardSettings, options: BuildOptions) -> BillboardJob:
    """The job for all objects of the open scene that would show in a render."""
    candidates = [item for item in bpy.context.scene.objects if may_have_surface(item)]
    shown = [item for item in candidates if not item.hide_render]
    job = prepare(bpy.context, shown, settings, options)
    job.skipped.extend(f"{item.name} (disabled in renders)" for item in candidates if item.hide_render)
    return job


def write(out: Path, job: BillboardJob) -> None:
    """Write the scene, or the levels alone, by the ending of `out`."""
    ending = out.suffix.lower()
    if ending == ".blend":
        scene_files.save_scene(out)
        return
    levels = [level for cloud in standing(job) for level in cloud.levels]
    with whole_folder(out.parent) as folder, quiet_operators():
        if ending == ".obj":
            write_obj(levels, folder / out.name)
        else:
            write_glb(levels, folder / out.name)


def standing(job: BillboardJob) -> list[StandingCloud]:
    """The clouds in the scene that `job` made."""
    return [cloud_of(bpy.data.collections[name]) for name, _ in job.made]


def report(job: BillboardJob, clock: StageClock) -> dict[str, Any]:
    """The figures of the run; several clouds are summed level by level. Lengths are in scene units."""
    clouds = [cloud for _, cloud in job.made]
    objects = [cloud.levels for cloud in standing(job)]
    levels = [
        level_report([cloud.levels[index] for cloud in clouds], [found[index] for found in objects]) for index in range(len(objects[0]))
    ]
    seconds = dict(clock.seconds)
    for stages in (*(cloud.seconds for cloud in clouds), job.seconds):
        for stage, taken in stages.items():
            seconds[stage] = seconds.get(stage, 0.0) + taken
    return {
        "source_triangles": sum(cloud.source_triangles for cloud in clouds),
        "dropped_triangles": sum(cloud.dropped_triangles for cloud in clouds),
        "quads": levels[0]["quads"],
        "texels": levels[0]["texels"],
        "levels": levels,
        "max_plane_distance": max(cloud.max_plane_distance for cloud in clouds),
        "faces_beyond_normal_bound": sum(cloud.faces_beyond_normal_bound for cloud in clouds),
        "uncovered_faces": sum(cloud.uncovered_faces for cloud in clouds),
        "skipped": job.skipped,
        "seconds": {stage: round(taken, 4) for stage, taken in seconds.items()},
        "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
    }


def level_report(levels: list[Level], objects: list[bpy.types.Object]) -> dict[str, Any]:
    """One level of all clouds. switch_distance is null where an orthographic camera never shows the level as it should."""
    distance = max(item["farfield_switch_distance"] for item in objects)
    return {
        "error": max(level.error for level in levels),
        "quads": sum(len(level.quads) for level in levels),
        "texels": sum(level.texels for level in levels),
        "switch_distance": distance if math.isfinite(distance) else None,
    }


if __name__ == "__main__":
    command_line.run(main)
