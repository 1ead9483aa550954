"""Shader nodes that sample images, and lookup tables of directions; see `core.btf.tables` and `core.geometry.directions`."""

from collections.abc import Iterable

import bpy

from .....core.btf.tables import ViewTable
from ....shading.node_builder import NodeBuilder, SocketOrValue, ensure_shared_group

OCTAHEDRAL_VERSION = 1
BLACK = (0.0, 0.0, 0.0)


def sample_image(
    builder: NodeBuilder,
    image: bpy.types.Image,
    label: str,
    uv: SocketOrValue | None = None,
    offset_y: float = 0.0,
    closest: bool = False,
) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """Return color and alpha of `image` at `uv` + (0, offset_y), or at the UV map. closest: nearest-pixel instead of linear filtering."""
    node = _image_node(builder, image, label, uv, closest)
    node.texture_mapping.translation = (0.0, offset_y, 0.0)
    return node.outputs["Color"], node.outputs["Alpha"]


def sample_weights(
    builder: NodeBuilder,
    images: list[bpy.types.Image],
    label: str,
    height: int,
    uv: SocketOrValue | None = None,
    closest: bool = False,
) -> list[tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]]:
    """Return color and alpha of every block of the weight `images`, see `core.btf.tables.pack_weights`.

    The nodes are labeled `label` and the block index. height: of a block in pixels.
    """
    uv = builder.node("ShaderNodeUVMap").outputs[0] if uv is None else uv
    weights = []
    for image in images:
        blocks = image.size[1] // height
        for block in range(blocks):
            node = _image_node(builder, image, f"{label} {len(weights)}", uv, closest)
            node.texture_mapping.scale = (1.0, 1.0 / blocks, 1.0)
            node.texture_mapping.translation = (0.0, block / blocks, 0.0)
            weights.append((node.outputs["Color"], node.outputs["Alpha"]))
    return weights


def _image_node(builder: NodeBuilder, image: bpy.types.Image, label: str, uv: SocketOrValue | None, closest: bool) -> bpy.types.Node:
    properties = {"image": image, "label": label, "extension": "EXTEND", "interpolation": "Closest" if closest else "Linear"}
    node = builder.node("ShaderNodeTexImage", properties)
    if uv is not None:
        builder.connect(uv, node.inputs["Vector"])
    return node


def call_group(builder: NodeBuilder, group: bpy.types.NodeTree, operands: Iterable[SocketOrValue], label: str = "") -> bpy.types.NodeSocket:
    """Add a node of `group` with this `label`, connect `operands` to all its inputs, and return its first output."""
    node = builder.node("ShaderNodeGroup", {"node_tree": group, "label": label})
    for operand, target in zip(operands, node.inputs, strict=True):
        builder.connect(operand, target)
    return node.outputs[0]


def map_uv(builder: NodeBuilder, upper: bool, direction: SocketOrValue) -> bpy.types.NodeSocket:
    """Return the UV (x, y, 0) in 0..1 of a world-space `direction` on the octahedral map in the object's space. upper: hemi-octahedral."""
    return call_group(builder, _octahedral_group(upper), [direction])


def _octahedral_group(upper: bool) -> bpy.types.NodeTree:
    """Return the node group that maps a world-space direction to the octahedral or hemi-octahedral map in the object's space."""

    def fill(builder: NodeBuilder) -> None:
        local = builder.vector_transform(builder.node("NodeGroupInput").outputs[0], "VECTOR", "WORLD", "OBJECT")
        uv = builder.vector("ADD", builder.vector("SCALE", to_octahedral(builder, local, upper), 0.5), (0.5, 0.5, 0.0))
        builder.connect(uv, builder.node("NodeGroupOutput").inputs[0])

    name = "Farfield Hemi-octahedral" if upper else "Farfield Octahedral"
    return ensure_shared_group(name, OCTAHEDRAL_VERSION, [("Direction", "Vector")], [("UV", "Vector")], fill)


def to_octahedral(builder: NodeBuilder, direction: SocketOrValue, upper: bool) -> bpy.types.NodeSocket:
    """Return the position (x, y, 0) in -1..1 of a `direction` of any length on the octahedral map.

    upper: on the hemi-octahedral map; directions below the horizon are projected onto it.
    """
    if upper:
        direction = builder.vector("MAXIMUM", direction, (-1e6, -1e6, 0.0))
    norm = builder.vector("DOT_PRODUCT", builder.vector("ABSOLUTE", direction), (1.0, 1.0, 1.0))
    projected = builder.vector("SCALE", direction, builder.math("DIVIDE", 1.0, builder.math("MAXIMUM", norm, 1e-12)))
    x, y, z = builder.separate(projected)
    if upper:
        return builder.combine(builder.math("ADD", x, y), builder.math("SUBTRACT", x, y), 0.0)
    fold = fold_below_horizon(builder, x, y, z)
    return builder.vector("ADD", builder.combine(x, y, 0.0), fold)


