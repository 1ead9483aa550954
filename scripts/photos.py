"""Create one texture from photographs: `python3 scripts/photos.py MESH --cameras DIR --images DIR --out OUT [flags]`.

MESH is a .blend, .obj, .ply, .stl, .glb, .gltf, .fbx or .usd file; cameras and mesh have the same coordinate system, so the axes of .obj,
.ply and .stl files are kept. Meshes without a UV map are unwrapped. `--out` is a .blend, .obj or .glb file with the texture. A texture with
UDIM tiles is named like `castle.<UDIM>.png`. Maps of confidence, source and holes appear next to the texture.
`blender --background --python scripts/photos.py -- MESH ...` does the same.
"""

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

from farfield.addon.bridge.geometry.meshes import read_instances
from farfield.addon.bridge.photos.material_groups import MaterialGroups, assign_to_materials, read_material_groups
from farfield.addon.bridge.photos.photo_files import check_mask_folder, read_photograph, size_reader
from farfield.addon.bridge.photos.photo_folders import PhotoFolder, strip_extension
from farfield.addon.bridge.photos.results import assign_texture, create_textures
from farfield.addon.bridge.photos.surfaces import read_surface
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.filenames import unique_filenames
from farfield.addon.core.files.outputs import OBJ_COMMENT, Output
from farfield.addon.core.files.scratch import Scratch
from farfield.addon.core.geometry.lenses import PhotoCamera
from farfield.addon.core.geometry.local_origin import describe_coarseness, describe_move
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import StageClock, run_to_end, subprogress
from farfield.addon.core.messages import format_count, join_sentences
from farfield.addon.core.photos.importers import read_camera_file
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.photo_texture import PhotoTexture
from farfield.addon.core.photos.photographs.photograph import Photograph
from farfield.addon.core.photos.previews import draw_overlay
from farfield.addon.core.photos.registration.refinement import refine
from farfield.addon.core.photos.settings import PhotosSettings
from farfield.addon.core.photos.texels.pages import PageLayout, lay_out_pages
from farfield.addon.core.settings import add_flags
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.unwrap import job as unwrap_job
from lib import command_line, run_files, scene_files
from lib.atomic_output import atomic_folder
from lib.contact_sheet import is_own_png, write_png
from lib.numbered_files import UDIM
from lib.run_files import RunFiles, obj_materials
from lib.script_stdout import mute_stderr
from lib.texture_paths import TexturePaths, first_path
from lib.tile_materials import split_tiles

