"""Access to the nodes of a shader."""

import bpy


def find_node(tree: bpy.types.NodeTree, node_type: str) -> bpy.types.Node:
    """Return the first node of `tree` whose `type` is `node_type`, for instance `BSDF_PRINCIPLED` or `BACKGROUND`."""
    return next(node for node in tree.nodes if node.type == node_type)
