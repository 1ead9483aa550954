"""The materials of clip-box terrain: the ground with colors by the kind of terrain, and water."""

from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import FileError
from ..shading.ground import DEFAULTS, LAYERS, NO_WATER, add_ground
from ..shading.ground_emission import add_emission
from ..shading.ground_noise import add_noise
from ..shading.node_builder import NodeBuilder, create_node_material
from ..shading.solid_view import show_color

SNOW_LINE = 0.3  # default height of snow above the upper height, relative to the size of the terrain
MIN_SIZE = 1e-3  # scene units, for a flat terrain
WATER_NAME = "Farfield Water"
WATER_IOR, WAVELENGTH, WAVE_HEIGHT = 1.333, 9.0, 1.2  # Lengths relative to the smallest voxels, like the distances.
CALM_DISTANCE, ROUGH_DISTANCE, CALM_ROUGHNESS, MAX_ROUGHNESS = 120.0, 8000.0, 0.02, 0.22
MEADOW, DRY_GRASS, SCRUB = (0.085, 0.11, 0.032, 1.0), (0.2, 0.16, 0.075, 1.0), (0.1, 0.1, 0.045, 1.0)
RED_ROCK, PALE_ROCK, DESERT_SAND = (0.4, 0.18, 0.095, 1.0), (0.56, 0.355, 0.22, 1.0), (0.5, 0.34, 0.19, 1.0)
LAVA_HEIGHT = 1.2  # Meters above its level below which there is lava: bumps of its surface are lower.
ALL = 1e6  # Scene units: a height that no ground reaches.
DEFAULTS_BY_TERRAIN = {  # Other values than DEFAULTS.
    "forest": {  # Steep ground is foliage.
        "Rock": (0.045, 0.075, 0.018, 1.0), "Strata": (0.045, 0.075, 0.018, 1.0), "Scree": (0.05, 0.07, 0.02, 1.0),
        "Snow": (0.06, 0.09, 0.025, 1.0), "Sand": (0.12, 0.105, 0.05, 1.0), "Blades": 0.5,
    },
    "alps": {
        "Rock": (0.2, 0.185, 0.17, 1.0), "Strata": (0.3, 0.28, 0.255, 1.0), "Scree": (0.27, 0.25, 0.225, 1.0),
        "Sand": (0.045, 0.06, 0.02, 1.0), "Rock Slope": 0.8,
    },
    "hills": {"Snow": MEADOW, "Sand": (0.05, 0.07, 0.022, 1.0), "Rock Slope": 0.5},
    "canyon": {
        "Rock": RED_ROCK, "Strata": PALE_ROCK, "Scree": (0.36, 0.19, 0.1, 1.0), "Grass": DRY_GRASS, "Undergrowth": SCRUB,
        "Dry Grass": (0.3, 0.2, 0.11, 1.0), "Snow": DRY_GRASS, "Sand": (0.36, 0.2, 0.11, 1.0), "Stones": 0.1,
        "Pebbles": 0.5, "Blades": 0.6, "Moisture": -0.2,
    },
    "mesas": {
        "Rock": RED_ROCK, "Strata": PALE_ROCK, "Scree": (0.36, 0.18, 0.09, 1.0), "Grass": (0.34, 0.2, 0.1, 1.0), "Undergrowth": SCRUB,
        "Dry Grass": (0.42, 0.23, 0.12, 1.0), "Snow": DRY_GRASS, "Sand": (0.42, 0.24, 0.13, 1.0), "Stones": 0.1,
        "Pebbles": 0.7, "Blades": 0.0, "Moisture": -0.3,
    },
    "coast": {
        "Rock": (0.15, 0.13, 0.11, 1.0), "Strata": (0.27, 0.23, 0.18, 1.0), "Snow": (0.075, 0.095, 0.028, 1.0),
        "Sand": (0.5, 0.41, 0.28, 1.0), "Ripples": 0.6, "Pebbles": 0.4, "Rock Slope": 0.75, "Height Blend": 0.02, "Height Noise": 0.04,
    },
    "dunes": {
        "Rock": (0.46, 0.3, 0.16, 1.0), "Strata": DESERT_SAND, "Scree": DESERT_SAND, "Grass": DESERT_SAND, "Undergrowth": DESERT_SAND,
        "Snow": DESERT_SAND, "Dry Grass": DESERT_SAND, "Sand": DESERT_SAND, "Sand Height": ALL, "Rock Slope": -1.0, "Stones": 0.0,
        "Ripples": 1.0, "Pebbles": 0.25, "Blades": 0.0, "Moisture": -0.3, "Color Noise": 0.3,
    },
    "karst": {
        "Rock": (0.2, 0.185, 0.16, 1.0), "Strata": (0.34, 0.31, 0.26, 1.0), "Scree": (0.16, 0.15, 0.1, 1.0),
        "Grass": (0.045, 0.075, 0.02, 1.0), "Undergrowth": (0.022, 0.042, 0.012, 1.0), "Snow": (0.04, 0.065, 0.018, 1.0),
        "Sand": (0.3, 0.26, 0.18, 1.0), "Rock Slope": 0.45, "Slope Noise": 0.5,
    },
    "arches": {
        "Rock": (0.36, 0.13, 0.055, 1.0), "Strata": (0.5, 0.24, 0.12, 1.0), "Scree": (0.4, 0.18, 0.085, 1.0),
        "Grass": (0.38, 0.2, 0.1, 1.0), "Undergrowth": SCRUB, "Dry Grass": (0.46, 0.22, 0.11, 1.0),
        "Stones": 0.1, "Pebbles": 0.7, "Blades": 0.0, "Moisture": -0.3, "Snow": (0.42, 0.18, 0.08, 1.0), "Sand": (0.46, 0.23, 0.115, 1.0),
    },
    "alien": {
        "Rock": (0.4, 0.17, 0.15, 1.0), "Strata": (0.6, 0.37, 0.28, 1.0), "Scree": (0.42, 0.26, 0.25, 1.0), "Grass": (0.05, 0.2, 0.17, 1.0),
        "Undergrowth": (0.16, 0.05, 0.15, 1.0), "Dry Grass": (0.3, 0.33, 0.1, 1.0), "Snow": (0.55, 0.45, 0.3, 1.0),
        "Sand": (0.55, 0.38, 0.36, 1.0), "Rock Slope": 0.6, "Ripples": 0.7, "Blades": 0.6,
    },
    "lava": {  # Young flows in hollows are black, old ones rusty, bare ground is yellow of sulfur.
        "Rock": (0.068, 0.059, 0.054, 1.0), "Strata": (0.125, 0.075, 0.05, 1.0), "Scree": (0.14, 0.112, 0.072, 1.0),
        "Grass": (0.066, 0.06, 0.056, 1.0), "Undergrowth": (0.024, 0.022, 0.022, 1.0), "Dry Grass": (0.118, 0.07, 0.048, 1.0),
        "Snow": (0.13, 0.08, 0.054, 1.0), "Sand": (0.042, 0.038, 0.037, 1.0), "Stones": 0.3, "Rock Slope": 0.78, "Roughness": 0.8,
        "Blades": 0.0, "Moisture": 0.22,
    },
}  # fmt: skip


