"""Create terrain in nested boxes: `python3 scripts/clipbox.py --terrain NAME --at x,y,z --out OUT.blend [flags]`.

The extension of --out selects the output: .blend (a scene with the terrain, which can follow a viewer where Farfield is installed; with
--convert-to-mesh, regular meshes), .ply (one welded mesh of all boxes in double precision) or .obj (the same as text; far from the origin,
coordinates are relative to a position in its first line). --path is a .csv file of positions x,y,z to which the viewer moves one after the
other; the output is the terrain at the last one. `blender --background --python scripts/clipbox.py -- FLAGS` does the same.
"""

import csv
import sys
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from lib import environment

environment.ensure(exits_on_signals=True)
environment.import_farfield()

import bpy
import numpy as np

from farfield.addon.bridge.clipbox import sources
from farfield.addon.core.clipbox import ClipboxSettings, ConvertSettings, TerrainEngine, Update, weld
from farfield.addon.core.clipbox.engine import check_viewer
from farfield.addon.core.clipbox.files.readers import check_path
from farfield.addon.core.clipbox.layout import choose_terrain_origin
from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.files.file_access import check_readable, error_reason
from farfield.addon.core.files.outputs import Input
from farfield.addon.core.jobs.progress import Progress, StageClock, Steps, run_to_end, subprogress
from farfield.addon.core.messages import format_count
from farfield.addon.core.settings import add_flags, describe
from farfield.addon.operators import following
from farfield.addon.operators.clipbox import convert_to_mesh
from farfield.addon.operators.clipbox.job import prepare
from farfield.addon.operators.job_run import run_job
from lib import command_line, run_files, scene_files
from lib.atomic_output import atomic_file
from lib.mesh_export import ObjPart, write_obj, write_ply
from lib.script_stdout import mute_stderr

