"""Large terrain in a folder, a store: `python3 scripts/bdam.py build INPUT... --out STORE`, and `info`, `verify` and `extract` of a STORE.

`build` makes a store from elevation models and, with --texture, from images of the ground; if it was interrupted, the same command
continues. `extract` writes the mesh that a camera needs: .ply (double precision), .obj or .glb (with textures), all in local meters of the
store, or .blend (a scene with the camera, a Sun and sky, whose terrain can follow a viewer where Farfield is installed).
`blender --background --python scripts/bdam.py -- build INPUT...` does the same.
"""

import math
import sys
from argparse import ArgumentParser, Namespace
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from lib import environment

environment.ensure(exits_on_signals=True)
environment.import_farfield()

import bpy
import mathutils
import numpy as np

from farfield.addon.bridge.imaging.images import read_gray_image
from farfield.addon.bridge.sky import add_sky
from farfield.addon.core.bdam import (
    BdamSettings,
    CutSettings,
    ExtractedMesh,
    FieldSettings,
    TerrainStore,
    build_terrain,
    extract_mesh,
    open_field,
)
from farfield.addon.core.bdam.building.store_target import check_target
from farfield.addon.core.bdam.fields.terrain_field import warn_of_heights
from farfield.addon.core.bdam.settings import ViewSettings
from farfield.addon.core.bdam.view.cut_files import encode_glb, has_alpha, read_texture
from farfield.addon.core.bdam.view.engine import BdamEngine
from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.files.complete_files import PNG_SIGNATURE
from farfield.addon.core.files.file_access import folder_bytes
from farfield.addon.core.files.filenames import material_path
from farfield.addon.core.files.outputs import OBJ_COMMENT, Output, is_named_by
from farfield.addon.core.files.scratch import Scratch
from farfield.addon.core.geometry.viewers import Projection, Viewer, camera_window, look_at
from farfield.addon.core.jobs.progress import StageClock, run_to_end
from farfield.addon.core.messages import join_sentences, list_first
from farfield.addon.core.settings import add_flags
from farfield.addon.core.sky import SkySettings
from farfield.addon.operators.bdam.job import ShowJob
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.sky import add_haze
from lib import command_line, run_files, scene_files
from lib.atomic_output import atomic_file, atomic_folder
from lib.executors import DASK_HELP, open_executor
from lib.mesh_export import ObjPart, write_obj, write_ply
from lib.run_files import obj_materials
from lib.script_stdout import mute_stderr

