"""Replaces shader nodes that read scene-space inputs, for materials rendered at a different place than in the scene.

While a quad is captured, its faces are placed in a rectangle of the atlas. The meshes there store the scene-space inputs as attributes. In
the copies of the materials, nodes that would read the position, normal or object in the atlas are replaced by these attributes. Not
supported: View and camera coordinates, reflections, Vector Transform nodes, box-projected images, Tangent and Pointiness of the Geometry
node, ambient occlusion and bevels (which would see the faces of one quad only).
"""

from collections.abc import Callable, Sequence

import bpy
import numpy as np

from ...core.errors import GeometryError
from .node_builder import NodeBuilder, nodes_in

POSITION, OBJECT, GENERATED = "farfield_position", "farfield_object", "farfield_generated"
LOCATION, RANDOM, ISLAND = "farfield_location", "farfield_random", "farfield_island"
QUAD_AXES = ("farfield_u", "farfield_v", "farfield_n")
OBJECT_AXES = ("farfield_x", "farfield_y", "farfield_z")
OBJECT_INFO = (("Color", "color", "Color"), ("Alpha", "color", "Alpha"), ("Object Index", "pass_index", "Fac"))
OBJECT_VALUE = "farfield_object "  # Followed by what a material reads of its object, see `read_object_value`.
INSTANCER_VALUE = "farfield_instancer "  # The same of an instance, of what makes it and then of its object.
Rgba = tuple[float, float, float, float]
GENERATED_BY_DEFAULT = {  # nodes whose unlinked Vector input means Generated coordinates
    "ShaderNodeTexNoise",
    "ShaderNodeTexVoronoi",
    "ShaderNodeTexWave",
    "ShaderNodeTexMagic",
    "ShaderNodeTexGradient",
    "ShaderNodeTexChecker",
    "ShaderNodeTexBrick",
    "ShaderNodeTexGabor",
}


def world_normal(builder: NodeBuilder) -> bpy.types.NodeSocket:
    """Return the shading normal in world space, on the viewer's side."""
    return builder.from_frame(builder.node("ShaderNodeNewGeometry").outputs["Normal"], QUAD_AXES)


def replace_scene_space_nodes(tree: bpy.types.NodeTree) -> None:
    """Replace the nodes of `tree` that would read the atlas instead of the scene. Node groups inside it are not changed.

    Raises:
        GeometryError: the transform of an object whose coordinates it uses is not finite.
    """
    builder = NodeBuilder(tree)
    for node in list(tree.nodes):
        if node.bl_idname == "ShaderNodeTexCoord":
            _replace_coordinates(builder, node)
        elif node.bl_idname == "ShaderNodeNewGeometry":
            _replace_geometry(builder, node)
        elif node.bl_idname == "ShaderNodeObjectInfo":
            _relink(builder, node.outputs["Location"], lambda: builder.attribute(LOCATION))
            _relink(builder, node.outputs["Random"], lambda: builder.attribute(RANDOM, is_scalar=True))
            for output, name, value in OBJECT_INFO:
                _relink(builder, node.outputs[output], lambda name=name, value=value: _object_value(builder, name).outputs[value])
        elif node.bl_idname == "ShaderNodeAttribute" and node.attribute_type in {"OBJECT", "INSTANCER"}:
            prefix = OBJECT_VALUE if node.attribute_type == "OBJECT" else INSTANCER_VALUE
            node.attribute_type, node.attribute_name = "GEOMETRY", prefix + node.attribute_name
        elif node.bl_idname in GENERATED_BY_DEFAULT and not node.inputs["Vector"].is_linked:
            tree.links.new(builder.attribute(GENERATED), node.inputs["Vector"])


def read_object_value(items: Sequence[bpy.types.Object], name: str) -> Rgba:
    """Return what an Attribute node of the type Object reads as `name`: a custom property of an object or of its data, or a built-in one
    such as "color"; that of the first of `items` that has one, 0 if none has."""
    for owner in (owner for item in items for owner in (item, item.data)):
        try:
            value = owner[name] if owner is not None and name in owner else owner.path_resolve(name)
            values = [float(component) for component in ([value] if isinstance(value, int | float) else value)]
        except (AttributeError, KeyError, TypeError, ValueError):
            continue
        if 1 <= len(values) <= 4:
            return to_rgba(values)
    return (0.0, 0.0, 0.0, 0.0)


