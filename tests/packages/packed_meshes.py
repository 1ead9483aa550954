"""Meshes of packages for tests: random ones, and sections that are changed but have right checksums."""

import zlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.packages.manifest import MAX_STEPS, MeshLevel, Section
from farfield.addon.core.packages.mesh.coding import encode_mesh
from farfield.addon.core.packages.mesh.order import OrderedMesh, order_mesh
from farfield.addon.core.packages.mesh.sections import deflate
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.levels import Simplification, simplify_by_cost
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh

SECTIONS = ("corners", "wedges", "parents", "positions", "uvs")


def make_random_mesh(seed: int) -> TexturedMesh:
    """Return triangles between random vertices: edges with many triangles, seams, degenerate UVs, three materials."""
    random = np.random.default_rng(seed)
    count = random.integers(4, 30)
    triangles = random.integers(0, count, (random.integers(3, 100), 3)).astype(np.int32)
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    triangles = np.concatenate([triangles, [[0, 1, 2]]]).astype(np.int32)
    has_few_uvs = random.uniform() < 0.5
    uvs = random.integers(0, 3, (len(triangles), 3, 2)) / 3.0 if has_few_uvs else random.uniform(size=(count, 2))[triangles]
    materials = random.integers(0, 3, len(triangles)).astype(np.int32)
    return build_textured_mesh(TriangleMesh(random.normal(size=(count, 3)), triangles, materials), uvs)


def order_with_levels(mesh: TexturedMesh, percents: tuple[int, ...] = (40, 15, 5)) -> tuple[Simplification, OrderedMesh]:
    """Return levels with so many percent of the triangles, and the numbering of the mesh."""
    targets = [max(len(mesh.triangles) * percent // 100, 1) for percent in percents]
    result = run_to_end(simplify_by_cost(mesh, None, targets, TexmeshSettings(vertices="original")))
    return result, order_mesh(mesh, [level for level in result.levels if len(level.triangles)], result)


def pack(ordered: OrderedMesh, material_count: int = 3) -> tuple[bytes, SimpleNamespace]:
    """Return mesh.bin and what a manifest says about it."""
    content, levels, bounds, uv_bounds = encode_mesh(ordered, (0.0,) * len(ordered.levels), material_count)
    return content, SimpleNamespace(levels=levels, bounds=bounds, uv_bounds=uv_bounds, steps=(MAX_STEPS, MAX_STEPS))


def replace_section(content: bytes, manifest: SimpleNamespace, level: int, name: str, part: bytes) -> tuple[bytes, SimpleNamespace]:
    """Return mesh.bin and the manifest with another content of a section, which is not compressed yet."""
    packed = deflate(part)
    levels = list(manifest.levels)
    levels[level] = _with_section(levels[level], name, Section(len(content), len(packed), zlib.crc32(packed)))
    return content + packed, SimpleNamespace(
        levels=tuple(levels), bounds=manifest.bounds, uv_bounds=manifest.uv_bounds, steps=manifest.steps
    )


def _with_section(level: MeshLevel, name: str, section: Section) -> MeshLevel:
    match name:
        case "corners":
            return replace(level, corners=section)
        case "wedges":
            return replace(level, wedges=section)
        case "parents":
            return replace(level, parents=section)
        case "positions":
            return replace(level, positions=section)
        case _:
            return replace(level, uvs=section)


def read_section(content: bytes, manifest: SimpleNamespace, level: int, name: str) -> bytes:
    """Return the content of a section, not compressed."""
    return zlib.decompress(getattr(manifest.levels[level], name).read(content, "mesh.bin"), -15)
