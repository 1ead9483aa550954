"""Nodes that look up textures, and tables of directions, see `core.btf.tables`."""

import bpy

from ..core.btf.tables import ViewTable
from .node_groups import shared_group
from .octahedral_nodes import place_on_map
from .wiring import Operand, Wiring

OCTAHEDRAL_VERSION = 1
BLACK = (0.0, 0.0, 0.0)


def texture(
    wiring: Wiring, image: bpy.types.Image, label: str, place: Operand | None = None, higher: float = 0.0, closest: bool = False
) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """Colour and alpha of `image` so much `higher` than a place, or at the UV map; without filter if it is the `closest` pixel."""
    node = _image_node(wiring, image, label, place, closest)
    node.texture_mapping.translation = (0.0, higher, 0.0)
    return node.outputs["Color"], node.outputs["Alpha"]


def weight_textures(
    wiring: Wiring, images: list[bpy.types.Image], label: str, height: int, place: Operand | None = None, closest: bool = False
) -> list[tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]]:
    """Colours and alphas of all blocks, `height` pixels each, of `images` of weights, see `core.btf.tables.weight_images`; nodes called
    `label` and their number."""
    place = wiring.node("ShaderNodeUVMap").outputs[0] if place is None else place
    found = []
    for image in images:
        blocks = image.size[1] // height
        for block in range(blocks):
            node = _image_node(wiring, image, f"{label} {len(found)}", place, closest)
            node.texture_mapping.scale = (1.0, 1.0 / blocks, 1.0)
            node.texture_mapping.translation = (0.0, block / blocks, 0.0)
            found.append((node.outputs["Color"], node.outputs["Alpha"]))
    return found


def _image_node(wiring: Wiring, image: bpy.types.Image, label: str, place: Operand | None, closest: bool) -> bpy.types.Node:
    properties = {"image": image, "label": label, "extension": "EXTEND", "interpolation": "Closest" if closest else "Linear"}
    node = wiring.node("ShaderNodeTexImage", properties)
    if place is not None:
        wiring.connect(place, node.inputs["Vector"])
    return node


def place_node(wiring: Wiring, upper: bool, direction: Operand) -> bpy.types.NodeSocket:
    """The place (x, y, 0) in 0..1 of a world-space `direction` on the map of the object's directions."""
    node = wiring.node("ShaderNodeGroup", {"node_tree": _octahedral_group(upper)})
    wiring.connect(direction, node.inputs[0])
    return node.outputs[0]


def _octahedral_group(upper: bool) -> bpy.types.NodeTree:
    """World-space direction to a place on the octahedral map of the whole sphere, or of the upper half, in the object's frame."""

    def fill(wiring: Wiring) -> None:
        turned = wiring.turned(wiring.node("NodeGroupInput").outputs[0], "VECTOR", "WORLD", "OBJECT")
        half = wiring.vector("ADD", wiring.vector("SCALE", place_on_map(wiring, turned, upper), 0.5), (0.5, 0.5, 0.0))
        wiring.connect(half, wiring.node("NodeGroupOutput").inputs[0])

    name = "Farfield Hemi-octahedral" if upper else "Farfield Octahedral"
    return shared_group(name, OCTAHEDRAL_VERSION, [("Direction", "Vector")], [("Place", "Vector")], fill)


def weight_sockets(images: int) -> list[tuple[str, str]]:
    """The inputs of a group for weights out of so many images: four numbers each."""
    return [socket for number in range(images) for socket in ((f"Weights {number}", "Color"), (f"Fourth {number}", "Float"))]


def pairs(weights: list[tuple[Operand, Operand]]) -> list[Operand]:
    """What the sockets of `weight_sockets` take."""
    return [operand for pair in weights for operand in pair]


def paired(sockets: list[Operand]) -> list[tuple[Operand, Operand]]:
    """What comes out of the sockets of `weight_sockets`; undoes `pairs`."""
    return list(zip(sockets[::2], sockets[1::2], strict=True))


def scalars(wiring: Wiring, weights: list[tuple[Operand, Operand]], count: int) -> list[Operand]:
    """The first `count` numbers of weight images, four of each."""
    return [number for color, fourth in weights for number in (*wiring.channels(color), fourth)][:count]


def in_views(wiring: Wiring, table: ViewTable, view: Operand) -> Operand:
    """Where the first component of `view` stands in a table."""
    return wiring.vector("ADD", wiring.vector("MULTIPLY", view, table.scale), table.start)


def in_column(wiring: Wiring, place: Operand, column: Operand | None) -> Operand:
    """A place in a table, moved to the column of a cluster where there are several."""
    return place if column is None else wiring.vector("ADD", place, wiring.combine(column, 0.0, 0.0))


def weighted_sum(wiring: Wiring, image: bpy.types.Image, label: str, uv: Operand, step: float, numbers: list[Operand]) -> Operand:
    """Sum over the components k of numbers[k] times `image` at `uv` moved up by k steps.

    Colours all the way, and the move up within the texture node: where Cycles has to turn one kind of vector into another it runs what
    follows after all else, so that every texture would wait on the shader's stack, which is small before Blender 5.2; a shader without
    room there is black.
    """
    total: Operand = BLACK
    for component, number in enumerate(numbers):
        total = wiring.add_scaled(total, number, texture(wiring, image, label, uv, component * step)[0])
    return total


def sum_of_numbers(
    wiring: Wiring, image: bpy.types.Image, label: str, table: ViewTable, place: Operand, weights: list[tuple[Operand, Operand]]
) -> Operand:
    """Sum over the components of `weights`, which come from images of four each, times a `table` of numbers at a `place` on its map."""
    uv = in_views(wiring, table, place)
    colours, fourths = BLACK, 0.0
    for block, (color, fourth) in enumerate(weights):
        found, last = texture(wiring, image, label, uv, block * table.step)
        colours = wiring.add_scaled(colours, 1.0, wiring.product(color, found))
        fourths = wiring.math("ADD", fourths, wiring.math("MULTIPLY", fourth, last))
    red, green, blue = wiring.channels(colours)
    return wiring.math("ADD", wiring.math("ADD", red, green), wiring.math("ADD", blue, fourths))
