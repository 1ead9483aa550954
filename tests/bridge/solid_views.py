"""Which image Solid views show whose color is *Texture*, by Blender's rule (`node_get_active_texture`)."""

import bpy


def shown_image(material: bpy.types.Material) -> bpy.types.Image | None:
    """Return the image that Solid views show of a material, None if they show its viewport color."""
    node = _shown_node(material.node_tree)
    return node.image if node is not None and node.type == "TEX_IMAGE" else None


def _shown_node(tree: bpy.types.NodeTree) -> bpy.types.Node | None:
    nodes, active = list(tree.nodes), tree.nodes.active
    flagged = [node for node in nodes if node.show_texture]
    if active in flagged:
        return active
    groups = [node for node in nodes if node.type == "GROUP" and node.node_tree is not None]
    if active in groups:
        inside = _shown_node(active.node_tree)
        if inside is not None and inside.show_texture:
            return inside
    if flagged:
        return flagged[-1]
    other = next((node for node in nodes if node.bl_idname.startswith("ShaderNodeTex") and node.type != "TEX_COORD"), None)
    for group in groups:
        inside = _shown_node(group.node_tree)
        if inside is not None and (inside.show_texture or other is None):
            return inside
    return other
