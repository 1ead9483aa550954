"""Textures from the photographs of Sceaux, rendered from every camera and compared: `python3 benchmarks/bench_photos.py [flags]`.

Prints JSON: for each method the seconds of each stage, the fraction of the surface in no photograph, and per photograph SSIM and PSNR of
the rendered texture against it. SSIM is that of the bounding box of the mesh, with the photograph itself where there is no mesh: it only
tells methods apart. Exposures of the photographs are not made up for.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import bpy
import numpy as np

from farfield.addon.bridge.meshes import read_instances
from farfield.addon.bridge.photos.photo_files import read_photograph
from farfield.addon.bridge.photos.surfaces import read_surface
from farfield.addon.core.errors import FileError
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.imaging.metrics import psnr, ssim
from farfield.addon.core.imaging.texture_renders import render_texture
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.importers import read_cameras
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.photographs import Photograph
from farfield.addon.core.photos.settings import METHODS, PhotosSettings
from lib import command_line, scene_files
from lib.contact_sheet import write_png
from photos import unwrap_missing

DATA = environment.ROOT.parent / "shared" / "data" / "sceaux"


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = command_line.Parser(prog="bench_photos.py", description="Compare textures from photographs with the photographs.")
    parser.add_argument("--data", type=Path, default=DATA, help="folder with the cameras, images/ and the mesh")
    parser.add_argument("--mesh", default="mesh_15k.ply", help="name of the mesh")
    parser.add_argument("--size", type=int, default=2048, help="pixels per side of the texture")
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS), help="methods to compare")
    parser.add_argument("--sheets", type=Path, help="folder for photographs next to renders")
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Measure and return the results as JSON; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    if not given.data.is_dir():
        raise FileError(f'There is no folder "{given.data}"; name another one with --data.')
    photographs = [read_photograph(camera, given.data / "images") for camera in read_cameras(given.data)]
    scene_files.open_scene(given.data / given.mesh)
    objects = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    started = time.perf_counter()
    unwrap_missing(objects, line)
    figures: dict[str, Any] = {"triangles": 0, "unwrap_seconds": round(time.perf_counter() - started, 2), "methods": {}}
    surface = read_surface(read_instances(objects, bpy.context.evaluated_depsgraph_get()))
    figures["triangles"] = len(surface.mesh.triangles)
    for method in given.methods:
        started = time.perf_counter()
        result = run_to_end(merge(surface.mesh, surface.corner_uvs, photographs, PhotosSettings(size=given.size, method=method)), line.show)
        seconds = time.perf_counter() - started
        scores = [compare(surface.mesh, surface.corner_uvs, result.colors, each, given.sheets, method) for each in photographs]
        covered = np.count_nonzero(result.holes | (result.source >= 0))
        figures["methods"][method] = {
            "seconds": round(seconds, 2),
            "stages": {name: round(value, 2) for name, value in result.seconds.items()},
            "holes": round(float(np.count_nonzero(result.holes) / covered), 4),
            "mean_ssim": round(float(np.mean([score["ssim"] for score in scores])), 4),
            "mean_psnr": round(float(np.mean([score["psnr"] for score in scores])), 2),
            "photographs": scores,
        }
    line.clear()
    return json.dumps(figures | {"peak_memory_mb": round(command_line.peak_memory_mb(), 1)}, indent=1)


def compare(
    mesh: TriangleMesh, corner_uvs: np.ndarray, colors: np.ndarray, photograph: Photograph, sheets: Path | None, method: str
) -> dict[str, Any]:
    """Render a texture from the camera of a photograph and return the scores."""
    camera = photograph.camera
    positions, depths, is_valid = camera.project(mesh.vertices)
    kept = is_valid[mesh.triangles].all(axis=1)
    triangles = mesh.triangles[kept]
    image, covered = render_texture(positions[triangles], depths[triangles], corner_uvs[kept], colors, camera.lens.size)
    pixels = photograph.pixels.astype(np.float32) / 255.0
    composed = np.where(covered[..., None], image, pixels)
    rows, columns = np.nonzero(covered)
    box = (slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1))
    if sheets is not None:
        sheets.mkdir(parents=True, exist_ok=True)
        write_png(sheets / f"{Path(camera.name).stem}-{method}.png", np.concatenate([pixels, composed], axis=1))
    return {
        "name": camera.name,
        "ssim": round(ssim(pixels[box], composed[box]), 4),
        "psnr": round(psnr(pixels[covered], image[covered]), 2),
    }


if __name__ == "__main__":
    command_line.run(main)