STORE = run_files.PathType(is_output=True, is_folder=True, is_exclusive=True, check=check_target)
EXTENSIONS = (".blend", ".ply", ".obj", ".glb")
MAX_KEPT_BYTES = 64 << 20  # Images of heights up to this size stay in memory.
MAX_SIDE = 65536  # pixels of an image
MAX_NAMED = 5  # damaged parts that a message names
CLIP_FRACTION, CLIP_FACTOR = 1e-3, 1e3  # nearest and farthest visible depth relative to the cell and to the terrain


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the script."""
    parser = command_line.Parser(prog="bdam.py", description="Build large terrain, look into it, check it, and extract meshes from it.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="build|info|verify|extract")
    build = commands.add_parser("build", description=f"Build a store from elevation models. {DASK_HELP}")
    build.add_argument("inputs", nargs="+", type=run_files.INPUT, metavar="INPUT", help="elevation models that form one grid")
    build.add_argument("--out", type=STORE, required=True, metavar="STORE", help="the folder to write")
    build.add_argument(
        "--texture",
        nargs="+",
        default=[],
        type=run_files.INPUT,
        metavar="IMAGE",
        help="images of the ground; later ones lie on top",
    )
    _add_report(build)
    add_flags(build, BdamSettings)
    info = commands.add_parser("info", description="Print figures of a store.")
    verify = commands.add_parser("verify", description="Read a whole store and name what is damaged.")
    extract = commands.add_parser("extract", description="Write the mesh that a camera needs.")
    for command in (info, verify, extract):
        command.add_argument("store", type=run_files.CLOSED_FOLDER, metavar="STORE", help="the folder of a terrain")
        _add_report(command)
    extract.add_argument("--from", dest="position", required=True, metavar="X,Y,Z", help="position of the camera in local meters")
    extract.add_argument("--to", dest="target", required=True, metavar="X,Y,Z", help="position that the camera looks at")
    extract.add_argument("--fov", default="50", help="field of view along the longer side of the image, in degrees (default: 50)")
    extract.add_argument("--size", default="800x600", help="width and height of the image in pixels (default: 800x600)")
    extract.add_argument("--tolerance", default="1", help="largest error in pixels (default: 1)")
    extract.add_argument(
        "--out", type=run_files.OUTPUT.ending_in(*EXTENSIONS), required=True, help="the file to write: .ply, .obj, .glb or .blend"
    )
    return parser


def _add_report(parser: ArgumentParser) -> None:
    parser.add_argument("--report", type=run_files.REPORT, help="write a report of the run to this JSON file")


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the script and return the summary; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    if given.command == "build":
        return build(given, line)
    if given.command == "extract":
        return extract(given, line)
    return show_info(given) if given.command == "info" else verify(given)


def build(given: Namespace, line: command_line.ProgressLine) -> str:
    """Build a store."""
    settings = command_line.read_settings(given, BdamSettings)[BdamSettings]
    inputs, images = ([path.absolute() for path in paths] for paths in (given.inputs, given.texture))
    with Scratch(MAX_KEPT_BYTES) as scratch:
        field_settings = FieldSettings(settings.cell_size, settings.image_height, settings.allow_gaps)
        with mute_stderr():  # libraries print what is wrong with a file
            field = open_field(inputs, field_settings, lambda path: scratch.keep(read_gray_image(path), 0))
        with open_executor(settings.executor) as executor:
            steps = build_terrain(warn_of_heights(field), inputs, given.out.absolute(), settings, images, executor)
            report = run_to_end(steps, line.show)
    line.clear()
    workers = command_line.children_peak_memory_mb()
    figures = {
        "origin": list(report.origin),
        "crs": report.crs,
        "rows": report.rows,
        "columns": report.columns,
        "holes": report.holes,
        "voids_filled": report.voids.filled,
        "voids_left": report.voids.left,
        "triangles": report.triangles,
        "patches": report.patches,
        "tiles": report.tiles,
        "max_error_px": None,
        "bytes": report.bytes,
        "warnings": list(report.warnings),
        "worker_peak_memory_mb": None if workers is None else round(workers, 1),
    }
    write_report(given, figures, report.seconds)
    summary = (
        f'"{given.out.name}": {report.columns:,} by {report.rows:,} heights in {report.patches:,} patches, {report.bytes / 1e6:,.1f} MB.'
    )
    return join_sentences([summary, report.describe_voids(), *report.warnings])


def show_info(given: Namespace) -> str:
    """Print figures of a store."""
    clock = StageClock()
    with clock.stage("read"), TerrainStore(given.store.absolute()) as store:
        low, high = store.levels[0].low.min(axis=0), store.levels[0].high.max(axis=0)
        textures = store.textures
        figures = describe_store(store) | {
            "max_error_px": None,
            "crs": store.header.crs,
            "rows": store.header.rows,
            "columns": store.header.columns,
            "cell_size": store.header.cell_size,
            "height_step": store.header.height_step,
            "bounds": [low.astype(float).tolist(), high.astype(float).tolist()],
            "bytes": folder_bytes(store.folder),
            "warnings": list(store.damages),
            "levels": [
                {
                    "patches": len(level.indices),
                    "triangles": int(level.counts[:, 1].sum()),
                    "max_error": float(level.errors.max(initial=0.0)),
                }
                for level in store.levels
            ],
            "texture": None
            if textures is None
            else {
                "format": textures.plan.image_format,
                "levels": textures.grid.level_count,
                "texel": textures.grid.texel_meters(textures.grid.level_count - 1),
            },
        }
    write_report(given, figures, clock.seconds)
    size, origin = high - low, ", ".join(f"{number:.10g}" for number in figures["origin"])
    texture = "no texture" if textures is None else f"{figures['tiles']:,} texture tiles"
    summary = (
        f'"{given.store.name}": {figures["columns"]:,} by {figures["rows"]:,} heights from {low[2]:.1f} to {high[2]:.1f} m, '
        f"{size[0] / 1000.0:,.1f} by {size[1] / 1000.0:,.1f} km, {figures['patches']:,} patches in {len(figures['levels'])} levels, "
        f"{texture}, "
        f"{figures['bytes'] / 1e6:,.1f} MB, origin {origin} ({figures['crs']})."
    )
    return " ".join([summary, *figures["warnings"]])


def verify(given: Namespace) -> str:
    """Check a whole store.

    Raises:
        FileError: something is damaged; the message names it.
    """
    clock = StageClock()
    with clock.stage("read"), TerrainStore(given.store.absolute()) as store:
        damaged = list(store.verify())
        figures = describe_store(store) | {"max_error_px": None, "damaged": damaged}
    write_report(given, figures, clock.seconds)
    if damaged:
        names = list_first(damaged, MAX_NAMED)
        raise FileError(f'"{given.store}" is damaged in {len(damaged):,} parts: {names}; the rest can be used, or build the terrain again.')
    return f'"{given.store.name}": {figures["patches"]:,} patches and {figures["tiles"]:,} texture tiles are undamaged.'


def extract(given: Namespace, line: command_line.ProgressLine) -> str:
    """Write the mesh that a camera needs."""
    out = given.out.absolute()
    extension = out.suffix.lower()
    tolerance = parse_number(given.tolerance, "--tolerance", 1e-3, 1e6)
    clock = StageClock()
    with TerrainStore(given.store.absolute()) as store:
        viewer = create_viewer(given, store)
        with clock.stage("extract"):
            extracted = run_to_end(extract_mesh(store, viewer, CutSettings(tolerance)), line.show)
        origin = list(store.header.origin)
        images, warnings = read_textures(store, extracted) if extension in (".obj", ".glb") else ({}, extracted.warnings)
    with clock.stage("write"):
        if extension == ".blend":
            warnings = write_scene(given.store.absolute(), viewer, tolerance, out, line)
        elif extension == ".obj":
            write_textured_obj(given, out, extracted, images)
        else:
            with atomic_file(out) as temporary:
                if extension == ".glb":
                    temporary.write_bytes(encode_glb(out.stem, extracted, images))
                else:
                    write_ply(temporary, extracted.mesh.positions, extracted.mesh.normals, extracted.mesh.triangles)
    line.clear()
    figures = {
        "origin": origin,
        "triangles": len(extracted.mesh.triangles),
        "patches": extracted.patches,
        "tiles": extracted.tiles,
        "max_error_px": round(extracted.max_error, 6),
        "warnings": list(warnings),
    }
    write_report(given, figures, clock.seconds)
    count = f"{figures['triangles']:,} triangles of {extracted.patches:,} patches"
    return " ".join([f'"{out.name}": {count}, errors up to {extracted.max_error:.2f} px.', *warnings[:MAX_NAMED]])


def create_viewer(given: Namespace, store: TerrainStore) -> Viewer:
    """Return the camera.

    Raises:
        SettingsError: a flag is invalid.
    """
    words = given.size.lower().split("x")
    if len(words) != 2 or not all(word.isdecimal() and 1 <= int(word) <= MAX_SIDE for word in words):
        raise SettingsError(f'--size is "{given.size}"; write width and height in pixels, as in 800x600.')
    size = int(words[0]), int(words[1])
    extent = 2.0 * math.tan(0.5 * math.radians(parse_number(given.fov, "--fov", 0.01, 179.0)))
    window = camera_window(extent, size[0] >= size[1], (0.0, 0.0), size)
    diagonal = float(np.linalg.norm(store.levels[0].high.max(axis=0) - store.levels[0].low.min(axis=0)))
    position = parse_position(given.position, "--from")
    far = CLIP_FACTOR * (diagonal + float(np.linalg.norm(position)))
    projection = Projection("perspective", window, size, CLIP_FRACTION * store.header.cell_size, far)
    return Viewer(look_at(position, parse_position(given.target, "--to")), projection)


def parse_number(text: str, flag: str, minimum: float, maximum: float) -> float:
    """Return a number within limits. Raises SettingsError."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not minimum <= number <= maximum:
        raise SettingsError(f'{flag} is "{text}"; it must be a number from {minimum:g} to {maximum:g}.')
    return number


