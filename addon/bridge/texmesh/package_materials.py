"""Materials of an object for packages: the images that its shaders use, by role."""

import bpy
import numpy as np

from ...core.imaging.colors import encode_signed_srgb
from ...core.texmesh.streaming.material_sources import MaterialSource
from ..color_spaces import SRGB, read_linear_pixels
from ..images import read_pixels
from .color_images import check_pixels, find_color_image, find_image_node, scaled_copy
from .glb_materials import WHITE, find_base_color, find_surface_node

INPUTS = {"roughness": "Roughness", "metallic": "Metallic", "emission": "Emission Color"}  # input of Principled BSDF by role
CHANNELS = ("Red", "Green", "Blue")
MAX_SIDE = 8192  # pixels; larger images are scaled down


def read_material(material: bpy.types.Material | None) -> MaterialSource:
    """Return the base color, and the images of the shader nearest to the output of a material.

    Raises:
        FileError: an image has no pixels, for instance because its file is missing.
    """
    if material is None:
        return MaterialSource("", (0.8, 0.8, 0.8, 1.0), False, {})
    image, _ = find_color_image(material)
    images = {} if image is None else {"base_color": read_color_bytes(image)}
    color = WHITE if image is not None else find_base_color(material)
    node = find_surface_node(material)
    if node is not None:
        images |= _read_data_images(node)
    return MaterialSource(material.name, color, not material.use_backface_culling, images)


def read_color_bytes(image: bpy.types.Image) -> np.ndarray:
    """Return the colors (H, W, 3) uint8 of an image, sRGB-encoded, row 0 at the bottom. Raises FileError."""
    check_pixels(image)
    with scaled_copy(image, MAX_SIDE) as source:
        if source.colorspace_settings.name == SRGB and not source.is_float:
            return _to_bytes(read_pixels(source)[..., :3])
        return _to_bytes(encode_signed_srgb(read_linear_pixels(source)[..., :3]))


def _read_data_images(node: bpy.types.Node) -> dict[str, np.ndarray]:
    """Return the images of a shader node other than its base color, by role."""
    images = {}
    for role, name in INPUTS.items():
        socket = node.inputs.get(name)
        found = None if socket is None or not socket.links else find_image_node(socket)
        if found is not None:
            images[role] = read_color_bytes(found.image) if role == "emission" else _read_channel(found.image, socket)
    normal = node.inputs.get("Normal")
    source = None if normal is None or not normal.links else normal.links[0].from_node
    if source is not None and source.type == "NORMAL_MAP" and source.space == "TANGENT":
        found = find_image_node(source.inputs["Color"])
        if found is not None:
            images["normal"] = _read_data(found.image)
    return images


def _read_channel(image: bpy.types.Image, socket: bpy.types.NodeSocket) -> np.ndarray:
    """Return the channel (H, W, 3) uint8 of an image that reaches a socket: that of a Separate Color node, or the mean."""
    pixels = _read_data(image)
    link = socket.links[0]
    if link.from_node.type in ("SEPARATE_COLOR", "SEPRGB") and link.from_socket.name in CHANNELS:
        channel = pixels[..., CHANNELS.index(link.from_socket.name)]
    else:
        channel = np.rint(pixels.mean(axis=2)).astype(np.uint8)
    return np.repeat(channel[..., None], 3, axis=2)


def _read_data(image: bpy.types.Image) -> np.ndarray:
    """Return the values (H, W, 3) uint8 of an image that holds data."""
    check_pixels(image)
    with scaled_copy(image, MAX_SIDE) as source:
        return _to_bytes(read_pixels(source)[..., :3])


def _to_bytes(values: np.ndarray) -> np.ndarray:
    return np.rint(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)
