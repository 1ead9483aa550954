"""Part `bytes` of bench_packages.py: bytes until a model looks right, against gltfpack with WebP textures; time and memory.

Both are judged by the mean FLIP error of shaded renders, in random views, against the original mesh with the original textures. Farfield
uses default settings for images of the size that is judged; its bytes are those of the manifest (gzip), of the table of increments, and of
the mesh and a state of the textures of a row of the plan.
For the other side every combination of a ratio of triangles, a scale and a quality of the textures is tried, and the smallest that reaches
the error counts. Its geometry is measured before it is quantized.
"""

import gzip
import io
import json
import os
import subprocess
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import texmesh_files
from packages_views import VIEWS, TextureJudge, list_left_out, list_members, random_directions
from packages_webp import QUALITIES, encode_webp
from PIL import Image
from reference.mesh_decoding import decode_level, dequantize
from texmesh_models import JUDGING, TexturedModel, open_textured
from texmesh_peers import GLTFPACK, simplify_with_gltfpack

from farfield.addon.core.files.glb import Y_UP
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from farfield.addon.core.jobs.progress import Progress, run_to_end
from farfield.addon.core.packages.files import PackageContent
from farfield.addon.core.packages.increments import decode_increments
from farfield.addon.core.packages.manifest import MESH, TEXTURES, encode_manifest
from farfield.addon.core.packages.material_sources import MaterialSource
from farfield.addon.core.packages.package import Package, build_package
from farfield.addon.core.packages.planning import PlanRow
from farfield.addon.core.packages.settings import PackageSettings
from farfield.addon.core.packages.textures.coding import decode_textures
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from lib.command_line import peak_memory_mb

MAX_FLIP = 0.05
RATIOS = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1)
SCALES = (1.0, 0.5, 0.25)


class WebpTextures:
    """The textures of a model as WebP, coded when they are needed first: all meshes are tried with them."""

    def __init__(self, images: Sequence[np.ndarray | None]) -> None:
        self._images = images
        self._files: dict[tuple[int, float, int], bytes] = {}

    def encode(self, scale: float, quality: int) -> tuple[int, list[np.ndarray | None]]:
        """Return the bytes of all textures, each counted once, and the decoded pixels of each material."""
        distinct = {id(image): image for image in self._images if image is not None}
        files = {key: self._encode(image, scale, quality) for key, image in distinct.items()}
        pixels = {key: np.asarray(Image.open(io.BytesIO(file)).convert("RGB"))[::-1].copy() for key, file in files.items()}
        return sum(map(len, files.values())), [None if image is None else pixels[id(image)] for image in self._images]

    def _encode(self, image: np.ndarray, scale: float, quality: int) -> bytes:
        key = id(image), scale, quality
        if key not in self._files:
            picture = Image.fromarray(image[::-1])
            if scale != 1.0:
                picture = picture.resize([max(1, round(side * scale)) for side in picture.size], Image.Resampling.LANCZOS)
            self._files[key] = encode_webp(np.asarray(picture), quality)
        return self._files[key]


class Reached(NamedTuple):
    """Bytes of mesh and textures with which an error is reached, and the error."""

    mesh: int
    textures: int
    flip: float
    how: str

    @property
    def total(self) -> int:
        return self.mesh + self.textures


def measure_bytes(given: Namespace) -> dict[str, Any]:
    """Return for each model the bytes of both sides, and their ratio."""
    names = [*JUDGING, f"planet:{given.seed}", f"ring:{given.seed + 1}"]
    results: dict[str, Any] = {}
    model, opened = None, ""
    for name, pixels in list_members(given, names):
        if name != opened:
            model, opened = open_textured(given.data, name, given.seed), name
        started = time.perf_counter()
        result = _measure_model(model, name, pixels, np.random.default_rng([given.seed, pixels, 77]))
        results[f"{name} at {pixels}"] = result | {"all_seconds": round(time.perf_counter() - started, 1)}
        print(name, pixels, json.dumps(results[f"{name} at {pixels}"]), file=sys.stderr)
    ratios = [item["ratio"] for item in results.values() if item["ratio"] is not None]
    return {
        "models": results,
        "left_out": list_left_out(given, names, results),
        "mean_ratio": float(np.mean(ratios)) if ratios else None,
        "worst_ratio": max(ratios, default=None),
    }


def _measure_model(model: TexturedModel, name: str, pixels: int, generator: np.random.Generator) -> dict[str, Any]:
    directions = random_directions(VIEWS[pixels], generator)
    started, started_cpu = time.perf_counter(), time.process_time()
    package = build(model, name, pixels)
    seconds, cpu = time.perf_counter() - started, time.process_time() - started_cpu
    judge = TextureJudge(model.mesh, model.images, directions, pixels)
    ours, table = _search_plan(package, judge)
    peer = _search_peer(model, judge)
    return {
        "ours": None if ours is None else ours._asdict() | {"total": ours.total},
        "peer": None if peer is None else peer._asdict() | {"total": peer.total},
        "ratio": None if ours is None or peer is None else ours.total / peer.total,
        "rows": table,
        "levels": package.report.levels,
        "errors_of_levels": package.report.table.level_errors.tolist(),
        "states": package.report.table.states.tolist(),
        "errors_of_states": package.report.table.texture_errors.tolist(),
        "state_bytes": _open(package).increments.measure_states(package.manifest.state_count),
        "mesh_bytes": [package.manifest.mesh_size(level) for level in range(len(package.manifest.levels))],
        "seconds": round(seconds, 2),
        "cpu_seconds": round(cpu, 2),
        "peak_memory_mb": round(peak_memory_mb(), 1),
    }


