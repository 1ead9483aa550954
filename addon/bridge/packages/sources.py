"""Objects as packages need them: in their orientation and size in the world, with the images that the shaders of their materials use."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.geometry.transforms import is_mirroring
from ...core.messages import describe_lacking
from ...core.packages.material_sources import MaterialSource
from ...core.texmesh.textured_mesh import TexturedMesh
from ..geometry.joined_meshes import find_frame
from ..geometry.meshes import find_material
from ..objects import world_matrix
from ..shading.texture_uses import TextureUse
from ..texmesh.rigs import describe_frozen
from ..texmesh.sources import TexturedSource, read_textured_source
from .images import PackageImages
from .materials import read_material


@dataclass(frozen=True)
class PackageSource:
    """One object.

    Attributes:
        name: of the object.
        mesh: about the origin of the object, with the axes and the unit of the world.
        materials: by material of the mesh; at least one.
        textures: their base colors for the analysis, (H, W, 3) float32 scene-linear or None.
        remarks: see `TexturedSource`.
    """

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
    materials = [None if key is None else find_material(key) for key in source.evaluated.materials or (None,)]
    found = [read_material(material, images) for material in materials]
    lacking = {item.source.name: (*item.lacking, *_list_lost_wrapping(item.placement, source)) for item in found}
    remarks = [*source.remarks, *describe_frozen(item), *describe_lacking(lacking, "The package")]
    mesh = _to_world(_place_uvs(source.mesh, [material.placement for material in found]), item)
    sources = tuple(material.source for material in found)
    return PackageSource(source.name, mesh, sources, source.textures or (None,), tuple(remarks))


def _place_uvs(mesh: TexturedMesh, placements: Sequence[TextureUse | None]) -> TexturedMesh:
    """Return `mesh` with texture coordinates of the images, which materials may have moved, turned and scaled."""
    uvs = mesh.uvs.copy()
    for number, use in enumerate(placements):
        if use is not None and use.is_moved:
            wedges = np.unique(mesh.wedge_triangles[mesh.materials == number])
            uvs[wedges] = mesh.uvs[wedges] @ use.matrix[:, :2].T + use.matrix[:, 2]
    return replace(mesh, uvs=uvs)


def _list_lost_wrapping(use: TextureUse | None, source: TexturedSource) -> tuple[str, ...]:
    """Return a label if the images of a material show something beyond their sides that the package lacks: it repeats them."""
    uvs = source.mesh.uvs
    leaves = uvs.min() < 0.0 or uvs.max() > 1.0 or (use is not None and use.is_moved)
    return ("the wrapping of its image",) if use is not None and leaves and use.wrap != ("repeat", "repeat") else ()


def _to_world(mesh: TexturedMesh, item: bpy.types.Object) -> TexturedMesh:
    """Return `mesh` of an object turned and scaled as in the world; faces of mirrored objects still have their front outside."""
    matrix = find_frame(np.array(world_matrix(item), np.float64))[:3, :3]
    turned = replace(mesh, vertices=mesh.vertices @ matrix.T)
    if not is_mirroring(matrix):
        return turned
    backwards = {name: np.ascontiguousarray(getattr(mesh, name)[:, ::-1]) for name in ("triangles", "wedge_triangles", "sources")}
    return replace(turned, **backwards)
