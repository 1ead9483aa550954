"""The material of a cloud. It consists of built-in nodes only, so it renders the same without Farfield."""

import itertools

import bpy

from ..shading.node_builder import NodeBuilder, SocketOrValue, create_node_material, ensure_shared_group

GROUP_NAME = "Farfield Cloud"
GROUP_VERSION = 1
JOINED_ATTRIBUTE = "farfield_joined"  # Per face: 1 if the quad shows part of a surface that continues on other quads.
SOLID_ATTRIBUTE = "farfield_solid"  # Per face: 1 if no camera sees the back, because it is the inside of a solid.
COLOR, NORMAL, ROUGHNESS_METALLIC_DEPTH = MAPS = ("Color", "Normal", "Roughness Metallic Depth")
SIDES = ("Front", "Back")
SHADOWLESS_DISTANCE = "Shadowless Distance"  # Input of the group.
FRONT_COLOR = "Front color"  # Label of the node with the color and alpha of the fronts.
FRONT_NORMAL = "Front normal"  # Label of the node with their normals in object space, encoded as colors.
FRONT_ROUGHNESS_METALLIC_DEPTH = "Front roughness metallic depth"  # Label of the node with their roughness, metallic and depth.


def create_cloud_material(name: str, images: dict[tuple[str, str], bpy.types.Image], shadowless_distance: float) -> bpy.types.Material:
    """Create a material that shows `images`, keyed by side (SIDES) and map (MAPS).

    shadowless_distance: the material blocks no light from within this length, in units of the cloud's objects.
    """
    material, builder = create_two_sided_material(name)
    group = builder.node("ShaderNodeGroup", {"node_tree": _cloud_group(), "width": 220.0})
    group.inputs[SHADOWLESS_DISTANCE].default_value = shadowless_distance
    output = builder.node("ShaderNodeOutputMaterial")
    builder.connect(group.outputs["BSDF"], output.inputs["Surface"])
    for side, map_name in itertools.product(SIDES, MAPS):
        color, alpha = sample_map(builder, images[side, map_name], side, map_name)
        builder.connect(color, group.inputs[f"{side} {map_name}"])
        if map_name == COLOR:
            builder.connect(alpha, group.inputs[f"{side} Alpha"])
    builder.arrange()
    return material


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


def set_two_sided(material: bpy.types.Material) -> None:
    """Make `material` two-sided, with dithered transparency: blended surfaces are sorted per object, so stacked quads would be wrong."""
    material.surface_render_method = "DITHERED"
    material.use_transparent_shadow = True
    material.use_backface_culling = material.use_backface_culling_shadow = False
    # The normal map of a quad deviates far from its plane by design. Bump map correction would darken it.
    material.cycles.use_bump_map_correction = False


def _cloud_group() -> bpy.types.NodeTree:
    """Return the node group that all clouds in the file share."""
    per_side = ((COLOR, "Color"), ("Alpha", "Float"), (NORMAL, "Color"), (ROUGHNESS_METALLIC_DEPTH, "Color"))
    inputs = [(f"{side} {name}", socket_type) for side in SIDES for name, socket_type in per_side]
    return ensure_shared_group(GROUP_NAME, GROUP_VERSION, [*inputs, (SHADOWLESS_DISTANCE, "Float")], [("BSDF", "Shader")], _fill_group)


def _fill_group(builder: NodeBuilder) -> None:
    """Select the visible side and shade it."""
    inputs = builder.node("NodeGroupInput").outputs
    is_backfacing = builder.node("ShaderNodeNewGeometry").outputs["Backfacing"]
    sides = {name: builder.mix(is_backfacing, inputs[f"Front {name}"], inputs[f"Back {name}"]) for name in (*MAPS, "Alpha")}
    shader = add_quad_shader(builder, sides, builder.separate(sides["Alpha"])[0], inputs[SHADOWLESS_DISTANCE], is_backfacing)
    builder.connect(shader.outputs[0], builder.node("NodeGroupOutput").inputs["BSDF"])


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
