"""The materials of the demo tree: an image of leaf sprigs painted with NumPy, and procedural bark."""

import bpy
import numpy as np

from lib import environment
from lib.shader_nodes import find_node

environment.import_farfield()

from farfield.addon.compat import enable_nodes
from farfield.addon.core.imaging.metrics import encode_srgb

SPRIGS_PER_SIDE = 2
SPRIG_PIXELS = 512
LEAVES_PER_SPRIG = 9
LEAF_GREEN = np.array([0.120, 0.270, 0.042])  # scene-linear
VEIN_GREEN = np.array([0.270, 0.420, 0.110])
TWIG_BROWN = np.array([0.100, 0.062, 0.030])


def create_leaf_material(seed: int) -> bpy.types.Material:
    """Create slightly glossy leaves: the sprig image with its alpha, multiplied by the color attribute "Leaf Color"."""
    material, nodes, links, surface = create_material("Tree Leaf")
    image = nodes.new("ShaderNodeTexImage")
    image.image = _packed_image("Tree Leaf Sprigs", paint_sprig_atlas(seed))
    color_attribute = nodes.new("ShaderNodeVertexColor")
    color_attribute.layer_name = "Leaf Color"
    product = nodes.new("ShaderNodeMix")
    product.data_type, product.blend_type = "RGBA", "MULTIPLY"
    product.inputs["Factor"].default_value = 1.0
    color_inputs = [socket for socket in product.inputs if socket.type == "RGBA"]
    links.new(image.outputs["Color"], color_inputs[0])
    links.new(color_attribute.outputs["Color"], color_inputs[1])
    color = next(socket for socket in product.outputs if socket.type == "RGBA")
    links.new(color, surface.inputs["Base Color"])
    links.new(image.outputs["Alpha"], surface.inputs["Alpha"])
    surface.inputs["Roughness"].default_value = 0.55
    return material


def create_bark_material() -> bpy.types.Material:
    """Create furrowed bark from noise stretched along the trunk: color, roughness and bump."""
    material, nodes, links, surface = create_material("Tree Bark")
    coordinates = nodes.new("ShaderNodeTexCoord")
    scaling = nodes.new("ShaderNodeMapping")
    scaling.inputs["Scale"].default_value = (9.0, 9.0, 1.6)
    furrows = nodes.new("ShaderNodeTexNoise")
    furrows.inputs["Scale"].default_value = 2.2
    furrows.inputs["Detail"].default_value = 7.0
    furrows.inputs["Roughness"].default_value = 0.62
    colors = nodes.new("ShaderNodeValToRGB")
    colors.color_ramp.elements[0].position, colors.color_ramp.elements[0].color = 0.36, (0.022, 0.014, 0.009, 1.0)
    colors.color_ramp.elements[1].position, colors.color_ramp.elements[1].color = 0.68, (0.210, 0.158, 0.112, 1.0)
    roughness = nodes.new("ShaderNodeMapRange")
    roughness.inputs["To Min"].default_value, roughness.inputs["To Max"].default_value = 0.95, 0.70
    bump = nodes.new("ShaderNodeBump")
    bump.inputs["Strength"].default_value = 0.8
    bump.inputs["Distance"].default_value = 0.03
    links.new(coordinates.outputs["Object"], scaling.inputs["Vector"])
    links.new(scaling.outputs["Vector"], furrows.inputs["Vector"])
    height = furrows.outputs[0]
    links.new(height, colors.inputs["Fac"])
    links.new(height, roughness.inputs["Value"])
    links.new(height, bump.inputs["Height"])
    links.new(colors.outputs["Color"], surface.inputs["Base Color"])
    links.new(roughness.outputs["Result"], surface.inputs["Roughness"])
    links.new(bump.outputs["Normal"], surface.inputs["Normal"])
    return material


def paint_sprig_atlas(seed: int) -> np.ndarray:
    """Return SPRIGS_PER_SIDE x SPRIGS_PER_SIDE sprigs of leaves: (H, W, 4) float32, sRGB values, straight alpha, row 0 at the bottom."""
    random = np.random.default_rng([seed, 3])
    cells = [[_paint_sprig(random) for _ in range(SPRIGS_PER_SIDE)] for _ in range(SPRIGS_PER_SIDE)]
    return np.concatenate([np.concatenate(row, axis=1) for row in cells]).astype(np.float32)


