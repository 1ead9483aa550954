"""Finds the image textures that give a material its color."""

from collections.abc import Iterator

import bpy

from ...compat import uses_nodes
from .socket_sources import ScopedSocket, find_source
from .surface_reader import find_output, list_color_inputs


def find_color_textures(material: bpy.types.Material) -> Iterator[ScopedSocket]:
    """Yield the outputs of image texture nodes that the color of the surface of a material depends on, depth-first, the nearest one first.

    Links are followed from the active output, through groups and reroutes. Images for roughness, normals and other inputs do not count.
    """
    if not uses_nodes(material) or material.node_tree is None:
        return
    output = find_output(material.node_tree)
    if output is None:
        return
    visited: set[ScopedSocket] = set()
    pending = [ScopedSocket(output.inputs["Surface"])]
    while pending:
        source = find_source(pending.pop())
        if source.is_constant or source in visited:
            continue
        visited.add(source)
        if source.node.type != "TEX_IMAGE":
            pending += [ScopedSocket(item, source.groups) for item in _color_inputs(source.node)]
        elif source.node.image is not None:
            yield source


def _color_inputs(node: bpy.types.Node) -> list[bpy.types.NodeSocket]:
    """Return the linked inputs of a node that determine its color, in the order in which a stack should hold them: the nearest one last."""
    linked = [item for item in node.inputs if item.links]
    shaders = [item for item in linked if item.type == "SHADER"]
    colors = [item for item in list_color_inputs(node) if item.links]
    if any(item.type == "SHADER" for item in node.outputs):
        return shaders[::-1] or colors[:1]
    if colors:
        return colors[:1]
    if node.type.startswith("TEX_"):  # their vectors are positions
        return []
    first = [item for item in linked if item.type in ("RGBA", "SHADER")]
    return [*(item for item in reversed(linked) if item not in first), *reversed(first)]
