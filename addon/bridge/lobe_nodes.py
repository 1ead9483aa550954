"""The diffuse and the glossy lobe of relightable textures as nodes: what `core.btf.lobes` says, at a point."""

import math
from dataclasses import dataclass

import bpy

from ..core.btf.lobes import LEAST_FACING, LEAST_ROUGHNESS, RIM_FACING
from .wiring import Operand, Wiring

GROUP_NAME, GROUP_VERSION = "Farfield Lobes", 1
WHITE = (1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True)
class LobeMaps:
    """Lobes at a point. viewer: towards the viewer, in world space. normal: a colour of the plain normal map, in the object's frame."""

    viewer: Operand
    normal: Operand
    roughness: Operand
    diffuse: Operand
    specular: Operand
    rim: Operand


def add_dome(wiring: Wiring, maps: LobeMaps, rest: Operand) -> Operand:
    """`rest` and what a dome of radiance 1 makes of the lobes."""
    facing = _facing(wiring, _normal(wiring, maps.normal), maps.viewer)[1]
    grazing = wiring.math("MULTIPLY", maps.rim, _fresnel(wiring, facing))
    matt = wiring.add_scaled(wiring.add_scaled(rest, 1.0, maps.diffuse), 1.0, maps.specular)
    return wiring.add_scaled(matt, grazing, WHITE)


def add_lobes(wiring: Wiring, maps: LobeMaps, sun: Operand, rest: Operand, label: str) -> Operand:
    """`rest` and what a sun of unit irradiance from `sun`, in world space, makes of the lobes: a node called `label`."""
    node = wiring.node("ShaderNodeGroup", {"node_tree": _group(), "label": label})
    operands = (rest, maps.viewer, sun, maps.normal, maps.roughness, maps.diffuse, maps.specular, maps.rim)
    for operand, target in zip(operands, node.inputs, strict=True):
        wiring.connect(operand, target)
    return node.outputs[0]


def _group() -> bpy.types.NodeTree:
    """The group of all relightable clouds in the file, made at first need."""
    for group in bpy.data.node_groups:
        if group.get("farfield_version") == GROUP_VERSION and group.name.startswith(GROUP_NAME) and group.library is None:
            return group
    group = bpy.data.node_groups.new(GROUP_NAME, "ShaderNodeTree")
    group["farfield_version"] = GROUP_VERSION
    kinds = {"Rest": "Color", "Viewer": "Vector", "Sun": "Vector", "Normal": "Color", "Roughness": "Float"}
    for name, kind in {**kinds, "Diffuse": "Color", "Specular": "Color", "Rim": "Float"}.items():
        group.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
    group.interface.new_socket("Colour", in_out="OUTPUT", socket_type="NodeSocketColor")
    wiring = Wiring(group)
    rest, viewer, sun, normal, roughness, diffuse, specular, rim = list(wiring.node("NodeGroupInput").outputs)[:-1]
    normal, from_view = _facing(wiring, _normal(wiring, normal), viewer)
    from_light = wiring.math("MAXIMUM", wiring.vector("DOT_PRODUCT", normal, sun), 0.0)
    half = wiring.vector("NORMALIZE", wiring.vector("ADD", viewer, sun))
    straight = _glossy(wiring, roughness, from_view, from_light, wiring.vector("DOT_PRODUCT", normal, half))
    fresnel = _fresnel(wiring, wiring.vector("DOT_PRODUCT", viewer, half))
    grazing = wiring.math("MULTIPLY", wiring.math("MULTIPLY", straight, rim), fresnel)
    total = wiring.add_scaled(rest, wiring.math("MULTIPLY", from_light, 1.0 / math.pi), diffuse)
    total = wiring.add_scaled(wiring.add_scaled(total, straight, specular), grazing, WHITE)
    wiring.connect(total, wiring.node("NodeGroupOutput").inputs[0])
    wiring.arrange()
    return group


def _normal(wiring: Wiring, encoded: Operand) -> Operand:
    """The world-space unit normal that a colour of the normal map stands for."""
    decoded = wiring.vector("SUBTRACT", wiring.vector("SCALE", encoded, 2.0), (1.0, 1.0, 1.0))
    turned = wiring.node("ShaderNodeVectorTransform", {"vector_type": "NORMAL", "convert_from": "OBJECT", "convert_to": "WORLD"})
    wiring.connect(decoded, turned.inputs[0])
    return wiring.vector("NORMALIZE", turned.outputs[0])


def _facing(wiring: Wiring, normal: Operand, viewer: Operand) -> tuple[Operand, Operand]:
    """`normal`, turned round where it points away from the viewer, and its cosine to there."""
    cosine = wiring.vector("DOT_PRODUCT", normal, viewer)
    side = wiring.math("SUBTRACT", 1.0, wiring.math("MULTIPLY", wiring.math("LESS_THAN", cosine, 0.0), 2.0))
    cosine = wiring.math("MINIMUM", wiring.math("MAXIMUM", wiring.math("ABSOLUTE", cosine), LEAST_FACING), 1.0)
    return wiring.vector("SCALE", normal, side), cosine


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


def _fresnel(wiring: Wiring, cosine: Operand) -> Operand:
    return wiring.math("POWER", wiring.math("SUBTRACT", 1.0, wiring.math("MAXIMUM", cosine, RIM_FACING), clamp=True), 5.0)
