"""Selects the image that a material shows in Solid views whose color is *Texture*, and the color in others.

Blender shows the image of the active texture node of a material, and without one that of any texture node, which may be a lookup table.
"""

from collections.abc import Sequence

import bpy

from .color_textures import find_color_textures
from .surface_reader import find_output

BRIGHTNESS = 2.5  # Of colors in Solid views, whose light is darker than that of a Sun.


def show_image(material: bpy.types.Material, image: bpy.types.Image | None) -> None:
    """Let Solid views show an `image` of a material, also inside its own node groups; None for its viewport color."""
    tree = material.node_tree
    if image is None or not _show_image_in(tree, image):
        output = find_output(tree)
        if output is not None:
            _activate(tree, output)


def show_color_image(copy: bpy.types.Material) -> None:
    """Let Solid views show the image that gives the `copy` of a material its color; its viewport color if there is none.

    An active image stays active if it is among several, or if nothing else gives a color. A copy whose images are all inside node groups
    stays as it is, because it has these groups in common with its original.
    """
    sources = [source for source in find_color_textures(copy) if _has_color(source.node)]
    nodes = [source.node for source in sources if not source.groups]
    if nodes:
        _activate(copy.node_tree, max(nodes, key=lambda node: node.show_texture))
        return
    others = () if sources or copy.node_tree is None else copy.node_tree.nodes
    if others and not any(node.show_texture and _has_color(node) for node in others):
        show_image(copy, None)


def _has_color(node: bpy.types.Node) -> bool:
    """Return whether a node has an image whose values are colors."""
    return node.type == "TEX_IMAGE" and node.image is not None and not node.image.colorspace_settings.is_data


def _show_image_in(tree: bpy.types.NodeTree, image: bpy.types.Image) -> bool:
    """Show an `image` that nodes of a tree or of its groups have, and return whether any has it."""
    for node in tree.nodes:
        has_image = node.type == "TEX_IMAGE" and node.image == image
        if has_image or (node.type == "GROUP" and node.node_tree is not None and _show_image_in(node.node_tree, image)):
            _activate(tree, node)
            return True
    return False


def _activate(tree: bpy.types.NodeTree, node: bpy.types.Node) -> None:
    """Let a node select the image of its tree: its own one, that of the active node in it if it is a group, or none for others."""
    for item in tree.nodes:
        item.show_texture = item == node and node.type != "GROUP"  # A group with this would count as a node without an image.
    tree.nodes.active = node


def show_color(material: bpy.types.Material, color: Sequence[float]) -> None:
    """Let Solid views show a scene-linear `color` (3,) for a material that has no image, without highlights."""
    material.diffuse_color = (*(min(BRIGHTNESS * channel, 1.0) for channel in color[:3]), 1.0)
    material.roughness = 1.0