def fold_below_horizon(builder: NodeBuilder, x: SocketOrValue, y: SocketOrValue, z: SocketOrValue) -> bpy.types.NodeSocket:
    """Return (sign x, sign y, 0) max(-z, 0): below the horizon the corners of the map fold outwards by this. The sign of 0 is -1."""
    is_positive = (builder.math("GREATER_THAN", value, 0.0) for value in (x, y))
    signs = builder.combine(*(builder.math("SUBTRACT", builder.math("MULTIPLY", value, 2.0), 1.0) for value in is_positive), 0.0)
    return builder.vector("SCALE", signs, builder.math("MAXIMUM", builder.math("MULTIPLY", z, -1.0), 0.0))


def weight_sockets(blocks: int) -> list[tuple[str, str]]:
    """Return the inputs of a group for the weights of `blocks` blocks: color and alpha of each."""
    return [socket for block in range(blocks) for socket in ((f"Weights {block}", "Color"), (f"Weights {block} Alpha", "Float"))]


def flatten_pairs(weights: list[tuple[SocketOrValue, SocketOrValue]]) -> list[SocketOrValue]:
    """Return the operands for the sockets of `weight_sockets`, in their order."""
    return [operand for pair in weights for operand in pair]


def split_pairs(sockets: list[SocketOrValue]) -> list[tuple[SocketOrValue, SocketOrValue]]:
    """Return the sockets of `weight_sockets` as pairs of color and alpha. The inverse of `flatten_pairs`."""
    return list(zip(sockets[::2], sockets[1::2], strict=True))


def split_weights(builder: NodeBuilder, weights: list[tuple[SocketOrValue, SocketOrValue]], count: int) -> list[SocketOrValue]:
    """Return the first `count` scalar weights of pairs of color and alpha, four per pair."""
    return [weight for color, alpha in weights for weight in (*builder.separate_color(color), alpha)][:count]


def view_table_uv(builder: NodeBuilder, table: ViewTable, view: SocketOrValue) -> SocketOrValue:
    """Return the UV of the first component in a table at `view`, a UV on the octahedral map."""
    return builder.vector("ADD", builder.vector("MULTIPLY", view, table.scale), table.offset)


def offset_to_cluster(builder: NodeBuilder, uv: SocketOrValue, cluster_offset: SocketOrValue | None) -> SocketOrValue:
    """Return a UV in a table, moved to the column of a cluster; unchanged if there is only one set of components."""
    return uv if cluster_offset is None else builder.vector("ADD", uv, builder.combine(cluster_offset, 0.0, 0.0))


def weighted_sum(
    builder: NodeBuilder, image: bpy.types.Image, label: str, uv: SocketOrValue, step: float, weights: list[SocketOrValue]
) -> SocketOrValue:
    """Return the sum over the components k of weights[k] times `image` at `uv` + (0, k * step).

    All operands are colors, and the offset is a property of the texture node. Where Cycles must convert between vector and color sockets,
    it evaluates the following nodes after all others. Every texture would then occupy the shader's stack, which is small before Blender
    5.2; a shader that exceeds it renders black.
    """
    total: SocketOrValue = BLACK
    for component, weight in enumerate(weights):
        total = builder.add_scaled(total, weight, sample_image(builder, image, label, uv, component * step)[0])
    return total


def weighted_scalar_sum(
    builder: NodeBuilder,
    image: bpy.types.Image,
    label: str,
    table: ViewTable,
    map_position: SocketOrValue,
    weights: list[tuple[SocketOrValue, SocketOrValue]],
) -> SocketOrValue:
    """Return the sum over the components of `weights`, pairs of color and alpha, times a `table` of scalars at a UV on its map."""
    uv = view_table_uv(builder, table, map_position)
    color_total, alpha_total = BLACK, 0.0
    for block, (color, alpha) in enumerate(weights):
        basis_color, basis_alpha = sample_image(builder, image, label, uv, block * table.component_step)
        color_total = builder.add_scaled(color_total, 1.0, builder.multiply_colors(color, basis_color))
        alpha_total = builder.math("ADD", alpha_total, builder.math("MULTIPLY", alpha, basis_alpha))
    red, green, blue = builder.separate_color(color_total)
    return builder.math("ADD", builder.math("ADD", red, green), builder.math("ADD", blue, alpha_total))
