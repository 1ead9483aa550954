"""Materials of an object for packages: the images that its shaders use, by role."""

import bpy
import numpy as np

from ...core.packages.material_sources import MaterialSource
from ..texmesh.color_images import find_color_image, find_image_node
from ..texmesh.glb_materials import WHITE, find_base_color, find_surface_node
from .images import MEAN, PackageImages

INPUTS = {"roughness": "Roughness", "metallic": "Metallic", "emission": "Emission Color"}  # input of Principled BSDF by role
CHANNELS = ("Red", "Green", "Blue")


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
