"""Bake relightable textures for the billboard clouds of a file: `python3 scripts/btf.py CLOUD.blend --out OUT.blend [flags]`.

CLOUD.blend contains source objects and their cloud, as written by scripts/billboards.py. In OUT.blend the cloud looks like the source under
all lights and from all directions; with --model emission under the Sun light --sun and uniform lighting of the World.
--executor dask:tcp://HOST:PORT sends the renders to the workers of a Dask scheduler.
`blender --background --python scripts/btf.py -- CLOUD.blend --out OUT.blend` does the same.
"""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from lib import environment

environment.ensure(exits_on_signals=True)
environment.import_farfield()

import bpy
import numpy as np

from farfield.addon.bridge.billboards.scene_clouds import clouds_in
from farfield.addon.bridge.btf.levels.emission_levels import link_suns
from farfield.addon.bridge.overlays.line_chart import draw_line_chart
from farfield.addon.core.btf.formats.fmf import check_direction_counts
from farfield.addon.core.btf.settings import BtfSettings, ExportSettings
from farfield.addon.core.errors import GeometryError, SettingsError
from farfield.addon.core.files.filenames import unique_filenames
from farfield.addon.core.files.user_folders import check_owner
from farfield.addon.core.jobs.executors import Executor
from farfield.addon.core.jobs.progress import StageClock, run_to_end, subprogress
from farfield.addon.core.settings import add_flags
from farfield.addon.operators.btf import export_job
from farfield.addon.operators.btf.job import BakeJob, prepare_bake
from farfield.addon.operators.job_run import run_job
from lib import command_line, run_files, scene_files
from lib.atomic_output import atomic_file
from lib.contact_sheet import write_png
from lib.executors import DASK_HELP, open_executor

EXPORT = run_files.PathType(is_output=True, check=export_job.check_target)


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the script."""
    description = f"Bake relightable textures for billboard clouds with Cycles. {DASK_HELP}"
    parser = command_line.Parser(prog="btf.py", description=description)
    parser.add_argument("input", type=run_files.INPUT, help="a .blend file with source objects and their cloud")
    parser.add_argument("--out", type=run_files.OUTPUT_SCENE.ending_in(".blend"), required=True, help="the .blend file to write")
    parser.add_argument(
        "--work", type=run_files.WORK_FOLDER, help="folder for finished views, so that a cancelled bake can resume (default: none)"
    )
    parser.add_argument(
        "--sun",
        default="Sun",
        help="with --model emission, name of the Sun light that lights the result; created if it is missing (default: Sun)",
    )
    parser.add_argument("--report", type=run_files.REPORT, help="write a report of the run to this JSON file")
    parser.add_argument("--curve", type=run_files.OUTPUT, help="write a chart of the PSNR by number of components to this PNG file")
    parser.add_argument(
        "--export",
        type=EXPORT,
        action="append",
        default=[],
        metavar="PATH",
        help="also export the result; the suffix selects the format: .glb, .btf, .octahedral for a folder with an octahedral atlas, "
        "or none for a folder of images; can be repeated",
    )
    add_flags(parser, BtfSettings)
    add_flags(parser, ExportSettings)
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the script and return the summary; raises FarfieldError if the input is invalid."""
    options = build_parser().parse_args(arguments)
    found = command_line.read_settings(options, BtfSettings, ExportSettings)
    settings, export_settings = found[BtfSettings], found[ExportSettings]
    out = options.out.absolute()
    export_paths = [path.absolute() for path in options.export]
    check_model(settings, options.curve, export_paths)
    check_directions(settings, export_settings, export_paths)
    clock = StageClock()
    with open_executor(settings.executor) as executor:
        with clock.stage("read"):
            scene_files.open_scene(options.input.absolute(), options.files)
            sun = find_or_create_sun(options.sun) if settings.bakes_emission else None
            jobs = prepare_jobs(settings, None if options.work is None else options.work.absolute(), export_paths, executor)
        summaries = [
            run_to_end(subprogress(run_job(job), index / len(jobs), (index + 1) / len(jobs)), line.show) for index, job in enumerate(jobs)
        ]
    line.clear()
    with clock.stage("write"):
        if sun is not None:
            for level in all_levels():
                link_suns(level, [sun], world_color())
        scene_files.save_scene(out)
    with clock.stage("export"):
        for path in export_paths:
            job = export_job.prepare_export(all_levels(), path, export_settings)
            run_to_end(run_job(job), line.show)
            line.clear()
            summaries += job.remarks
    if options.curve is not None:
        with atomic_file(options.curve.absolute()) as temporary:
            write_png(temporary, draw_curve(jobs))
    if options.report is not None:
        command_line.write_report(options.report.absolute(), build_report(jobs, clock))
    return " ".join(summaries)