def to_rgba(values: Sequence[float]) -> Rgba:
    """Return the color and alpha as which shaders read an attribute of one to four numbers."""
    if len(values) == 1:
        return (values[0], values[0], values[0], 1.0)
    return tuple([*values, 0.0][:3] + [values[3] if len(values) == 4 else 1.0])


def reads_object(tree: bpy.types.NodeTree, is_one_of_several: bool) -> bool:
    """Return whether `tree` and the node groups inside it read anything that one mesh of all objects of a source would not have.

    is_one_of_several: whether the source has several objects or instances, so that it also lacks their coordinates and properties.
    """
    for node in nodes_in(tree):
        linked = {output.name for output in node.outputs if output.is_linked}
        if node.bl_idname == "ShaderNodeObjectInfo" and (is_one_of_several or "Random" in linked):
            return True
        if not is_one_of_several:
            continue
        if node.bl_idname == "ShaderNodeAttribute" and node.attribute_type in {"OBJECT", "INSTANCER"}:
            return True
        if node.bl_idname == "ShaderNodeTexCoord" and linked & {"Generated", "Object"}:
            return True
        if node.bl_idname in GENERATED_BY_DEFAULT and not node.inputs["Vector"].is_linked:
            return True
    return False


def required_attributes(tree: bpy.types.NodeTree) -> set[str]:
    """Return the names of the attributes read by `tree` and the node groups inside it."""
    keys = ("attribute_name", "layer_name", "uv_map")
    return {getattr(node, key) for node in nodes_in(tree) for key in keys if getattr(node, key, "")}


def _object_value(builder: NodeBuilder, name: str) -> bpy.types.Node:
    return builder.node("ShaderNodeAttribute", {"attribute_name": OBJECT_VALUE + name})


def _replace_coordinates(builder: NodeBuilder, node: bpy.types.Node) -> None:
    _relink(builder, node.outputs["Generated"], lambda: builder.attribute(GENERATED))
    _relink(builder, node.outputs["Normal"], lambda: builder.to_frame(world_normal(builder), OBJECT_AXES))
    if node.object is None:
        _relink(builder, node.outputs["Object"], lambda: builder.attribute(OBJECT))
    else:
        matrix = np.array(node.object.matrix_world, np.float64)
        if not np.isfinite(matrix).all():
            raise GeometryError(f'"{node.object.name}" has a transform that is not finite, and a material uses its coordinates; clear it.')
        to_object = np.linalg.pinv(matrix)
        _relink(builder, node.outputs["Object"], lambda: builder.transform(builder.attribute(POSITION), to_object))


def _replace_geometry(builder: NodeBuilder, node: bpy.types.Node) -> None:
    _relink(builder, node.outputs["Position"], lambda: builder.attribute(POSITION))
    _relink(builder, node.outputs["Random Per Island"], lambda: builder.attribute(ISLAND, is_scalar=True))
    # An input called Normal expects the normal at the shading point, which is in the atlas.
    _relink(builder, node.outputs["Normal"], lambda: builder.from_frame(node.outputs["Normal"], QUAD_AXES), keep="Normal")
    _relink(builder, node.outputs["True Normal"], lambda: builder.from_frame(node.outputs["True Normal"], QUAD_AXES), keep="Normal")


def _relink(
    builder: NodeBuilder, output: bpy.types.NodeSocket, replacement: Callable[[], bpy.types.NodeSocket], keep: str | None = None
) -> None:
    """Move the links of `output`, except those into inputs called `keep`, to the socket returned by `replacement`."""
    targets = [link.to_socket for link in output.links if link.to_socket.name != keep]
    if not targets:
        return
    source = replacement()
    for target in targets:
        builder.tree.links.new(source, target)
