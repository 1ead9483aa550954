"""Shader nodes that ask where a point is, answered with the place it has in the scene although it is rendered somewhere else.

While a quad is captured its faces lie in a slot of the atlas. The meshes there carry what the scene said as attributes, and in the copies
of the materials those nodes are replaced that would read the slot's position, normal or object. What cannot be kept: View and camera
coordinates, reflections, Vector Transform nodes, box-projected images, the Tangent and Pointiness of the Geometry node, ambient occlusion
and bevels (which would see one quad's faces only), and the colour and indices of an instance where they differ from its object's.
"""

from collections.abc import Callable

import bpy
import numpy as np

from .node_groups import nodes_in
from .wiring import Wiring

POSITION, OBJECT, GENERATED = "farfield_position", "farfield_object", "farfield_generated"
LOCATION, RANDOM, ISLAND = "farfield_location", "farfield_random", "farfield_island"
QUAD_AXES = ("farfield_u", "farfield_v", "farfield_n")
OBJECT_AXES = ("farfield_x", "farfield_y", "farfield_z")
GENERATED_BY_DEFAULT = {
    "ShaderNodeTexNoise",
    "ShaderNodeTexVoronoi",
    "ShaderNodeTexWave",
    "ShaderNodeTexMagic",
    "ShaderNodeTexGradient",
    "ShaderNodeTexChecker",
    "ShaderNodeTexBrick",
    "ShaderNodeTexGabor",
}


def world_normal(wiring: Wiring) -> bpy.types.NodeSocket:
    """The shading normal in world space, on the side of the viewer."""
    return wiring.along(wiring.node("ShaderNodeNewGeometry").outputs["Normal"], QUAD_AXES)


def answer_for_the_scene(tree: bpy.types.NodeTree) -> None:
    """Replace the nodes of `tree` that would read the slot instead of the scene. Groups in it are left alone."""
    wiring = Wiring(tree)
    for node in list(tree.nodes):
        if node.bl_idname == "ShaderNodeTexCoord":
            _replace_coordinates(wiring, node)
        elif node.bl_idname == "ShaderNodeNewGeometry":
            _replace_geometry(wiring, node)
        elif node.bl_idname == "ShaderNodeObjectInfo":
            _relink(wiring, node.outputs["Location"], lambda: wiring.attribute(LOCATION))
            _relink(wiring, node.outputs["Random"], lambda: wiring.attribute(RANDOM, number=True))
        elif node.bl_idname in GENERATED_BY_DEFAULT and not node.inputs["Vector"].is_linked:
            tree.links.new(wiring.attribute(GENERATED), node.inputs["Vector"])


def asked_layers(tree: bpy.types.NodeTree) -> set[str]:
    """Names of the attributes that `tree` and the groups in it read."""
    keys = ("attribute_name", "layer_name", "uv_map")
    return {getattr(node, key) for node in nodes_in(tree) for key in keys if getattr(node, key, "")}


def _replace_coordinates(wiring: Wiring, node: bpy.types.Node) -> None:
    _relink(wiring, node.outputs["Generated"], lambda: wiring.attribute(GENERATED))
    _relink(wiring, node.outputs["Normal"], lambda: wiring.across(world_normal(wiring), OBJECT_AXES))
    if node.object is None:
        _relink(wiring, node.outputs["Object"], lambda: wiring.attribute(OBJECT))
    else:
        to_object = np.linalg.pinv(np.array(node.object.matrix_world, np.float64))
        _relink(wiring, node.outputs["Object"], lambda: wiring.transform(wiring.attribute(POSITION), to_object))


def _replace_geometry(wiring: Wiring, node: bpy.types.Node) -> None:
    _relink(wiring, node.outputs["Position"], lambda: wiring.attribute(POSITION))
    _relink(wiring, node.outputs["Random Per Island"], lambda: wiring.attribute(ISLAND, number=True))
    # An input called Normal wants the normal where the shading happens, which is in the slot.
    _relink(wiring, node.outputs["Normal"], lambda: wiring.along(node.outputs["Normal"], QUAD_AXES), keep="Normal")
    _relink(wiring, node.outputs["True Normal"], lambda: wiring.along(node.outputs["True Normal"], QUAD_AXES), keep="Normal")


def _relink(wiring: Wiring, output: bpy.types.NodeSocket, replacement: Callable[[], bpy.types.NodeSocket], keep: str | None = None) -> None:
    """Hand the links of `output` to the socket that `replacement()` makes, but for those into inputs called `keep`."""
    targets = [link.to_socket for link in output.links if link.to_socket.name != keep]
    if not targets:
        return
    source = replacement()
    for target in targets:
        wiring.tree.links.new(source, target)