EXTENSIONS = (".blend", ".obj", ".glb")
MAPS = ("confidence", "source", "holes")


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the script."""
    parser = command_line.Parser(prog="photos.py", description="Create one texture for a mesh from registered photographs.")
    parser.add_argument("input", type=run_files.INPUT, help="a .blend .obj .ply .stl .glb .gltf .fbx or .usd file")
    parser.add_argument(
        "--cameras",
        type=run_files.INPUT,
        required=True,
        help="the cameras: a folder of COLMAP, or a transforms.json, .sfm, .out, .nvm, .mvs, .xml or .pairs file",
    )
    parser.add_argument("--images", type=run_files.INPUT, required=True, help="the folder of the photographs")
    parser.add_argument("--masks", type=run_files.INPUT, help="a folder of masks NAME.png or NAME.jpg.png, white where usable")
    parser.add_argument(
        "--out", type=run_files.OUTPUT_SCENE.ending_in(*EXTENSIONS), help="the textured mesh to write: .blend, .obj or .glb"
    )
    parser.add_argument(
        "--texture",
        type=run_files.OUTPUT.ending_in(".png"),
        required=True,
        help="the texture to write, a PNG file; <UDIM> and <MATERIAL> in its name stand for tiles and materials",
    )
    parser.add_argument("--overlays", type=run_files.IMAGE_FOLDER, help="a folder for pictures of the photographs with the mesh")
    parser.add_argument("--stages", type=run_files.IMAGE_FOLDER, help="a folder for pictures of the stages of the merge")
    parser.add_argument(
        "--refine", nargs="*", metavar="PHOTOGRAPH", help="refine the cameras of these photographs, or all, against the others first"
    )
    parser.add_argument("--refine-lens", action="store_true", help="with --refine, refine focal length and distortion, too")
    parser.add_argument("--report", type=run_files.REPORT, help="write a report of the run to this JSON file")
    add_flags(parser, PhotosSettings)
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the script and return the summary; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    settings = command_line.read_settings(given, PhotosSettings)[PhotosSettings]
    texture = given.texture.absolute()
    if given.out is not None:
        given.files.check(obj_materials(given.out.absolute()))
    check_files(given, texture, [first_path(texture)])
    with Scratch() as scratch:
        return merge_files(given, settings, texture, scratch, line)


def check_files(given: Namespace, texture: Path, pages: list[Path]) -> None:
    """Raise FileError if a page of the texture or a map cannot be written, or would replace another file or an input."""
    outputs = [Output(f'--texture "{path.name}"', path) for path in pages if path != texture]
    outputs += [Output(f'the {name} map of "{path.name}"', map_path(path, name), is_ours=is_own_png) for path in pages for name in MAPS]
    given.files.check(outputs)


def map_path(texture: Path, name: str) -> Path:
    """Return the path of a map of a texture."""
    return texture.with_suffix(f".{name}.png")


def merge_files(given: Namespace, settings: PhotosSettings, texture: Path, scratch: Scratch, line: command_line.ProgressLine) -> str:
    """Read cameras, mesh and photographs, merge, write all files, and return the summary."""
    clock = StageClock()
    with clock.stage("cameras"):
        images = PhotoFolder(given.images.absolute())
        found = read_camera_file(given.cameras.absolute(), size_reader(images))
    with clock.stage("mesh"):
        objects, origin = read_objects(given.input.absolute(), given.files)
        skipped = scene_files.describe_unread()
    cameras = found.cameras if origin is None else [camera.relative_to(origin) for camera in found.cameras]
    with clock.stage("unwrap"):
        unwrapped = unwrap_missing(objects, line)
    instances = read_instances(objects, bpy.context.evaluated_depsgraph_get())
    groups = read_material_groups(objects, instances) if settings.materials == "keep" else None
    surface = read_surface(instances)
    layout = lay_out_pages(surface.corner_uvs, None if groups is None else groups.triangles, keeps_tiles=UDIM in texture.name)
    paths = TexturePaths(texture, layout, None if groups is None else groups.names)
    check_files(given, texture, paths.pages)
    notes = [*found.notes, describe_coarseness(surface.mesh.vertices) if origin is None else describe_move(origin)]
    with clock.stage("photographs"), mute_stderr():
        photographs, note = read_photographs(given, cameras, images, scratch)
        notes.append(note)
    refined = []
    if given.refine is not None:
        with clock.stage("refinement"):
            photographs, refined = refine_cameras(surface.mesh, photographs, given, scratch, line)
    if given.overlays is not None:
        with clock.stage("overlays"):
            write_overlays(surface.mesh, photographs, given.overlays.absolute())
    keep_stages = given.stages is not None
    steps = merge(surface.mesh, layout.corner_uvs, photographs, settings, scratch, pages=layout.pages, keep_stages=keep_stages)
    result = run_to_end(subprogress(steps, 0.0, 1.0), line.show)
    line.clear()
    clock.seconds |= result.seconds
    with clock.stage("write"):
        if given.stages is not None:
            write_stages(result, paths.pages, given.stages.absolute())
        write_textures(result, paths.pages, len(cameras))
        if given.out is not None:
            assign(result, objects, layout, groups, paths)
            write_scene(objects, given.out.absolute())
    if given.report is not None:
        report = build_report(result, [camera.name for camera in cameras], unwrapped, layout, groups, paths.pages, clock) | {
            "refined": refined,
            "notes": [*filter(None, notes)],
            "origin": None if origin is None else origin.tolist(),
        }
        command_line.write_report(given.report.absolute(), report)
    unused = [camera.name for index, camera in enumerate(cameras) if not (result.source == index).any()]
    notes.append(f"Not used: {', '.join(unused)}." if unused else "")
    holes = np.count_nonzero(result.holes) / max(np.count_nonzero(result.holes | (result.source >= 0)), 1)
    summary = f"Merged {format_count(len(cameras), 'photograph')} into {texture.name}; {holes:.1%} of the surface is in no photograph."
    summary = join_sentences([summary, *notes])
    count = sum(each["problem"] is None for each in refined)
    summary = f"Refined {count} of {format_count(len(refined), 'camera')}. {summary}" if refined else summary
    return f"{summary} Skipped: {'; '.join(skipped)}." if skipped else summary


def read_photographs(given: Namespace, cameras: list[PhotoCamera], images: PhotoFolder, scratch: Scratch) -> tuple[list[Photograph], str]:
    """Read the photographs with their masks, each kept in the group of its index; and return a sentence about those without a mask, if only
    some have one."""
    masks, note = None, ""
    if given.masks is not None:
        masks = PhotoFolder(given.masks.absolute())
        missing = check_mask_folder(masks, [camera.name for camera in cameras])
        note = f'{format_count(len(missing), "photograph")} without a mask, like "{missing[0]}".' if missing else ""
    return [read_photograph(camera, images, masks).keep_in(scratch, index) for index, camera in enumerate(cameras)], note


def read_objects(path: Path, files: RunFiles) -> tuple[list[bpy.types.Object], np.ndarray | None]:
    """Open the scene and return its meshes, with the axes of the file, and the position (3,) from which they were moved to the origin, None
    if they were not. Raises FileError if one of its files would be replaced."""
    origin = scene_files.open_near_origin(path, files)
    objects = scene_files.objects_in_renders(path, scene_files.is_mesh)
    if path.suffix.lower() == ".obj":  # which Blender's importer turns
        for item in objects:
            item.matrix_world.identity()
    return objects, origin


def unwrap_missing(objects: list[bpy.types.Object], line: command_line.ProgressLine) -> list[str]:
    """Unwrap the meshes without a UV map into one texture; returns their names."""
    missing = [item for item in objects if not item.data.uv_layers]
    if missing:
        run_to_end(run_job(unwrap_job.prepare(bpy.context, missing, UnwrapSettings(combine_selected=True))), line.show)
        line.clear()
    return [item.name for item in missing]


def refine_cameras(
    mesh: TriangleMesh, photographs: list[Photograph], given: Namespace, scratch: Scratch, line: command_line.ProgressLine
) -> tuple[list[Photograph], list[dict[str, Any]]]:
    """Return the photographs with refined cameras, and figures for the report. Raises FileError for a name that is none of a photograph."""
    names = [photograph.camera.name for photograph in photographs]
    for name in given.refine:
        if name not in names:
            raise FileError(
                f'--refine names "{name}", but the cameras have no photograph of this name; they have "{names[0]}", for example.'
            )
    chosen = [index for index, name in enumerate(names) if not given.refine or name in given.refine]
    found = run_to_end(refine(mesh, photographs, chosen, scratch, has_free_lens=[given.refine_lens] * len(chosen)), line.show)
    line.clear()
    result = list(photographs)
    for index, each in zip(chosen, found, strict=True):
        result[index] = replace(photographs[index], camera=each.camera)
    figures = [
        {
            "name": names[index],
            "pixels_before": None if np.isnan(each.before) else round(each.before, 3),
            "pixels_after": None if np.isnan(each.after) else round(each.after, 3),
            "matches": each.matches,
            "problem": each.problem or None,
        }
        for index, each in zip(chosen, found, strict=True)
    ]
    return result, figures


def write_overlays(mesh: TriangleMesh, photographs: list[Photograph], folder: Path) -> None:
    """Write each photograph with the mesh drawn into it, before merging, which may fail because of what they show."""
    with atomic_folder(folder) as temporary:
        names = unique_filenames([strip_extension(photograph.camera.name) for photograph in photographs])
        for name, photograph in zip(names, photographs, strict=True):
            write_png(temporary / f"{name}.overlay.png", draw_overlay(mesh, photograph))


def write_stages(result: PhotoTexture, textures: list[Path], folder: Path) -> None:
    """Write the pictures of the stages: those of photographs, and those of textures for each page, with its name if there are several."""
    with atomic_folder(folder) as temporary:
        kinds = [name.partition(" ") for name in result.stages]
        stems = unique_filenames([f"{kind}.{strip_extension(name)}".rstrip(".").replace(" ", ".") for kind, _, name in kinds])
        for stem, picture in zip(stems, result.stages.values(), strict=True):
            if picture.shape != result.colors.shape or len(textures) == 1:
                write_png(temporary / f"{stem}.png", picture)
                continue
            for texture, page in zip(textures, np.split(picture, len(textures)), strict=True):
                write_png(temporary / f"{stem}.{texture.name}", page)


def write_textures(result: PhotoTexture, textures: list[Path], count: int) -> None:
    """Write the pages and their maps; they appear together or not at all."""
    with atomic_folder(textures[0].parent) as temporary:
        for index, texture in enumerate(textures):
            page = result.page(index)
            write_png(temporary / texture.name, page.colors)
            maps = {"confidence": page.confidence, "source": (page.source + 1) / max(count, 1), "holes": page.holes}
            for name, values in maps.items():
                write_png(temporary / map_path(texture, name).name, np.repeat(values[..., None].astype(np.float32), 3, axis=2))


def assign(
    result: PhotoTexture, objects: list[bpy.types.Object], layout: PageLayout, groups: MaterialGroups | None, paths: TexturePaths
) -> None:
    """Give the objects materials with the texture."""
    names = [path.stem.replace(f".{UDIM}", "") for path in paths.groups]
    images = create_textures(layout, result, names)
    for group, image in images.items():
        image.filepath_raw = str(paths.groups[group])
    if groups is None:
        assign_texture(objects, images[0], names[0])
    else:
        assign_to_materials(objects, {groups.uids[group]: image for group, image in images.items()})


def write_scene(objects: list[bpy.types.Object], out: Path) -> None:
    """Write the textured mesh."""
    extension = out.suffix.lower()
    if extension == ".blend":
        scene_files.save_scene(out)
        return
    split_tiles(objects)
    with atomic_folder(out.parent) as temporary, mute_stderr():
        if extension == ".obj":
            bpy.ops.wm.obj_export(filepath=str(temporary / out.name), forward_axis="Y", up_axis="Z", path_mode="ABSOLUTE")
            for path in temporary.glob("*.mtl"):
                path.write_text(OBJ_COMMENT + path.read_text(encoding="utf-8"), encoding="utf-8")
        else:
            bpy.ops.export_scene.gltf(filepath=str(temporary / out.name), export_format="GLB")


def build_report(
    result: PhotoTexture,
    names: list[str],
    unwrapped: list[str],
    layout: PageLayout,
    groups: MaterialGroups | None,
    textures: list[Path],
    clock: StageClock,
) -> dict[str, Any]:
    """Return the figures of the run."""
    pages = [
        {
            "name": texture.name,
            "material": None if groups is None else groups.names[layout.groups[index]] or None,
            "tile": layout.tiles[index],
            "texels": result.page(index).texel_count,
            "holes": int(np.count_nonzero(result.page(index).holes)),
        }
        for index, texture in enumerate(textures)
    ]
    return {
        "size": result.colors.shape[1],
        "texels": sum(page["texels"] for page in pages),
        "holes": sum(page["holes"] for page in pages),
        "pages": pages,
        "restored_holes": None if result.hole_counts is None else result.hole_counts._asdict(),
        "photographs": [
            {
                "name": name,
                "gain": [round(float(value), 4) for value in correction.gain],
                "gamma": round(correction.gamma, 4),
                "vignetting": [round(value, 4) for value in correction.vignetting],
                "texels": int(np.count_nonzero(result.source == index)),
                "faces": int(np.count_nonzero(result.labels == index)),
            }
            for index, (name, correction) in enumerate(zip(names, result.color_corrections, strict=True))
        ],
        "unwrapped": unwrapped,
        "seconds": {name: round(value, 3) for name, value in clock.seconds.items()},
        "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
    }


if __name__ == "__main__":
    command_line.run(main)
