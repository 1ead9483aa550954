"""The shaders that show an octahedral impostor: ordinary nodes and images, in Cycles and EEVEE. See `btf_octahedral` for the object.

The node group "Look" says what a ray sees: its three frames, in each the surface where the ray meets it (group "Frame"), blended. The
quads ask it for every camera ray and hand colour, normal and roughness to a Principled shader. The shell asks it for every other ray:
what comes from outside meets the silhouette that its direction sees; what comes from a point on a quad sets out from the place that is
seen there, and is stopped when the frames of its direction show something farther out, as a shadow map would tell.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import bpy
import numpy as np

from ..compat import give_nodes
from ..core.btf.octahedral import LEAST_COSINE, STEPS, Atlas, FrameGrid
from ..core.images import EMPTY
from .cloud_materials import set_two_sided
from .node_groups import new_group
from .octahedral_nodes import direction_on_map, place_on_map
from .wiring import Operand, Wiring

FACING = "farfield_facing"  # attribute of all corners: the unit direction that the quad faces, in the object's frame
RIGHT = "farfield_right"  # the same for the x axis of the picture that the viewer has
OWN_NORMAL = "farfield_own_normal"  # attribute of the quads: one of LEANING
LEANS = ((0.0, 1), (28.0, 5), (58.0, 9))  # degrees from the viewer, and quads that lean as much, evenly all around
# Normals of the quads as the viewer sees them: x to the right, y up, z to the viewer.
LEANING = np.array(
    [
        (np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean))
        for lean, count in ((np.radians(degrees), count) for degrees, count in LEANS)
        for turn in 2.0 * np.pi * np.arange(count) / count
    ]
)
SHELL = 2.1  # radius of the shell in half sides of a frame; all quads lie inside
OWN = 2.0  # what comes from nearer to the centre comes from a quad
# EEVEE takes a smaller mip of a filtered image where places jump from pixel to pixel, as they do behind heights: frames would run together.
FILTERING = {"CYCLES": "Linear", "EEVEE": "Closest"}
NOWHERE = -16.0  # half sides along a ray: nearer than anything it could meet from a place in the shell


@dataclass(frozen=True)
class FrameImages:
    """The images of an atlas, and what its nodes have to know. surface: roughness and metallic (2,) where no image is needed for them."""

    grid: FrameGrid
    pixels: int
    images: dict[str, bpy.types.Image]
    surface: tuple[float, float] | None

    @classmethod
    def of(cls, atlas: Atlas, images: dict[str, bpy.types.Image]) -> "FrameImages":
        """The `images` that hold what `atlas.encoded()` gives."""
        plain = atlas.plain_surface
        return cls(atlas.grid, atlas.pixels, images, None if plain is None else (float(plain[0]), float(plain[1])))


@dataclass(frozen=True)
class Sight:
    """What a ray sees, as sockets: scene-linear colour, alpha, unit normal in the object's frame, and so on; `along` is in half sides."""

    colour: bpy.types.NodeSocket
    alpha: bpy.types.NodeSocket
    normal: bpy.types.NodeSocket
    roughness: bpy.types.NodeSocket
    metallic: bpy.types.NodeSocket
    along: bpy.types.NodeSocket


LOOK_OUTPUTS = (
    ("Colour", "Color"),
    ("Alpha", "Float"),
    ("Normal", "Vector"),
    ("Roughness", "Float"),
    ("Metallic", "Float"),
    ("Along", "Float"),
)


def quad_material(name: str, looks: Mapping[str, bpy.types.NodeTree], half_side: float) -> bpy.types.Material:
    """What the camera sees on that quad which suits the normal seen."""
    material, wiring = _material(name)
    for renderer, look in looks.items():
        sight = _look(wiring, look, _place(wiring, half_side), _to_viewer(wiring), NOWHERE)
        _shine(wiring, sight, wiring.math("MULTIPLY", sight.alpha, _suits(wiring, sight.normal)), renderer)
    return material


def _suits(wiring: Wiring, normal: Operand) -> bpy.types.NodeSocket:
    """1 on the quad whose own normal is nearest to `normal`, else 0."""
    facing, right = wiring.attribute(FACING), wiring.attribute(RIGHT)
    axes = (right, wiring.vector("CROSS_PRODUCT", facing, right), facing)
    seen = wiring.combine(*(wiring.vector("DOT_PRODUCT", normal, axis) for axis in axes))
    nearest: Operand = -1.0
    for leaning in LEANING:
        nearest = wiring.math("MAXIMUM", wiring.vector("DOT_PRODUCT", seen, leaning.tolist()), nearest)
    nearness = wiring.vector("DOT_PRODUCT", seen, wiring.attribute(OWN_NORMAL))
    return wiring.math("GREATER_THAN", nearness, wiring.math("SUBTRACT", nearest, 1e-4))