def parse_position(text: str, flag: str) -> np.ndarray:
    """Return a position (3,) from `x,y,z`. Raises SettingsError."""
    try:
        position = np.array([float(number) for number in text.split(",")])
    except ValueError:
        position = np.empty(0)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise SettingsError(f'{flag} is "{text}"; a position consists of three numbers x,y,z.')
    return position


def read_textures(store: TerrainStore, extracted: ExtractedMesh) -> tuple[dict[int, bytes], tuple[str, ...]]:
    """Return the images of a cut by the number of their texture tile, and sentences about what is damaged."""
    images, warnings = {}, list(extracted.warnings)
    for part in extracted.parts:
        if part.texture is not None:
            try:
                images[part.texture] = read_texture(store, part.texture)
            except FileError as error:
                warnings.append(str(error))
    return images, tuple(warnings)


def write_textured_obj(given: Namespace, out: Path, extracted: ExtractedMesh, images: dict[int, bytes]) -> None:
    """Write an .obj file, and its materials and images next to it if it has any.

    Raises:
        FileError: a file cannot be written, or would replace one that Farfield did not write.
    """
    library, mesh = material_path(out), extracted.mesh
    names = {number: f"{library.stem.replace(' ', '_')}_{number}" for number in images}
    files = {number: names[number] + (".png" if image.startswith(PNG_SIGNATURE) else ".jpg") for number, image in images.items()}
    if images:
        is_ours = partial(is_named_by, library)
        outputs = [Output("an image of --out", out.with_name(name), is_ours=is_ours) for name in files.values()]
        given.files.check([*obj_materials(out, library), *outputs])
    parts = [
        ObjPart(part.vertices[part.triangles], part.uvs, part.triangles, names[part.texture])
        if part.texture in images
        else ObjPart(part.vertices[part.triangles])
        for part in extracted.parts
    ]
    with atomic_folder(out.parent) as folder:
        write_obj(folder / out.name, mesh.positions, mesh.normals, parts, np.zeros(3), library.name if images else None)
        materials = []
        for number, name in names.items():
            (folder / files[number]).write_bytes(images[number])
            materials += [f"newmtl {name}", "Kd 1 1 1", "Ks 0 0 0", "illum 1", f"map_Kd {files[number]}"]
            materials += [f"map_d {files[number]}"] if has_alpha(images[number]) else []
        if images:
            (folder / library.name).write_text(OBJ_COMMENT + "\n".join(materials) + "\n", encoding="utf-8")


