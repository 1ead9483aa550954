"""Materials of levels for glTF files: the base color and the image file with it."""

from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from ...compat import uses_nodes
from ...core.files.file_access import convert_os_errors, is_file
from ...core.files.glb import IMAGE_TYPES, GlbMaterial
from ...core.imaging.coded_images import encode
from ...core.imaging.colors import encode_signed_srgb
from ..imaging.color_spaces import SRGB, read_linear_pixels
from ..imaging.images import find_path, read_pixels
from .color_images import COLOR_INPUTS, check_pixels, find_color_image

WHITE = (1.0, 1.0, 1.0, 1.0)
MAX_NODES = 64  # between the output of a material and the node with its color


@dataclass
class GlbMaterials:
    """Materials and images of a file, each once, in the order in which they are added."""

    materials: list[GlbMaterial] = field(default_factory=list)
    images: list[bytes] = field(default_factory=list)
    _indices: dict[bpy.types.Material, int] = field(default_factory=dict)
    _image_indices: dict[bpy.types.Image, int] = field(default_factory=dict)

    def add(self, material: bpy.types.Material | None) -> int | None:
        """Return the index of a material, None for none.

        Raises:
            FileError: its image is missing or cannot be read.
        """
        if material is None:
            return None
        if material not in self._indices:
            image, _ = find_color_image(material)
            color = WHITE if image is not None else find_base_color(material)
            index = None if image is None else self._add_image(image)
            self._indices[material] = len(self.materials)
            self.materials.append(GlbMaterial(material.name, color, index, not material.use_backface_culling))
        return self._indices[material]

    def _add_image(self, image: bpy.types.Image) -> int:
        if image not in self._image_indices:
            self.images.append(read_coded_image(image))
            self._image_indices[image] = len(self.images) - 1
        return self._image_indices[image]


def find_base_color(material: bpy.types.Material) -> tuple[float, float, float, float]:
    """Return the scene-linear RGBA color of a material without an image: that of the first shader with a color input, white if it is
    linked. Materials without nodes have their viewport color."""
    if not uses_nodes(material) or material.node_tree is None:
        return tuple(material.diffuse_color)
    node = find_surface_node(material)
    color = None if node is None else _color_input(node)
    return WHITE if color is None or color.links else (*tuple(color.default_value)[:3], 1.0)


def find_surface_node(material: bpy.types.Material) -> bpy.types.Node | None:
    """Return the shader node with a color input that is nearest to the output of a material, the first of mixed ones; None if there is
    none."""
    output = material.node_tree.get_output_node("ALL") if uses_nodes(material) and material.node_tree is not None else None
    socket = None if output is None else output.inputs["Surface"]
    for _ in range(MAX_NODES):
        if socket is None or not socket.links:
            return None
        node = socket.links[0].from_node
        if _color_input(node) is not None:
            return node
        socket = next((item for item in node.inputs if item.type == "SHADER" and item.links), None)
    return None


def _color_input(node: bpy.types.Node) -> bpy.types.NodeSocket | None:
    return next((item for item in node.inputs if item.name in COLOR_INPUTS and item.type == "RGBA"), None)


def read_coded_image(image: bpy.types.Image) -> bytes:
    """Return an image as PNG or JPEG: as it is packed or on the disk if it is one with sRGB colors, otherwise converted to PNG.

    Raises:
        FileError: it has no pixels, for instance because its file is missing, or cannot be read.
    """
    check_pixels(image)
    if image.source == "FILE" and not image.is_dirty and image.colorspace_settings.name == SRGB:
        content = _read_content(image)
        if any(content.startswith(start) for start in IMAGE_TYPES):
            return content
    is_encoded = not image.is_float and image.colorspace_settings.name == SRGB
    pixels = read_pixels(image) if is_encoded else read_linear_pixels(image)
    colors = pixels[..., :3] if is_encoded else encode_signed_srgb(pixels[..., :3])
    has_alpha = bool((pixels[..., 3] < 1.0).any())
    values = np.concatenate([colors, pixels[..., 3:]], axis=2) if has_alpha else colors
    return encode(np.rint(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8), "png")


def _read_content(image: bpy.types.Image) -> bytes:
    """Return the file of an image, b"" if there is none although it has pixels."""
    if image.packed_files:
        return image.packed_files[0].packed_file.data
    path = Path(find_path(image))
    if not is_file(path):
        return b""
    with convert_os_errors(f'Cannot read "{path}"'):
        return path.read_bytes()
