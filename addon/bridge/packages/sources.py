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
from ..shading.color_products import CHANNELS, read_product
from ..shading.socket_sources import ScopedSocket, find_source
from ..shading.surface_reader import MaterialSurface, choose_textures, read_surface
from ..shading.texture_uses import TextureUse
from ..texmesh.sources import TexturedSource, read_textured_source
from .images import MEAN, PackageImages

INPUTS = {"roughness": "Roughness", "metallic": "Metallic", "emission": "Emission Color"}  # input of Principled BSDF by role
STORED_INPUTS = {*INPUTS.values(), "Normal"}


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
    found = [None if key is None else find_material(key) for key in source.evaluated.materials or (None,)]
    surfaces = [None if material is None else read_surface(material) for material in found]
    materials = tuple(read_material(material, images) for material in found)
    unread = {item.name: _list_unread(surface, source) for item, surface in zip(found, surfaces, strict=True) if item is not None}
    remarks = [*source.remarks, *describe_lacking(unread, "The package")]
    mesh = _to_world(_place_uvs(source.mesh, surfaces), item)
    return PackageSource(source.name, mesh, materials, source.textures or (None,), tuple(remarks))


def _place_uvs(mesh: TexturedMesh, surfaces: Sequence[MaterialSurface | None]) -> TexturedMesh:
    """Return `mesh` with texture coordinates of the images, which materials may have moved, turned and scaled."""
    uvs = mesh.uvs.copy()
    for number, surface in enumerate(surfaces):
        use = None if surface is None else choose_textures(surface.color, surface.alpha)[0]
        if use is not None and use.is_moved:
            wedges = np.unique(mesh.wedge_triangles[mesh.materials == number])
            uvs[wedges] = mesh.uvs[wedges] @ use.matrix[:, :2].T + use.matrix[:, 2]
    return replace(mesh, uvs=uvs)


def _list_unread(surface: MaterialSurface, source: TexturedSource) -> tuple[str, ...]:
    """Return labels of what the package lacks of a material."""
    color, _, unread = choose_textures(surface.color, surface.alpha)
    leaves = source.mesh.uvs.min() < 0.0 or source.mesh.uvs.max() > 1.0 or (color is not None and color.is_moved)
    labels = [label for label in (*unread, *surface.unread) if label not in STORED_INPUTS]
    labels += [] if surface.is_opaque else ["transparency"]
    labels += ["vertex colors"] if surface.color.attributes else []
    labels += ["the wrapping of its image"] if color is not None and leaves and color.wrap != ("repeat", "repeat") else []
    return tuple(dict.fromkeys(labels))


def _to_world(mesh: TexturedMesh, item: bpy.types.Object) -> TexturedMesh:
    """Return `mesh` of an object turned and scaled as in the world; faces of mirrored objects still have their front outside."""
    matrix = find_frame(np.array(world_matrix(item), np.float64))[:3, :3]
    turned = replace(mesh, vertices=mesh.vertices @ matrix.T)
    if not is_mirroring(matrix):
        return turned
    backwards = {name: np.ascontiguousarray(getattr(mesh, name)[:, ::-1]) for name in ("triangles", "wedge_triangles", "sources")}
    return replace(turned, **backwards)


def read_material(material: bpy.types.Material | None, images: PackageImages) -> MaterialSource:
    """Return the base color, and the images of the shader nearest to the output of a material.

    Raises:
        FileError: an image has no pixels, for instance because its file is missing.
    """
    if material is None:
        return MaterialSource("", (0.8, 0.8, 0.8, 1.0), False, {})
    surface = read_surface(material)
    color, _, _ = choose_textures(surface.color, surface.alpha)
    found = {} if color is None else {"base_color": images.read_colors(color.image)}
    if surface.shader is not None:
        found |= _read_data_images(surface.shader, images)
    return MaterialSource(material.name, (*surface.color.factor, 1.0), not material.use_backface_culling, found)


def _read_data_images(node: bpy.types.Node, images: PackageImages) -> dict[str, np.ndarray]:
    """Return the images of a shader node other than its base color, by role."""
    result = {}
    for role, name in INPUTS.items():
        use = _find_texture(node.inputs.get(name))
        if use is not None and role == "emission":
            result[role] = images.read_colors(use.image)
        elif use is not None:
            result[role] = images.read_channel(use.image, CHANNELS.index(use.channel) if use.channel in CHANNELS else MEAN)
    normal = node.inputs.get("Normal")
    source = None if normal is None else find_source(ScopedSocket(normal)).node
    if source is not None and source.type == "NORMAL_MAP" and source.space == "TANGENT":
        use = _find_texture(source.inputs["Color"])
        if use is not None:
            result["normal"] = images.read_data(use.image)
    return result


def _find_texture(socket: bpy.types.NodeSocket | None) -> TextureUse | None:
    """Return the use of the image that is nearest to an input, None if there is none."""
    return None if socket is None else next(iter(read_product(socket).textures), None)
