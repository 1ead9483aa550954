"""A World with sky, a Sun light, and haze on the ground: one setup for landscapes.

The haze is a node group before the output of materials. It mixes their light with that of the sky in the direction of the view, by the
length of the ray through air whose density falls with height. Only the camera sees it, so that shadows and reflections stay as they are.
"""

import math
from collections.abc import Iterable

import bpy
import mathutils
import numpy as np

from ..compat import enable_nodes
from ..core.geometry.directions import from_spherical
from ..core.sky import LIGHT_VALUES, Light, SkySettings
from .shading.node_builder import NodeBuilder, SocketOrValue, ensure_shared_group
from .sky_clouds import CLOUD_INPUTS, ensure_cloud_group

WORLD_NAME, SUN_NAME, HAZE_GROUP, HAZE_VERSION = "Farfield Sky", "Farfield Sun", "Farfield Haze", 1
SHARED_SURFACE = "Farfield Terrain Ground"  # The group from color to surface of textured terrain.
SKY_STRENGTH = 0.1  # From the radiance of Blender's sky to the strength of its Sun lights.
SKY_MAP_RESOLUTION = 256  # Pixels of the map by which Cycles samples the light of the sky.
CLOUD_ALBEDO = 0.7  # Fraction of sunlight that clouds scatter.
HORIZON = 0.04  # Lowest z of the directions in which the sky is read.
HAZE_HEIGHT = 0.12  # Height by which the density of air falls to 37 %, relative to the size of the terrain.
HAZE_VALUES = "Distance", "Height", "Base Height"
HAZE_INPUTS = (("Shader", "Shader"), *((name, "Float") for name in HAZE_VALUES))
SKY_TYPES = ("MULTIPLE_SCATTERING", "NISHITA")  # The first that Blender has.


def add_sky(scene: bpy.types.Scene, settings: SkySettings) -> bpy.types.Object:
    """Give a scene a World with sky and a Sun light, or change those that it got before. A World of the user stays in the file.

    Returns the Sun light.
    """
    light, users_world = LIGHT_VALUES[settings.light], find_users_world(scene)
    if users_world is not None and users_world.library is None:
        users_world.use_fake_user = True
    if users_world is not None or scene.world is None:
        scene.world = bpy.data.worlds.new(WORLD_NAME)
    world = scene.world
    enable_nodes(world)
    if hasattr(world, "cycles"):  # Nothing in this sky is as small as the disk of the Sun, which would take a large map of its light.
        world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", SKY_MAP_RESOLUTION
    world.node_tree.nodes.clear()
    builder = NodeBuilder(world.node_tree)
    background = builder.node("ShaderNodeBackground")
    sky = _add_sky_texture(builder, light, settings.sun_direction)
    direction = builder.node("ShaderNodeTexCoord").outputs["Generated"]
    builder.connect(_above_horizon(builder, *builder.separate(direction)), sky.inputs["Vector"])
    builder.connect(_add_clouds(builder, settings, sky.outputs["Color"], direction), background.inputs["Color"])
    background.inputs["Strength"].default_value = SKY_STRENGTH * light.sky
    builder.connect(background.outputs[0], builder.node("ShaderNodeOutputWorld").inputs["Surface"])
    builder.arrange()
    sun = next((item for item in scene.objects if item.name.startswith(SUN_NAME) and item.type == "LIGHT"), None)
    if sun is None:
        sun = bpy.data.objects.new(SUN_NAME, bpy.data.lights.new(SUN_NAME, "SUN"))
        scene.collection.objects.link(sun)
    sun.data.energy, sun.data.angle, sun.data.color = light.strength, light.angle, light.color.tolist()
    to_sun = mathutils.Vector(from_spherical(0.5 * math.pi - np.array([light.elevation, settings.sun_direction])))
    sun.rotation_mode, sun.rotation_euler = "XYZ", to_sun.to_track_quat("Z", "Y").to_euler()
    return sun


def find_users_world(scene: bpy.types.Scene) -> bpy.types.World | None:
    """Return the World of a scene that `add_sky` replaces, None if it changes its own."""
    world = scene.world
    return world if world is not None and (world.library is not None or not world.name.startswith(WORLD_NAME)) else None


