"""The material of a cloud. It consists of built-in nodes only, so it renders the same without Farfield."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import bpy

from ..shading.node_builder import NodeBuilder, SocketOrValue, create_node_material, ensure_shared_group
from ..shading.shared_parameters import Value
from ..shading.solid_view import show_image
from ..shading.surface_layers import COAT, EMISSION, HDR_LAYERS, SHEEN, SPECULAR, TRANSLUCENCY, TRANSMISSION

GROUP_NAME = "Farfield Cloud"
GROUP_VERSION = 1  # Materials without layers have this one.
LAYER_GROUP_VERSION = 2
JOINED_ATTRIBUTE = "farfield_joined"  # Per face: 1 if the quad shows part of a surface that continues on other quads.
SOLID_ATTRIBUTE = "farfield_solid"  # Per face: 1 if no camera sees the back, because it is the inside of a solid.
COLOR, NORMAL, ROUGHNESS_METALLIC_DEPTH = MAPS = ("Color", "Normal", "Roughness Metallic Depth")
SIDES = ("Front", "Back")
SHADOWLESS_DISTANCE = "Shadowless Distance"  # Input of the group.
MIN_TEXEL_ALPHA = 0.1  # A texel with less counts as transparent where texels are identified.
FRONT_COLOR = "Front color"  # Label of the node with the color and alpha of the fronts.
FRONT_NORMAL = "Front normal"  # Label of the node with their normals in object space, encoded as colors.
FRONT_ROUGHNESS_METALLIC_DEPTH = "Front roughness metallic depth"  # Label of the node with their roughness, metallic and depth.


@dataclass(frozen=True)
class ShownLayer:
    """A layer of a material, see `surface_layers`: `images` by side (SIDES) or one `constant` value, to be multiplied with `scale`.

    A single image is that of both sides.
    """

    scale: float
    images: Mapping[str, bpy.types.Image]
    constant: tuple[float, float, float] | None = None


def create_cloud_material(
    name: str,
    images: dict[tuple[str, str], bpy.types.Image],
    shadowless_distance: float,
    layers: Mapping[str, ShownLayer] = MappingProxyType({}),
    parameters: Mapping[str, Value] = MappingProxyType({}),
) -> bpy.types.Material:
    """Create a material that shows `images`, keyed by side (SIDES) and map (MAPS).

    shadowless_distance: the material blocks no light from within this length, in units of the cloud's objects. layers: by name, see
    `surface_layers`. parameters: inputs of a Principled shader that all texels have in common.
    """
    material, builder = create_two_sided_material(name)
    group = builder.node("ShaderNodeGroup", {"node_tree": _cloud_group(tuple(layers), parameters), "width": 220.0})
    group.inputs[SHADOWLESS_DISTANCE].default_value = shadowless_distance
    output = builder.node("ShaderNodeOutputMaterial")
    builder.connect(group.outputs["BSDF"], output.inputs["Surface"])
    for side, map_name in itertools.product(SIDES, MAPS):
        color, alpha = sample_map(builder, images[side, map_name], side, map_name)
        builder.connect(color, group.inputs[f"{side} {map_name}"])
        if map_name == COLOR:
            builder.connect(alpha, group.inputs[f"{side} Alpha"])
    for layer, shown in layers.items():
        for side, value in sample_layer(builder, layer, shown).items():
            builder.connect(value, group.inputs[f"{side} {layer.title()}"])
        if layer in HDR_LAYERS:
            group.inputs[strength_name(layer)].default_value = shown.scale
    for parameter, value in parameters.items():
        builder.connect(value, group.inputs[parameter])
    builder.arrange()
    show_image(material, images[SIDES[0], COLOR])
    return material


def sample_layer(builder: NodeBuilder, layer: str, shown: ShownLayer) -> dict[str, SocketOrValue]:
    """Return the values of a layer by side (SIDES), without its scale."""
    if shown.constant is not None:
        return dict.fromkeys(SIDES, shown.constant)
    colors = {side: sample_map(builder, image, side, layer)[0] for side, image in shown.images.items()}
    return {side: colors.get(side, colors[SIDES[0]]) for side in SIDES}


def strength_name(layer: str) -> str:
    """Return the name of the input of the group with the scale of one of HDR_LAYERS."""
    return f"{layer.title()} Strength"


def sample_map(
    builder: NodeBuilder, image: bpy.types.Image, side: str, map_name: str, uv: SocketOrValue | None = None
) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """Return color and alpha of the map `map_name` (MAPS) of a side (SIDES), at `uv` or at the UV map."""
    texture = builder.node("ShaderNodeTexImage", {"image": image, "extension": "EXTEND", "label": map_label(side, map_name)})
    if uv is not None:
        builder.connect(uv, texture.inputs["Vector"])
    return texture.outputs["Color"], texture.outputs["Alpha"]


def map_label(side: str, map_name: str) -> str:
    """Return the label of the node that samples the map `map_name` (MAPS) of a side (SIDES)."""
    return f"{side} {map_name.lower()}"


def create_gray_material(name: str) -> bpy.types.Material:
    """Create a material with Blender's default gray, for clouds without textures."""
    material = bpy.data.materials.new(name)
    set_two_sided(material)
    return material


