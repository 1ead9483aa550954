"""The material of the model *surface*: the PBR maps of a level with silhouettes that depend on the view, lit by all lights.

The alpha of a quad is that of its silhouette as seen from outside, where the bake knows it: by camera rays from the camera, by light from
the light. Which end of a ray that is depends on the render engine: Cycles traces shadow rays from the shaded point to the light, EEVEE from
the light. So the material has an output for each of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import bpy

from ....core.btf.tables import ViewTable
from ...billboards.cloud_materials import (
    COLOR,
    JOINED_ATTRIBUTE,
    MAPS,
    NORMAL,
    ROUGHNESS_METALLIC_DEPTH,
    SIDES,
    SOLID_ATTRIBUTE,
    ShownLayer,
    add_layers,
    add_quad_shader,
    create_two_sided_material,
    sample_layer,
    sample_map,
)
from ...shading.node_builder import NodeBuilder, SocketOrValue, create_group
from ...shading.shared_parameters import Value, write_parameters
from ...shading.solid_view import show_image
from .emission_material import ALPHA_BASIS, ALPHA_WEIGHTS
from .nodes.parallax_nodes import depth_uv
from .nodes.table_nodes import map_uv, sample_weights, weighted_scalar_sum

SHADOW_RAYS_LEAVE = "Shadow Rays Leave"  # Input of the group: 1 if shadow rays start at the shaded point, 0 if they start at the light.
LIGHT_COVERAGE = "Light Coverage"  # Input of the group: 0 to 1, see `_light_alpha`.
DEFAULT_LIGHT_COVERAGE = 1.0
CONTRAST, PIVOT = 2.0, 0.4  # For silhouettes: alpha above the pivot grows, alpha below it shrinks.
SHARPNESS = 2.0  # Factor of the alpha of joined quads for light: two that meet with half coverage each let none through.


@dataclass(frozen=True)
class SurfaceImages:
    """Images of the material.

    Attributes:
        maps: PBR maps by side (SIDES) and map (MAPS), without backs if nobody sees them.
        alpha_weights: Images of blocks with four components each.
        alpha_basis: Image of the lookup table `alpha`.
        alpha: Lookup table by view.
        upper: Whether its views are in the hemi-octahedral map.
        layers: Other layers of the PBR maps by name, see `surface_layers`.
    """

    maps: dict[tuple[str, str], bpy.types.Image]
    alpha_weights: Sequence[bpy.types.Image]
    alpha_basis: bpy.types.Image
    alpha: ViewTable
    upper: bool
    layers: Mapping[str, ShownLayer]


def build_surface_material(
    name: str, images: SurfaceImages, shadowless_distance: float, parameters: dict[str, Value]
) -> bpy.types.Material:
    """Create the material, for a mesh with texel axes.

    shadowless_distance: see `create_cloud_material`. parameters: see `read_shared_parameters`.
    """
    material, builder = create_two_sided_material(name)
    group = create_group(f"{name} Surface", [(SHADOW_RAYS_LEAVE, "Float"), (LIGHT_COVERAGE, "Float")], [("BSDF", "Shader")])
    _fill_group(NodeBuilder(group), images, shadowless_distance, parameters)
    for engine, leave in (("CYCLES", 1.0), ("EEVEE", 0.0)):
        node = builder.node("ShaderNodeGroup", {"node_tree": group, "label": engine.title()})
        node.inputs[SHADOW_RAYS_LEAVE].default_value = leave
        node.inputs[LIGHT_COVERAGE].default_value = DEFAULT_LIGHT_COVERAGE
        builder.connect(node.outputs[0], builder.node("ShaderNodeOutputMaterial", {"target": engine}).inputs["Surface"])
    builder.arrange()
    show_image(material, images.maps[SIDES[0], COLOR])
    return material


def _fill_group(builder: NodeBuilder, images: SurfaceImages, shadowless_distance: float, parameters: dict[str, Value]) -> None:
    """Add the shader to the group."""
    geometry, path = builder.node("ShaderNodeNewGeometry"), builder.node("ShaderNodeLightPath")
    is_backfacing, incoming = geometry.outputs["Backfacing"], geometry.outputs["Incoming"]
    is_light_ray = builder.math("SUBTRACT", 1.0, path.outputs["Is Camera Ray"])
    inputs = builder.node("NodeGroupInput").outputs
    leaving_shadow_ray = builder.math("MULTIPLY", path.outputs["Is Shadow Ray"], inputs[SHADOW_RAYS_LEAVE])
    is_leaving = builder.math("MAXIMUM", path.outputs["Is Diffuse Ray"], leaving_shadow_ray)
    is_joined, is_solid = (builder.attribute(name, is_scalar=True) for name in (JOINED_ATTRIBUTE, SOLID_ATTRIBUTE))
    viewer = _viewer(builder, incoming, is_solid, is_backfacing, is_leaving)
    view_alpha, pbr_alpha = _decode_alpha(builder, images, viewer)
    alpha = _light_alpha(builder, view_alpha, pbr_alpha, is_joined, is_light_ray, inputs[LIGHT_COVERAGE])
    arriving_shadow_ray = builder.math("SUBTRACT", path.outputs["Is Shadow Ray"], leaving_shadow_ray)
    alpha = builder.math("MULTIPLY", alpha, _casts_shadow(builder, is_solid, is_backfacing, arriving_shadow_ray))
    maps = _visible_maps(builder, images, incoming, is_backfacing)
    layers = {name: _visible_layer(builder, name, layer, is_backfacing) for name, layer in images.layers.items()}
    shader = add_quad_shader(builder, maps, alpha, shadowless_distance, is_backfacing)
    write_parameters(shader, parameters)
    surface = add_layers(builder, shader, layers, {name: layer.scale for name, layer in images.layers.items()})
    builder.connect(surface, builder.node("NodeGroupOutput").inputs[0])
    builder.arrange()


def _visible_layer(builder: NodeBuilder, name: str, layer: ShownLayer, is_backfacing: SocketOrValue) -> SocketOrValue:
    """Return the values of a layer of the visible side, without its scale."""
    front, back = sample_layer(builder, name, layer).values()
    return builder.mix(is_backfacing, front, back)


def _viewer(
    builder: NodeBuilder, incoming: SocketOrValue, is_solid: SocketOrValue, is_backfacing: SocketOrValue, is_leaving: SocketOrValue
) -> SocketOrValue:
    """Return the direction to a viewer outside of the object. is_leaving: whether the ray starts on the object.

    Rays leave a solid through the backs of its quads, and enter it through their fronts.
    """
    is_flipped = builder.math(
        "ADD",
        builder.math("MULTIPLY", is_solid, is_backfacing),
        builder.math("MULTIPLY", builder.math("SUBTRACT", 1.0, is_solid), is_leaving),
    )
    return builder.vector("SCALE", incoming, builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", is_flipped, 2.0)))


def _casts_shadow(
    builder: NodeBuilder, is_solid: SocketOrValue, is_backfacing: SocketOrValue, arriving_shadow_ray: SocketOrValue
) -> SocketOrValue:
    """Return 0 where a shadow ray from the light meets the outside of a solid, otherwise 1.

    The backs cast the same shadow on everything else. The fronts overlap within the error, and would draw dark lines in EEVEE,
    which does not know the distance to the shaded point, see `add_quad_shader`.
    """
    is_front_of_solid = builder.math("MULTIPLY", is_solid, builder.math("SUBTRACT", 1.0, is_backfacing))
    return builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", is_front_of_solid, arriving_shadow_ray))


def _light_alpha(
    builder: NodeBuilder,
    view_alpha: SocketOrValue,
    pbr_alpha: SocketOrValue,
    is_joined: SocketOrValue,
    is_light_ray: SocketOrValue,
    light_coverage: SocketOrValue,
) -> SocketOrValue:
    """Return the alpha for this ray. Camera rays get the `view_alpha`.

    For light, joined quads are sharper, and loose ones reach towards the `pbr_alpha` where that is higher, by the `light_coverage`.
    """
    excess = builder.math("MAXIMUM", builder.math("SUBTRACT", pbr_alpha, view_alpha), 0.0)
    loose = builder.math("MULTIPLY", excess, light_coverage)
    joined = builder.math("MULTIPLY", view_alpha, SHARPNESS - 1.0)
    difference = builder.math("SUBTRACT", joined, loose)
    more = builder.math("ADD", loose, builder.math("MULTIPLY", is_joined, difference))
    return builder.math("ADD", view_alpha, builder.math("MULTIPLY", more, is_light_ray), clamp=True)


def _decode_alpha(builder: NodeBuilder, images: SurfaceImages, viewer: SocketOrValue) -> tuple[SocketOrValue, SocketOrValue]:
    """Return the alpha in 0..1 of the silhouette from `viewer`, the sum over its components plus the alpha of the PBR map, and the latter.

    The silhouette gets more contrast. Least squares average what they cannot place: leaves would fade into a smooth crown, and cracks would
    show between joined quads.
    """
    front = images.maps[SIDES[0], COLOR]
    weights = sample_weights(builder, list(images.alpha_weights), ALPHA_WEIGHTS, front.size[1])
    view = map_uv(builder, images.upper, viewer)
    total = weighted_scalar_sum(builder, images.alpha_basis, ALPHA_BASIS, images.alpha, view, weights)
    pbr_alpha = sample_map(builder, front, SIDES[0], COLOR)[1]
    alpha = builder.math("ADD", total, pbr_alpha, clamp=True)
    sharpened = builder.math("MULTIPLY", builder.math("SUBTRACT", alpha, PIVOT), CONTRAST)
    return builder.math("ADD", sharpened, PIVOT, clamp=True), pbr_alpha


def _visible_maps(
    builder: NodeBuilder, images: SurfaceImages, incoming: SocketOrValue, is_backfacing: SocketOrValue
) -> dict[str, SocketOrValue]:
    """Return the maps of the visible side, the normal with parallax mapping."""
    sides = [side for side in SIDES if (side, NORMAL) in images.maps]

    def visible_side(map_name: str, uv: SocketOrValue | None = None) -> SocketOrValue:
        colors = [sample_map(builder, images.maps[side, map_name], side, map_name, uv)[0] for side in sides]
        return builder.mix(is_backfacing, *colors) if len(colors) > 1 else colors[0]

    maps = {name: visible_side(name) for name in MAPS if name != NORMAL}
    depth = builder.separate(maps[ROUGHNESS_METALLIC_DEPTH])[2]
    uv = depth_uv(builder, depth, images.maps[SIDES[0], ROUGHNESS_METALLIC_DEPTH].size, incoming)
    return maps | {NORMAL: visible_side(NORMAL, uv)}
