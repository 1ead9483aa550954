"""The diffuse and the glossy lobe of relightable textures as nodes: what `core.btf.lobes` says, at a point."""

import math
from dataclasses import dataclass, fields

from ..core.btf.lobes import LEAST_FACING, LEAST_ROUGHNESS, RIM_FACING, SCHLICK, Grazing
from .node_groups import shared_group
from .wiring import Operand, Wiring

GROUP_NAME, GROUP_VERSION = "Farfield Lobes", 3
INPUTS = [  # what remains, the sun, how much of it comes, and a texel's lobes in the order of `TexelLobes`
    *(("Rest", "Color"), ("Sun", "Vector"), ("Reached", "Float"), ("Viewer", "Vector"), ("Normal", "Vector"), ("Facing", "Float")),
    *(("Roughness", "Float"), ("Diffuse", "Color"), ("Specular", "Color"), ("Rim", "Float")),
]
OUTPUTS = [("Colour", "Color")]
WHITE = (1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True)
class TexelLobes:
    """Lobes at a point. viewer: towards the viewer; normal: on that side; both unit, in world space. facing: the cosine between them."""

    viewer: Operand
    normal: Operand
    facing: Operand
    roughness: Operand
    diffuse: Operand
    specular: Operand
    rim: Operand


def facing_normal(wiring: Wiring, encoded: Operand, viewer: Operand) -> tuple[Operand, Operand]:
    """The world-space unit normal that a colour of the plain normal map stands for, turned round where it points away from `viewer`, and
    its cosine to there."""
    decoded = wiring.vector("SUBTRACT", wiring.vector("SCALE", encoded, 2.0), (1.0, 1.0, 1.0))
    normal = wiring.vector("NORMALIZE", wiring.turned(decoded, "NORMAL", "OBJECT", "WORLD"))
    cosine = wiring.vector("DOT_PRODUCT", normal, viewer)
    side = wiring.math("SUBTRACT", 1.0, wiring.math("MULTIPLY", wiring.math("LESS_THAN", cosine, 0.0), 2.0))
    cosine = wiring.math("MINIMUM", wiring.math("MAXIMUM", wiring.math("ABSOLUTE", cosine), LEAST_FACING), 1.0)
    return wiring.vector("SCALE", normal, side), cosine


def add_dome(wiring: Wiring, lobes: TexelLobes, openness: Operand, rim: Grazing, rest: Operand) -> Operand:
    """`rest` and what a dome of radiance 1, so much of which comes back, makes of the lobes, with such a `rim`."""
    grazing = wiring.math("MULTIPLY", openness, wiring.math("MULTIPLY", lobes.rim, _grazing(wiring, rim, lobes.facing)))
    matt = wiring.add_scaled(wiring.add_scaled(rest, openness, lobes.diffuse), openness, lobes.specular)
    return wiring.add_scaled(matt, grazing, WHITE)


def add_lobes(wiring: Wiring, lobes: TexelLobes, sun: Operand, reached: Operand, rest: Operand, label: str) -> Operand:
    """`rest` and what a sun of unit irradiance from `sun`, in world space, makes of the lobes where so much of it has `reached` them, 0..1:
    a node called `label`."""
    node = wiring.node("ShaderNodeGroup", {"node_tree": shared_group(GROUP_NAME, GROUP_VERSION, INPUTS, OUTPUTS, _fill), "label": label})
    operands = (rest, sun, reached, *(getattr(lobes, field.name) for field in fields(lobes)))
    for operand, target in zip(operands, node.inputs, strict=True):
        wiring.connect(operand, target)
    return node.outputs[0]


def _fill(wiring: Wiring) -> None:
    rest, sun, reached, viewer, normal, from_view, roughness, diffuse, specular, rim = list(wiring.node("NodeGroupInput").outputs)[:-1]
    from_light = wiring.math("MAXIMUM", wiring.vector("DOT_PRODUCT", normal, sun), 0.0)
    half = wiring.vector("NORMALIZE", wiring.vector("ADD", viewer, sun))
    glossy = _glossy(wiring, roughness, from_view, from_light, wiring.vector("DOT_PRODUCT", normal, half))
    straight = wiring.math("MULTIPLY", glossy, reached)
    fresnel = _grazing(wiring, SCHLICK, wiring.vector("DOT_PRODUCT", viewer, half))
    grazing = wiring.math("MULTIPLY", wiring.math("MULTIPLY", straight, rim), fresnel)
    matt = wiring.math("MULTIPLY", wiring.math("MULTIPLY", from_light, 1.0 / math.pi), reached)
    total = wiring.add_scaled(rest, matt, diffuse)
    total = wiring.add_scaled(wiring.add_scaled(total, straight, specular), grazing, WHITE)
    wiring.connect(total, wiring.node("NodeGroupOutput").inputs[0])


def _glossy(wiring: Wiring, roughness: Operand, from_view: Operand, from_light: Operand, from_half: Operand) -> Operand:
    """GGX with Smith's shadowing, times the cosine of the light; see `core.btf.lobes.glossy_lobe`."""
    alpha = wiring.math("POWER", wiring.math("MAXIMUM", roughness, LEAST_ROUGHNESS), 4.0)
    rest = wiring.math("SUBTRACT", 1.0, alpha)
    spread = wiring.math("SUBTRACT", 1.0, wiring.math("MULTIPLY", wiring.math("MULTIPLY", from_half, from_half), rest))

    def shadowed(cosine: Operand, other: Operand) -> Operand:
        square = wiring.math("ADD", wiring.math("MULTIPLY", wiring.math("MULTIPLY", other, other), rest), alpha)
        return wiring.math("MULTIPLY", cosine, wiring.math("SQRT", square))

    masked = wiring.math("MAXIMUM", wiring.math("ADD", shadowed(from_light, from_view), shadowed(from_view, from_light)), 1e-6)
    below = wiring.math("MULTIPLY", wiring.math("MULTIPLY", spread, spread), masked)
    return wiring.math("DIVIDE", wiring.math("MULTIPLY", wiring.math("MULTIPLY", alpha, from_light), 0.5 / math.pi), below)


def _grazing(wiring: Wiring, rim: Grazing, cosine: Operand) -> Operand:
    away = wiring.math("SUBTRACT", 1.0, wiring.math("MAXIMUM", cosine, RIM_FACING), clamp=True)
    return wiring.math("MULTIPLY", wiring.math("POWER", away, rim.power), rim.strength)
