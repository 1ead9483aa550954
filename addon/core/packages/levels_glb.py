"""The levels of a package as one binary glTF file for programs that know nothing of packages (MSFT_lod)."""

from collections.abc import Sequence

import numpy as np

from ..files.glb import Y_UP, Document, save_glb
from ..files.glb_levels import FULL, LevelNode, arrange_levels
from ..geometry.mesh import vertex_normals
from ..texmesh.level_chain import LevelChain
from ..texmesh.perception.switch_distances import level_coverages
from ..texmesh.textured_mesh import TexturedMesh
from .gltf_materials import describe_materials
from .material_sources import MaterialSource


def encode_levels(name: str, chain: LevelChain, materials: Sequence[MaterialSource]) -> bytes:
    """Return the quantized levels with their materials. The meshes have z upwards.

    Raises:
        FileError: the file would be too large.
    """
    meshes = [level.mesh for level in chain.levels]
    vertices = meshes[0].vertices @ Y_UP.T
    bounds = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    names = [f"{name}_LOD{index}" for index in range(len(meshes))]
    coverages = level_coverages([level.pixel_size for level in chain.levels[1:]], bounds) if len(meshes) > 1 else ()
    nodes = [LevelNode(item, item, bounds, np.eye(4)) for item in names]
    nodes[0] = LevelNode(names[0], names[0], bounds, np.eye(4), tuple(range(1, len(meshes))), coverages)
    document = {
        "nodes": [{"name": item, "mesh": index} for index, item in enumerate(names)],
        "meshes": [{"primitives": _primitives(mesh)} for mesh in meshes],
        **describe_materials(materials),
    }
    return save_glb(arrange_levels(document, nodes, FULL, {}))


def _primitives(mesh: TexturedMesh) -> list[Document]:
    """Return the triangles of each material with smooth normals."""
    positions = (mesh.vertices @ Y_UP.T)[mesh.wedge_vertices]
    normals = (vertex_normals(mesh.vertices, mesh.triangles) @ Y_UP.T)[mesh.wedge_vertices]
    uvs = mesh.uvs * [1.0, -1.0] + [0.0, 1.0]  # v is downwards
    primitives = []
    for material in np.unique(mesh.materials).tolist():
        used, indices = np.unique(mesh.wedge_triangles[mesh.materials == material], return_inverse=True)
        attributes = {"POSITION": positions[used], "NORMAL": normals[used], "TEXCOORD_0": uvs[used]}
        primitives.append({"attributes": attributes, "indices": indices.ravel(), "material": material})
    return primitives
