"""Meshes and photographs for `bench_photos.py`: the castle of Sceaux, and models in two sets, of which only one was used for tuning."""

from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np
from photos_models import make_knot, make_rock

from farfield.addon.bridge.geometry.meshes import concatenate_in_world_space, read_instances
from farfield.addon.bridge.photos.photo_files import read_photograph
from farfield.addon.bridge.photos.photo_folders import PhotoFolder
from farfield.addon.core.errors import FileError
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.importers import read_cameras
from farfield.addon.core.photos.photographs.photograph import Photograph
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.core.unwrap.unwrapping import unwrap
from lib import scene_files

SETS = {"tuning": ("bunny", "cowhead"), "judging": ("spot", "blub", "max_planck", "knot", "rock")}
FILES = {
    "bunny": "meshes/stanford_bunny.obj",
    "cowhead": "meshes/bff_cowhead.obj",
    "spot": "textured/spot/spot.obj",
    "blub": "textured/blub/blub.glb",
    "max_planck": "meshes/max_planck.obj",
}
GENERATED = {"knot": make_knot, "rock": make_rock}


class Unwrapped(NamedTuple):
    """A mesh and its UVs (T, 3, 2) float32."""

    mesh: TriangleMesh
    corner_uvs: np.ndarray


def load_model(name: str, data: Path, random: np.random.Generator) -> Unwrapped:
    """Return a model by name, read from the folder `data` or generated; unwrapped, since peers refuse UV maps with flipped triangles."""
    if name in GENERATED:
        return unwrap_mesh(GENERATED[name](random))
    return unwrap_mesh(read_mesh(data / FILES[name]))


def load_photographs(data: Path) -> list[Photograph]:
    """Return the photographs of Sceaux."""
    folder = data / "sceaux"
    images = PhotoFolder(folder / "images")
    return [read_photograph(camera, images) for camera in read_cameras(folder)]


def read_mesh(path: Path) -> TriangleMesh:
    """Return the mesh of a file with the axes of the file; raises FileError if it is missing."""
    if not path.is_file():
        raise FileError(f'There is no file "{path}"; name the folder with the data by --data.')
    scene_files.open_scene(path)
    objects = [item for item in bpy.context.scene.objects if item.type == "MESH"]
    for item in objects:
        item.matrix_world.identity()
    return concatenate_in_world_space(read_instances(objects, bpy.context.evaluated_depsgraph_get()))


def unwrap_mesh(mesh: TriangleMesh) -> Unwrapped:
    """Return the mesh with the UV map of the tool `unwrap`."""
    count = len(mesh.triangles)
    result = run_to_end(unwrap(mesh, np.arange(count), np.zeros((0, 2), np.int32), np.zeros(count), UnwrapSettings()))
    return Unwrapped(mesh, result.corner_uvs.astype(np.float32))