def build(
    model: TexturedModel, name: str, pixels: int = PackageSettings.pixels, on_progress: Callable[[Progress], None] | None = None
) -> Package:
    """Return the package of a model with default settings, for images of `pixels` pixels."""
    materials = [
        MaterialSource(f"m{index}", (1.0, 1.0, 1.0, 1.0), False, {} if image is None else {"base_color": image})
        for index, image in enumerate(model.images)
    ]
    linear = {id(image): LINEAR_OF_BYTE[image] for image in model.images if image is not None}
    textures = [None if image is None else linear[id(image)] for image in model.images]
    settings = TexmeshSettings(vertices="original")
    return run_to_end(build_package(name, model.mesh, materials, textures, settings, PackageSettings(pixels=pixels)), on_progress)


def _open(package: Package) -> PackageContent:
    manifest, textures = package.manifest, package.contents[TEXTURES]
    increments = decode_increments(manifest.increments.read(textures, TEXTURES), manifest)
    return PackageContent(manifest, increments, package.contents[MESH], textures)


def _search_plan(package: Package, judge: TextureJudge) -> tuple[Reached | None, list[dict[str, Any]]]:
    """Return the first row of the plan that reaches MAX_FLIP, by bisection, and the predicted and measured errors of the rows tried."""
    content = _open(package)
    plan, tried = package.report.plan, {}
    extra = len(gzip.compress(encode_manifest(content.manifest), 9)) + content.manifest.increments.size

    def measure(row: PlanRow) -> float:
        images = decode_textures(
            content.manifest.textures,
            content.increments,
            memoryview(content.textures)[content.manifest.first_increment :],
            row.state,
        )
        by_material = [
            images[item.textures["base_color"]] if "base_color" in item.textures else None for item in content.manifest.materials
        ]
        tried[row] = judge.measure_flip(by_material, _decode_mesh(content, row.level))
        return tried[row]

    low, high = 0, len(plan) - 1
    if measure(plan[high]) > MAX_FLIP:
        return None, _list_rows(tried)
    while low < high:
        center = (low + high) // 2
        low, high = (low, center) if measure(plan[center]) <= MAX_FLIP else (center + 1, high)
    row = plan[high]
    mesh = content.manifest.mesh_size(row.level)
    return Reached(mesh, row.byte_count - mesh + extra, tried[row], f"level {row.level}, state {row.state}"), _list_rows(tried)


def _list_rows(tried: dict[PlanRow, float]) -> list[dict[str, Any]]:
    rows = sorted(tried, key=lambda row: row.byte_count)
    return [
        {"bytes": row.byte_count, "level": row.level, "state": row.state, "predicted": row.error, "measured": tried[row]} for row in rows
    ]


def _decode_mesh(content: PackageContent, level: int) -> TexturedMesh:
    decoded = decode_level(content.mesh, content.manifest, level)
    positions = dequantize(decoded.positions, content.manifest.bounds, content.manifest.steps[0]).astype(np.float64) @ Y_UP
    uvs = dequantize(decoded.uvs, content.manifest.uv_bounds, content.manifest.steps[1]).astype(np.float64) * [1.0, -1.0] + [0.0, 1.0]
    mesh = TriangleMesh(positions, decoded.wedge_vertices[decoded.triangles], decoded.materials)
    return build_textured_mesh(mesh, uvs[decoded.triangles], name="package")


def _search_peer(model: TexturedModel, judge: TextureJudge) -> Reached | None:
    """Return the smallest gltfpack mesh with WebP textures that reaches MAX_FLIP."""
    best, textures = None, WebpTextures(model.images)
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "model.obj"
        texmesh_files.write_obj(source, model.mesh, {})
        for ratio in RATIOS:
            count = max(int(ratio * len(model.mesh.triangles)), 4)
            level = simplify_with_gltfpack(source, Path(folder), count).mesh if ratio < 1.0 else model.mesh
            if level is None or judge.measure_flip(model.images, level) > MAX_FLIP:
                break
            size = _packed_size(source, Path(folder), ratio)
            found = _search_textures(textures, level, judge, None if best is None else best.total - size)
            if found is not None and (best is None or size + found.textures < best.total):
                best = Reached(size, found.textures, found.flip, f"ratio {ratio:g}, {found.how}")
    return best


def _packed_size(source: Path, folder: Path, ratio: float) -> int:
    """Return the bytes of the quantized and compressed mesh without textures, as a server sends them."""
    target = folder / "packed.glb"
    flags = [] if ratio >= 1.0 else ["-si", f"{ratio:.6f}", "-se", "1"]
    program = os.environ.get(GLTFPACK, "gltfpack")
    subprocess.run([program, "-i", str(source), "-o", str(target), "-cc", "-km", "-kv", *flags], check=True, capture_output=True)
    content = target.read_bytes()
    return min(len(content), len(gzip.compress(content, 9)))


def _search_textures(textures: WebpTextures, level: TexturedMesh, judge: TextureJudge, limit: int | None) -> Reached | None:
    """Return the smallest WebP textures, all of one scale and quality, that reach MAX_FLIP on `level` with at most `limit` bytes."""
    best = None
    for scale in SCALES:
        low, high = 0, len(QUALITIES)
        while low < high:
            center = (low + high) // 2
            size, decoded = textures.encode(scale, QUALITIES[center])
            ceiling = min((item for item in (limit, None if best is None else best.textures) if item is not None), default=None)
            if ceiling is not None and size >= ceiling:
                high = center
                continue
            flip = judge.measure_flip(decoded, level)
            if flip <= MAX_FLIP:
                best, high = Reached(0, size, flip, f"scale {scale:g}, quality {QUALITIES[center]}"), center
            else:
                low = center + 1
    return best