@dataclass(frozen=True)
class GroundImage:
    """An image of the ground from above, centered on x = y = 0 of the terrain.

    path: the file. size: length of its longest side, scene units. origin: (3,) terrain position at the root.
    """

    path: Path
    size: float
    origin: np.ndarray


def create_terrain_material(
    name: str,
    root: bpy.types.Object,
    low: float,
    high: float,
    voxel_size: float,
    ground_image: GroundImage | None = None,
    terrain: str = "",
    meter: float = 1.0,
    level: float = 0.0,
) -> bpy.types.Material:
    """Create a material for terrain below `root`, most of which lies between the heights `low` and `high`, scene units above the root.

    All colors and numbers are inputs of its node group. voxel_size: of the smallest voxels; shading adds bumps between them. A
    `ground_image` replaces all ground colors. terrain: its kind. meter: the length of a meter in scene units. level: z = 0 of the terrain,
    relative to the root.

    Raises:
        FileError: the ground image cannot be read.
    """
    size = max(0.5 * (high - low), MIN_SIZE)
    material, builder = create_node_material(name)
    position = builder.node("ShaderNodeTexCoord", {"object": root}).outputs["Object"]
    values = {"Size": size, "Bump Size": voxel_size, "Meter": meter, "Snow Height": high + SNOW_LINE * size, "Sand Height": low}
    values["Middle Height"] = 0.5 * (low + high)
    values |= DEFAULTS_BY_TERRAIN.get(terrain, {})
    if ground_image is not None:
        values |= dict.fromkeys(LAYERS, _project_ground_image(builder, position, ground_image))
    normal = builder.node("ShaderNodeNewGeometry").outputs["Normal"]
    shader = add_ground(builder, position, normal, values)
    if terrain == "lava":
        shader = add_emission(builder, position, normal, {"Height": level + LAVA_HEIGHT * meter, "Meter": meter}, shader)
        if hasattr(material, "cycles"):
            material.cycles.emission_sampling = "NONE"  # Most of the ground does not glow.
    builder.connect(shader, builder.node("ShaderNodeOutputMaterial").inputs["Surface"])
    builder.arrange()
    show_color(material, (DEFAULTS | values)["Grass"] if ground_image is None else DEFAULTS["Grass"])
    return material