def shell_material(name: str, looks: Mapping[str, bpy.types.NodeTree], half_side: float, bias: float) -> bpy.types.Material:
    """What rays of light meet, where they leave the shell.

    EEVEE, whose rays of light never come from a quad, has a shorter graph of its own. bias: in half sides; what is less than that before
    a place does not shade it.
    """
    material, wiring = _material(name)
    path = wiring.node("ShaderNodeLightPath")
    leaves = wiring.node("ShaderNodeNewGeometry").outputs["Backfacing"]
    back = _to_viewer(wiring)  # to where the ray comes from
    onwards = wiring.vector("SCALE", back, -1.0)
    place = _place(wiring, half_side)
    from_outside = _look(wiring, looks["EEVEE"], place, onwards, NOWHERE)
    _shine(wiring, from_outside, wiring.math("MULTIPLY", from_outside.alpha, leaves), "EEVEE")
    travelled = wiring.math("DIVIDE", _in_object(wiring, path.outputs["Ray Length"]), half_side)
    origin = wiring.vector("ADD", place, wiring.vector("SCALE", back, travelled))
    own = wiring.math("LESS_THAN", wiring.vector("DOT_PRODUCT", origin, origin), OWN**2)
    facing = wiring.attribute(FACING)
    seen = _look(wiring, looks["CYCLES"], origin, facing, NOWHERE)
    lifted = wiring.vector("ADD", origin, wiring.vector("SCALE", facing, seen.along))
    start = wiring.mix(own, place, wiring.vector("ADD", lifted, wiring.vector("SCALE", seen.normal, bias)))
    nearest = wiring.math("ADD", wiring.math("MULTIPLY", own, bias - NOWHERE), NOWHERE)
    outside = wiring.math("MULTIPLY", wiring.math("SUBTRACT", 1.0, own), wiring.math("SUBTRACT", 1.0, path.outputs["Is Shadow Ray"]))
    met = _look(wiring, looks["CYCLES"], start, wiring.mix(outside, onwards, back), nearest)
    _shine(wiring, met, wiring.math("MULTIPLY", met.alpha, leaves), "CYCLES")
    return material


def look_groups(name: str, frames: FrameImages) -> dict[str, bpy.types.NodeTree]:
    """The group "Look" for each renderer."""
    return {renderer: _look_group(f"{name} {renderer.title()}", frames, filtering) for renderer, filtering in FILTERING.items()}


