"""Objects as packages need them: in their orientation and size in the world, with the images that the shaders of their materials use."""

from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...core.packages.material_sources import MaterialSource
from ...core.texmesh.textured_mesh import TexturedMesh
from ..geometry.meshes import find_material
from ..objects import world_matrix
from ..texmesh.color_images import find_color_image, find_image_node
from ..texmesh.glb_materials import WHITE, find_base_color, find_surface_node
from ..texmesh.sources import read_textured_source
from .images import MEAN, PackageImages

INPUTS = {"roughness": "Roughness", "metallic": "Metallic", "emission": "Emission Color"}  # input of Principled BSDF by role
CHANNELS = ("Red", "Green", "Blue")


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


def read_material(material: bpy.types.Material | None, images: PackageImages) -> MaterialSource:
    """Return the base color, and the images of the shader nearest to the output of a material.

    Raises:
        FileError: an image has no pixels, for instance because its file is missing.
    """
    if material is None:
        return MaterialSource("", (0.8, 0.8, 0.8, 1.0), False, {})
    image, _ = find_color_image(material)
    found = {} if image is None else {"base_color": images.read_colors(image)}
    color = WHITE if image is not None else find_base_color(material)
    node = find_surface_node(material)
    if node is not None:
        found |= _read_data_images(node, images)
    return MaterialSource(material.name, color, not material.use_backface_culling, found)


def _read_data_images(node: bpy.types.Node, images: PackageImages) -> dict[str, np.ndarray]:
    """Return the images of a shader node other than its base color, by role."""
    result = {}
    for role, name in INPUTS.items():
        socket = node.inputs.get(name)
        found = None if socket is None or not socket.links else find_image_node(socket)
        if found is not None:
            is_color = role == "emission"
            result[role] = images.read_colors(found.image) if is_color else images.read_channel(found.image, _find_channel(socket))
    normal = node.inputs.get("Normal")
    source = None if normal is None or not normal.links else normal.links[0].from_node
    if source is not None and source.type == "NORMAL_MAP" and source.space == "TANGENT":
        found = find_image_node(source.inputs["Color"])
        if found is not None:
            result["normal"] = images.read_data(found.image)
    return result


def _find_channel(socket: bpy.types.NodeSocket) -> int:
    """Return the channel of an image that reaches a socket: that of a Separate Color node, or the mean."""
    link = socket.links[0]
    if link.from_node.type in ("SEPARATE_COLOR", "SEPRGB") and link.from_socket.name in CHANNELS:
        return CHANNELS.index(link.from_socket.name)
    return MEAN
