"""The decoder of meshes in the page: it gives the arrays of the one in Python, bit by bit, and refuses what is damaged."""

import base64
import json
import shutil
import subprocess
from dataclasses import astuple
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from packed_meshes import SECTIONS, make_random_mesh, order_with_levels, pack, read_section, replace_section
from reference.mesh_decoding import decode_level, dequantize

from farfield.addon.core import packages
from farfield.addon.core.errors import FileError
from textured_models import cube, torus

pytestmark = pytest.mark.once
DECODER = Path(packages.__file__).parent / "page" / "mesh_decoding.js"
RUNNER = """
import { readFileSync } from "node:fs";
const { decodeLevel } = await import(process.argv[2]);
const toBase64 = (values) => Buffer.from(values.buffer).toString("base64");
const results = [];
for (const { manifest, mesh, missing } of JSON.parse(readFileSync(process.argv[3]))) {
  const content = new Uint8Array(Buffer.from(mesh, "base64"));
  const levels = [];
  try {
    let decoded;
    for (const [index, level] of manifest.levels.entries()) {
      const sections = {};
      for (const name of ["corners", "wedges", "parents", "positions", "uvs"]) {
        const [offset, size] = level[name];
        sections[name] = name === "positions" && index === missing ? null : content.subarray(offset, offset + size);
      }
      decoded = await decodeLevel(manifest, index, sections, decoded);
      const { positions, uvs, wedges, corners, parents } = decoded;
      const arrays = Object.entries({ positions, uvs, wedges, corners, parents });
      levels.push(Object.fromEntries(arrays.map(([name, values]) => [name, toBase64(values)])));
    }
    results.push(levels);
  } catch (error) {
    results.push(error.constructor.name);
  }
}
console.log(JSON.stringify(results));
"""
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed, so the decoder of the page is not run")


def make_case(content: bytes, manifest: SimpleNamespace, missing: int = -1) -> dict[str, Any]:
    levels = [
        vars(level) | {name: astuple(getattr(level, name)) for name in SECTIONS} | {"triangle_counts": level.triangle_counts}
        for level in manifest.levels
    ]
    described = {"levels": levels, "bounds": manifest.bounds, "uv_bounds": manifest.uv_bounds, "steps": manifest.steps}
    return {"manifest": described, "mesh": base64.b64encode(content).decode(), "missing": missing}


def run(cases: list[dict[str, Any]], folder: Path) -> list[Any]:
    """Return the levels of each case, or the name of the error."""
    (folder / "runner.mjs").write_text(RUNNER, encoding="utf-8")
    (folder / "cases.json").write_text(json.dumps(cases), encoding="utf-8")
    command = ["node", str(folder / "runner.mjs"), DECODER.as_uri(), str(folder / "cases.json")]
    outcome = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert outcome.returncode == 0, outcome.stderr
    return json.loads(outcome.stdout)


def describe(content: bytes, manifest: SimpleNamespace, missing: int = -1) -> list[dict[str, str]]:
    """Return what the page must give."""
    levels = []
    for index in range(len(manifest.levels)):
        level = decode_level(content, manifest, index, () if missing < 0 else (missing,))
        arrays = {
            "positions": dequantize(level.positions, manifest.bounds, manifest.steps[0]),
            "uvs": dequantize(level.uvs, manifest.uv_bounds, manifest.steps[1]),
            "wedges": level.wedge_vertices,
            "corners": level.triangles,
            "parents": level.parents,
        }
        levels.append({name: base64.b64encode(array.tobytes()).decode() for name, array in arrays.items()})
    return levels


@pytest.mark.slow
@needs_node
def test_the_page_decodes_the_same_arrays(tmp_path):
    meshes = [torus(has_materials=True), cube(), *(make_random_mesh(seed) for seed in range(2))]
    packed = [pack(order_with_levels(mesh)[1]) for mesh in meshes]
    cases = [make_case(*item, missing) for item in packed for missing in (-1, 1)]
    expected = [describe(*item, missing) for item in packed for missing in (-1, 1)]
    for found, levels in zip(run(cases, tmp_path), expected, strict=True):
        assert found == levels


@pytest.mark.slow
@needs_node
def test_the_page_refuses_what_python_refuses(tmp_path):
    random = np.random.default_rng(0)
    packed = pack(order_with_levels(torus(16, 12, 4, has_materials=True))[1])
    cases, expected = [], []
    for _ in range(60):
        level, name = int(random.integers(len(packed[1].levels))), SECTIONS[random.integers(len(SECTIONS))]
        part = bytearray(read_section(*packed, level, name))
        if part:
            part[random.integers(len(part))] = random.integers(256)
        changed = replace_section(*packed, level, name, bytes(part))
        cases.append(make_case(*changed))
        try:
            expected.append(describe(*changed))
        except FileError:
            expected.append("RangeError")
    assert run(cases, tmp_path) == expected
    assert 6 < expected.count("RangeError") < 54


@pytest.mark.slow
@needs_node
def test_the_page_bounds_what_it_allocates(tmp_path):
    content, manifest = pack(order_with_levels(torus(16, 12, 4))[1])
    bombs = [replace_section(content, manifest, 0, name, bytes(10**6)) for name in SECTIONS]
    lies = []
    for change in ({"vertex_count": 2**40}, {"wedge_count": 2**40}, {"triangle_counts": (2**40, 0, 0)}):
        level = type(manifest.levels[0])(**vars(manifest.levels[0]) | change)
        lies.append((content, SimpleNamespace(levels=(level,), bounds=manifest.bounds, uv_bounds=manifest.uv_bounds, steps=manifest.steps)))
    noise = bytes(np.random.default_rng(0).integers(0, 256, len(content), np.uint8))
    cases = [*bombs, *lies, (noise, manifest), (content[:-1], manifest), (b"", manifest)]
    assert run([make_case(*case) for case in cases], tmp_path) == ["RangeError"] * len(cases)
