"""Node trees as plain data: recorded from one version of Farfield, and built again by tests of another one."""

from collections.abc import Callable
from typing import Any

import bpy

LAYOUT = {"name", "location", "location_absolute", "width", "height", "select", "show_options", "show_preview", "hide", "color", "parent"}
LAYOUT |= {"show_texture"}  # which image Solid views show


def describe_tree(tree: bpy.types.NodeTree) -> dict[str, Any]:
    """Return the sockets of a node tree, its nodes with everything that differs from new ones, and its links; without their layout."""
    nodes = list(tree.nodes)
    fresh = bpy.data.node_groups.new("Fresh", "ShaderNodeTree")
    try:
        described = [_describe_node(node, fresh) for node in nodes]
    finally:
        bpy.data.node_groups.remove(fresh)
    sockets = [] if tree.interface is None else [item for item in tree.interface.items_tree if item.item_type == "SOCKET"]
    links = [[nodes.index(link.from_node), _key(link.from_socket), nodes.index(link.to_node), _key(link.to_socket)] for link in tree.links]
    return {
        "interface": [[item.name, item.in_out, item.bl_socket_idname] for item in sockets],
        "nodes": described,
        "links": sorted(links, key=str),
    }


def build_tree(tree: bpy.types.NodeTree, description: dict[str, Any], find: Callable[[str, str], bpy.types.ID]) -> None:
    """Fill an empty node tree. find: returns a data-block by the name of the property that holds it and its recorded name."""
    for name, in_out, socket_type in description["interface"]:
        tree.interface.new_socket(name, in_out=in_out, socket_type=socket_type)
    nodes = []
    for item in description["nodes"]:
        node = tree.nodes.new(item["type"])
        for name, value in item["properties"].items():
            setattr(node, name, find(name, value["data"]) if isinstance(value, dict) else value)
        nodes.append(node)
    for node, item in zip(nodes, description["nodes"], strict=True):
        for key, value in item["inputs"].items():
            _find(node.inputs, key).default_value = value
    for source, output, target, wanted in description["links"]:
        tree.links.new(_find(nodes[source].outputs, output), _find(nodes[target].inputs, wanted))


def _describe_node(node: bpy.types.Node, fresh: bpy.types.NodeTree) -> dict[str, Any]:
    new = fresh.nodes.new(node.bl_idname)
    properties = {}
    for item in node.bl_rna.properties:
        name = item.identifier
        if item.is_readonly or name in LAYOUT or name.startswith("bl_"):
            continue
        value = _plain(getattr(node, name))
        if value != _plain(getattr(new, name)):
            properties[name] = value
            if not isinstance(value, dict):
                setattr(new, name, getattr(node, name))
    inputs = {}
    for socket in node.inputs:
        other = next((item for item in new.inputs if _key(item) == _key(socket)), None)
        if not socket.is_linked and hasattr(socket, "default_value"):
            value = _plain(socket.default_value)
            if other is None or value != _plain(other.default_value):
                inputs[_key(socket)] = value
    return {"type": node.bl_idname, "properties": properties, "inputs": inputs}


def _plain(value: Any) -> Any:
    if isinstance(value, bpy.types.ID):
        return {"data": value.name}
    if isinstance(value, float):
        return round(value, 6)
    if value is None or isinstance(value, bool | int | str):
        return value
    return [round(float(component), 6) for component in value] if hasattr(value, "__len__") else str(value)


def _key(socket: bpy.types.NodeSocket) -> str:
    """Return the identifier of a socket, which is the same in all versions of Blender; that of a group depends on the file."""
    return socket.name if socket.identifier.startswith("Socket_") else socket.identifier


def _find(sockets: bpy.types.bpy_prop_collection, key: str) -> bpy.types.NodeSocket:
    return next(socket for socket in sockets if _key(socket) == key)
