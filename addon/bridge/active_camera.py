"""A group of geometry nodes that tells what the active camera sees, or a viewport in its place. It needs no extension: drivers read the
camera's lens and the resolution."""

from dataclasses import dataclass

import bpy

from ..core.geometry.cameras import Camera
from .geometry.geometry_nodes import TREE, GeometryBuilder
from .lod_crossfade import CONSTANT, GROWTH, PIXELS, SCENE_PATHS
from .objects import drive_by_scene
from .shading.node_builder import NodeBuilder, ensure_shared_group

VIEW_NAME, VIEW_VERSION = "Farfield Active Camera", 3
# The tangent of the angle between the view direction and the corners of the image; as large as possible where everything may be seen. Only
# the functions of simple expressions, without hypot: Blender would not run another driver of a file from elsewhere.
DIAGONAL = f"1e6 if t!=0 else tan(a/2)/{PIXELS}*sqrt(x*x+y*y)*p/100+sqrt(i*i+j*j)*2*tan(a/2)"
VIEW_VALUES = {"Growth": GROWTH, "Constant": CONSTANT, "Diagonal": DIAGONAL}
VIEW_PATHS = SCENE_PATHS | {"i": "camera.data.shift_x", "j": "camera.data.shift_y"}
# Values of the view that a viewport shows instead of that of the active camera, while it follows the user's: 1, the position, and sizes.
VIEWPORT_VALUES = ("Follows Viewport", "Viewport X", "Viewport Y", "Viewport Z", "Viewport Growth", "Viewport Constant")
EVERYTHING = 1e6  # The diagonal of a view to all sides.


@dataclass(frozen=True)
class View:
    """What the active camera sees.

    Attributes:
        position: of the camera, in world space.
        direction: in which it looks, in world space.
        growth: of the size of a pixel per unit of distance, see `lod_crossfade`; for levels times what they may leave out, in pixels.
        constant: size of a pixel at the camera, for levels times the same.
        diagonal: see `DIAGONAL`.
        is_viewport: whether no render is made.
    """

    position: bpy.types.NodeSocket
    direction: bpy.types.NodeSocket
    growth: bpy.types.NodeSocket
    constant: bpy.types.NodeSocket
    diagonal: bpy.types.NodeSocket
    is_viewport: bpy.types.NodeSocket


def add_view(builder: GeometryBuilder) -> View:
    """Add the group to a tree, and return its outputs."""
    return View(*builder.call("GeometryNodeGroup", {}, {"node_tree": _ensure_view()}).outputs[:6])


def _ensure_view() -> bpy.types.NodeTree:
    """Return the node group whose outputs are the fields of `View`."""
    outputs = [("Position", "Vector"), ("Direction", "Vector"), ("Growth", "Float"), ("Constant", "Float"), ("Diagonal", "Float")]
    return ensure_shared_group(VIEW_NAME, VIEW_VERSION, [], [*outputs, ("Is Viewport", "Bool")], _fill_view, tree_type=TREE)


def _fill_view(builder: NodeBuilder) -> None:
    builder = GeometryBuilder(builder.tree)
    camera = builder.node("GeometryNodeInputActiveCamera").outputs[0]
    info = builder.call("GeometryNodeObjectInfo", {"Object": camera})
    rotate = builder.call("FunctionNodeRotateVector", {0: (0.0, 0.0, -1.0), 1: info.outputs["Rotation"]})
    values = [info.outputs["Location"], rotate.outputs[0]]
    for name, expression in VIEW_VALUES.items():
        node = builder.node("ShaderNodeValue", {"name": name, "label": name})
        drive_by_scene(node.outputs[0].driver_add("default_value").driver, expression, VIEW_PATHS)
        values.append(node.outputs[0])
    is_viewport = builder.node("GeometryNodeIsViewport").outputs[0]
    follows, *position, growth, constant = [
        builder.node("ShaderNodeValue", {"name": name, "label": name}).outputs[0] for name in VIEWPORT_VALUES
    ]
    is_following = builder.boolean("AND", is_viewport, builder.less(0.5, follows))
    of_viewport = (builder.combine(*position), None, growth, constant, EVERYTHING)
    kinds = ("VECTOR", "", "FLOAT", "FLOAT", "FLOAT")
    values = [
        value if other is None else builder.switch(is_following, value, other, kind)
        for value, other, kind in zip(values, of_viewport, kinds, strict=True)
    ]
    values.append(is_viewport)
    output = builder.node("NodeGroupOutput")
    for value, target in zip(values, output.inputs, strict=False):
        builder.tree.links.new(value, target)


def follow_viewport(camera: Camera | None) -> None:
    """Let viewports show levels for a view in place of that of the active camera, or with None for that of the active camera again."""
    values = [0.0] * len(VIEWPORT_VALUES)
    if camera is not None:
        constant = camera.pixel_size(0.0)
        growth = camera.pixel_size(1.0) if camera.field_of_view else 0.0
        values = [1.0, *camera.position, growth, constant]
    for tree in bpy.data.node_groups:
        if tree.name.startswith(VIEW_NAME) and tree.library is None:
            for name, value in zip(VIEWPORT_VALUES, values, strict=True):
                output = tree.nodes[name].outputs[0]
                if output.default_value != value:
                    output.default_value = value