def add_haze(materials: Iterable[bpy.types.Material], settings: SkySettings, size: float, base_height: float) -> None:
    """Put haze before the output of materials, or of the group from color to surface that the materials of a terrain share.

    size: of the terrain, scene units; its farthest ground is half as far away. base_height: of dense air, z in world space.
    """
    distance = 0.5 * size / -math.log(1.0 - settings.haze) if settings.haze else 1e12
    _place_haze(materials, _ensure_haze_group(settings), (distance, HAZE_HEIGHT * size, base_height))


def copy_haze(materials: Iterable[bpy.types.Material], targets: Iterable[bpy.types.Material]) -> None:
    """Give `targets` the haze of `materials`, if these have any."""
    for tree in filter(None, map(_find_surface, materials)):
        for node in tree.nodes:
            if node.type == "GROUP" and node.node_tree is not None and node.node_tree.name.startswith(HAZE_GROUP):
                _place_haze(targets, node.node_tree, tuple(node.inputs[name].default_value for name in HAZE_VALUES))
                return


def _place_haze(materials: Iterable[bpy.types.Material], group: bpy.types.NodeTree, values: tuple[float, float, float]) -> None:
    """Put the group of haze before the outputs of materials, once, with `HAZE_VALUES`."""
    for tree in dict.fromkeys(filter(None, map(_find_surface, materials))):
        node = next((item for item in tree.nodes if item.type == "GROUP" and item.node_tree == group), None) or _insert(tree, group)
        for name, value in zip(HAZE_VALUES, values, strict=True):
            node.inputs[name].default_value = value


def _find_surface(material: bpy.types.Material) -> bpy.types.NodeTree | None:
    """Return the node tree with the surface of a material: its own or a shared one, None if that cannot be changed."""
    tree = material.node_tree
    for node in tree.nodes if tree is not None else ():
        if node.type == "GROUP" and node.node_tree is not None and node.node_tree.name.startswith(SHARED_SURFACE):
            tree = node.node_tree
    return tree if tree is not None and tree.library is None else None


def _insert(tree: bpy.types.NodeTree, group: bpy.types.NodeTree) -> bpy.types.Node:
    """Put a group node between the surface of a tree and its outputs."""
    builder = NodeBuilder(tree)
    node = builder.node("ShaderNodeGroup", {"node_tree": group, "width": 160.0})
    for target in _find_outputs(tree):
        if target.is_linked:
            builder.connect(target.links[0].from_socket, node.inputs["Shader"])
            builder.connect(node.outputs["Shader"], target)
    builder.arrange()
    return node


def _find_outputs(tree: bpy.types.NodeTree) -> list[bpy.types.NodeSocket]:
    """Return the sockets that a surface is connected to."""
    found = []
    for node in tree.nodes:
        if node.type == "OUTPUT_MATERIAL":
            found.append(node.inputs["Surface"])
        elif node.type == "GROUP_OUTPUT":
            found += [socket for socket in node.inputs if socket.type == "SHADER"]
    return found


def _add_sky_texture(builder: NodeBuilder, light: Light, azimuth: float) -> bpy.types.Node:
    """Add the sky without the disk of the Sun, which is a light of its own."""
    sky = builder.node("ShaderNodeTexSky")
    known = {item.identifier for item in sky.bl_rna.properties["sky_type"].enum_items}
    sky.sky_type = next(name for name in SKY_TYPES if name in known)
    sky.sun_disc, sky.sun_elevation, sky.sun_rotation = False, light.elevation, azimuth
    dust = "aerosol_density" if hasattr(sky, "aerosol_density") else "dust_density"
    setattr(sky, dust, light.dust)
    return sky


