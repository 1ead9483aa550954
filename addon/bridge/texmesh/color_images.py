"""The image that gives a material its color, as an array."""

import bpy
import numpy as np

from ...compat import uses_nodes
from ...core.errors import FileError
from ..color_spaces import read_linear_pixels
from ..images import find_path

MAX_SIDE = 4096  # pixels; larger images are halved until they fit
COLOR_INPUTS = ("Base Color", "Color")


def find_color_image(material: bpy.types.Material | None) -> tuple[bpy.types.Image | None, str]:
    """Return the image texture that is nearest to the color of the surface of a material, and the name of the UV map it uses ("" for the
    active one); None if there is none.

    Links are followed from the active output, through groups and reroutes, color inputs first.
    """
    if material is None or not uses_nodes(material) or material.node_tree is None:
        return None, ""
    output = material.node_tree.get_output_node("ALL")
    node = _find_image_node(output.inputs["Surface"], ()) if output is not None else None
    return (None, "") if node is None else (node.image, _uv_map_of(node))


def read_color_image(image: bpy.types.Image) -> tuple[np.ndarray, bool]:
    """Return the colors (H, W, 3) float32 of an image, scene-linear, row 0 at the bottom, and whether it was scaled down to MAX_SIDE.

    Raises:
        FileError: it has no pixels, for instance because its file is missing.
    """
    check_pixels(image)
    side = max(image.size)
    if side <= MAX_SIDE:
        return _read_colors(image), False
    copy = image.copy()
    try:
        scale = MAX_SIDE / side
        copy.scale(max(1, round(image.size[0] * scale)), max(1, round(image.size[1] * scale)))
        return _read_colors(copy), True
    finally:
        bpy.data.images.remove(copy)


def check_pixels(image: bpy.types.Image) -> None:
    """Raise FileError if an image has no pixels, for instance because its file is missing."""
    if not all(image.size):
        raise FileError(
            f'The image "{image.name}" is missing or empty ("{find_path(image)}"); find its file, or remove it from the material.'
        )


def _read_colors(image: bpy.types.Image) -> np.ndarray:
    return np.ascontiguousarray(read_linear_pixels(image)[..., :3])


def _find_image_node(socket: bpy.types.NodeSocket, groups: tuple[bpy.types.Node, ...]) -> bpy.types.Node | None:
    """Return the first image texture node before `socket`, depth-first. groups: the group nodes that contain it, outermost first."""
    visited: set[tuple[tuple[str, ...], str, str]] = set()
    pending = [(socket, groups)]
    while pending:
        current, path = pending.pop()
        key = (tuple(group.name for group in path), current.node.name, current.identifier)
        if not current.links or key in visited:
            continue
        visited.add(key)
        source = current.links[0].from_socket
        node = source.node
        if node.type == "TEX_IMAGE" and node.image is not None:
            return node
        if node.type == "GROUP" and node.node_tree is not None:
            output = next((item for item in node.node_tree.nodes if item.type == "GROUP_OUTPUT" and item.is_active_output), None)
            inside = None if output is None else output.inputs.get(source.name)
            if inside is not None:
                pending.append((inside, (*path, node)))
        elif node.type == "GROUP_INPUT" and path:
            outside = path[-1].inputs.get(source.name)
            if outside is not None:
                pending.append((outside, path[:-1]))
        else:
            pending += [(item, path) for item in _ordered_inputs(node)]
    return None


def _ordered_inputs(node: bpy.types.Node) -> list[bpy.types.NodeSocket]:
    """Return the linked inputs of a node in the order in which a stack should hold them: those of colors last, so that they come first."""
    linked = [item for item in node.inputs if item.links][::-1]
    return sorted(linked, key=lambda item: (item.name in COLOR_INPUTS, item.type in ("RGBA", "SHADER")))


def _uv_map_of(node: bpy.types.Node) -> str:
    """Return the name of the UV map that the Vector input of an image node is linked to, through a Mapping node or not."""
    socket = node.inputs["Vector"]
    for _ in range(8):
        if not socket.links:
            return ""
        source = socket.links[0].from_node
        if source.type == "UVMAP":
            return source.uv_map
        if source.type not in ("MAPPING", "REROUTE"):
            return ""
        socket = source.inputs["Vector"] if source.type == "MAPPING" else source.inputs[0]
    return ""
