"""The material of a cloud. It consists of built-in nodes only, so it renders the same without Farfield."""

import itertools

import bpy

from ...compat import enable_nodes
from ..node_builder import NodeBuilder, SocketOrValue
from ..node_groups import ensure_shared_group

GROUP_NAME = "Farfield Cloud"
GROUP_VERSION = 1
JOINED_ATTRIBUTE = "farfield_joined"  # per face: 1 if the quad shows part of a surface that continues on other quads
SOLID_ATTRIBUTE = "farfield_solid"  # per face: 1 if no camera sees the back, because it is the inside of a solid
COLOR, NORMAL, ROUGHNESS_METALLIC_DEPTH = MAPS = ("Color", "Normal", "Roughness Metallic Depth")
SIDES = ("Front", "Back")
FRONT_COLOR = "Front color"  # label of the node with the color and alpha of the fronts
FRONT_NORMAL = "Front normal"  # label of the node with their normals in object space, encoded as colors
FRONT_ROUGHNESS_METALLIC_DEPTH = "Front roughness metallic depth"  # label of the node with their roughness, metallic and depth


def create_cloud_material(name: str, images: dict[tuple[str, str], bpy.types.Image], shadowless_distance: float) -> bpy.types.Material:
    """Create a material that shows `images`, keyed by side (SIDES) and map (MAPS).

    shadowless_distance: the material blocks no light from within this length, in units of the cloud's objects.
    """
    material = bpy.data.materials.new(name)
    set_two_sided(material)
    enable_nodes(material)
    tree = material.node_tree
    tree.nodes.clear()
    builder = NodeBuilder(tree)
    group = builder.node("ShaderNodeGroup", {"node_tree": _cloud_group(), "width": 220.0})
    group.inputs["Shadowless Distance"].default_value = shadowless_distance
    output = builder.node("ShaderNodeOutputMaterial")
    builder.connect(group.outputs["BSDF"], output.inputs["Surface"])
    for side, map_name in itertools.product(SIDES, MAPS):
        properties = {"image": images[side, map_name], "extension": "EXTEND", "label": f"{side} {map_name.lower()}"}
        texture = builder.node("ShaderNodeTexImage", properties)
        builder.connect(texture.outputs["Color"], group.inputs[f"{side} {map_name}"])
        if map_name == COLOR:
            builder.connect(texture.outputs["Alpha"], group.inputs[f"{side} Alpha"])
    builder.arrange()
    return material


def create_gray_material(name: str) -> bpy.types.Material:
    """Create a material with Blender's default gray, for clouds without textures."""
    material = bpy.data.materials.new(name)
    set_two_sided(material)
    return material


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
    return ensure_shared_group(GROUP_NAME, GROUP_VERSION, [*inputs, ("Shadowless Distance", "Float")], [("BSDF", "Shader")], _fill_group)


def _fill_group(builder: NodeBuilder) -> None:
    """Select the visible side and shade it."""
    inputs = builder.node("NodeGroupInput").outputs
    is_backfacing = builder.node("ShaderNodeNewGeometry").outputs["Backfacing"]

    def visible_side(name: str) -> SocketOrValue:
        return builder.mix(is_backfacing, inputs[f"Front {name}"], inputs[f"Back {name}"])

    roughness, metallic, _ = builder.separate(visible_side(ROUGHNESS_METALLIC_DEPTH))
    decoded = builder.vector("SUBTRACT", builder.vector("SCALE", visible_side(NORMAL), 2.0), (1.0, 1.0, 1.0))
    shader = builder.node("ShaderNodeBsdfPrincipled")
    builder.connect(visible_side(COLOR), shader.inputs["Base Color"])
    builder.connect(roughness, shader.inputs["Roughness"])
    builder.connect(metallic, shader.inputs["Metallic"])
    alpha = builder.separate(visible_side("Alpha"))[0]
    lit = builder.math("MULTIPLY", alpha, _blocks_light(builder, inputs["Shadowless Distance"]))
    builder.connect(builder.math("MULTIPLY", lit, _is_outside(builder, is_backfacing)), shader.inputs["Alpha"])
    builder.connect(builder.vector_transform(decoded, "NORMAL", "OBJECT", "WORLD"), shader.inputs["Normal"])
    builder.connect(shader.outputs[0], builder.node("NodeGroupOutput").inputs["BSDF"])


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
