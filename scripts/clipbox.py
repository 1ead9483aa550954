"""Make terrain in nested boxes: `python3 scripts/clipbox.py --terrain NAME --at x,y,z --out OUT.blend [flags]`.

The ending of --out chooses what is written: .blend (a scene with the terrain, which goes on following where Farfield is installed; with
--freeze, plain meshes of it), .ply (the welded union of all boxes, in double precision) or .obj (the same as text; far from the origin it
counts from a place that its first line tells). With --path, a .csv of places x,y,z, the viewer goes there one after the other, and what
is written is where that ends. `blender --background --python scripts/clipbox.py -- FLAGS` does the same.
"""

import csv
import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

import environment

environment.ensure()

import bpy
import numpy as np

import command_line
import scene_files
from farfield.addon.core.clipbox.files import write_obj, write_ply
from farfield.addon.core.clipbox.layout import good_origin
from farfield.addon.core.clipbox.settings import ClipboxSettings, FreezeSettings
from farfield.addon.core.clipbox.terrain import Terrain, Update, check_viewer, welded
from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.progress import Progress, StageClock, Steps, finish, scaled
from farfield.addon.core.settings import add_flags, describe, from_flags
from farfield.addon.operators import clipbox_engines, clipbox_following, clipbox_freeze, clipbox_job
from farfield.addon.operators.long_work import whole
from whole_files import check_writable, whole_file

ENDINGS = (".blend", ".ply", ".obj")


def parser() -> command_line.Parser:
    """All arguments of the script."""
    made = command_line.Parser(prog="clipbox.py", description="Make volumetric terrain of any extent in nested boxes about a viewer.")
    made.add_argument("--at", default="0,0,60", help="where the viewer is, x,y,z in scene units (default: 0,0,60)")
    made.add_argument("--path", type=Path, help="a .csv file with a place x,y,z a line, where the viewer goes after that")
    made.add_argument("--out", type=Path, required=True, help="the file to write: .blend, .ply or .obj")
    made.add_argument("--report", type=Path, help="a JSON file for the figures of the run")
    add_flags(made, ClipboxSettings)
    made.add_argument("--freeze", action="store_true", help="for a .blend: plain meshes that need nothing of Farfield")
    add_flags(made.add_argument_group("with --freeze"), FreezeSettings)
    return made


def main(arguments: list[str], line: command_line.ProgressLine) -> None:
    """Run the script; raises FarfieldError when the input is bad."""
    given = parser().parse_args(arguments)
    if given.formula is not None and given.terrain is None:
        given.terrain = "formula"
    settings, chosen = from_flags(ClipboxSettings, given), frozen_as(given)
    out = given.out.absolute()
    if out.suffix.lower() not in ENDINGS:
        raise FileError(f'--out is "{given.out}"; it must end in one of {", ".join(ENDINGS)}.')
    if chosen is not None and out.suffix.lower() != ".blend":
        raise FileError(f'--out is "{given.out}"; what --freeze makes can only be written to a .blend.')
    check_writable(out, given.report)
    places = [place_of(given.at), *(path_in(given.path.absolute()) if given.path is not None else [])]
    for place in places:
        check_viewer(place, settings.voxel)
    clock = StageClock()
    is_scene = out.suffix.lower() == ".blend"
    made = in_scene(settings, places, chosen, clock, line) if is_scene else in_memory(settings, places, clock, line)
    line.clear()
    with clock.stage("write"):
        write(out, made, good_origin(places[-1], settings))
    if given.report is not None:
        command_line.write_report(given.report.absolute(), report(made, clock))


def frozen_as(given: Namespace) -> FreezeSettings | None:
    """How the terrain is to be frozen, None if it is not.

    Raises:
        SettingsError: when a flag says how to freeze, but --freeze is missing.
    """
    if not given.freeze:
        for item in describe(FreezeSettings):
            if getattr(given, item.name) is not None:
                raise SettingsError(f"{item.flag} tells how to freeze; give --freeze as well.")
        return None
    return from_flags(FreezeSettings, given)


