"""Builds shader node trees from expressions, and node groups with named sockets; finds nodes in groups, and those that emit light."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import bpy
import numpy as np

from ...compat import enable_nodes

COLUMN_WIDTH, ROW_HEIGHT, TALL_ROW_HEIGHT = 260.0, 190.0, 300.0  # Units of the node editor, see `NodeBuilder.arrange`.
TALL_NODES = {"TEX_IMAGE", "BSDF_PRINCIPLED"}

SocketOrValue = bpy.types.NodeSocket | float | Sequence[float]


class NodeBuilder:
    """Adds nodes to one tree. Operands are output sockets, numbers or triples of numbers; results are output sockets."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree

    def node(self, node_type: str, properties: Mapping[str, Any] = MappingProxyType({})) -> bpy.types.Node:
        """Add a node of the type `node_type` and set some of its `properties`, unless they are as wanted: Blender updates the tree whenever
        one is set."""
        node = self.tree.nodes.new(node_type)
        for name, value in properties.items():
            if getattr(node, name) != value:
                setattr(node, name, value)
        return node

    def connect(self, operand: SocketOrValue, target: bpy.types.NodeSocket) -> None:
        """Link `operand` to an input, or set the input to it."""
        if isinstance(operand, bpy.types.NodeSocket):
            self.tree.links.new(operand, target)
        elif isinstance(target.default_value, float):
            target.default_value = operand
        else:
            width = len(target.default_value)
            values = [operand] * width if isinstance(operand, float | int) else list(operand)
            target.default_value = [*values, 1.0][:width]

    def math(self, operation: str, first: SocketOrValue, second: SocketOrValue = 0.0, clamp: bool = False) -> bpy.types.NodeSocket:
        """Return a number computed from one or two numbers (Math node)."""
        node = self.node("ShaderNodeMath", {"operation": operation, "use_clamp": clamp})
        self.connect(first, node.inputs[0])
        self.connect(second, node.inputs[1])
        return node.outputs[0]

    def multiply_add(self, first: SocketOrValue, second: SocketOrValue, third: SocketOrValue) -> bpy.types.NodeSocket:
        """Return first * second + third of three numbers (Math node)."""
        value = self.math("MULTIPLY_ADD", first, second)
        self.connect(third, value.node.inputs[2])
        return value

    def vector(self, operation: str, first: SocketOrValue, second: SocketOrValue = (0.0, 0.0, 0.0)) -> bpy.types.NodeSocket:
        """Return a vector, or a number for DOT_PRODUCT and LENGTH, computed from two vectors; for SCALE, `second` is a number."""
        node = self.node("ShaderNodeVectorMath", {"operation": operation})
        self.connect(first, node.inputs[0])
        self.connect(second, node.inputs["Scale"] if operation == "SCALE" else node.inputs[1])
        return node.outputs["Value" if operation in {"DOT_PRODUCT", "LENGTH"} else "Vector"]

    def vector_transform(self, vector: SocketOrValue, vector_type: str, source: str, target: str) -> bpy.types.NodeSocket:
        """Transform `vector`, of the type "VECTOR" or "NORMAL", between the spaces "WORLD", "OBJECT" and "CAMERA"."""
        node = self.node("ShaderNodeVectorTransform", {"vector_type": vector_type, "convert_from": source, "convert_to": target})
        self.connect(vector, node.inputs[0])
        return node.outputs[0]

    def mix(self, factor: SocketOrValue, first: SocketOrValue, second: SocketOrValue) -> bpy.types.NodeSocket:
        """Return (1 - factor) * first + factor * second of two vectors, with the factor clamped to 0..1."""
        node = self.node("ShaderNodeMix", {"data_type": "VECTOR", "clamp_factor": True})
        self.connect(factor, node.inputs[0])
        self.connect(first, node.inputs[4])
        self.connect(second, node.inputs[5])
        return node.outputs[1]

    def combine(self, x: SocketOrValue, y: SocketOrValue, z: SocketOrValue) -> bpy.types.NodeSocket:
        """Combine three numbers into a vector."""
        node = self.node("ShaderNodeCombineXYZ")
        for operand, target in zip((x, y, z), node.inputs, strict=True):
            self.connect(operand, target)
        return node.outputs[0]

    def separate(self, vector: SocketOrValue) -> list[bpy.types.NodeSocket]:
        """Separate a vector into its three numbers."""
        node = self.node("ShaderNodeSeparateXYZ")
        self.connect(vector, node.inputs[0])
        return list(node.outputs)

    def attenuate(self, depth: SocketOrValue) -> bpy.types.NodeSocket:
        """Return exp(-depth), the fraction of light that passes an optical depth."""
        return self.math("EXPONENT", self.math("MULTIPLY", depth, -1.0))

    def add_scaled(self, total: SocketOrValue, factor: SocketOrValue, color: SocketOrValue) -> bpy.types.NodeSocket:
        """Return total + factor * color of two colors, for any factor."""
        properties = {"data_type": "RGBA", "blend_type": "ADD", "clamp_factor": False, "clamp_result": False}
        node = self.node("ShaderNodeMix", properties)
        self.connect(factor, node.inputs[0])
        self.connect(total, node.inputs[6])
        self.connect(color, node.inputs[7])
        return node.outputs[2]

    def multiply_colors(self, first: SocketOrValue, second: SocketOrValue) -> bpy.types.NodeSocket:
        """Multiply two colors channel by channel."""
        properties = {"data_type": "RGBA", "blend_type": "MULTIPLY", "clamp_factor": False, "clamp_result": False}
        node = self.node("ShaderNodeMix", properties)
        self.connect(1.0, node.inputs[0])
        self.connect(first, node.inputs[6])
        self.connect(second, node.inputs[7])
        return node.outputs[2]

    def separate_color(self, color: SocketOrValue) -> list[bpy.types.NodeSocket]:
        """Separate a color into red, green and blue."""
        node = self.node("ShaderNodeSeparateColor", {"mode": "RGB"})
        self.connect(color, node.inputs[0])
        return list(node.outputs)[:3]

    def attribute(self, name: str, is_scalar: bool = False) -> bpy.types.NodeSocket:
        """Return the geometry attribute `name` as a vector, or as a number."""
        node = self.node("ShaderNodeAttribute", {"attribute_name": name})
        return node.outputs["Fac" if is_scalar else "Vector"]

    def object_attribute(self, name: str) -> bpy.types.NodeSocket:
        """Return the custom property `name` of the shaded object as a vector; for an instance, that of the instanced object."""
        node = self.node("ShaderNodeAttribute", {"attribute_type": "OBJECT", "attribute_name": name, "label": name})
        return node.outputs["Vector"]

    def instance_attribute(self, name: str) -> bpy.types.NodeSocket:
        """Return the attribute `name` of the shaded instance as a vector, 0 without it."""
        return self.node("ShaderNodeAttribute", {"attribute_type": "INSTANCER", "attribute_name": name, "label": name}).outputs["Vector"]

    def transform(self, point: SocketOrValue, matrix: np.ndarray) -> bpy.types.NodeSocket:
        """Transform `point` by an affine `matrix` (4, 4)."""
        rows = [self.math("ADD", self.vector("DOT_PRODUCT", point, row[:3].tolist()), float(row[3])) for row in matrix[:3]]
        return self.combine(*rows)

    def from_frame(self, vector: SocketOrValue, axes: Sequence[str]) -> bpy.types.NodeSocket:
        """Transform `vector` out of the frame whose three unit vectors are the attributes `axes`: the sum of component times axis."""
        parts = [self.vector("SCALE", self.attribute(axis), value) for axis, value in zip(axes, self.separate(vector), strict=True)]
        return self.vector("ADD", self.vector("ADD", parts[0], parts[1]), parts[2])

    def to_frame(self, vector: SocketOrValue, axes: Sequence[str]) -> bpy.types.NodeSocket:
        """Transform `vector` into the frame whose three unit vectors are the attributes `axes`."""
        return self.combine(*(self.vector("DOT_PRODUCT", vector, self.attribute(axis)) for axis in axes))

    def arrange(self) -> None:
        """Lay out the nodes for readers: the output on the right, every node in a column left of all nodes that it feeds."""
        columns = {node.name: 0 for node in self.tree.nodes}
        links = [(link.from_node.name, link.to_node.name) for link in self.tree.links]
        for _ in columns:
            has_changed = False
            for from_node, to_node in links:
                column = columns[to_node] + 1
                if columns[from_node] < column:
                    columns[from_node], has_changed = column, True
            if not has_changed:
                break
        heights: dict[int, float] = {}
        locations: list[float] = []
        for node in self.tree.nodes:
            column = columns[node.name]
            locations += -COLUMN_WIDTH * column, heights.get(column, 0.0)
            heights[column] = heights.get(column, 0.0) - (TALL_ROW_HEIGHT if node.type in TALL_NODES else ROW_HEIGHT)
        self.tree.nodes.foreach_set("location", locations)  # All at once: Blender updates the tree whenever one node is moved.


