"""Shader nodes written as formulas."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import bpy
import numpy as np

Operand = bpy.types.NodeSocket | float | Sequence[float]


class Wiring:
    """Adds nodes to one tree. Operands are output sockets, numbers or triples of numbers; results are output sockets."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree

    def node(self, kind: str, properties: Mapping[str, Any] = MappingProxyType({})) -> bpy.types.Node:
        """A new node of the type `kind` with some of its `properties` set."""
        made = self.tree.nodes.new(kind)
        for name, value in properties.items():
            setattr(made, name, value)
        return made

    def connect(self, operand: Operand, target: bpy.types.NodeSocket) -> None:
        """Link `operand` to an input, or set the input to it."""
        if isinstance(operand, bpy.types.NodeSocket):
            self.tree.links.new(operand, target)
        elif isinstance(target.default_value, float):
            target.default_value = operand
        else:
            width = len(target.default_value)
            numbers = [operand] * width if isinstance(operand, float | int) else list(operand)
            target.default_value = [*numbers, 1.0][:width]

    def math(self, operation: str, first: Operand, second: Operand = 0.0, clamp: bool = False) -> bpy.types.NodeSocket:
        """A number out of one or two numbers."""
        made = self.node("ShaderNodeMath", {"operation": operation, "use_clamp": clamp})
        self.connect(first, made.inputs[0])
        self.connect(second, made.inputs[1])
        return made.outputs[0]

    def vector(self, operation: str, first: Operand, second: Operand = (0.0, 0.0, 0.0)) -> bpy.types.NodeSocket:
        """A vector, or a number for DOT_PRODUCT and LENGTH, out of two vectors; SCALE takes a number second."""
        made = self.node("ShaderNodeVectorMath", {"operation": operation})
        self.connect(first, made.inputs[0])
        self.connect(second, made.inputs["Scale"] if operation == "SCALE" else made.inputs[1])
        return made.outputs["Value" if operation in {"DOT_PRODUCT", "LENGTH"} else "Vector"]

    def turned(self, vector: Operand, kind: str, source: str, target: str) -> bpy.types.NodeSocket:
        """`vector`, a "VECTOR" or a "NORMAL", from one space into another: "WORLD", "OBJECT" or "CAMERA"."""
        made = self.node("ShaderNodeVectorTransform", {"vector_type": kind, "convert_from": source, "convert_to": target})
        self.connect(vector, made.inputs[0])
        return made.outputs[0]

    def mix(self, factor: Operand, first: Operand, second: Operand) -> bpy.types.NodeSocket:
        """(1 - factor) * first + factor * second of two vectors, with the factor clamped to 0..1."""
        made = self.node("ShaderNodeMix", {"data_type": "VECTOR", "clamp_factor": True})
        self.connect(factor, made.inputs[0])
        self.connect(first, made.inputs[4])
        self.connect(second, made.inputs[5])
        return made.outputs[1]

    def combine(self, x: Operand, y: Operand, z: Operand) -> bpy.types.NodeSocket:
        """A vector of three numbers."""
        made = self.node("ShaderNodeCombineXYZ")
        for operand, target in zip((x, y, z), made.inputs, strict=True):
            self.connect(operand, target)
        return made.outputs[0]

    def separate(self, vector: Operand) -> list[bpy.types.NodeSocket]:
        """The three numbers of a vector."""
        made = self.node("ShaderNodeSeparateXYZ")
        self.connect(vector, made.inputs[0])
        return list(made.outputs)

    def add_scaled(self, total: Operand, factor: Operand, color: Operand) -> bpy.types.NodeSocket:
        """total + factor * color of two colours, for any factor."""
        properties = {"data_type": "RGBA", "blend_type": "ADD", "clamp_factor": False, "clamp_result": False}
        made = self.node("ShaderNodeMix", properties)
        self.connect(factor, made.inputs[0])
        self.connect(total, made.inputs[6])
        self.connect(color, made.inputs[7])
        return made.outputs[2]

    def product(self, first: Operand, second: Operand) -> bpy.types.NodeSocket:
        """Two colours, channel by channel."""
        properties = {"data_type": "RGBA", "blend_type": "MULTIPLY", "clamp_factor": False, "clamp_result": False}
        made = self.node("ShaderNodeMix", properties)
        self.connect(1.0, made.inputs[0])
        self.connect(first, made.inputs[6])
        self.connect(second, made.inputs[7])
        return made.outputs[2]

    def channels(self, color: Operand) -> list[bpy.types.NodeSocket]:
        """Red, green and blue of a colour."""
        made = self.node("ShaderNodeSeparateColor", {"mode": "RGB"})
        self.connect(color, made.inputs[0])
        return list(made.outputs)[:3]

    def attribute(self, name: str, number: bool = False) -> bpy.types.NodeSocket:
        """The geometry attribute `name` as a vector, or as a number."""
        made = self.node("ShaderNodeAttribute", {"attribute_name": name})
        return made.outputs["Fac" if number else "Vector"]

    def of_object(self, name: str) -> bpy.types.NodeSocket:
        """The custom property `name` of the object that is shaded, as a vector; of an instance, that of the object it shows."""
        made = self.node("ShaderNodeAttribute", {"attribute_type": "OBJECT", "attribute_name": name, "label": name})
        return made.outputs["Vector"]

    def transform(self, point: Operand, matrix: np.ndarray) -> bpy.types.NodeSocket:
        """`point` through an affine `matrix` (4, 4)."""
        rows = [self.math("ADD", self.vector("DOT_PRODUCT", point, row[:3].tolist()), float(row[3])) for row in matrix[:3]]
        return self.combine(*rows)

    def along(self, vector: Operand, axes: Sequence[str]) -> bpy.types.NodeSocket:
        """x, y and z of `vector` times the three unit vectors that the attributes `axes` hold, summed: out of their frame."""
        parts = [self.vector("SCALE", self.attribute(axis), number) for axis, number in zip(axes, self.separate(vector), strict=True)]
        return self.vector("ADD", self.vector("ADD", parts[0], parts[1]), parts[2])

    def across(self, vector: Operand, axes: Sequence[str]) -> bpy.types.NodeSocket:
        """`vector` measured along the three unit vectors that the attributes `axes` hold: into their frame."""
        return self.combine(*(self.vector("DOT_PRODUCT", vector, self.attribute(axis)) for axis in axes))

    def arrange(self) -> None:
        """Place the nodes for a reader: the output on the right, every node in a column left of all that it feeds."""
        columns = {node.name: 0 for node in self.tree.nodes}
        for _ in columns:
            moved = False
            for link in self.tree.links:
                wanted = columns[link.to_node.name] + 1
                if columns[link.from_node.name] < wanted:
                    columns[link.from_node.name], moved = wanted, True
            if not moved:
                break
        heights: dict[int, float] = {}
        for node in self.tree.nodes:
            column = columns[node.name]
            node.location = -260.0 * column, heights.get(column, 0.0)
            heights[column] = heights.get(column, 0.0) - (300.0 if node.type in {"TEX_IMAGE", "BSDF_PRINCIPLED"} else 190.0)
