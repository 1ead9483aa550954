"""Unwrap the meshes of a file: `python3 scripts/unwrap.py INPUT --out OUT.blend [flags]`.

INPUT is .blend .obj .ply .stl .glb .gltf .fbx or .usd; each of its visible meshes gets a UV map of its own. The ending of --out chooses
what is written: .blend (the whole scene), .obj or .glb (all objects). `--direction` alone stands for `--importance direction` as well.
`blender --background --python scripts/unwrap.py -- INPUT --out OUT` does the same.
"""

import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

import environment

environment.ensure()

import bpy

import command_line
import scene_files
from farfield.addon.bridge import stretch_pictures
from farfield.addon.core.errors import FileError
from farfield.addon.core.progress import StageClock, finish
from farfield.addon.core.settings import add_flags, from_flags
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.operators.long_work import whole
from farfield.addon.operators.unwrap_job import UnwrapJob, prepare
from whole_files import check_writable, quiet_operators, whole_file, whole_folder

ENDINGS = (".blend", ".obj", ".glb")
PICTURE = 2048  # pixels along a side


def parser() -> command_line.Parser:
    """All arguments of the script."""
    made = command_line.Parser(prog="unwrap.py", description="Lay meshes out with little stretch, and with most texels where it matters.")
    made.add_argument("input", type=Path, help="a .blend .obj .ply .stl .glb .gltf .fbx or .usd file")
    made.add_argument("--out", type=Path, required=True, help="the file to write: .blend, .obj or .glb")
    made.add_argument("--report", type=Path, help="a JSON file for the figures of the run")
    made.add_argument("--picture", type=Path, help="a PNG of the UV map of the first mesh, coloured by stretch")
    add_flags(made, UnwrapSettings)
    return made


def main(arguments: list[str], line: command_line.ProgressLine) -> None:
    """Run the script; raises FarfieldError when the input is bad."""
    given = parser().parse_args(arguments)
    if given.direction is not None and given.importance is None:
        given.importance = "direction"
    settings = from_flags(UnwrapSettings, given)
    out = given.out.absolute()
    if out.suffix.lower() not in ENDINGS:
        raise FileError(f'--out is "{given.out}"; it must end in one of {", ".join(ENDINGS)}.')
    if given.picture is not None and given.picture.suffix.lower() != ".png":
        raise FileError(f'--picture is "{given.picture}"; it must end in .png.')
    check_writable(out, given.report, given.picture)
    clock = StageClock()
    with clock.stage("read"):
        scene_files.open_scene(given.input.absolute())
        job = prepare(bpy.context, [item for item in bpy.context.scene.objects if not item.hide_render], settings)
    for reason in job.skipped:
        print(f"Skipped: {reason}.", file=sys.stderr)
    finish(whole(job), line.show)
    line.clear()
    with clock.stage("write"):
        write(out)
        if given.picture is not None:
            with whole_file(given.picture.absolute()) as temporary:
                stretch_pictures.save(bpy.data.objects[job.made[0][0].name], temporary, PICTURE)
    if given.report is not None:
        command_line.write_report(given.report.absolute(), report(job, clock))


def write(out: Path) -> None:
    """Write the scene, or all its meshes, by the ending of `out`."""
    ending = out.suffix.lower()
    if ending == ".blend":
        scene_files.save_scene(out)
        return
    with whole_folder(out.parent) as folder, quiet_operators():
        if ending == ".obj":
            bpy.ops.wm.obj_export(filepath=str(folder / out.name), export_materials=False, export_normals=False, apply_modifiers=False)
        else:
            bpy.ops.export_scene.gltf(filepath=str(folder / out.name), export_format="GLB", export_apply=False)


def report(job: UnwrapJob, clock: StageClock) -> dict[str, Any]:
    """The figures of the run: those of the mesh with most triangles, and of all of them one by one."""
    seconds = dict(clock.seconds)
    objects = []
    for target, made in job.made:
        objects.append({"name": target.name, "triangles": len(target.loops), "charts": made.charts, **finite(asdict(made.measures))})
        for stage, taken in made.seconds.items():
            seconds[stage] = seconds.get(stage, 0.0) + taken
    largest = max(objects, key=lambda figures: figures["triangles"])
    return {
        **{key: figure for key, figure in largest.items() if key != "name"},
        "objects": objects,
        "skipped": job.skipped,
        "seconds": {stage: round(taken, 4) for stage, taken in seconds.items()},
        "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
    }


def finite(figures: dict[str, Any]) -> dict[str, Any]:
    """`figures` with None for stretch without end, which JSON has no number for."""
    return {name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in figures.items()}


if __name__ == "__main__":
    command_line.run(main)
