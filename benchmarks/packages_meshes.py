"""Part `meshes` of bench_packages.py: bytes of the meshes of packages compared with those of gltfpack and Draco, time, and estimated
positions.

All get the same triangles with texture coordinates, without normals, and 16 bits per coordinate. `gltfpack` is the finest level alone, and
gzip as a server would compress it. With `-noq` it keeps 32-bit floating-point numbers, of which meshopt removes less. Draco is used if
FARFIELD_DRACO3D is a folder with node_modules/draco3d. Neither keeps coarser levels; `prefix` are the bytes of all levels of a package.
"""

import gzip
import json
import os
import shutil
import subprocess
import sys
import time
from argparse import Namespace
from dataclasses import astuple
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import photos_inputs
import texmesh_files
from reference.mesh_decoding import decode_level
from texmesh_models import generate_ring, open_model, unwrap_triangles
from texmesh_peers import GLTFPACK

from farfield.addon.core import packages
from farfield.addon.core.files.temporary_folders import temporary_folder
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.packages.manifest import MAX_STEPS
from farfield.addon.core.packages.mesh.coding import encode_mesh
from farfield.addon.core.packages.mesh.order import OrderedMesh, order_mesh
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.levels import Simplification, simplify_by_cost
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

MODELS = ("spot", "blub", "bunny", "castle", "fuze")
CASTLE = "sceaux/mesh_15k.ply"
RING_GRID = (106, 53)  # cells of a patch: 202,248 triangles
RATIOS = (0.4, 0.16, 0.064, 0.0256)  # Fractions of the triangles in coarser levels.
DRACO = "FARFIELD_DRACO3D"
PAGE_DECODER = Path(packages.__file__).parent / "page" / "mesh_decoding.js"
REPEATS = 6
GLTFPACK_FLAGS = {
    "gltfpack -c": ("-c", "-vp", "16", "-vt", "16"),
    "gltfpack -cc": ("-cc", "-vp", "16", "-vt", "16"),
    "gltfpack -cc -noq": ("-cc", "-noq"),
}
DRACO_SCRIPT = """
const draco = require(process.argv[1] + '/node_modules/draco3d');
const fs = require('fs');
const { vertices, positions, uvs, triangles } = JSON.parse(fs.readFileSync(process.argv[2]));
draco.createEncoderModule({}).then((module) => {
  const encoder = new module.Encoder(), builder = new module.MeshBuilder(), mesh = new module.Mesh();
  builder.AddFacesToMesh(mesh, triangles.length / 3, new Uint32Array(triangles));
  builder.AddFloatAttributeToMesh(mesh, module.POSITION, vertices, 3, new Float32Array(positions));
  builder.AddFloatAttributeToMesh(mesh, module.TEX_COORD, vertices, 2, new Float32Array(uvs));
  encoder.SetSpeedOptions(0, 0);
  encoder.SetAttributeQuantization(module.POSITION, 16);
  encoder.SetAttributeQuantization(module.TEX_COORD, 16);
  encoder.SetEncodingMethod(module.MESH_EDGEBREAKER_ENCODING);
  console.log(encoder.EncodeMeshToDracoBuffer(mesh, new module.DracoInt8Array()));
});
"""
PAGE_SCRIPT = """
import { readFileSync } from "node:fs";
const { decodeLevel } = await import(process.argv[2]);
const manifest = JSON.parse(readFileSync(process.argv[3])), content = new Uint8Array(readFileSync(process.argv[4]));
const seconds = [];
for (let repeat = 0; repeat < Number(process.argv[5]); repeat++) {
  let mesh;
  const levels = [];
  for (const [index, level] of manifest.levels.entries()) {
    const names = ["corners", "wedges", "parents", "positions", "uvs"];
    const sections = Object.fromEntries(names.map((name) => [name, content.subarray(level[name][0], level[name][0] + level[name][1])]));
    const start = process.cpuUsage();
    mesh = await decodeLevel(manifest, index, sections, mesh);
    const { user, system } = process.cpuUsage(start);
    levels.push((user + system) / 1e6);
  }
  seconds.push(levels);
}
console.log(JSON.stringify(seconds));
"""


def measure_meshes(given: Namespace) -> dict[str, Any]:
    """Return bytes and seconds by model."""
    results = {}
    for name in given.models or (*MODELS, f"large ring:{given.seed}"):
        results[name] = measure_model(_open(given.data, name))
        print(name, json.dumps(results[name]), file=sys.stderr)
    return results