def set_water(material: bpy.types.Material, height: float | None) -> None:
    """Let the ground below a height, z relative to the root, be under water; None removes the water."""
    for node in material.node_tree.nodes if material.node_tree is not None else ():
        if node.type == "GROUP" and "Water Height" in node.inputs:
            node.inputs["Water Height"].default_value = NO_WATER if height is None else height


def create_water_material(voxel_size: float) -> bpy.types.Material:
    """Create the material of a water surface: a mirror by Fresnel's equations, and clear where it does not reflect, since the material of
    the ground has the color of the depth. voxel_size: of the smallest voxels; waves are several times as long."""
    material, builder = create_node_material(WATER_NAME)
    distance = builder.math("DIVIDE", builder.node("ShaderNodeCameraData").outputs["View Distance"], voxel_size)
    position = builder.node("ShaderNodeNewGeometry").outputs["Position"]
    waves = builder.math("MULTIPLY", add_noise(builder, position, 1.0 / (WAVELENGTH * voxel_size), 4.0), WAVE_HEIGHT * voxel_size)
    bump = builder.node("ShaderNodeBump")
    builder.connect(
        builder.math("DIVIDE", 1.0, builder.math("ADD", builder.math("DIVIDE", distance, CALM_DISTANCE), 1.0)), bump.inputs["Strength"]
    )
    builder.connect(waves, bump.inputs["Height"])
    bump.inputs["Distance"].default_value = 1.0
    fresnel, glossy = builder.node("ShaderNodeFresnel"), builder.node("ShaderNodeBsdfGlossy")
    fresnel.inputs["IOR"].default_value = WATER_IOR
    for node in (fresnel, glossy):
        builder.connect(bump.outputs["Normal"], node.inputs["Normal"])
    # Waves that are smaller than pixels make the surface rough.
    roughness = builder.math("ADD", builder.math("DIVIDE", distance, ROUGH_DISTANCE), CALM_ROUGHNESS)
    builder.connect(builder.math("MINIMUM", roughness, MAX_ROUGHNESS), glossy.inputs["Roughness"])
    mix = builder.node("ShaderNodeMixShader")
    builder.connect(fresnel.outputs[0], mix.inputs[0])
    builder.connect(builder.node("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[1])
    builder.connect(glossy.outputs[0], mix.inputs[2])
    builder.connect(mix.outputs[0], builder.node("ShaderNodeOutputMaterial").inputs["Surface"])
    builder.arrange()
    show_color(material, DEFAULTS["Water"])
    return material


def _project_ground_image(builder: NodeBuilder, position: bpy.types.NodeSocket, ground_image: GroundImage) -> bpy.types.NodeSocket:
    """Return the color of a ground image at a `position` relative to the root."""
    try:
        image = bpy.data.images.load(str(ground_image.path), check_existing=True)
    except RuntimeError as error:
        raise FileError(f'The image "{ground_image.path}" cannot be read; check the path.') from error
    width, height = image.size
    if not (width and height):
        raise FileError(f'The file "{ground_image.path}" is not an image that Blender supports.')
    size = np.array([width, height]) * ground_image.size / max(width, height)
    centered_uv = builder.vector("MULTIPLY", builder.vector("ADD", position, ground_image.origin.tolist()), (*(1.0 / size).tolist(), 0.0))
    node = builder.node("ShaderNodeTexImage", {"image": image, "extension": "EXTEND", "label": "Ground Image"})
    builder.connect(builder.vector("ADD", centered_uv, (0.5, 0.5, 0.0)), node.inputs["Vector"])
    return node.outputs["Color"]
