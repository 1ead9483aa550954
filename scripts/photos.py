"""Create one texture from photographs: `python3 scripts/photos.py MESH --cameras DIR --images DIR --out OUT [flags]`.

MESH is a .blend, .obj, .ply, .stl, .glb, .gltf, .fbx or .usd file; cameras and mesh have the same coordinate system, so the axes of .obj,
.ply and .stl files are kept. Meshes without a UV map are unwrapped. `--out` is a .blend, .obj or .glb file with the texture. Maps of
confidence, source and holes appear next to the texture. `blender --background --python scripts/photos.py -- MESH ...` does the same.
"""

import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from lib import environment

environment.ensure()
environment.import_farfield()

import bpy
import numpy as np

from farfield.addon.bridge.meshes import read_instances
from farfield.addon.bridge.photos.mask_files import apply_mask_file, check_mask_folder
from farfield.addon.bridge.photos.photo_files import read_photograph, size_reader
from farfield.addon.bridge.photos.results import assign_texture, create_texture_image
from farfield.addon.bridge.photos.surfaces import read_surface
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.scratch import Scratch
from farfield.addon.core.geometry.lenses import PhotoCamera
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import StageClock, run_to_end, subprogress
from farfield.addon.core.photos.importers import read_cameras
from farfield.addon.core.photos.merging import PhotoTexture, merge
from farfield.addon.core.photos.overlays import draw_overlay
from farfield.addon.core.photos.photographs import Photograph
from farfield.addon.core.photos.settings import PhotosSettings
from farfield.addon.core.settings import add_flags, from_flags
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.unwrap import job as unwrap_job
from lib import command_line, scene_files
from lib.atomic_output import atomic_folder, check_outputs
from lib.contact_sheet import write_png
from lib.script_stdout import mute_stderr