def create_two_sided_material(name: str) -> tuple[bpy.types.Material, NodeBuilder]:
    """Create a two-sided material without nodes, and return it with the builder of its nodes."""
    material, builder = create_node_material(name)
    set_two_sided(material)
    return material, builder


def create_texel_material(shown: bpy.types.Material) -> bpy.types.Material:
    """Create a material that emits (u, v, 1) on the fronts of opaque texels of the cloud material `shown`, and (u, v, 2) on their backs."""
    material, builder = create_two_sided_material(shown.name)
    images = {node.label: node.image for node in shown.node_tree.nodes if node.type == "TEX_IMAGE"}
    is_backfacing = builder.node("ShaderNodeNewGeometry").outputs["Backfacing"]
    alphas = [sample_map(builder, images[map_label(side, COLOR)], side, COLOR)[1] for side in SIDES]
    alpha = builder.separate(builder.mix(is_backfacing, *alphas))[0]
    is_opaque = builder.math("GREATER_THAN", builder.math("MULTIPLY", alpha, _is_outside(builder, is_backfacing)), MIN_TEXEL_ALPHA)
    u, v, _ = builder.separate(builder.node("ShaderNodeUVMap", {"uv_map": "UVMap"}).outputs["UV"])
    emission, transparent, mixed = (
        builder.node(node_type) for node_type in ("ShaderNodeEmission", "ShaderNodeBsdfTransparent", "ShaderNodeMixShader")
    )
    builder.connect(builder.combine(u, v, builder.math("ADD", 1.0, is_backfacing)), emission.inputs["Color"])
    builder.connect(is_opaque, mixed.inputs[0])
    builder.connect(transparent.outputs[0], mixed.inputs[1])
    builder.connect(emission.outputs[0], mixed.inputs[2])
    builder.connect(mixed.outputs[0], builder.node("ShaderNodeOutputMaterial").inputs["Surface"])
    material.cycles.emission_sampling = "NONE"
    return material


def set_two_sided(material: bpy.types.Material) -> None:
    """Make `material` two-sided, with dithered transparency: blended surfaces are sorted per object, so stacked quads would be wrong."""
    material.surface_render_method = "DITHERED"
    material.use_transparent_shadow = True
    material.use_backface_culling = material.use_backface_culling_shadow = False
    # The normal map of a quad deviates far from its plane by design. Bump map correction would darken it.
    material.cycles.use_bump_map_correction = False


def _cloud_group(layers: tuple[str, ...], parameters: Mapping[str, Value]) -> bpy.types.NodeTree:
    """Return the node group that all clouds in the file with these `layers` and `parameters` share."""
    per_side = [(COLOR, "Color"), ("Alpha", "Float"), (NORMAL, "Color"), (ROUGHNESS_METALLIC_DEPTH, "Color")]
    per_side += [(layer.title(), "Color") for layer in layers]
    inputs = [(f"{side} {name}", socket_type) for side in SIDES for name, socket_type in per_side]
    inputs += [(SHADOWLESS_DISTANCE, "Float"), *((strength_name(layer), "Float") for layer in layers if layer in HDR_LAYERS)]
    inputs += [(name, "Float" if isinstance(value, float) else "Color") for name, value in parameters.items()]

    def fill(builder: NodeBuilder) -> None:
        _fill_group(builder, layers, tuple(parameters))

    variant = ", ".join([*map(str.title, layers), *parameters])
    version = LAYER_GROUP_VERSION if variant else GROUP_VERSION
    return ensure_shared_group(GROUP_NAME, version, inputs, [("BSDF", "Shader")], fill, variant)


def _fill_group(builder: NodeBuilder, layers: tuple[str, ...], parameters: tuple[str, ...]) -> None:
    """Select the visible side and shade it."""
    inputs = builder.node("NodeGroupInput").outputs
    is_backfacing = builder.node("ShaderNodeNewGeometry").outputs["Backfacing"]
    names = (*MAPS, "Alpha", *map(str.title, layers))
    sides = {name: builder.mix(is_backfacing, inputs[f"Front {name}"], inputs[f"Back {name}"]) for name in names}
    shader = add_quad_shader(builder, sides, builder.separate(sides["Alpha"])[0], inputs[SHADOWLESS_DISTANCE], is_backfacing)
    for name in parameters:
        if name in shader.inputs:  # other versions of Blender may have others
            builder.connect(inputs[name], shader.inputs[name])
    values = {layer: sides[layer.title()] for layer in layers}
    scales = {layer: inputs[strength_name(layer)] for layer in layers if layer in HDR_LAYERS}
    builder.connect(add_layers(builder, shader, values, scales), builder.node("NodeGroupOutput").inputs["BSDF"])