def create_node_material(name: str) -> tuple[bpy.types.Material, NodeBuilder]:
    """Create a material without nodes, and return it with the builder of its nodes."""
    material = bpy.data.materials.new(name)
    enable_nodes(material)
    material.node_tree.nodes.clear()
    return material, NodeBuilder(material.node_tree)


Sockets = Sequence[tuple[str, str]]  # names and types: "Color", "Float", "Shader" or "Vector"


def nodes_in(tree: bpy.types.NodeTree, muted: bool = True) -> Iterator[bpy.types.Node]:
    """Yield the nodes of `tree` and, recursively, of its node groups; with or without `muted` nodes."""
    for node in tree.nodes:
        if muted or not node.mute:
            yield node
            if node.type == "GROUP" and node.node_tree is not None:
                yield from nodes_in(node.node_tree, muted)


def create_group(name: str, inputs: Sockets, outputs: Sockets, tree_type: str = "ShaderNodeTree") -> bpy.types.NodeTree:
    """Create an empty group of nodes."""
    group = bpy.data.node_groups.new(name, tree_type)
    for direction, sockets in (("INPUT", inputs), ("OUTPUT", outputs)):
        for socket, socket_type in sockets:
            group.interface.new_socket(socket, in_out=direction, socket_type=f"NodeSocket{socket_type}")
    return group


def ensure_shared_group(
    name: str,
    version: int,
    inputs: Sockets,
    outputs: Sockets,
    fill: Callable[[NodeBuilder], None],
    variant: str = "",
    tree_type: str = "ShaderNodeTree",
) -> bpy.types.NodeTree:
    """Return the group of this name, version and `variant` that all materials or modifiers of the file share; create it with `fill` if
    there is none."""
    for group in bpy.data.node_groups:
        is_same = group.get("farfield_version") == version and group.get("farfield_variant", "") == variant
        if is_same and group.name.startswith(name) and group.library is None:
            return group
    group = create_group(name, inputs, outputs, tree_type)
    group["farfield_version"] = version
    if variant:
        group["farfield_variant"] = variant
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
