"""The diffuse and specular lobes of relightable textures as shader nodes; see `core.btf.reflectance.lobes`."""

import math
from dataclasses import dataclass, fields

from .....core.btf.reflectance.lobes import MIN_COSINE, MIN_FRESNEL_COSINE, MIN_ROUGHNESS, SCHLICK, GrazingFresnel
from ....shading.node_builder import NodeBuilder, SocketOrValue, ensure_shared_group
from .table_nodes import call_group

GROUP_NAME, GROUP_VERSION = "Farfield Lobes", 3
INPUTS = [  # The residual radiance, the Sun and its visibility, and a texel's lobes in the order of `TexelLobes`.
    *(("Residual", "Color"), ("Sun", "Vector"), ("Visibility", "Float"), ("Viewer", "Vector"), ("Normal", "Vector")),
    *(("View Cosine", "Float"), ("Roughness", "Float"), ("Diffuse", "Color"), ("F0", "Color"), ("F90 - F0", "Float")),
]
OUTPUTS = [("Color", "Color")]
WHITE = (1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True)
class TexelLobes:
    """Lobes at a texel; directions are unit vectors in world space.

    Attributes:
        viewer: Direction to the viewer.
        normal: Surface normal on the side of the viewer.
        cosine: Cosine between both.
        roughness: As in a Principled BSDF.
        diffuse: Albedo.
        f0: Specular reflectance at normal incidence.
        f90_minus_f0: Added reflectance at grazing incidence.
    """

    viewer: SocketOrValue
    normal: SocketOrValue
    cosine: SocketOrValue
    roughness: SocketOrValue
    diffuse: SocketOrValue
    f0: SocketOrValue
    f90_minus_f0: SocketOrValue


def decode_facing_normal(builder: NodeBuilder, encoded: SocketOrValue, viewer: SocketOrValue) -> tuple[SocketOrValue, SocketOrValue]:
    """Return the world-space unit normal of a color of the PBR normal map, flipped towards `viewer`, and the cosine between both."""
    decoded = builder.vector("SUBTRACT", builder.vector("SCALE", encoded, 2.0), (1.0, 1.0, 1.0))
    normal = builder.vector("NORMALIZE", builder.vector_transform(decoded, "NORMAL", "OBJECT", "WORLD"))
    cosine = builder.vector("DOT_PRODUCT", normal, viewer)
    sign = builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", builder.math("LESS_THAN", cosine, 0.0), 2.0))
    cosine = builder.math("MINIMUM", builder.math("MAXIMUM", builder.math("ABSOLUTE", cosine), MIN_COSINE), 1.0)
    return builder.vector("SCALE", normal, sign), cosine


def add_dome_response(
    builder: NodeBuilder, lobes: TexelLobes, sky_visibility: SocketOrValue, fresnel: GrazingFresnel, residual: SocketOrValue
) -> SocketOrValue:
    """Return `residual` plus the radiance of the lobes under uniform World lighting of radiance 1, scaled by `sky_visibility`."""
    grazing = builder.math(
        "MULTIPLY", sky_visibility, builder.math("MULTIPLY", lobes.f90_minus_f0, _grazing_weight(builder, fresnel, lobes.cosine))
    )
    total = builder.add_scaled(builder.add_scaled(residual, sky_visibility, lobes.diffuse), sky_visibility, lobes.f0)
    return builder.add_scaled(total, grazing, WHITE)


def add_sun_response(
    builder: NodeBuilder, lobes: TexelLobes, sun: SocketOrValue, visibility: SocketOrValue, residual: SocketOrValue, label: str
) -> SocketOrValue:
    """Return `residual` plus the radiance of the lobes under a Sun light of unit irradiance, from a node with this `label`.

    sun: direction to the Sun in world space. visibility: of the Sun, 0..1.
    """
    group = ensure_shared_group(GROUP_NAME, GROUP_VERSION, INPUTS, OUTPUTS, _fill)
    return call_group(builder, group, (residual, sun, visibility, *(getattr(lobes, field.name) for field in fields(lobes))), label)


def _fill(builder: NodeBuilder) -> None:
    inputs = list(builder.node("NodeGroupInput").outputs)[:-1]
    residual, sun, visibility, viewer, normal, view_cosine, roughness, diffuse, f0, f90_minus_f0 = inputs
    light_cosine = builder.math("MAXIMUM", builder.vector("DOT_PRODUCT", normal, sun), 0.0)
    half = builder.vector("NORMALIZE", builder.vector("ADD", viewer, sun))
    specular = _specular_response(builder, roughness, view_cosine, light_cosine, builder.vector("DOT_PRODUCT", normal, half))
    visible_specular = builder.math("MULTIPLY", specular, visibility)
    fresnel = _grazing_weight(builder, SCHLICK, builder.vector("DOT_PRODUCT", viewer, half))
    grazing = builder.math("MULTIPLY", builder.math("MULTIPLY", visible_specular, f90_minus_f0), fresnel)
    visible_diffuse = builder.math("MULTIPLY", builder.math("MULTIPLY", light_cosine, 1.0 / math.pi), visibility)
    total = builder.add_scaled(residual, visible_diffuse, diffuse)
    total = builder.add_scaled(builder.add_scaled(total, visible_specular, f0), grazing, WHITE)
    builder.connect(total, builder.node("NodeGroupOutput").inputs[0])


def _specular_response(
    builder: NodeBuilder, roughness: SocketOrValue, view_cosine: SocketOrValue, light_cosine: SocketOrValue, half_cosine: SocketOrValue
) -> SocketOrValue:
    """Return GGX with Smith masking-shadowing, times the cosine of the light; see `core.btf.reflectance.lobes`."""
    alpha_squared = builder.math("POWER", builder.math("MAXIMUM", roughness, MIN_ROUGHNESS), 4.0)
    complement = builder.math("SUBTRACT", 1.0, alpha_squared)
    distribution = builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", builder.math("MULTIPLY", half_cosine, half_cosine), complement))

    def smith(cosine: SocketOrValue, other: SocketOrValue) -> SocketOrValue:
        square = builder.math("ADD", builder.math("MULTIPLY", builder.math("MULTIPLY", other, other), complement), alpha_squared)
        return builder.math("MULTIPLY", cosine, builder.math("SQRT", square))

    masking = builder.math("MAXIMUM", builder.math("ADD", smith(light_cosine, view_cosine), smith(view_cosine, light_cosine)), 1e-6)
    denominator = builder.math("MULTIPLY", builder.math("MULTIPLY", distribution, distribution), masking)
    numerator = builder.math("MULTIPLY", builder.math("MULTIPLY", alpha_squared, light_cosine), 0.5 / math.pi)
    return builder.math("DIVIDE", numerator, denominator)


def _grazing_weight(builder: NodeBuilder, fresnel: GrazingFresnel, cosine: SocketOrValue) -> SocketOrValue:
    complement = builder.math("SUBTRACT", 1.0, builder.math("MAXIMUM", cosine, MIN_FRESNEL_COSINE), clamp=True)
    return builder.math("MULTIPLY", builder.math("POWER", complement, fresnel.power), fresnel.strength)
