"""Objects as packages need them: in their orientation and size in the world, with the images of their materials."""

from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.packages.material_sources import MaterialSource
from ...core.texmesh.textured_mesh import TexturedMesh
from ..geometry.meshes import find_material
from ..objects import world_matrix
from ..texmesh.sources import read_textured_source
from .images import PackageImages
from .materials import read_material


@dataclass(frozen=True)
class PackageSource:
    """One object. mesh: about the origin of the object, with the axes and the unit of the world. materials: by material of the mesh; at
    least one. textures: their base colors for the analysis, (H, W, 3) float32 scene-linear or None. remarks: see `TexturedSource`."""

    name: str
    mesh: TexturedMesh
    materials: tuple[MaterialSource, ...]
    textures: tuple[np.ndarray | None, ...]
    remarks: tuple[str, ...]


def read_package_source(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> PackageSource:
    """Read the evaluated mesh of an object, with modifiers and shape keys, and its materials.

    Raises:
        GeometryError: it has no faces or no area. FileError: an image is missing.
    """
    images = PackageImages()
    source = read_textured_source(item, depsgraph, has_attributes=False, read_image=images.read_analyzed)
    slots = source.evaluated.materials or (None,)
    materials = tuple(read_material(None if key is None else find_material(key), images) for key in slots)
    textures = source.textures or (None,)
    remarks = list(source.remarks)
    if any(_has_alpha(None if key is None else find_material(key)) for key in slots):
        remarks.append(f'Transparent parts of the materials of "{item.name}" are opaque in the package.')
    return PackageSource(source.name, _to_world(source.mesh, item), materials, textures, tuple(remarks))


def _to_world(mesh: TexturedMesh, item: bpy.types.Object) -> TexturedMesh:
    """Return `mesh` of an object turned and scaled as in the world; faces of mirrored objects still have their front outside."""
    matrix = np.array(world_matrix(item), np.float64)[:3, :3]
    turned = replace(mesh, vertices=mesh.vertices @ matrix.T)
    if np.linalg.det(matrix) >= 0.0:
        return turned
    backwards = {name: np.ascontiguousarray(getattr(mesh, name)[:, ::-1]) for name in ("triangles", "wedge_triangles", "sources")}
    return replace(turned, **backwards)


def _has_alpha(material: bpy.types.Material | None) -> bool:
    """Return whether the first shader of a material is not opaque."""
    if material is None or material.node_tree is None:
        return False
    nodes = [node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED"]
    return any(node.inputs["Alpha"].links or node.inputs["Alpha"].default_value < 1.0 for node in nodes)