def measure_model(mesh: TexturedMesh) -> dict[str, Any]:
    """Return bytes of a mesh alone, of all its levels, and by other programs; CPU seconds; and errors of estimated positions."""
    targets = [max(round(ratio * len(mesh.triangles)), 4) for ratio in RATIOS]
    result = run_to_end(simplify_by_cost(mesh, None, targets, TexmeshSettings()))
    material_count = int(mesh.materials.max()) + 1
    started = time.process_time()
    ordered = order_mesh(mesh, result.levels, result)
    content, levels, bounds, uv_bounds = encode_mesh(ordered, (0.0,) * len(ordered.levels), material_count)
    encoded = time.process_time()
    manifest = SimpleNamespace(levels=levels, bounds=bounds, uv_bounds=uv_bounds, steps=(MAX_STEPS, MAX_STEPS))
    decode_level(content, manifest, len(levels) - 1)
    decoded = time.process_time()
    nothing = np.zeros(0, np.int32)
    alone = order_mesh(mesh, [], Simplification((), nothing, nothing, np.zeros(0)))
    alone_size = len(encode_mesh(alone, (0.0,), material_count)[0])
    names = ("corners", "wedges", "parents", "positions", "uvs")
    with temporary_folder() as folder:
        peers = _measure_peers(mesh, folder)
        page = _measure_page(content, manifest, folder)
    best = peers.get("gltfpack -cc", {}).get("gzip")
    return {
        "triangles": len(mesh.triangles),
        "vertices": len(mesh.vertices),
        "wedges": len(ordered.uvs),
        "prefix": len(content),
        "prefix_per_vertex": round(len(content) / len(mesh.vertices), 2),
        "prefix_per_triangle": round(len(content) / len(mesh.triangles), 2),
        "finest_alone": alone_size,
        "sections": {name: sum(getattr(level, name).size for level in levels) for name in names},
        "level_sizes": [level.size for level in levels],
        **peers,
        "prefix_to_gltfpack": None if best is None else round(len(content) / best, 3),
        "alone_to_gltfpack": None if best is None else round(alone_size / best, 3),
        "encoding_cpu_seconds": round(encoded - started, 2),
        "decoding_cpu_seconds": round(decoded - encoded, 2),
        **page,
        "estimated": _measure_estimates(content, manifest, ordered),
    }


def _open(data: Path, name: str) -> TexturedMesh:
    if name == "castle":
        mesh = photos_inputs.read_mesh(data / CASTLE)
        return unwrap_triangles(TriangleMesh(mesh.vertices, mesh.triangles), name)
    if name.startswith("large ring:"):
        return generate_ring(np.random.default_rng(int(name.split(":")[1])), RING_GRID)
    return open_model(data, name)


def _measure_peers(mesh: TexturedMesh, folder: Path) -> dict[str, Any]:
    """Return bytes of other programs, plain and compressed by gzip."""
    results = {}
    source, target = folder / "mesh.obj", folder / "packed.glb"
    texmesh_files.write_obj(source, mesh, {})
    program = os.environ.get(GLTFPACK, "gltfpack")
    for name, flags in GLTFPACK_FLAGS.items() if shutil.which(program) else ():
        subprocess.run([program, "-i", str(source), "-o", str(target), "-km", "-kv", *flags], check=True, capture_output=True)
        packed = target.read_bytes()
        results[name] = {"bytes": len(packed), "gzip": len(gzip.compress(packed, 9))}
    draco, node = os.environ.get(DRACO), shutil.which("node")
    if draco and node:
        indices = {
            "vertices": len(mesh.uvs),
            "positions": mesh.vertices[mesh.wedge_vertices].ravel().tolist(),
            "uvs": mesh.uvs.ravel().tolist(),
            "triangles": mesh.wedge_triangles.ravel().tolist(),
        }
        (folder / "mesh.json").write_text(json.dumps(indices), encoding="ascii")
        outcome = subprocess.run([node, "-e", DRACO_SCRIPT, draco, str(folder / "mesh.json")], check=True, capture_output=True, text=True)
        results["draco"] = int(outcome.stdout)
    return results


def _measure_page(content: bytes, manifest: SimpleNamespace, folder: Path) -> dict[str, Any]:
    """Return the CPU seconds of the page's decoder for all levels and for the finest one, the least of the later runs."""
    node = shutil.which("node")
    if node is None:
        return {}
    names = ("corners", "wedges", "parents", "positions", "uvs")
    levels = [vars(level) | {name: astuple(getattr(level, name)) for name in names} for level in manifest.levels]
    (folder / "manifest.json").write_text(json.dumps(vars(manifest) | {"levels": levels}), encoding="ascii")
    (folder / "mesh.bin").write_bytes(content)
    (folder / "decode.mjs").write_text(PAGE_SCRIPT, encoding="ascii")
    command = [node, folder / "decode.mjs", PAGE_DECODER.as_uri(), folder / "manifest.json", folder / "mesh.bin", str(REPEATS)]
    seconds = np.array(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
    return {
        "page_first_run_cpu_seconds": round(float(seconds[0].sum()), 3),
        "page_all_levels_cpu_seconds": round(float(seconds[1:].sum(axis=1).min()), 3),
        "page_finest_level_cpu_seconds": round(float(seconds[1:, -1].min()), 3),
    }


def _measure_estimates(content: bytes, manifest: SimpleNamespace, ordered: OrderedMesh) -> list[dict[str, float]]:
    """Return for each level but the coarsest the mean distance of its added vertices from the truth, divided by the diagonal of the bounds,
    if its positions are estimated, and if they are those of the parents."""
    low, high = (np.array(bound) for bound in manifest.bounds)
    results = []
    for index in range(1, len(manifest.levels)):
        exact, estimated = decode_level(content, manifest, index), decode_level(content, manifest, index, (index,))
        added = slice(manifest.levels[index - 1].vertex_count, None)
        true = exact.positions[added].astype(float)
        scale = (high - low) / 65535 / np.linalg.norm(high - low)
        guesses = {"estimate": estimated.positions[added], "parent": exact.positions[ordered.parents[added][: len(true)]]}
        results.append({name: round(float(np.linalg.norm((guess - true) * scale, axis=1).mean()), 6) for name, guess in guesses.items()})
    return results
