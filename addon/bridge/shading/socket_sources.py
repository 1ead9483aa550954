"""Where the values of shader sockets come from: links followed through reroutes, muted nodes and groups."""

from dataclasses import dataclass

import bpy

from ..lod_crossfade import is_crossfade
from .node_builder import SocketOrValue

MAX_LINKS = 256  # from one node to another with content


@dataclass(frozen=True)
class ScopedSocket:
    """A socket of a node, and the group nodes around it, the outermost first."""

    socket: bpy.types.NodeSocket
    groups: tuple[bpy.types.Node, ...] = ()

    @property
    def node(self) -> bpy.types.Node:
        """The node that has the socket."""
        return self.socket.node

    @property
    def is_constant(self) -> bool:
        """Whether the value is that of the socket itself: an input without a link."""
        return not self.socket.is_output

    @property
    def operation(self) -> str:
        """The operation of the Math node that has the output, "" for other nodes and for constants."""
        return self.node.operation if not self.is_constant and self.node.type == "MATH" else ""

    def input(self, key: str | int) -> "ScopedSocket":
        """Return what determines an input of the node, by its identifier or index, see `find_source`."""
        inputs = self.node.inputs
        socket = inputs[key] if isinstance(key, int) else next(item for item in inputs if item.identifier == key)
        return find_source(ScopedSocket(socket, self.groups))


def find_source(start: ScopedSocket) -> ScopedSocket:
    """Return the output that determines an input, or the input without a link that does.

    Cross-fades of Farfield do not count.
    """
    current = start
    for _ in range(MAX_LINKS):
        link = next((item for item in current.socket.links if not item.is_muted), None)
        if link is None:
            return current
        following = _enter(ScopedSocket(link.from_socket, current.groups))
        if following is None:
            return ScopedSocket(link.from_socket, current.groups)
        current = following
    return current


def _enter(output: ScopedSocket) -> ScopedSocket | None:
    """Return the input that an output only passes on; None if its node has content."""
    node, socket, groups = output.node, output.socket, output.groups
    if node.mute:
        inside = next((link.from_socket for link in node.internal_links if link.to_socket == socket), None)
        return None if inside is None else ScopedSocket(inside, groups)
    if node.type == "REROUTE" or is_crossfade(node):
        return ScopedSocket(node.inputs[0], groups)
    if node.type == "GROUP" and node.node_tree is not None:
        end = next((item for item in node.node_tree.nodes if item.type == "GROUP_OUTPUT" and item.is_active_output), None)
        inside = None if end is None else _find(end.inputs, socket)
        return None if inside is None else ScopedSocket(inside, (*groups, node))
    if node.type == "GROUP_INPUT" and groups:
        outside = _find(groups[-1].inputs, socket)
        return None if outside is None else ScopedSocket(outside, groups[:-1])
    return None


def _find(sockets: bpy.types.bpy_prop_collection, wanted: bpy.types.NodeSocket) -> bpy.types.NodeSocket | None:
    return next((item for item in sockets if item.identifier == wanted.identifier), None)


def linked_output(target: bpy.types.NodeSocket) -> bpy.types.NodeSocket | None:
    """Return the output linked to `target`."""
    return next((link.from_socket for link in target.links if not link.is_muted), None)


def input_value(node: bpy.types.Node, name: str | float, default: SocketOrValue) -> SocketOrValue:
    """Return the link or the value of the input `name` of `node`; a number is returned unchanged; `default` if there is no such input."""
    if not isinstance(name, str):
        return name
    target = node.inputs.get(name)
    if target is None:
        return default
    source = linked_output(target)
    if source is not None:
        return source
    value = target.default_value
    return float(value) if isinstance(value, float | int) else list(value)[:3]