def _add_clouds(
    builder: NodeBuilder, settings: SkySettings, sky: bpy.types.NodeSocket, direction: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    """Return the color of a sky with the clouds of the settings."""
    if not settings.clouds:
        return sky
    light = LIGHT_VALUES[settings.light]
    clouds = builder.node("ShaderNodeGroup", {"node_tree": ensure_cloud_group(), "width": 160.0})
    radiance = light.color * light.strength * CLOUD_ALBEDO / (math.pi * SKY_STRENGTH * light.sky)
    toward_sun = math.sin(settings.sun_direction), math.cos(settings.sun_direction)
    values = sky, (*radiance, 1.0), direction, settings.clouds, *toward_sun
    for (name, _), value in zip(CLOUD_INPUTS, values, strict=True):
        builder.connect(value, clouds.inputs[name])
    return clouds.outputs["Sky"]


def _ensure_haze_group(settings: SkySettings) -> bpy.types.NodeTree:
    """Return the node group of haze, with the sky of the settings."""
    group = ensure_shared_group(HAZE_GROUP, HAZE_VERSION, HAZE_INPUTS, (("Shader", "Shader"),), _fill_haze_group)
    light = LIGHT_VALUES[settings.light]
    for node in group.nodes:
        if node.type == "EMISSION":
            node.inputs["Strength"].default_value = SKY_STRENGTH * light.sky
        elif node.type == "TEX_SKY":
            group.nodes.remove(node)
    builder = NodeBuilder(group)
    sky = _add_sky_texture(builder, light, settings.sun_direction)
    emission = next(node for node in group.nodes if node.type == "EMISSION")
    direction = next(node for node in group.nodes if node.label == "Direction")
    builder.connect(direction.outputs[0], sky.inputs["Vector"])
    builder.connect(sky.outputs["Color"], emission.inputs["Color"])
    builder.arrange()
    return group


def _fill_haze_group(builder: NodeBuilder) -> None:
    inputs = builder.node("NodeGroupInput").outputs
    geometry, camera_data = builder.node("ShaderNodeNewGeometry"), builder.node("ShaderNodeCameraData")
    backward = builder.separate(geometry.outputs["Incoming"])
    direction = _above_horizon(builder, *(builder.math("MULTIPLY", axis, -1.0) for axis in backward))
    direction.node.label = "Direction"
    distance = camera_data.outputs["View Distance"]
    height = builder.math("SUBTRACT", builder.separate(geometry.outputs["Position"])[2], inputs["Base Height"])
    climb = builder.math("MULTIPLY", distance, backward[2])
    lowest = builder.math("MAXIMUM", builder.math("MINIMUM", height, builder.math("ADD", height, climb)), 0.0)
    change = builder.math("DIVIDE", builder.math("ABSOLUTE", climb), inputs["Height"])
    density = builder.attenuate(builder.math("DIVIDE", lowest, inputs["Height"]))
    depth = builder.math("MULTIPLY", density, _mean_falloff(builder, change))
    depth = builder.math("MULTIPLY", depth, builder.math("DIVIDE", distance, inputs["Distance"]))
    passed = builder.attenuate(depth)
    is_camera = builder.node("ShaderNodeLightPath").outputs["Is Camera Ray"]
    haze = builder.math("MULTIPLY", builder.math("SUBTRACT", 1.0, passed), is_camera)
    mix, emission = builder.node("ShaderNodeMixShader"), builder.node("ShaderNodeEmission")
    builder.connect(haze, mix.inputs[0])
    builder.connect(inputs["Shader"], mix.inputs[1])
    builder.connect(emission.outputs[0], mix.inputs[2])
    builder.connect(mix.outputs[0], builder.node("NodeGroupOutput").inputs["Shader"])


def _above_horizon(builder: NodeBuilder, x: SocketOrValue, y: SocketOrValue, z: SocketOrValue) -> bpy.types.NodeSocket:
    """Return a direction, or that of the horizon above it: Blender's sky is black below."""
    return builder.combine(x, y, builder.math("MAXIMUM", z, HORIZON))


def _mean_falloff(builder: NodeBuilder, change: SocketOrValue) -> bpy.types.NodeSocket:
    """Return the mean of exp(-t) for t from 0 to a positive `change`: (1 - exp(-change)) / change."""
    safe = builder.math("MAXIMUM", change, 1e-3)
    return builder.math("DIVIDE", builder.math("SUBTRACT", 1.0, builder.attenuate(safe)), safe)
