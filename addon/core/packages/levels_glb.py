"""The levels of a package as one binary glTF file for programs that know nothing of packages (MSFT_lod)."""

from collections.abc import Sequence

import numpy as np

from ..files.glb import Y_UP, GlbMesh, GlbNode, GlbPrimitive, GlbScene, encode_glb
from ..files.glb_materials import GlbMaterial, GlbTexture
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
    nodes = [GlbNode(f"{name} L{index}", index) for index in range(len(meshes))]
    if len(meshes) > 1:
        coverages = level_coverages([level.pixel_size for level in chain.levels[1:]], bounds)
        nodes[0] = GlbNode(nodes[0].name, 0, levels=tuple(range(1, len(meshes))), coverages=coverages)
    images, indices = [], {}
    for material in materials:
        image = material.images.get("base_color")
        if image is not None and id(image) not in indices:
            indices[id(image)] = len(images)
            images.append(encode(image, "jpeg", QUALITY))
    textures = [
        None if image is None else GlbTexture(indices[id(image)]) for image in (item.images.get("base_color") for item in materials)
    ]
    glb_materials = [
        GlbMaterial(item.name, item.base_color, texture, item.is_double_sided) for item, texture in zip(materials, textures, strict=True)
    ]
    parts = [GlbMesh(node.name, tuple(_primitives(mesh)), bounds) for node, mesh in zip(nodes, meshes, strict=True)]
    return encode_glb(GlbScene(tuple(nodes), tuple(parts), tuple(glb_materials), tuple(images)), is_quantized=True)


def _primitives(mesh: TexturedMesh) -> list[GlbPrimitive]:
    """Return the triangles of each material with smooth normals."""
    positions = (mesh.vertices @ Y_UP.T)[mesh.wedge_vertices]
    normals = (vertex_normals(mesh.vertices, mesh.triangles) @ Y_UP.T)[mesh.wedge_vertices]
    primitives = []
    for material in np.unique(mesh.materials).tolist():
        used, triangles = np.unique(mesh.wedge_triangles[mesh.materials == material], return_inverse=True)
        primitives.append(GlbPrimitive(positions[used], triangles.reshape(-1, 3), normals[used], mesh.uvs[used], material=int(material)))
    return primitives