def write_scene(folder: Path, viewer: Viewer, tolerance: float, out: Path, line: command_line.ProgressLine) -> tuple[str, ...]:
    """Write a scene with the terrain as objects, with textures, the camera, a Sun, and a World with sky. Returns sentences about damaged
    parts, which are replaced or missing."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    settings = ViewSettings(tolerance=tolerance, triangle_budget=0, culling=False)
    engine = BdamEngine(folder, settings)
    job = ShowJob(engine, viewer, str(folder))
    run_to_end(run_job(job), line.show)
    add_camera(viewer, engine)
    add_sky(bpy.context.scene, SkySettings())
    add_haze(job.terrain, SkySettings())
    scene_files.save_scene(out)
    return job.terrain.warnings


def add_camera(viewer: Viewer, engine: BdamEngine) -> None:
    """Add a camera with the view, and let the scene render its size."""
    scene, (low, high) = bpy.context.scene, engine.bounds
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera, camera.matrix_world = camera, mathutils.Matrix(viewer.matrix)
    camera.data.angle = max(viewer.projection.field_of_view)
    camera.data.clip_start = viewer.projection.near
    camera.data.clip_end = float(np.linalg.norm(high - low) + np.linalg.norm(viewer.position - 0.5 * (low + high)))
    scene.render.resolution_x, scene.render.resolution_y = viewer.projection.size
    bpy.context.view_layer.update()


def describe_store(store: TerrainStore) -> dict[str, Any]:
    """Return the figures that all reports have about a store."""
    return {
        "origin": list(store.header.origin),
        "triangles": sum(int(level.counts[:, 1].sum()) for level in store.levels),
        "patches": sum(len(level.indices) for level in store.levels),
        "tiles": 0 if store.textures is None else len(store.textures),
    }


def write_report(given: Namespace, figures: dict[str, Any], seconds: dict[str, float]) -> None:
    """Write the report of the run, if it is wanted."""
    if given.report is not None:
        times = {stage: round(number, 4) for stage, number in seconds.items()}
        report = figures | {"seconds": times, "peak_memory_mb": round(command_line.peak_memory_mb(), 1)}
        command_line.write_report(given.report.absolute(), report)


if __name__ == "__main__":
    command_line.run(main)
