"""The materials of the demo tree: an image of leaf sprigs painted in NumPy, and procedural bark."""

import bpy
import numpy as np

SPRIGS_A_SIDE = 2
CELL = 512
LEAVES_A_SPRIG = 9
LEAF_GREEN = np.array([0.120, 0.270, 0.042])  # scene-linear
VEIN_GREEN = np.array([0.270, 0.420, 0.110])
TWIG_BROWN = np.array([0.100, 0.062, 0.030])


def leaf_material(seed: int) -> bpy.types.Material:
    """Slightly glossy leaves: the sprig image times the vertex colour "Tint", with its alpha."""
    material, nodes, links, surface = new_material("Tree Leaf")
    picture = nodes.new("ShaderNodeTexImage")
    picture.image = _packed_image("Tree Leaf Sprigs", sprig_atlas(seed))
    tint = nodes.new("ShaderNodeVertexColor")
    tint.layer_name = "Tint"
    product = nodes.new("ShaderNodeMix")
    product.data_type, product.blend_type = "RGBA", "MULTIPLY"
    product.inputs["Factor"].default_value = 1.0
    color_inputs = [socket for socket in product.inputs if socket.type == "RGBA"]
    links.new(picture.outputs["Color"], color_inputs[0])
    links.new(tint.outputs["Color"], color_inputs[1])
    color = next(socket for socket in product.outputs if socket.type == "RGBA")
    links.new(color, surface.inputs["Base Color"])
    links.new(picture.outputs["Alpha"], surface.inputs["Alpha"])
    surface.inputs["Roughness"].default_value = 0.55
    return material


def bark_material() -> bpy.types.Material:
    """Furrowed bark out of noise stretched along the trunk: colour, roughness and relief."""
    material, nodes, links, surface = new_material("Tree Bark")
    place = nodes.new("ShaderNodeTexCoord")
    stretch = nodes.new("ShaderNodeMapping")
    stretch.inputs["Scale"].default_value = (9.0, 9.0, 1.6)
    furrows = nodes.new("ShaderNodeTexNoise")
    furrows.inputs["Scale"].default_value = 2.2
    furrows.inputs["Detail"].default_value = 7.0
    furrows.inputs["Roughness"].default_value = 0.62
    colors = nodes.new("ShaderNodeValToRGB")
    colors.color_ramp.elements[0].position, colors.color_ramp.elements[0].color = 0.36, (0.022, 0.014, 0.009, 1.0)
    colors.color_ramp.elements[1].position, colors.color_ramp.elements[1].color = 0.68, (0.210, 0.158, 0.112, 1.0)
    gloss = nodes.new("ShaderNodeMapRange")
    gloss.inputs["To Min"].default_value, gloss.inputs["To Max"].default_value = 0.95, 0.70
    relief = nodes.new("ShaderNodeBump")
    relief.inputs["Strength"].default_value = 0.8
    relief.inputs["Distance"].default_value = 0.03
    links.new(place.outputs["Object"], stretch.inputs["Vector"])
    links.new(stretch.outputs["Vector"], furrows.inputs["Vector"])
    height = furrows.outputs[0]
    links.new(height, colors.inputs["Fac"])
    links.new(height, gloss.inputs["Value"])
    links.new(height, relief.inputs["Height"])
    links.new(colors.outputs["Color"], surface.inputs["Base Color"])
    links.new(gloss.outputs["Result"], surface.inputs["Roughness"])
    links.new(relief.outputs["Normal"], surface.inputs["Normal"])
    return material


def sprig_atlas(seed: int) -> np.ndarray:
    """Sprigs of leaves in SPRIGS_A_SIDE x SPRIGS_A_SIDE cells: (H, W, 4) float32, sRGB values, straight alpha, row 0 at the bottom."""
    random = np.random.default_rng([seed, 3])
    cells = [[_sprig(random) for _ in range(SPRIGS_A_SIDE)] for _ in range(SPRIGS_A_SIDE)]
    return np.concatenate([np.concatenate(row, axis=1) for row in cells]).astype(np.float32)


