"""Kinds of light for comparison renders: a Sun light, an area light, a point light, or a World with a bright region, as in an HDRI."""

import math

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.cameras import light_matrix
from farfield.addon.bridge.rendering.render_scene import RenderScene
from farfield.addon.bridge.shading.node_builder import NodeBuilder
from farfield.addon.compat import enable_nodes
from lib.studio import SUN_STRENGTH, Studio, set_uniform_sky

LIGHT_KINDS = ("sun", "environment", "area", "point")
AREA_DISTANCE, AREA_SIDE, POINT_DISTANCE = 3.0, 1.5, 2.5  # radii of the object
SUN_LOBE = 200.0  # concentration of the bright region of the World: half of its light comes from within 5 degrees
SAMPLING_MAP_PIXELS = 256  # computed again for each direction; a pixel is 1.4 degrees
ZENITH, NADIR = (0.25, 0.32, 0.45, 1.0), (0.16, 0.13, 0.10, 1.0)  # radiance of the rest of the World


class StudioLight:
    """One kind of light in a studio, at any direction from the object. About SUN_STRENGTH reaches the object's center from there."""

    def __init__(self, work: RenderScene, studio: Studio, kind: str) -> None:
        self._studio, self._kind = studio, kind
        studio.sun.hide_render = kind != "sun"
        self._local_light = None
        self._direction_node: bpy.types.Node | None = None
        if kind in ("area", "point"):
            self._local_light = work.add_object(work.own(bpy.data.lights.new("Farfield Studio", kind.upper())))
            self._local_light.data.color = (1.0, 0.95, 0.9)
        if kind == "environment":
            self._direction_node = _fill_world(work.scene.world)
        else:
            set_uniform_sky(work.scene.world)

    def aim(self, direction: np.ndarray, center: np.ndarray, radius: float) -> None:
        """Let the light come from the unit `direction` (3,) for an object with this `center` (3,) and `radius`."""
        if self._kind == "sun":
            self._studio.set_sun_direction(direction)
        elif self._direction_node is not None:
            self._direction_node.inputs[1].default_value = direction.tolist()
        else:
            self._place_local_light(direction, center, radius)

    def close(self) -> None:
        """Show the Sun light alone again."""
        if self._local_light is not None:
            self._local_light.hide_render = True
        self._studio.sun.hide_render = False

    def _place_local_light(self, direction: np.ndarray, center: np.ndarray, radius: float) -> None:
        is_area = self._kind == "area"
        distance = radius * (AREA_DISTANCE if is_area else POINT_DISTANCE)
        matrix = light_matrix(direction)
        matrix.translation = (center + distance * direction).tolist()
        self._local_light.matrix_world = matrix
        if is_area:
            self._local_light.data.size = AREA_SIDE * radius
        else:
            self._local_light.data.shadow_soft_size = 0.05 * radius
        self._local_light.data.energy = SUN_STRENGTH * (math.pi if is_area else 4.0 * math.pi) * distance**2


def _fill_world(world: bpy.types.World) -> bpy.types.Node:
    """Give `world` a sky with a bright region; return the node whose second input is the direction of this region."""
    enable_nodes(world)
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", SAMPLING_MAP_PIXELS
    tree = world.node_tree
    tree.nodes.clear()
    builder = NodeBuilder(tree)
    ray = builder.vector("NORMALIZE", builder.node("ShaderNodeTexCoord").outputs["Generated"])
    height = builder.math("ADD", builder.math("MULTIPLY", builder.separate(ray)[2], 0.5), 0.5, clamp=True)
    sky = builder.mix(height, NADIR[:3], ZENITH[:3])
    cosine = builder.vector("DOT_PRODUCT", ray, (0.0, 0.0, 1.0))
    peak = SUN_STRENGTH * SUN_LOBE / (2.0 * math.pi)
    lobe = builder.math(
        "MULTIPLY", builder.math("EXPONENT", builder.math("MULTIPLY", builder.math("SUBTRACT", cosine, 1.0), SUN_LOBE)), peak
    )
    background = builder.node("ShaderNodeBackground")
    builder.connect(builder.vector("ADD", sky, builder.combine(lobe, lobe, lobe)), background.inputs["Color"])
    builder.connect(background.outputs[0], builder.node("ShaderNodeOutputWorld").inputs["Surface"])
    return cosine.node