def check_model(settings: BtfSettings, curve: Path | None, exports: list[Path]) -> None:
    """Raise SettingsError if the model of the bake has nothing to draw or to export."""
    if settings.bakes_emission:
        return
    radiance_exports = [path for path in exports if path.suffix.lower() in export_job.RADIANCE_SUFFIXES]
    needing = "--curve" if curve is not None else f'--export "{radiance_exports[0].name}"' if radiance_exports else ""
    if needing:
        raise SettingsError(f"{needing} needs baked lighting; add --model emission.", ("model",))


def check_directions(settings: BtfSettings, export_settings: ExportSettings, exports: list[Path]) -> None:
    """Raise SettingsError if a .btf file cannot store the directions that will be baked."""
    if export_settings.directions == "baked" and any(path.suffix.lower() == export_job.FMF for path in exports):
        check_direction_counts(settings.view_count, settings.light_count)


def all_levels() -> list[bpy.types.Object]:
    """Return the levels of all clouds of the open scene."""
    return [level for cloud in clouds_in(bpy.context.scene) for level in cloud.levels]


def prepare_jobs(settings: BtfSettings, work_folder: Path | None, exports: list[Path], executor: Executor | None = None) -> list[BakeJob]:
    """Return one job per cloud of the open scene, after a check that its levels can be exported.

    executor: where views are rendered; that of the settings if it is None.
    """
    clouds = clouds_in(bpy.context.scene)
    if not clouds:
        raise GeometryError("The file contains no billboard cloud; build one with scripts/billboards.py.")
    for path in exports:
        export_job.check_levels(all_levels(), path)
    if work_folder is not None and work_folder.exists():
        check_owner(work_folder)
    names = unique_filenames([cloud.collection.name for cloud in clouds])
    folders = [None if work_folder is None else work_folder / name for name in names]
    return [
        prepare_bake(bpy.context, cloud, settings, folder, keep_finished_views=True, executor=executor)
        for cloud, folder in zip(clouds, folders, strict=True)
    ]


def find_or_create_sun(name: str) -> bpy.types.Object:
    """Return the Sun light of that name. If it does not exist, create one of 3 W/m2 from above.

    Raises:
        GeometryError: if the object of that name is not a Sun light.
    """
    sun = bpy.data.objects.get(name)
    if sun is None:
        light = bpy.data.lights.new(name, "SUN")
        light.energy = 3.0
        sun = bpy.data.objects.new(name, light)
        sun.rotation_euler = (0.6, 0.3, 0.0)
        bpy.context.scene.collection.objects.link(sun)
    if sun.type != "LIGHT" or sun.data.type != "SUN":
        raise GeometryError(f'"{name}" is not a Sun light. Give the name of a Sun light with --sun, or omit it to create one.')
    return sun


def world_color() -> list[float]:
    """Return the radiance of the World: color times strength of its Background node; black if the color is linked."""
    world = bpy.context.scene.world
    nodes = world.node_tree.nodes if world is not None and world.node_tree is not None else []
    background = next((node for node in nodes if node.type == "BACKGROUND"), None)
    if background is None or background.inputs["Color"].is_linked:
        return [0.0, 0.0, 0.0]
    return [background.inputs["Strength"].default_value * value for value in background.inputs["Color"].default_value[:3]]


def draw_curve(jobs: list[BakeJob]) -> np.ndarray:
    """Return a chart of the PSNR of every level relative to its capture, by number of components; 0 means the lobes only."""
    lines = {
        f"{job.collection} L{figure['level']}": [(error["components"], error["psnr"]) for error in figure["component_errors"]]
        for job in jobs
        for figure in job.figures
    }
    return draw_line_chart("PSNR in dB relative to the captured textures, including their noise", "components", lines)


def build_report(jobs: list[BakeJob], clock: StageClock) -> dict[str, Any]:
    """Return the report of the run for all levels of all clouds."""
    seconds = dict(clock.seconds)
    for job in jobs:
        for stage, duration in job.clock.seconds.items():
            seconds[stage] = seconds.get(stage, 0.0) + duration
    levels = [figure for job in jobs for figure in job.figures]
    workers_peak = command_line.children_peak_memory_mb()
    totals = ("renders", "shards", "bare_render_seconds", "raw_bytes", "captured_bytes", "compressed_bytes")
    return {
        **{name: sum(figure[name] for figure in levels) for name in totals},
        "levels": levels,
        "seconds": {stage: round(duration, 4) for stage, duration in seconds.items()},
        "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
        "workers_peak_memory_mb": None if workers_peak is None else round(workers_peak, 1),
    }


if __name__ == "__main__":
    command_line.run(main)