def _paint_sprig(random: np.random.Generator) -> np.ndarray:
    """Return one sprig, painted at double resolution: a twig up from the bottom edge with leaves on both sides and one at the tip."""
    size = 2 * SPRIG_PIXELS
    row, column = (np.mgrid[:size, :size].astype(np.float32) + 0.5) / size
    curvature = random.uniform(-0.06, 0.06)
    color = np.broadcast_to(
        LEAF_GREEN, (size, size, 3)
    ).copy()  # transparent pixels are leaf green, so that filtering does not darken edges
    alpha = np.zeros((size, size))
    twig = np.abs(column - 0.5 - curvature * np.sin(3.0 * row)) < 0.007 * (1.15 - row)
    twig &= row < 0.65
    color[twig], alpha[twig] = TWIG_BROWN, 1.0
    for index in range(LEAVES_PER_SPRIG):
        rank = index / (LEAVES_PER_SPRIG - 1)
        height = 0.06 + 0.57 * rank
        base = np.array([0.5 + curvature * np.sin(3.0 * height), height])
        side = 1.0 if index % 2 else -1.0
        lean = 0.0 if index == LEAVES_PER_SPRIG - 1 else side * random.uniform(0.75, 1.15) * (1.1 - 0.35 * rank)
        length = random.uniform(0.31, 0.38) * (1.0 - 0.12 * rank)
        window = _leaf_window(base, length, size)
        _paint_leaf(color[window], alpha[window], column[window] - base[0], row[window] - base[1], lean, length, random)
    color = color.reshape(SPRIG_PIXELS, 2, SPRIG_PIXELS, 2, 3).mean(axis=(1, 3))
    alpha = alpha.reshape(SPRIG_PIXELS, 2, SPRIG_PIXELS, 2).mean(axis=(1, 3))
    return np.concatenate([encode_srgb(color), alpha[..., None]], axis=-1)


def _leaf_window(base: np.ndarray, length: float, size: int) -> tuple[slice, slice]:
    """Return the rows and columns of a square image that a leaf of this length can cover from its base (x, y); the side is 1."""
    low = np.clip(((base - 1.02 * length) * size).astype(int), 0, size)
    high = np.clip(((base + 1.02 * length) * size).astype(int) + 1, 0, size)
    return slice(low[1], high[1]), slice(low[0], high[0])


def _paint_leaf(
    color: np.ndarray, alpha: np.ndarray, x: np.ndarray, y: np.ndarray, lean: float, length: float, random: np.random.Generator
) -> None:
    """Paint one leaf over `color` and `alpha`: its base at x = y = 0, tilted by `lean` radians to the right of vertical."""
    along = (x * np.sin(lean) + y * np.cos(lean)) / length
    across = (x * np.cos(lean) - y * np.sin(lean)) / length
    stalk = (along > -0.02) & (along <= 0.14) & (np.abs(across) < 0.014)
    color[stalk], alpha[stalk] = VEIN_GREEN, 1.0
    across = across - random.uniform(-0.12, 0.12) * along**2
    inside = (along > 0.10) & (along < 1.0) & (np.abs(across) < 0.36)
    blade = (along[inside] - 0.10) / 0.90
    across = across[inside]
    teeth = 1.0 + 0.05 * (2.0 * np.abs((14.0 * blade) % 1.0 - 0.5) - 0.5)
    outline = 0.62 * blade**0.62 * (1.0 - blade) ** 0.80 * teeth
    in_outline = np.abs(across) < outline
    inside[inside] = in_outline
    color[inside] = _leaf_colors(blade[in_outline], across[in_outline], outline[in_outline], random)
    alpha[inside] = 1.0


def _leaf_colors(blade: np.ndarray, across: np.ndarray, outline: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return scene-linear colors (N, 3) of points on a leaf: `blade` 0..1 from base to tip, `across` from the midrib to the `outline`."""
    edge_fraction = np.abs(across) / outline
    midrib = np.exp(-((across / (0.020 * (1.1 - blade))) ** 2))
    phase = (blade - 0.55 * np.abs(across)) * 7.0
    ribs = 0.55 * np.exp(-(((phase % 1.0 - 0.5) / 0.09) ** 2)) * (1.0 - 0.6 * edge_fraction)
    veins = np.clip(midrib + ribs, 0.0, 1.0)[:, None]
    mottle = 1.0 + 0.10 * np.sin(34.0 * blade) * np.sin(41.0 * across)
    shade = random.uniform(0.78, 1.22) * mottle * (1.0 - 0.22 * edge_fraction**3) * np.where(across > 0.0, 1.06, 0.94)
    green = LEAF_GREEN * [random.uniform(0.85, 1.35), 1.0, random.uniform(0.7, 1.2)]
    return (green * (1.0 - veins) + VEIN_GREEN * veins) * shade[:, None]


def create_material(name: str) -> tuple[bpy.types.Material, bpy.types.Nodes, bpy.types.NodeLinks, bpy.types.Node]:
    """Create a material with a Principled BSDF; return the material, its nodes, its links and the Principled node."""
    material = bpy.data.materials.new(name)
    enable_nodes(material)
    nodes = material.node_tree.nodes
    return material, nodes, material.node_tree.links, find_node(material.node_tree, "BSDF_PRINCIPLED")


def _packed_image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """Create an 8-bit image with alpha, packed into the file. `pixels` (H, W, 4) are sRGB values with straight alpha."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=True)
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    image.pack()
    return image