def add_quad_shader(
    builder: NodeBuilder,
    maps: dict[str, SocketOrValue],
    alpha: SocketOrValue,
    shadowless_distance: SocketOrValue,
    is_backfacing: SocketOrValue,
) -> bpy.types.Node:
    """Add the Principled shader of a quad for the `maps` (MAPS) of its visible side; quads hide and block light as described below."""
    roughness, metallic, _ = builder.separate(maps[ROUGHNESS_METALLIC_DEPTH])
    decoded = builder.vector("SUBTRACT", builder.vector("SCALE", maps[NORMAL], 2.0), (1.0, 1.0, 1.0))
    shader = builder.node("ShaderNodeBsdfPrincipled")
    builder.connect(maps[COLOR], shader.inputs["Base Color"])
    builder.connect(roughness, shader.inputs["Roughness"])
    builder.connect(metallic, shader.inputs["Metallic"])
    lit = builder.math("MULTIPLY", alpha, _blocks_light(builder, shadowless_distance))
    builder.connect(builder.math("MULTIPLY", lit, _is_outside(builder, is_backfacing)), shader.inputs["Alpha"])
    builder.connect(builder.vector_transform(decoded, "NORMAL", "OBJECT", "WORLD"), shader.inputs["Normal"])
    return shader


def add_layers(
    builder: NodeBuilder, shader: bpy.types.Node, values: Mapping[str, SocketOrValue], scales: Mapping[str, SocketOrValue]
) -> bpy.types.NodeSocket:
    """Let the `shader` of a quad show layers, see `surface_layers`, and return its surface.

    values: of the visible side, in 0..1. scales: of the layers HDR_LAYERS.
    """
    inputs, normal = shader.inputs, _source_of(shader.inputs["Normal"])
    if EMISSION in values:
        builder.connect(values[EMISSION], inputs["Emission Color"])
        builder.connect(scales[EMISSION], inputs["Emission Strength"])
    if SPECULAR in values:
        builder.connect(values[SPECULAR], inputs["Specular Tint"])
        builder.connect(scales[SPECULAR], inputs["Specular IOR Level"])
    if COAT in values:
        names = ("Coat Weight", "Coat Roughness", "Sheen Roughness")
        for name, value in zip(names, builder.separate(values[COAT]), strict=True):
            builder.connect(value, inputs[name])
        builder.connect(normal, inputs["Coat Normal"])
    if SHEEN in values:
        inputs["Sheen Weight"].default_value = 1.0
        builder.connect(values[SHEEN], inputs["Sheen Tint"])
    surface, alpha = shader.outputs[0], _source_of(shader.inputs["Alpha"])
    for layer, node_type in ((TRANSLUCENCY, "ShaderNodeBsdfTranslucent"), (TRANSMISSION, "ShaderNodeBsdfTransparent")):
        if layer in values:
            added, total = builder.node(node_type), builder.node("ShaderNodeAddShader")
            builder.connect(builder.vector("SCALE", values[layer], alpha), added.inputs["Color"])
            if layer == TRANSLUCENCY:
                builder.connect(normal, added.inputs["Normal"])
            builder.connect(surface, total.inputs[0])
            builder.connect(added.outputs[0], total.inputs[1])
            surface = total.outputs[0]
    return surface


def _source_of(target: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    return target.links[0].from_socket


def _blocks_light(builder: NodeBuilder, shadowless_distance: SocketOrValue) -> SocketOrValue:
    """Return 0 for light rays that end on a joined quad nearer than `shadowless_distance`, otherwise 1.

    Quads of one surface overlap and must not darken each other, while leaves must. This works in Cycles only: EEVEE distinguishes only
    camera and shadow rays, and its shadow rays have the length to the light.
    """
    path = builder.node("ShaderNodeLightPath")
    offset = builder.vector_transform(builder.combine(shadowless_distance, 0.0, 0.0), "VECTOR", "OBJECT", "WORLD")
    is_near = builder.math("LESS_THAN", path.outputs["Ray Length"], builder.vector("LENGTH", offset))
    is_light_ray = builder.math("SUBTRACT", 1.0, path.outputs["Is Camera Ray"])
    is_joined_light_ray = builder.math("MULTIPLY", is_light_ray, builder.attribute(JOINED_ATTRIBUTE, is_scalar=True))
    return builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", is_joined_light_ray, is_near))


def _is_outside(builder: NodeBuilder, is_backfacing: SocketOrValue) -> SocketOrValue:
    """Return 0 for a camera ray that meets the inside of a solid, otherwise 1. Quads exceed the silhouette by up to the error there."""
    is_camera_ray = builder.node("ShaderNodeLightPath").outputs["Is Camera Ray"]
    is_inside = builder.math("MULTIPLY", is_backfacing, builder.attribute(SOLID_ATTRIBUTE, is_scalar=True))
    return builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", is_inside, is_camera_ray))
