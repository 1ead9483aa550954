"""Builds trees of geometry nodes from expressions."""

import bpy

from ..shading.node_builder import NodeBuilder, SocketOrValue

TREE = "GeometryNodeTree"


class GeometryBuilder(NodeBuilder):
    """Adds geometry nodes to one tree."""

    def call(self, node_type: str, inputs: dict[str | int, object], properties: dict[str, object] | None = None) -> bpy.types.Node:
        """Add a node and set or connect some of its inputs, by name or index."""
        node = self.node(node_type, properties or {})
        for key, value in inputs.items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, node.inputs[key])
            else:
                node.inputs[key].default_value = value
        return node

    def boolean(self, operation: str, *conditions: SocketOrValue) -> bpy.types.NodeSocket:
        """Return "AND" or "OR" of two conditions, or "NOT" of one: from Blender 5.2, the node has no second input for that."""
        return self.call("FunctionNodeBooleanMath", dict(enumerate(conditions)), {"operation": operation}).outputs[0]

    def switch(self, condition: SocketOrValue, if_false: object, if_true: object, input_type: str) -> bpy.types.NodeSocket:
        """Return one of two values."""
        return self.call("GeometryNodeSwitch", {0: condition, 1: if_false, 2: if_true}, {"input_type": input_type}).outputs[0]

    def less(self, first: SocketOrValue, second: SocketOrValue) -> bpy.types.NodeSocket:
        """Return whether a number is smaller than another one."""
        return self.call("FunctionNodeCompare", {0: first, 1: second}, {"data_type": "FLOAT", "operation": "LESS_THAN"}).outputs[0]

    def transform_point(self, point: SocketOrValue, matrix: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
        """Transform a point by a matrix."""
        return self.call("FunctionNodeTransformPoint", {0: point, 1: matrix}).outputs[0]

    def capture_transforms(self, geometry: bpy.types.NodeSocket) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
        """Return instances with their matrices, which points made of them keep, and these matrices."""
        node = self.node("GeometryNodeCaptureAttribute", {"domain": "INSTANCE"})
        node.capture_items.new("MATRIX", "Transform")
        self.tree.links.new(geometry, node.inputs[0])
        self.tree.links.new(self.node("GeometryNodeInstanceTransform").outputs[0], node.inputs["Transform"])
        return node.outputs[0], node.outputs["Transform"]