EXTENSIONS = (".blend", ".ply", ".obj")


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the script."""
    parser = command_line.Parser(prog="clipbox.py", description="Create unbounded volumetric terrain in nested boxes around a viewer.")
    parser.add_argument("--at", default="0,0,60", help="position of the viewer, x,y,z in scene units (default: 0,0,60)")
    parser.add_argument("--path", type=run_files.INPUT, help="a .csv file with further positions of the viewer, x,y,z per line")
    parser.add_argument(
        "--out", type=run_files.OUTPUT.ending_in(*EXTENSIONS), required=True, help="the file to write: .blend, .ply or .obj"
    )
    parser.add_argument("--report", type=run_files.REPORT, help="write a report of the run to this JSON file")
    add_flags(parser, ClipboxSettings)
    parser.add_argument("--convert-to-mesh", action="store_true", help="for a .blend: write regular meshes that do not need Farfield")
    add_flags(parser.add_argument_group("with --convert-to-mesh"), ConvertSettings)
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the script and return the summary; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    if given.formula is not None and given.terrain is None:
        given.terrain = "formula"
    settings = make_sources_absolute(command_line.read_settings(given, ClipboxSettings)[ClipboxSettings])
    convert_settings = read_convert_settings(given)
    out = given.out.absolute()
    if convert_settings is not None and out.suffix.lower() != ".blend":
        raise FileError(f'--out is "{given.out}"; with --convert-to-mesh it must end in .blend.')
    sources = {"--source": settings.source, "--source-color": settings.source_color}
    given.files.check(inputs=[Input(flag, Path(text)) for flag, text in sources.items() if text])
    positions = [parse_position(given.at), *(read_path(given.path.absolute()) if given.path is not None else [])]
    for position in positions:
        check_viewer(position, settings.voxel_size)
    clock = StageClock()
    if out.suffix.lower() == ".blend":
        engine = build_scene(settings, positions, convert_settings, clock, line)
    else:
        engine = build_engine(settings, positions, clock, line)
    line.clear()
    with clock.stage("write"):
        write_output(out, engine, choose_terrain_origin(positions[-1], settings))
    if given.report is not None:
        command_line.write_report(given.report.absolute(), build_report(engine, clock))
    triangles = sum(box["triangles"] for box in engine.statistics())
    summary = f'"{out.name}": {format_count(triangles, "triangle")} in {format_count(settings.boxes, "box")}.'
    return " ".join([summary, *engine.warnings])


def make_sources_absolute(settings: ClipboxSettings) -> ClipboxSettings:
    """Return `settings` with absolute paths, so that the terrain of a .blend finds its files wherever Blender is started.

    Raises:
        FileError: a path begins with "//", which means that it is relative to a .blend file.
    """
    for path in (settings.source, settings.source_color):
        check_path(path)
    absolute = {name: str(Path(path).absolute()) for name in ("source", "source_color") if (path := getattr(settings, name))}
    return replace(settings, **absolute)


def read_convert_settings(given: Namespace) -> ConvertSettings | None:
    """Return the settings of the conversion, None without --convert-to-mesh.

    Raises:
        SettingsError: a flag of the conversion is given without --convert-to-mesh.
    """
    if not given.convert_to_mesh:
        for item in describe(ConvertSettings):
            if getattr(given, item.name) is not None:
                raise SettingsError(f"{item.flag} needs --convert-to-mesh.")
        return None
    return command_line.read_settings(given, ConvertSettings)[ConvertSettings]


def parse_position(text: str) -> np.ndarray:
    """Parse a position (3,) from `x,y,z`.

    Raises:
        SettingsError: it is invalid.
    """
    try:
        position = np.array([float(number) for number in text.split(",")])
    except ValueError:
        position = np.empty(0)
    if position.shape != (3,):
        raise SettingsError(f'A position consists of three numbers x,y,z, not "{text}".')
    return position


def read_path(path: Path) -> list[np.ndarray]:
    """Read positions (3,) from a .csv file; a first line without numbers is skipped as a header.

    Raises:
        FileError: it cannot be read.
    """
    check_readable(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    except OSError as error:
        raise FileError(f'The path "{path}" cannot be read: {error_reason(error)}.') from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(f'The path "{path}" cannot be read: {error}.') from error
    try:
        if rows and any(cell.strip()[:1].isalpha() for cell in rows[0]):
            rows = rows[1:]
        positions = [parse_position(",".join(row[:3])) for row in rows]
    except SettingsError as error:
        raise FileError(f'The path "{path}" cannot be read: {error}') from error
    if not positions:
        raise FileError(f'The path "{path}" contains no positions; write one line x,y,z for each.')
    return positions


def build_engine(
    settings: ClipboxSettings, positions: list[np.ndarray], clock: StageClock, line: command_line.ProgressLine
) -> TerrainEngine:
    """Build a terrain that has followed the path, without Blender objects."""
    with mute_stderr():  # libraries print what is wrong with a file
        engine = sources.create_engine(settings)
    with clock.stage("first build"):
        run_to_end(subprogress(engine.move(positions[0]), 0.0, 1.0 / len(positions)), line.show)
    with clock.stage("path"):
        run_to_end(follow_path(engine, positions[1:]), line.show)
    return engine


def follow_path(engine: TerrainEngine, positions: list[np.ndarray]) -> Steps[list[Update]]:
    """Move a terrain to one position after the other."""
    updates = []
    for index, position in enumerate(positions):
        start = (index + 1) / (len(positions) + 1)
        updates.append((yield from subprogress(engine.move(position), start, start + 1.0 / (len(positions) + 1))))
    return updates


def build_scene(
    settings: ClipboxSettings,
    positions: list[np.ndarray],
    convert_settings: ConvertSettings | None,
    clock: StageClock,
    line: command_line.ProgressLine,
) -> TerrainEngine:
    """Build the same as objects of an empty scene; with `convert_settings`, converted to regular meshes."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with mute_stderr():
        job = prepare(settings, positions[0])
    with clock.stage("first build"):
        run_to_end(subprogress(run_job(job), 0.0, 1.0 / len(positions)), line.show)
    with clock.stage("path"):
        for index, position in enumerate(positions[1:]):
            following.recenter(job.terrain, position)
            line.show(Progress((index + 2) / len(positions), "Following the path"))
    if convert_settings is not None:
        with clock.stage("convert"):
            run_to_end(run_job(convert_to_mesh.prepare(job.terrain, convert_settings)), line.show)
    return job.engine


def write_output(out: Path, engine: TerrainEngine, origin: np.ndarray) -> None:
    """Write the scene or the welded mesh of all boxes. Coordinates in an .obj are relative to `origin` (3,)."""
    extension = out.suffix.lower()
    if extension == ".blend":
        scene_files.save_scene(out)
        return
    mesh = weld(list(engine.extract_all()))
    with atomic_file(out) as temporary:
        if extension == ".obj":
            write_obj(temporary, mesh.vertices, mesh.normals, [ObjPart(mesh.triangles)], origin)
        else:
            write_ply(temporary, mesh.vertices, mesh.normals, mesh.triangles)


def build_report(engine: TerrainEngine, clock: StageClock) -> dict[str, Any]:
    """Return the report of the run."""
    boxes = engine.statistics()
    computed, reused = (sum(box[name] for box in boxes) for name in ("computed", "reused"))
    return {
        "triangles": sum(box["triangles"] for box in boxes),
        "boxes": boxes,
        "reused_fraction": None if engine.moves < 2 else round(reused / (reused + computed - engine.initial_voxels), 4),
        "moves": engine.moves,
        "warnings": list(engine.warnings),
        "seconds": {stage: round(seconds, 4) for stage, seconds in (clock.seconds | engine.clock.seconds).items()},
        "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
    }


if __name__ == "__main__":
    command_line.run(main)
