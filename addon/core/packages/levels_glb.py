"""The levels of a package as one binary glTF file for programs that know nothing of packages (MSFT_lod)."""

from collections.abc import Sequence

import numpy as np

from ..files.glb import Y_UP, GlbMesh, GlbPrimitive, GlbScene, encode_glb
from ..files.glb_levels import LevelNode
from ..files.glb_levels import encode_levels as encode_glb_levels
from ..geometry.mesh import vertex_normals
from ..imaging.coded_images import encode
from ..texmesh.level_chain import LevelChain
from ..texmesh.perception.switch_distances import level_coverages
from ..texmesh.textured_mesh import TexturedMesh
from .material_sources import MaterialSource

QUALITY = 95  # Quality of JPEG.


def encode_levels(name: str, chain: LevelChain, materials: Sequence[MaterialSource]) -> bytes:
    """Return the quantized levels with their base colors. The meshes have z upwards.

    Raises:
        FileError: the file would be too large.
    """
    meshes = [level.mesh for level in chain.levels]
    vertices = meshes[0].vertices @ Y_UP.T
    bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    names = [f"{name}_LOD{index}" for index in range(len(meshes))]
    nodes = [LevelNode(item, item, bounds) for item in names]
    if len(meshes) > 1:
        coverages = level_coverages([level.pixel_size for level in chain.levels[1:]], bounds)
        nodes[0] = LevelNode(names[0], names[0], bounds, levels=tuple(range(1, len(meshes))), coverages=coverages)
    images, indices = [], {}
    for material in materials:
        image = material.images.get("base_color")
        if image is not None and id(image) not in indices:
            indices[id(image)] = len(images)
            images.append(encode(image, "jpeg", QUALITY))
    described = tuple(_describe_material(item, indices) for item in materials)
    parts = tuple(GlbMesh(item, tuple(_primitives(mesh))) for item, mesh in zip(names, meshes, strict=True))
    return encode_glb_levels(encode_glb(GlbScene(parts, described, tuple(images))), nodes, True, {})


def _describe_material(material: MaterialSource, indices: dict[int, int]) -> dict[str, object]:
    """Return a material as in the file. indices: of textures, by the identity of their images."""
    surface: dict[str, object] = {"baseColorFactor": list(material.base_color), "metallicFactor": 0.0}
    image = material.images.get("base_color")
    surface |= {} if image is None else {"baseColorTexture": {"index": indices[id(image)]}}
    sides = {"doubleSided": True} if material.is_double_sided else {}
    return {"name": material.name, "pbrMetallicRoughness": surface, **sides}


def _primitives(mesh: TexturedMesh) -> list[GlbPrimitive]:
    """Return the triangles of each material with smooth normals."""
    positions = (mesh.vertices @ Y_UP.T)[mesh.wedge_vertices]
    normals = (vertex_normals(mesh.vertices, mesh.triangles) @ Y_UP.T)[mesh.wedge_vertices]
    primitives = []
    for material in np.unique(mesh.materials).tolist():
        used, triangles = np.unique(mesh.wedge_triangles[mesh.materials == material], return_inverse=True)
        primitives.append(GlbPrimitive(positions[used], triangles.reshape(-1, 3), normals[used], mesh.uvs[used], int(material)))
    return primitives