EXTENSIONS = (".blend", ".obj", ".glb")
MAPS = ("confidence", "source", "holes")


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the script."""
    parser = command_line.Parser(prog="photos.py", description="Create one texture for a mesh from registered photographs.")
    parser.add_argument("input", type=command_line.parse_path, help="a .blend .obj .ply .stl .glb .gltf .fbx or .usd file")
    parser.add_argument(
        "--cameras",
        type=command_line.parse_path,
        required=True,
        help="the cameras: a folder of COLMAP, or a transforms.json, .sfm, .out, .nvm, .mvs, .xml or .pairs file",
    )
    parser.add_argument("--images", type=command_line.parse_path, required=True, help="the folder of the photographs")
    parser.add_argument("--masks", type=command_line.parse_path, help="a folder of masks NAME.png or NAME.jpg.png, white where usable")
    parser.add_argument("--out", type=command_line.parse_path, help="the textured mesh to write: .blend, .obj or .glb")
    parser.add_argument("--texture", type=command_line.parse_path, required=True, help="the texture to write, a PNG file")
    parser.add_argument("--overlays", type=command_line.parse_path, help="a folder for pictures of the photographs with the mesh")
    parser.add_argument("--stages", type=command_line.parse_path, help="a folder for pictures of the stages of the merge")
    parser.add_argument("--report", type=command_line.parse_path, help="write a report of the run to this JSON file")
    add_flags(parser, PhotosSettings)
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the script and return the summary; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    settings = from_flags(PhotosSettings, given)
    texture = given.texture.absolute()
    if texture.suffix.lower() != ".png":
        raise FileError(f'--texture is "{given.texture}"; it must end in .png.')
    if given.out is not None and given.out.suffix.lower() not in EXTENSIONS:
        raise FileError(f'--out is "{given.out}"; it must end in one of {", ".join(EXTENSIONS)}.')
    maps = {name: texture.with_suffix(f".{name}.png") for name in MAPS}
    outputs = {"--out": given.out, "--texture": texture, **{f"the {name} map": path for name, path in maps.items()}}
    check_outputs(outputs, {"the input": given.input}, given.report)
    with Scratch() as scratch:
        return merge_files(given, settings, texture, scratch, line)


def merge_files(given: Namespace, settings: PhotosSettings, texture: Path, scratch: Scratch, line: command_line.ProgressLine) -> str:
    """Read cameras, mesh and photographs, merge, write all files, and return the summary."""
    clock = StageClock()
    with clock.stage("cameras"):
        cameras = read_cameras(given.cameras.absolute(), size_reader(given.images.absolute()))
    with clock.stage("mesh"):
        objects = read_objects(given.input.absolute())
    with clock.stage("unwrap"):
        unwrapped = unwrap_missing(objects, line)
    with clock.stage("photographs"), mute_stderr():
        photographs = read_photographs(given, cameras, scratch)
    surface = read_surface(read_instances(objects, bpy.context.evaluated_depsgraph_get()))
    if given.overlays is not None:
        with clock.stage("overlays"):
            write_overlays(surface.mesh, photographs, given.overlays.absolute())
    result = run_to_end(
        subprogress(
            merge(surface.mesh, surface.corner_uvs, photographs, settings, scratch, keep_stages=given.stages is not None), 0.0, 1.0
        ),
        line.show,
    )
    line.clear()
    clock.seconds |= result.seconds
    with clock.stage("write"):
        if given.stages is not None:
            write_stages(result, given.stages.absolute())
        write(result, objects, texture, given.out, len(cameras))
    if given.report is not None:
        report = build_report(result, [camera.name for camera in cameras], unwrapped, clock)
        command_line.write_report(given.report.absolute(), report)
    holes = np.count_nonzero(result.holes) / max(np.count_nonzero(result.holes | (result.source >= 0)), 1)
    return f"Merged {len(cameras)} photographs into {texture.name}; {holes:.1%} of the surface is in no photograph."


def read_photographs(given: Namespace, cameras: list[PhotoCamera], scratch: Scratch) -> list[Photograph]:
    """Read the photographs with their masks, each kept in the group of its index."""
    photographs = []
    if given.masks is not None:
        check_mask_folder(given.masks.absolute(), [camera.name for camera in cameras])
    for index, camera in enumerate(cameras):
        photograph = read_photograph(camera, given.images.absolute())
        if given.masks is not None:
            photograph = apply_mask_file(photograph, given.masks.absolute())
        photographs.append(photograph.keep_in(scratch, index))
    return photographs


def read_objects(path: Path) -> list[bpy.types.Object]:
    """Open the scene and return its meshes, with the axes of the file."""
    scene_files.open_scene(path)
    objects = scene_files.objects_in_renders([item for item in bpy.context.scene.objects if item.type == "MESH"], path)
    if path.suffix.lower() == ".obj":  # which Blender's importer turns
        for item in objects:
            item.matrix_world.identity()
    return objects


def unwrap_missing(objects: list[bpy.types.Object], line: command_line.ProgressLine) -> list[str]:
    """Unwrap the meshes without a UV map; returns their names."""
    missing = [item for item in objects if not item.data.uv_layers]
    if missing:
        run_to_end(run_job(unwrap_job.prepare(bpy.context, missing, UnwrapSettings())), line.show)
        line.clear()
    return [item.name for item in missing]


def write_overlays(mesh: TriangleMesh, photographs: list[Photograph], folder: Path) -> None:
    """Write each photograph with the mesh drawn into it, before merging, which may fail because of what they show."""
    with atomic_folder(folder) as temporary:
        for photograph in photographs:
            write_png(temporary / f"{Path(photograph.camera.name).stem}.overlay.png", draw_overlay(mesh, photograph))


def write_stages(result: PhotoTexture, folder: Path) -> None:
    """Write the pictures of the stages."""
    with atomic_folder(folder) as temporary:
        for name, picture in result.stages.items():
            write_png(temporary / f"{Path(name).stem.replace(' ', '.')}.png", picture)


def write(result: PhotoTexture, objects: list[bpy.types.Object], texture: Path, out: Path | None, count: int) -> None:
    """Write all files; they appear together or not at all."""
    images = {
        "confidence": result.confidence,
        "source": (result.source + 1) / max(count, 1),
        "holes": result.holes.astype(np.float32),
    }
    with atomic_folder(texture.parent) as temporary:
        write_png(temporary / texture.name, result.colors)
        for name, values in images.items():
            write_png(temporary / f"{texture.stem}.{name}.png", np.repeat(values[..., None].astype(np.float32), 3, axis=2))
    if out is None:
        return
    image = create_texture_image(texture.stem, result.colors)
    assign_texture(objects, image, texture.stem)
    extension = out.suffix.lower()
    if extension == ".blend":
        scene_files.save_scene(out.absolute())
        return
    image.filepath_raw = str(texture)
    with atomic_folder(out.absolute().parent) as temporary, mute_stderr():
        if extension == ".obj":
            bpy.ops.wm.obj_export(filepath=str(temporary / out.name), forward_axis="Y", up_axis="Z", path_mode="ABSOLUTE")
        else:
            bpy.ops.export_scene.gltf(filepath=str(temporary / out.name), export_format="GLB")


def build_report(result: PhotoTexture, names: list[str], unwrapped: list[str], clock: StageClock) -> dict[str, Any]:
    """Return the figures of the run."""
    covered = int(np.count_nonzero(result.holes | (result.source >= 0)))
    return {
        "size": len(result.colors),
        "texels": covered,
        "holes": int(np.count_nonzero(result.holes)),
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
