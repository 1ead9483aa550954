"""Node groups with named sockets: new ones, groups shared by all materials of a file, and the nodes in groups that emit light."""

from collections.abc import Callable, Iterable, Iterator, Sequence

import bpy

from .node_builder import NodeBuilder

Sockets = Sequence[tuple[str, str]]  # names and types: "Color", "Float", "Shader" or "Vector"


def nodes_in(tree: bpy.types.NodeTree, muted: bool = True) -> Iterator[bpy.types.Node]:
    """Yield the nodes of `tree` and, recursively, of its node groups; with or without `muted` nodes."""
    for node in tree.nodes:
        if muted or not node.mute:
            yield node
            if node.type == "GROUP" and node.node_tree is not None:
                yield from nodes_in(node.node_tree, muted)


def create_group(name: str, inputs: Sockets, outputs: Sockets) -> bpy.types.NodeTree:
    """Create an empty group of shader nodes."""
    group = bpy.data.node_groups.new(name, "ShaderNodeTree")
    for direction, sockets in (("INPUT", inputs), ("OUTPUT", outputs)):
        for socket, socket_type in sockets:
            group.interface.new_socket(socket, in_out=direction, socket_type=f"NodeSocket{socket_type}")
    return group


def ensure_shared_group(
    name: str, version: int, inputs: Sockets, outputs: Sockets, fill: Callable[[NodeBuilder], None]
) -> bpy.types.NodeTree:
    """Return the group of this name and version that all materials of the file share; create it with `fill` if there is none."""
    for group in bpy.data.node_groups:
        if group.get("farfield_version") == version and group.name.startswith(name) and group.library is None:
            return group
    group = create_group(name, inputs, outputs)
    group["farfield_version"] = version
    builder = NodeBuilder(group)
    fill(builder)
    builder.arrange()
    return group


COLOR_AND_STRENGTH = {"EMISSION": ("Color", "Strength"), "BSDF_PRINCIPLED": ("Emission Color", "Emission Strength")}


def has_emission(materials: Iterable[bpy.types.Material]) -> bool:
    """Return whether any of `materials` has a node, also inside groups, that emits light or may do so depending on its links."""
    trees = [material.node_tree for material in materials if material.node_tree is not None]
    return any(_emits(node) for tree in trees for node in nodes_in(tree, muted=False))


def _emits(node: bpy.types.Node) -> bool:
    if node.type not in COLOR_AND_STRENGTH:
        return False
    color, strength = (node.inputs[name] for name in COLOR_AND_STRENGTH[node.type])
    is_black = not color.is_linked and not any(color.default_value[:3])
    return not is_black and (strength.is_linked or strength.default_value != 0.0)
