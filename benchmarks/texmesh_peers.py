"""Other programs that simplify textured meshes, for `bench_texmesh.py`: Blender's Decimate, gltfpack, and pymeshlab.

All get the same .obj. Programs run with the settings that their manuals recommend for textured meshes, and without the limits of error
that would keep them from the wanted number of triangles.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import texmesh_files

from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh

GLTFPACK = "FARFIELD_GLTFPACK"  # environment variable with the path of the program; by default it is searched for
MESHLAB_SCRIPT = """
import sys, pymeshlab
source, target, count = sys.argv[1:]
meshes = pymeshlab.MeshSet()
meshes.load_new_mesh(source)
meshes.{method}(targetfacenum=int(count), preserveboundary={boundary}, preservenormal=True)
meshes.save_current_mesh(target, save_textures=False)
"""
MESHLAB_PLAIN = "meshing_decimation_quadric_edge_collapse"
MESHLAB_TEXTURED = f"{MESHLAB_PLAIN}_with_texture"
TIMEOUT = 600.0  # seconds


@dataclass(frozen=True)
class PeerLevel:
    """A level by another program, None where it fails, with the seconds of its process or modifier. mesh: a TexturedMesh, or what a reader
    made of its file."""

    mesh: Any
    seconds: float
    message: str = ""


def simplify_in_blender(source: Path, _folder: Path, count: int) -> PeerLevel:
    """Simplify with the modifier Decimate, mode Collapse."""
    fine = texmesh_files.read_obj(source)
    mesh = bpy.data.meshes.new("peer")
    item = bpy.data.objects.new("peer", mesh)
    try:
        mesh.from_pydata(fine.vertices.tolist(), [], fine.triangles.tolist())
        mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", fine.corner_uvs.ravel().astype(np.float32))
        mesh.polygons.foreach_set("material_index", fine.materials)
        for _ in range(int(fine.materials.max()) + 1):
            mesh.materials.append(bpy.data.materials.new("peer"))
        bpy.context.scene.collection.objects.link(item)
        modifier = item.modifiers.new("Decimate", "DECIMATE")
        modifier.ratio, modifier.use_collapse_triangulate = count / len(fine.triangles), True
        started = time.perf_counter()
        evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
        result = evaluated.to_mesh()
        seconds = time.perf_counter() - started
        return PeerLevel(_read_blender_mesh(result), seconds)
    finally:
        bpy.data.objects.remove(item)
        bpy.data.meshes.remove(mesh)


def _read_blender_mesh(mesh: bpy.types.Mesh) -> TexturedMesh:
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    triangles, loops, materials = np.empty((count, 3), np.int32), np.empty((count, 3), np.int32), np.empty(count, np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles.ravel())
    mesh.loop_triangles.foreach_get("loops", loops.ravel())
    mesh.loop_triangles.foreach_get("material_index", materials)
    uvs = np.empty((len(mesh.loops), 2), np.float32)
    mesh.uv_layers[0].uv.foreach_get("vector", uvs.ravel())
    return build_textured_mesh(TriangleMesh(points.astype(float), triangles, materials), uvs[loops].astype(float), name="Blender")


def simplify_with_gltfpack(source: Path, folder: Path, count: int, flags: tuple[str, ...] = ()) -> PeerLevel:
    """Simplify with gltfpack, without quantization and without its limit of error."""
    return run_gltfpack(source, folder, count / _count_triangles(source), texmesh_files.read_glb, flags)


def run_gltfpack(source: Path, folder: Path, fraction: float, read: Callable[[Path], Any], flags: tuple[str, ...] = ()) -> PeerLevel:
    """Return what `read` returns of the .glb that `simplify_with_gltfpack` makes of an .obj or .glb, with a fraction of its triangles."""
    target = folder / "gltfpack.glb"
    program = os.environ.get(GLTFPACK, "gltfpack")
    command = [program, "-i", str(source), "-o", str(target), "-si", f"{fraction:.6f}", "-se", "1", "-noq", "-km", "-kv", *flags]
    return _run(command, target, read)


def simplify_with_meshlab(source: Path, folder: Path, count: int, boundary: bool = True, method: str = MESHLAB_TEXTURED) -> PeerLevel:
    """Simplify with the quadric edge collapse of pymeshlab, in the environment of the texture tools. method: the name of the filter."""
    target = folder / "meshlab.obj"
    root = Path(os.environ.get("FARFIELD_VENV", Path(__file__).resolve().parents[1] / ".venv"))
    python = root / "texture-tools" / "bin" / "python"
    script = MESHLAB_SCRIPT.format(method=method, boundary=boundary)
    return _run([str(python), "-c", script, str(source), str(target), str(count)], target, texmesh_files.read_obj)


def _count_triangles(source: Path) -> int:
    with source.open(encoding="ascii") as file:
        return sum(line.startswith("f ") for line in file)


def _run(command: list[str], target: Path, read: Callable[[Path], Any]) -> PeerLevel:
    if shutil.which(command[0]) is None:
        return PeerLevel(None, 0.0, f"{command[0]} is not installed")
    target.unlink(missing_ok=True)
    started = time.perf_counter()
    finished = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, cwd=target.parent, check=False)
    seconds = time.perf_counter() - started
    if finished.returncode != 0 or not target.exists():
        message = (finished.stderr or finished.stdout).strip().splitlines()[-1:] or [f"exit code {finished.returncode}"]
        print(command[0], message[0], file=sys.stderr)
        return PeerLevel(None, seconds, message[0])
    try:
        return PeerLevel(read(target), seconds)
    except GeometryError as error:
        return PeerLevel(None, seconds, str(error))


def simplify_permissively(source: Path, folder: Path, count: int) -> PeerLevel:
    """Simplify with gltfpack, across discontinuities of attributes."""
    return simplify_with_gltfpack(source, folder, count, ("-sp",))


def simplify_with_optimization(source: Path, folder: Path, count: int) -> PeerLevel:
    """Simplify with gltfpack, which then moves positions and attributes."""
    return simplify_with_gltfpack(source, folder, count, ("-sv",))


def simplify_permissively_with_optimization(source: Path, folder: Path, count: int) -> PeerLevel:
    """Simplify with gltfpack, across discontinuities of attributes, and with moved positions and attributes."""
    return simplify_with_gltfpack(source, folder, count, ("-sp", "-sv"))


PEERS: dict[str, Callable[[Path, Path, int], PeerLevel]] = {
    "blender": simplify_in_blender,
    "gltfpack -si": simplify_with_gltfpack,
    "gltfpack -si -sv": simplify_with_optimization,
    "gltfpack -si -sp": simplify_permissively,
    "gltfpack -si -sp -sv": simplify_permissively_with_optimization,
    "pymeshlab": simplify_with_meshlab,
}
