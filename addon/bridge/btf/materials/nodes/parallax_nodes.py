"""Shader nodes for parallax mapping of the normal lookup; see `core.btf.reflectance.parallax`."""

from collections.abc import Sequence

import bpy
import numpy as np

from .....core.btf.reflectance.parallax import MAX_OFFSET, MIN_COSINE
from ....billboards.level_objects import read_face_quads
from ....geometry.mesh_arrays import write_attribute
from ....shading.node_builder import NodeBuilder, SocketOrValue
from .table_nodes import sample_image

TEXEL_AXES = ("farfield_texel_x", "farfield_texel_y")  # Face attributes of a level.
DEPTH = "Depth"  # Label of the image node of the PBR map with depth.


def write_texel_axes(mesh: bpy.types.Mesh, axes: np.ndarray) -> None:
    """Store the `axes` (Q, 2, 3) of the quads of `mesh` as face attributes, see `core.btf.reflectance.parallax.parallax_axes`."""
    quads = read_face_quads(mesh)
    for index, name in enumerate(TEXEL_AXES):
        write_attribute(mesh, name, "FACE", axes[:, index] if quads is None else axes[quads, index])


def parallax_uv(builder: NodeBuilder, depth_image: bpy.types.Image, viewer: SocketOrValue) -> bpy.types.NodeSocket:
    """Return the UV of the surface point that is visible from the world-space direction `viewer`, by the depth in `depth_image`."""
    encoded = builder.separate_color(sample_image(builder, depth_image, DEPTH)[0])[2]
    return depth_uv(builder, encoded, depth_image.size, viewer)


def depth_uv(builder: NodeBuilder, encoded: SocketOrValue, size: Sequence[int], viewer: SocketOrValue) -> bpy.types.NodeSocket:
    """Return the UV of the surface point that is visible from the world-space direction `viewer`.

    encoded: depth of the texel, 0..1 for -1..1 errors. size: (width, height) of the texture in pixels.
    """
    view = builder.vector("NORMALIZE", builder.vector_transform(viewer, "VECTOR", "WORLD", "OBJECT"))
    axes = [builder.attribute(name) for name in TEXEL_AXES]
    cosine = builder.vector("DOT_PRODUCT", builder.vector("NORMALIZE", builder.vector("CROSS_PRODUCT", *axes)), view)
    squared_cosine = builder.math("MAXIMUM", builder.math("MULTIPLY", cosine, cosine), MIN_COSINE**2)
    depth = builder.math("SUBTRACT", builder.math("MULTIPLY", encoded, 2.0), 1.0)
    distance = builder.math("DIVIDE", builder.math("MULTIPLY", depth, cosine), squared_cosine)
    offsets = []
    for axis, side in zip(axes, size, strict=True):
        texels = builder.math("MULTIPLY", distance, builder.vector("DOT_PRODUCT", axis, view))
        clamped = builder.math("MAXIMUM", builder.math("MINIMUM", texels, MAX_OFFSET), -MAX_OFFSET)
        offsets.append(builder.math("DIVIDE", clamped, float(side)))
    return builder.vector("ADD", builder.node("ShaderNodeUVMap").outputs[0], builder.combine(*offsets, 0.0))
