"""Validate the .glb files of Farfield with the Khronos validator, and measure how much smaller quantized files are.

    python3 benchmarks/texmesh_glb.py --validator FOLDER [--report glb.json] [FILE.glb ...]

FOLDER contains `node_modules/gltf-validator`, the npm package gltf-validator; Node.js runs it. Without FILEs, generated meshes are written
plain and quantized: a textured sphere with all attributes, texture coordinates outside of 0..1, several materials, and levels of detail.
FILEs are validated as they are. Exit code 1 if a file has an error or a warning.
"""

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
from lib import environment

environment.ensure()

import numpy as np

environment.import_farfield()

from farfield.addon.core.files.glb import Document, save_glb
from farfield.addon.core.files.glb_levels import FULL, LevelNode, arrange_levels
from farfield.addon.core.files.temporary_folders import temporary_folder
from farfield.addon.core.imaging.coded_images import encode

VALIDATE = """
const validator = require(process.argv[1] + '/node_modules/gltf-validator');
const content = new Uint8Array(require('fs').readFileSync(process.argv[2]));
validator.validateBytes(content).then(report => console.log(JSON.stringify(report.issues)));
"""


def make_sphere(rings: int, material: int | None, uv_scale: float = 1.0, has_all: bool = True) -> Document:
    """Return a UV sphere with normals, texture coordinates 0..`uv_scale`, or with positions only."""
    polar, azimuth = np.meshgrid(np.linspace(0.0, np.pi, rings + 1), np.linspace(0.0, 2.0 * np.pi, 2 * rings + 1), indexing="ij")
    normals = np.stack([np.sin(polar) * np.cos(azimuth), np.cos(polar), np.sin(polar) * np.sin(azimuth)], axis=2).reshape(-1, 3)
    uvs = uv_scale * np.stack([azimuth / (2.0 * np.pi), 1.0 - polar / np.pi], axis=2).reshape(-1, 2)
    first = (np.arange(rings)[:, None] * (2 * rings + 1) + np.arange(2 * rings)).ravel()
    below = first + 2 * rings + 1
    triangles = np.concatenate([np.stack([first, first + 1, below], axis=1), np.stack([first + 1, below + 1, below], axis=1)])
    points = normals * (1.0 + 0.1 * np.sin(9.0 * azimuth.reshape(-1, 1)) * np.sin(polar.reshape(-1, 1)))
    is_degenerate = np.linalg.norm(np.cross(*(points[triangles[:, k]] - points[triangles[:, 0]] for k in (1, 2))), axis=1) < 1e-12
    triangles = triangles[~is_degenerate]
    attributes = {"POSITION": points, **({"NORMAL": normals, "TEXCOORD_0": uvs} if has_all else {})}
    return {"attributes": attributes, "indices": triangles.ravel(), **({} if material is None else {"material": material})}


def make_document(image: bytes, *meshes: list[Document]) -> Document:
    """Return a document with meshes of primitives."""
    painted = {"name": "painted", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0}}
    plain = {"name": "plain", "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.2, 0.1, 1.0]}, "doubleSided": True}
    return {
        "nodes": [{"name": str(index), "mesh": index} for index in range(len(meshes))],
        "meshes": [{"primitives": parts} for parts in meshes],
        "materials": [painted, plain],
        "textures": [{"source": 0}],
        "images": [{"content": image}],
    }


def make_scenes() -> dict[str, tuple[Document, list[LevelNode]]]:
    """Return documents by name, with their nodes."""
    image = encode(np.random.default_rng(1).integers(0, 255, (64, 64, 3)).astype(np.uint8), "png")
    photo = encode(np.full((64, 64, 3), 90, np.uint8), "jpeg")
    bounds, moved = np.array([[-1.1] * 3, [1.1] * 3]), np.eye(4)
    moved[:3, 3] = [1.0, 2.0, 3.0]
    parts = [make_sphere(20, 0), make_sphere(12, 1), make_sphere(9, None, has_all=False)]
    nodes = [LevelNode(str(index), name, bounds, np.eye(4)) for index, name in enumerate(("fine", "medium", "coarse"))]
    nodes[0] = LevelNode("0", "fine", bounds, np.eye(4), (1, 2), (0.2, 0.02, 0.0001))
    one = [LevelNode("0", "object", bounds, moved)]
    return {
        "sphere": (make_document(image, [make_sphere(48, 0)]), one),
        "repeated texture": (make_document(photo, [make_sphere(48, 0, 3.0)]), one),
        "several materials": (make_document(image, parts), one),
        "levels": (make_document(image, *([make_sphere(rings, 0)] for rings in (48, 24, 12))), nodes),
        "long indices": (make_document(image, [make_sphere(200, 0)]), one),
    }


def validate(path: Path, folder: Path) -> dict[str, Any]:
    """Return the numbers of issues that the validator finds, and their messages."""
    node = shutil.which("node")
    if node is None:
        print("Node.js is needed to run the validator; install it.", file=sys.stderr)
        sys.exit(2)
    outcome = subprocess.run([node, "-e", VALIDATE, str(folder.absolute()), str(path)], capture_output=True, text=True, check=False)
    if outcome.returncode:
        print(f"The validator failed: {outcome.stderr.strip()}", file=sys.stderr)
        sys.exit(2)
    issues = json.loads(outcome.stdout)
    messages = sorted({f"{issue['code']}: {issue['message']} {issue.get('pointer', '')}" for issue in issues["messages"]})
    return {"errors": issues["numErrors"], "warnings": issues["numWarnings"], "infos": issues["numInfos"], "messages": messages[:10]}


def validate_scenes(validator: Path) -> dict[str, Any]:
    """Return the sizes and issues of all scenes, plain and quantized."""
    results = {}
    with temporary_folder() as folder:
        for is_quantized in (False, True):
            for name, (document, nodes) in make_scenes().items():
                path = folder / f"{len(results)}.glb"
                path.write_bytes(save_glb(arrange_levels(document, nodes, FULL if is_quantized else None, {})))
                label = f"{name}, {'quantized' if is_quantized else 'plain'}"
                results[label] = {"bytes": path.stat().st_size, **validate(path, validator)}
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE.glb")
    parser.add_argument("--validator", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--report", type=Path)
    arguments = parser.parse_args()
    results = [{"name": str(path), "bytes": path.stat().st_size, **validate(path, arguments.validator)} for path in arguments.files]
    if not arguments.files:
        results = [{"name": name, **result} for name, result in validate_scenes(arguments.validator).items()]
    for result in results:
        print(
            f"{result['name']}: {result['bytes']} bytes, {result['errors']} errors, {result['warnings']} warnings, {result['infos']} infos"
        )
        for message in result["messages"]:
            print(f"    {message}")
    if arguments.report is not None:
        arguments.report.write_text(json.dumps(results, indent=1), encoding="utf-8")
    if any(result["errors"] or result["warnings"] for result in results):
        sys.exit(1)


if __name__ == "__main__":
    main()