def _sprig(random: np.random.Generator) -> np.ndarray:
    """One sprig, its twig upwards from the bottom edge, leaves to both sides and one at the tip; painted twice as large and halved."""
    size = 2 * CELL
    row, column = (np.mgrid[:size, :size].astype(np.float32) + 0.5) / size
    bend = random.uniform(-0.06, 0.06)
    color = np.broadcast_to(LEAF_GREEN, (size, size, 3)).copy()  # the ground is leaf green, so that edges do not darken when filtered
    alpha = np.zeros((size, size))
    twig = np.abs(column - 0.5 - bend * np.sin(3.0 * row)) < 0.007 * (1.15 - row)
    twig &= row < 0.65
    color[twig], alpha[twig] = TWIG_BROWN, 1.0
    for index in range(LEAVES_A_SPRIG):
        rank = index / (LEAVES_A_SPRIG - 1)
        height = 0.06 + 0.57 * rank
        foot = np.array([0.5 + bend * np.sin(3.0 * height), height])
        side = 1.0 if index % 2 else -1.0
        lean = 0.0 if index == LEAVES_A_SPRIG - 1 else side * random.uniform(0.75, 1.15) * (1.1 - 0.35 * rank)
        length = random.uniform(0.31, 0.38) * (1.0 - 0.12 * rank)
        near = _window(foot, length, size)
        _paint_leaf(color[near], alpha[near], column[near] - foot[0], row[near] - foot[1], lean, length, random)
    color = color.reshape(CELL, 2, CELL, 2, 3).mean(axis=(1, 3))
    alpha = alpha.reshape(CELL, 2, CELL, 2).mean(axis=(1, 3))
    srgb = np.where(color <= 0.0031308, 12.92 * color, 1.055 * color ** (1.0 / 2.4) - 0.055)
    return np.concatenate([np.clip(srgb, 0.0, 1.0), alpha[..., None]], axis=-1)


def _window(foot: np.ndarray, length: float, size: int) -> tuple[slice, slice]:
    """Rows and columns of a square picture that a leaf of this length can reach from its foot (x, y); picture sides are 1."""
    low = np.clip(((foot - 1.02 * length) * size).astype(int), 0, size)
    high = np.clip(((foot + 1.02 * length) * size).astype(int) + 1, 0, size)
    return slice(low[1], high[1]), slice(low[0], high[0])


def _paint_leaf(
    color: np.ndarray, alpha: np.ndarray, x: np.ndarray, y: np.ndarray, lean: float, length: float, random: np.random.Generator
) -> None:
    """Paint one leaf over `color` and `alpha`: its foot at x = y = 0, leaning by `lean` radians to the right of straight up."""
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
    painted = np.abs(across) < outline
    inside[inside] = painted
    color[inside] = _leaf_colors(blade[painted], across[painted], outline[painted], random)
    alpha[inside] = 1.0


def _leaf_colors(blade: np.ndarray, across: np.ndarray, outline: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Scene-linear colours (N, 3) of places on a leaf: `blade` 0..1 from foot to tip, `across` the midrib, whose edge is at `outline`."""
    share = np.abs(across) / outline
    midrib = np.exp(-((across / (0.020 * (1.1 - blade))) ** 2))
    phase = (blade - 0.55 * np.abs(across)) * 7.0
    ribs = 0.55 * np.exp(-(((phase % 1.0 - 0.5) / 0.09) ** 2)) * (1.0 - 0.6 * share)
    veins = np.clip(midrib + ribs, 0.0, 1.0)[:, None]
    mottle = 1.0 + 0.10 * np.sin(34.0 * blade) * np.sin(41.0 * across)
    shade = random.uniform(0.78, 1.22) * mottle * (1.0 - 0.22 * share**3) * np.where(across > 0.0, 1.06, 0.94)
    green = LEAF_GREEN * [random.uniform(0.85, 1.35), 1.0, random.uniform(0.7, 1.2)]
    return (green * (1.0 - veins) + VEIN_GREEN * veins) * shade[:, None]


def new_material(name: str) -> tuple[bpy.types.Material, bpy.types.Nodes, bpy.types.NodeLinks, bpy.types.Node]:
    """A material with a Principled surface: itself, its nodes, its links, and the Principled node."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    nodes = material.node_tree.nodes
    surface = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    return material, nodes, material.node_tree.links, surface


def _packed_image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """An 8-bit image with alpha, packed into the file. `pixels` (H, W, 4) are sRGB values with straight alpha."""
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(name, width, height, alpha=True)
    image.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    image.pack()
    return image