def place_of(text: str) -> np.ndarray:
    """A place (3,) from `x,y,z`.

    Raises:
        SettingsError: when it is none.
    """
    try:
        place = np.array([float(number) for number in text.split(",")])
    except ValueError:
        place = np.empty(0)
    if place.shape != (3,):
        raise SettingsError(f'A place is x,y,z, three numbers, not "{text}".')
    return place


def path_in(path: Path) -> list[np.ndarray]:
    """The places (3,) in a .csv file; a first line without numbers is its head.

    Raises:
        FileError: when it cannot be read.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as lines:
            rows = [row for row in csv.reader(lines) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FileError(f'The path "{path}" cannot be read: {error}.') from error
    try:
        if rows and any(cell.strip()[:1].isalpha() for cell in rows[0]):
            rows = rows[1:]
        places = [place_of(",".join(row[:3])) for row in rows]
    except SettingsError as error:
        raise FileError(f'The path "{path}" cannot be read: {error}') from error
    if not places:
        raise FileError(f'The path "{path}" holds no places; give a line x,y,z for each.')
    return places


def in_memory(settings: ClipboxSettings, places: list[np.ndarray], clock: StageClock, line: command_line.ProgressLine) -> Terrain:
    """A terrain that has followed the path, without Blender's data."""
    engine = clipbox_engines.new_engine(settings)
    with clock.stage("first build"):
        finish(scaled(engine.move(places[0]), 0.0, 1.0 / len(places)), line.show)
    with clock.stage("path"):
        finish(follow(engine, places[1:]), line.show)
    return engine


def follow(engine: Terrain, places: list[np.ndarray]) -> Steps[list[Update]]:
    """Let a terrain go to one place after the other."""
    updates = []
    for number, place in enumerate(places):
        start = (number + 1) / (len(places) + 1)
        updates.append((yield from scaled(engine.move(place), start, start + 1.0 / (len(places) + 1))))
    return updates


def in_scene(
    settings: ClipboxSettings, places: list[np.ndarray], chosen: FreezeSettings | None, clock: StageClock, line: command_line.ProgressLine
) -> Terrain:
    """The same as objects of an empty scene, which they follow in; plain meshes at the end where it is `chosen` how."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    job = clipbox_job.prepare(settings, places[0])
    with clock.stage("first build"):
        finish(scaled(whole(job), 0.0, 1.0 / len(places)), line.show)
    with clock.stage("path"):
        for number, place in enumerate(places[1:]):
            clipbox_following.follow_at_once(job.standing, place)
            line.show(Progress((number + 2) / len(places), "Following"))
    if chosen is not None:
        with clock.stage("freeze"):
            finish(whole(clipbox_freeze.prepare(job.standing, chosen)), line.show)
    return job.engine


def write(out: Path, made: Terrain, origin: np.ndarray) -> None:
    """Write the scene, or the welded union of all boxes; in an .obj counted from `origin` (3,)."""
    ending = out.suffix.lower()
    if ending == ".blend":
        scene_files.save_scene(out)
        return
    united = welded(list(made.all_meshes()))
    with whole_file(out) as temporary:
        if ending == ".obj":
            write_obj(temporary, united, origin)
        else:
            write_ply(temporary, united)


def report(made: Terrain, clock: StageClock) -> dict[str, Any]:
    """The figures of the run."""
    boxes = made.figures()
    computed, reused = (sum(box[name] for box in boxes) for name in ("computed", "reused"))
    return {
        "triangles": sum(box["triangles"] for box in boxes),
        "boxes": boxes,
        "reused_share": None if made.moves < 2 else round(reused / (reused + computed - made.first_computed), 4),
        "moves": made.moves,
        "seconds": {stage: round(taken, 4) for stage, taken in (clock.seconds | made.clock.seconds).items()},
        "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
    }


if __name__ == "__main__":
    command_line.run(main)
