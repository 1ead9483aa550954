"""Node groups with named sockets: new ones, and those that all materials of a file share."""

from collections.abc import Callable, Iterator, Sequence

import bpy

from .wiring import Wiring

Sockets = Sequence[tuple[str, str]]  # names, and what they carry: "Color", "Float", "Shader" or "Vector"


def nodes_in(tree: bpy.types.NodeTree, muted: bool = True) -> Iterator[bpy.types.Node]:
    """The nodes of `tree` and of the groups in it, those groups' nodes included; with or without what is `muted`."""
    for node in tree.nodes:
        if muted or not node.mute:
            yield node
            if node.type == "GROUP" and node.node_tree is not None:
                yield from nodes_in(node.node_tree, muted)


def new_group(name: str, inputs: Sockets, outputs: Sockets) -> bpy.types.NodeTree:
    """An empty group of shader nodes."""
    group = bpy.data.node_groups.new(name, "ShaderNodeTree")
    for direction, sockets in (("INPUT", inputs), ("OUTPUT", outputs)):
        for socket, kind in sockets:
            group.interface.new_socket(socket, in_out=direction, socket_type=f"NodeSocket{kind}")
    return group


def shared_group(name: str, version: int, inputs: Sockets, outputs: Sockets, fill: Callable[[Wiring], None]) -> bpy.types.NodeTree:
    """The group of this name and version that all materials of the file share; made, and told to `fill`, at first need."""
    for group in bpy.data.node_groups:
        if group.get("farfield_version") == version and group.name.startswith(name) and group.library is None:
            return group
    group = new_group(name, inputs, outputs)
    group["farfield_version"] = version
    wiring = Wiring(group)
    fill(wiring)
    wiring.arrange()
    return group
