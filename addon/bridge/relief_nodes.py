"""Nodes that look normals up where a viewer from aslant sees them; see `core.btf.relief`."""

import bpy
import numpy as np

from ..core.btf.relief import LEAST_FACING, MOST
from .table_nodes import texture
from .wiring import Operand, Wiring

AXES = ("farfield_texel_x", "farfield_texel_y")  # attributes of the faces of a level
RELIEF = "Relief"  # label of the node with the plain map that holds depths


def write_axes(mesh: bpy.types.Mesh, axes: np.ndarray) -> None:
    """Keep the `axes` (Q, 2, 3) of the polygons of `mesh` on it, see `core.btf.relief.axes_of`."""
    for number, name in enumerate(AXES):
        attribute = mesh.attributes.get(name) or mesh.attributes.new(name, "FLOAT_VECTOR", "FACE")
        attribute.data.foreach_set("vector", np.ascontiguousarray(axes[:, number], np.float32).ravel())


def seen_place(wiring: Wiring, depths: bpy.types.Image, viewer: Operand) -> bpy.types.NodeSocket:
    """The place in the UV map of what is seen from the world-space direction `viewer`."""
    view = wiring.vector("NORMALIZE", wiring.turned(viewer, "VECTOR", "WORLD", "OBJECT"))
    axes = [wiring.attribute(name) for name in AXES]
    facing = wiring.vector("DOT_PRODUCT", wiring.vector("NORMALIZE", wiring.vector("CROSS_PRODUCT", *axes)), view)
    square = wiring.math("MAXIMUM", wiring.math("MULTIPLY", facing, facing), LEAST_FACING**2)
    stored = wiring.channels(texture(wiring, depths, RELIEF)[0])[2]
    depth = wiring.math("SUBTRACT", wiring.math("MULTIPLY", stored, 2.0), 1.0)
    far = wiring.math("DIVIDE", wiring.math("MULTIPLY", depth, facing), square)
    moves = []
    for axis, size in zip(axes, depths.size, strict=True):
        texels = wiring.math("MULTIPLY", far, wiring.vector("DOT_PRODUCT", axis, view))
        within = wiring.math("MAXIMUM", wiring.math("MINIMUM", texels, MOST), -MOST)
        moves.append(wiring.math("DIVIDE", within, float(size)))
    return wiring.vector("ADD", wiring.node("ShaderNodeUVMap").outputs[0], wiring.combine(*moves, 0.0))