def _look_group(name: str, frames: FrameImages, filtering: str) -> bpy.types.NodeTree:
    """The group "Look": through Point (object's frame, half sides from the centre) along Direction (unit, to the viewer); what lies less
    than Nearest half sides along, measured from Point, does not count."""
    group = new_group(f"{name} Look", (("Point", "Vector"), ("Direction", "Vector"), ("Nearest", "Float")), LOOK_OUTPUTS)
    wiring = Wiring(group)
    frame = _frame_group(name, frames, filtering)
    point, direction, nearest = list(wiring.node("NodeGroupInput").outputs)[:3]
    totals: list[Operand] = [(0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0]
    for column, row, weight in _triangle(wiring, direction, frames.grid):
        node = wiring.node("ShaderNodeGroup", {"node_tree": frame})
        for operand, target in zip((point, direction, nearest, column, row), node.inputs, strict=True):
            wiring.connect(operand, target)
        share = wiring.math("MULTIPLY", weight, node.outputs["Alpha"])
        totals[1] = wiring.math("ADD", totals[1], share)
        for index in (0, 2):
            totals[index] = wiring.vector("ADD", totals[index], wiring.vector("SCALE", node.outputs[index], share))
        for index in (3, 4, 5):
            totals[index] = wiring.math("ADD", totals[index], wiring.math("MULTIPLY", node.outputs[index], share))
    over = wiring.math("DIVIDE", 1.0, wiring.math("MAXIMUM", totals[1], EMPTY))
    # Where normals differ their mean is short, and as much less of a light reaches the faces: all of them cannot face it.
    agreed = wiring.vector("LENGTH", wiring.vector("SCALE", totals[2], over))
    results = [
        wiring.vector("SCALE", totals[0], wiring.math("MULTIPLY", over, agreed)),
        totals[1],
        wiring.vector("NORMALIZE", totals[2]),
        *(wiring.math("MULTIPLY", totals[index], over) for index in (3, 4, 5)),
    ]
    for result, target in zip(results, wiring.node("NodeGroupOutput").inputs, strict=False):
        wiring.connect(result, target)
    wiring.arrange()
    return group


def _triangle(wiring: Wiring, direction: Operand, grid: FrameGrid) -> list[tuple[Operand, Operand, Operand]]:
    """Column, row and weight of the three frames around `direction`; see `FrameGrid.around`."""
    cells = float(grid.frames - 1)
    half = wiring.vector("ADD", wiring.vector("SCALE", place_on_map(wiring, direction, grid.upper), 0.5), (0.5, 0.5, 0.0))
    places = wiring.vector("SCALE", half, cells)
    low = wiring.vector("MAXIMUM", wiring.vector("MINIMUM", wiring.vector("FLOOR", places), (cells - 1.0,) * 3), (0.0, 0.0, 0.0))
    share_x, y, _ = wiring.separate(wiring.vector("SUBTRACT", places, low))
    low_x, low_y, _ = wiring.separate(low)
    middle_x, middle_y = (wiring.math("ADD", value, 0.5 - 0.5 * cells) for value in (low_x, low_y))
    mirrored = wiring.math("GREATER_THAN", wiring.math("MULTIPLY", middle_x, middle_y), 0.0)
    step = wiring.math("SUBTRACT", 1.0, wiring.math("MULTIPLY", mirrored, 2.0))  # along the columns: 1, or -1 where mirrored
    first = wiring.math("ADD", low_x, mirrored)
    x = wiring.math("ADD", wiring.math("MULTIPLY", share_x, step), mirrored)
    rightwards = wiring.math("GREATER_THAN", x, y)
    return [
        (first, low_y, wiring.math("SUBTRACT", 1.0, wiring.math("MAXIMUM", x, y))),
        (wiring.math("ADD", first, step), wiring.math("ADD", low_y, 1.0), wiring.math("MINIMUM", x, y)),
        (
            wiring.math("ADD", wiring.math("MULTIPLY", rightwards, step), first),
            wiring.math("ADD", low_y, wiring.math("SUBTRACT", 1.0, rightwards)),
            wiring.math("ABSOLUTE", wiring.math("SUBTRACT", x, y)),
        ),
    ]


def _frame_group(name: str, frames: FrameImages, filtering: str) -> bpy.types.NodeTree:
    """The group "Frame": what a ray sees in the frame at Column, Row; see `core.btf.octahedral.look_up`."""
    inputs = (("Point", "Vector"), ("Direction", "Vector"), ("Nearest", "Float"), ("Column", "Float"), ("Row", "Float"))
    group = new_group(f"{name} Frame", inputs, LOOK_OUTPUTS)
    wiring = Wiring(group)
    point, direction, nearest, column, row = list(wiring.node("NodeGroupInput").outputs)[:5]
    cells = 0.5 * (frames.grid.frames - 1)
    x, y = (wiring.math("SUBTRACT", wiring.math("DIVIDE", value, cells), 1.0) for value in (column, row))
    towards = direction_on_map(wiring, x, y, frames.grid.upper)
    right = _right(wiring, towards)
    up = wiring.vector("CROSS_PRODUCT", towards, right)
    cosine = wiring.math("MAXIMUM", wiring.vector("DOT_PRODUCT", towards, direction), LEAST_COSINE)
    base = wiring.vector("DOT_PRODUCT", point, towards)
    corner = wiring.combine(column, row, 0.0)
    height: Operand = 0.0
    for _ in range(STEPS + 1):
        along = wiring.math("DIVIDE", wiring.math("SUBTRACT", height, base), cosine)
        hit = wiring.vector("ADD", point, wiring.vector("SCALE", direction, along))
        across = wiring.combine(wiring.vector("DOT_PRODUCT", hit, right), wiring.vector("DOT_PRODUCT", hit, up), 0.0)
        at = wiring.vector("ADD", wiring.vector("SCALE", across, 0.5), (0.5, 0.5, 0.0))
        edge = 0.5 / frames.pixels
        inside = wiring.vector("MINIMUM", wiring.vector("MAXIMUM", at, (edge, edge, 0.0)), (1.0 - edge, 1.0 - edge, 0.0))
        uv = wiring.vector("SCALE", wiring.vector("ADD", corner, inside), 1.0 / frames.grid.frames)
        normal, stored = _texture(wiring, frames.images["normal_height"], uv, filtering)
        height = wiring.math("MULTIPLY", wiring.math("SUBTRACT", stored, 0.5), 2.0)
    colour, alpha = _texture(wiring, frames.images["colour"], uv, filtering)
    from_middle = wiring.separate(wiring.vector("ABSOLUTE", wiring.vector("SUBTRACT", at, (0.5, 0.5, 0.0))))
    within = wiring.math("LESS_THAN", wiring.math("MAXIMUM", from_middle[0], from_middle[1]), 0.5)
    counts = wiring.math("MULTIPLY", within, wiring.math("GREATER_THAN", along, nearest))
    if frames.surface is None:
        roughness, metallic, _ = wiring.channels(_texture(wiring, frames.images["surface"], uv, filtering)[0])
    else:
        roughness, metallic = frames.surface
    decoded = wiring.vector("SUBTRACT", wiring.vector("SCALE", normal, 2.0), (1.0, 1.0, 1.0))
    results = (colour, wiring.math("MULTIPLY", alpha, counts), decoded, roughness, metallic, along)
    for result, target in zip(results, wiring.node("NodeGroupOutput").inputs, strict=False):
        wiring.connect(result, target)
    wiring.arrange()
    return group


def _right(wiring: Wiring, direction: Operand) -> bpy.types.NodeSocket:
    """The x axis of the frame seen from `direction`; see `core.btf.texels.View.right`."""
    x, y, _ = wiring.separate(direction)
    across = wiring.combine(wiring.math("MULTIPLY", y, -1.0), x, 0.0)
    upright = wiring.math("LESS_THAN", wiring.vector("DOT_PRODUCT", across, across), 1e-8)
    return wiring.vector("NORMALIZE", wiring.vector("ADD", across, wiring.combine(upright, 0.0, 0.0)))


def _texture(wiring: Wiring, image: bpy.types.Image, uv: Operand, filtering: str) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """Colour and alpha of `image` at a place."""
    node = wiring.node("ShaderNodeTexImage", {"image": image, "extension": "EXTEND", "interpolation": filtering})
    wiring.connect(uv, node.inputs["Vector"])
    return node.outputs["Color"], node.outputs["Alpha"]


def _material(name: str) -> tuple[bpy.types.Material, Wiring]:
    material = bpy.data.materials.new(name)
    set_two_sided(material)
    give_nodes(material)
    material.node_tree.nodes.clear()
    return material, Wiring(material.node_tree)


def _look(wiring: Wiring, group: bpy.types.NodeTree, point: Operand, direction: Operand, nearest: Operand) -> Sight:
    node = wiring.node("ShaderNodeGroup", {"node_tree": group, "width": 180.0})
    for operand, target in zip((point, direction, nearest), node.inputs, strict=True):
        wiring.connect(operand, target)
    return Sight(*node.outputs)


def _place(wiring: Wiring, half_side: float) -> bpy.types.NodeSocket:
    """Where the ray meets the mesh, in the object's frame and half sides."""
    return wiring.vector("SCALE", wiring.node("ShaderNodeTexCoord").outputs["Object"], 1.0 / half_side)


def _to_viewer(wiring: Wiring) -> bpy.types.NodeSocket:
    """The unit direction to where the ray comes from, in the object's frame."""
    return wiring.vector("NORMALIZE", _incoming(wiring))


def _in_object(wiring: Wiring, length: Operand) -> bpy.types.NodeSocket:
    """A length of the world as one of the object, however its instance is scaled."""
    return wiring.math("MULTIPLY", length, wiring.vector("LENGTH", _incoming(wiring)))


def _incoming(wiring: Wiring) -> bpy.types.NodeSocket:
    """The direction to where the ray comes from, in the object's frame, as long as a unit of the world is there."""
    return wiring.turned(wiring.node("ShaderNodeNewGeometry").outputs["Incoming"], "VECTOR", "WORLD", "OBJECT")


def _shine(wiring: Wiring, sight: Sight, alpha: Operand, renderer: str) -> None:
    """A Principled shader of what a ray sees, as the surface of the material in the `renderer`, CYCLES or EEVEE."""
    shader = wiring.node("ShaderNodeBsdfPrincipled")
    wiring.connect(sight.colour, shader.inputs["Base Color"])
    wiring.connect(sight.roughness, shader.inputs["Roughness"])
    wiring.connect(sight.metallic, shader.inputs["Metallic"])
    wiring.connect(alpha, shader.inputs["Alpha"])
    wiring.connect(wiring.turned(sight.normal, "NORMAL", "OBJECT", "WORLD"), shader.inputs["Normal"])
    wiring.connect(shader.outputs[0], wiring.node("ShaderNodeOutputMaterial", {"target": renderer}).inputs["Surface"])
    wiring.arrange()
