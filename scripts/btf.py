"""Bake relightable textures for the billboard clouds of a file: `python3 scripts/btf.py CLOUD.blend --out OUT.blend [flags]`.

CLOUD.blend holds an original and its cloud, as scripts/billboards.py leaves them. In OUT.blend the cloud shines as the original does under
the sun lamp --sun and the even light of the world, from every side, with drivers and nodes alone.
`blender --background --python scripts/btf.py -- CLOUD.blend --out OUT.blend` does the same.
"""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

import environment

environment.ensure()

import bpy
import numpy as np

import command_line
import scene_files
from contact_sheet import write_png
from farfield.addon.bridge.btf_clouds import light_with
from farfield.addon.core.btf.settings import BtfSettings, ExportSettings
from farfield.addon.core.errors import FileError, GeometryError
from farfield.addon.core.progress import StageClock, finish, scaled
from farfield.addon.core.settings import add_flags, from_flags
from farfield.addon.operators import btf_export_job
from farfield.addon.operators.billboards_clouds import clouds_in
from farfield.addon.operators.btf_job import BtfJob, prepare
from farfield.addon.operators.long_work import whole
from line_chart import line_chart
from whole_files import check_writable


def parser() -> command_line.Parser:
    """All arguments of the script."""
    made = command_line.Parser(prog="btf.py", description="Bake relightable textures for billboard clouds with Cycles.")
    made.add_argument("input", type=Path, help="a .blend file with an original and its cloud")
    made.add_argument("--out", type=Path, required=True, help="the .blend file to write")
    made.add_argument("--work", type=Path, help="a folder for finished views, so that a stopped bake goes on (default: none kept)")
    made.add_argument("--sun", default="Sun", help="name of the sun lamp that lights the result, made when missing (default: Sun)")
    made.add_argument("--report", type=Path, help="a JSON file for the figures of the run")
    made.add_argument("--curve", type=Path, help="a PNG file for a chart of the likeness to what was captured, by number of components")
    made.add_argument(
        "--export",
        type=Path,
        action="append",
        default=[],
        metavar="PATH",
        help="also write the result for other programs, by its ending: .glb, .btf, .octahedral for a folder with an octahedral atlas, "
        "or none for a folder of pictures; may be given again",
    )
    add_flags(made, BtfSettings)
    add_flags(made, ExportSettings)
    return made


def main(arguments: list[str], line: command_line.ProgressLine) -> None:
    """Run the script; raises FarfieldError when the input is bad."""
    given = parser().parse_args(arguments)
    settings, export_settings = from_flags(BtfSettings, given), from_flags(ExportSettings, given)
    out = given.out.absolute()
    if out.suffix.lower() != ".blend":
        raise FileError(f'--out is "{given.out}"; it must end in .blend.')
    check_writable(out, given.report, given.curve)
    exports = [path.absolute() for path in given.export]
    for path in exports:
        btf_export_job.check_target(path)
    clock = StageClock()
    with clock.stage("read"):
        scene_files.open_scene(given.input.absolute())
        sun = sun_named(given.sun)
        jobs = jobs_of(settings, None if given.work is None else given.work.absolute())
    for number, job in enumerate(jobs):
        finish(scaled(whole(job), number / len(jobs), (number + 1) / len(jobs)), line.show)
    line.clear()
    with clock.stage("write"):
        for cloud in clouds_in(bpy.context.scene):
            for level in cloud.levels:
                light_with(level, [sun], world_colour())
        scene_files.save_scene(out)
    with clock.stage("export"):
        levels = [level for cloud in clouds_in(bpy.context.scene) for level in cloud.levels]
        for path in exports:
            finish(whole(btf_export_job.prepare(levels, path, export_settings)), line.show)
            line.clear()
    if given.curve is not None:
        write_png(given.curve.absolute(), curve(jobs))
    if given.report is not None:
        command_line.write_report(given.report.absolute(), report(jobs, clock))


def jobs_of(settings: BtfSettings, work: Path | None) -> list[BtfJob]:
    """One job a cloud of the open scene."""
    standing = clouds_in(bpy.context.scene)
    if not standing:
        raise GeometryError("The file holds no billboard cloud; make one with scripts/billboards.py.")
    folders = [None if work is None else work / cloud.collection.name for cloud in standing]
    return [prepare(bpy.context, cloud, settings, folder, keeps_work=True) for cloud, folder in zip(standing, folders, strict=True)]


def sun_named(name: str) -> bpy.types.Object:
    """The sun lamp of that name; a new one of 3 W/m2 from above where there is none.

    Raises:
        GeometryError: when the object of that name is no sun lamp.
    """
    found = bpy.data.objects.get(name)
    if found is None:
        lamp = bpy.data.lights.new(name, "SUN")
        lamp.energy = 3.0
        found = bpy.data.objects.new(name, lamp)
        found.rotation_euler = (0.6, 0.3, 0.0)
        bpy.context.scene.collection.objects.link(found)
    if found.type != "LIGHT" or found.data.type != "SUN":
        raise GeometryError(f'"{name}" is no sun lamp; name another one with --sun, or none of the objects and one is made.')
    return found


def world_colour() -> list[float]:
    """The even light of the scene's world: colour times strength of its Background, where that is a plain colour."""
    world = bpy.context.scene.world
    nodes = world.node_tree.nodes if world is not None and world.node_tree is not None else []
    background = next((node for node in nodes if node.type == "BACKGROUND"), None)
    if background is None or background.inputs["Color"].is_linked:
        return [0.0, 0.0, 0.0]
    return [background.inputs["Strength"].default_value * value for value in background.inputs["Color"].default_value[:3]]


def curve(jobs: list[BtfJob]) -> np.ndarray:
    """A chart of the PSNR of every level against what was captured, by the number of components; 0 are the lobes alone."""
    lines = {
        f"{job.collection} L{figure['level']}": [(fit["components"], fit["psnr"]) for fit in figure["fits"]]
        for job in jobs
        for figure in job.figures
    }
    return line_chart("PSNR in dB against the captured textures, noise counted as error", "components", lines)


def report(jobs: list[BtfJob], clock: StageClock) -> dict[str, Any]:
    """The figures of the run, all levels of all clouds."""
    seconds = dict(clock.seconds)
    for job in jobs:
        for stage, taken in job.clock.seconds.items():
            seconds[stage] = seconds.get(stage, 0.0) + taken
    levels = [figure for job in jobs for figure in job.figures]
    workers = command_line.children_peak_memory_mb()
    totals = ("renders", "shards", "bare_render_seconds", "raw_bytes", "captured_bytes", "compressed_bytes")
    return {
        **{name: sum(figure[name] for figure in levels) for name in totals},
        "levels": levels,
        "seconds": {stage: round(taken, 4) for stage, taken in seconds.items()},
        "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
        "workers_peak_memory_mb": None if workers is None else round(workers, 1),
    }


if __name__ == "__main__":
    command_line.run(main)
