"""Materials of large terrain: images of the ground, colors by slope, height or level of detail. All are shader nodes of Blender.

The material of a texture tile has one or two packed images, as coded in the store, and is kept for a while after its last use.
"""

import bpy

from ...core.bdam.store.curvature import EARTH_RADIUS
from ...core.bdam.textures.tile_blocks import CodedTile
from ..shading.ground import DEFAULTS, add_ground
from ..shading.node_builder import NodeBuilder, create_node_material, ensure_shared_group
from ..shading.solid_view import show_color, show_image
from ..sky import SHARED_SURFACE

GROUND_VERSION = 1
LEVEL_ATTRIBUTE = "terrain_level"  # attribute of faces: the level of the patch
MATERIAL_KEY = "farfield_bdam_material"  # custom property of the material of a terrain: its shading, and whether the ground is curved
ROUGHNESS = 0.95
LEVEL_COLOR_STEP = 0.381966  # between two levels; multiples of the golden ratio are far from each other
SNOW_HEIGHT = 0.66  # Fraction of the height range at which snow begins.
ROCK_NORMAL = 0.8  # z of the normal below which the ground is rock.
BUMP_SIZE = 0.1  # Bump Size of the ground, relative to the distance between samples.
MAP_COLORS = (  # colors by height: fraction of the height range and scene-linear color
    (0.0, (0.03, 0.13, 0.04)), (0.15, (0.13, 0.28, 0.07)), (0.35, (0.6, 0.55, 0.22)), (0.55, (0.42, 0.21, 0.07)),
    (0.75, (0.24, 0.13, 0.08)), (0.9, (0.55, 0.52, 0.5)), (1.0, (0.9, 0.9, 0.92)),
)  # fmt: skip
TEXTURE_KEY = "farfield_bdam_texture"  # custom property of materials and images: the store, and the number of the tile
MAX_USES = 2**31 - 2  # The custom property stores larger numbers as floats.
USED_KEY = "farfield_bdam_used"  # custom property of materials: counts up with every use
MAX_UNUSED = 64  # materials of texture tiles that are kept without users
MAX_REMOVED = 8  # unused materials that are removed at a time


def create_material(
    name: str, shading: str, root: bpy.types.Object, heights: tuple[float, float], cell_size: float, curvature: float = 0.0
) -> bpy.types.Material:
    """Create the material of a terrain below `root` for a shading other than "texture": "slope", "height" or "level".

    heights: lowest and highest height above the root, with exaggeration. cell_size: distance between samples. curvature: the
    exaggeration where the curvature of the Earth lowers the ground, which colors by height do not count; 0 where it does not.
    """
    material, builder = create_node_material(name)
    material[MATERIAL_KEY] = shading
    show_color(material, MAP_COLORS[1][1] if shading == "height" else DEFAULTS["Grass"])
    if shading == "level":
        _finish(builder, _color_by_level(builder), None)
        return material
    position, span = builder.node("ShaderNodeTexCoord", {"object": root}).outputs["Object"], max(heights[1] - heights[0], 1e-6)
    if curvature:
        position = _raise(builder, position, curvature / (2.0 * EARTH_RADIUS))
    if shading == "slope":
        levels = {"Rock Slope": ROCK_NORMAL, "Snow Height": heights[0] + SNOW_HEIGHT * span, "Sand Height": heights[0] - span}
        add_ground(material, builder, position, {"Size": 0.5 * span, "Bump Size": BUMP_SIZE * cell_size, "Distant Bumps": 0.0, **levels})
        return material
    fraction = builder.math("DIVIDE", builder.math("SUBTRACT", builder.separate(position)[2], heights[0]), span)
    fraction.node.label = "Height"
    _finish(builder, _color_by_height(builder, fraction), None)
    return material


def _raise(builder: NodeBuilder, position: bpy.types.NodeSocket, factor: float) -> bpy.types.NodeSocket:
    """Return a position whose height is larger by the square of the distance from the center times a factor."""
    level = builder.vector("MULTIPLY", position, (1.0, 1.0, 0.0))
    squared = builder.node("ShaderNodeVectorMath", {"operation": "DOT_PRODUCT", "label": "Curvature"})
    for index in range(2):
        builder.connect(level, squared.inputs[index])
    return builder.vector("ADD", position, builder.combine(0.0, 0.0, builder.math("MULTIPLY", squared.outputs["Value"], factor)))


def create_texture_material(name: str, color: bpy.types.Image, alpha: bpy.types.Image | None) -> bpy.types.Material:
    """Create the material of one texture tile. alpha: None if the color image contains it."""
    material, builder = create_node_material(name)
    image = builder.node("ShaderNodeTexImage", {"image": color, "extension": "EXTEND", "label": "Texture"})
    opacity = image.outputs["Alpha"] if color.channels == 4 and color.depth == 32 else None
    if alpha is not None:
        opacity = builder.node("ShaderNodeTexImage", {"image": alpha, "extension": "EXTEND", "label": "Alpha"}).outputs["Color"]
    _finish(builder, image.outputs["Color"], opacity)
    show_image(material, color)
    return material


def _finish(builder: NodeBuilder, color: bpy.types.NodeSocket, opacity: bpy.types.NodeSocket | None) -> None:
    """Connect a color, and an opacity if there is one, to the surface."""
    group = builder.node("ShaderNodeGroup", {"node_tree": _ensure_ground_group(), "width": 200.0})
    group.inputs["Alpha"].default_value, group.inputs["Roughness"].default_value = 1.0, ROUGHNESS
    builder.connect(color, group.inputs["Color"])
    if opacity is not None:
        builder.connect(opacity, group.inputs["Alpha"])
    builder.connect(group.outputs["Shader"], builder.node("ShaderNodeOutputMaterial").inputs["Surface"])
    builder.arrange()


def _ensure_ground_group() -> bpy.types.NodeTree:
    """Return the group from color to surface that all materials of terrains share."""
    inputs = (("Color", "Color"), ("Alpha", "Float"), ("Roughness", "Float"))
    return ensure_shared_group(SHARED_SURFACE, GROUND_VERSION, inputs, (("Shader", "Shader"),), _fill_ground_group)


def _fill_ground_group(builder: NodeBuilder) -> None:
    inputs = builder.node("NodeGroupInput").outputs
    principled = builder.node("ShaderNodeBsdfPrincipled")
    builder.connect(inputs["Color"], principled.inputs["Base Color"])
    builder.connect(inputs["Alpha"], principled.inputs["Alpha"])
    builder.connect(inputs["Roughness"], principled.inputs["Roughness"])
    principled.inputs["Specular IOR Level"].default_value = 0.2
    builder.connect(principled.outputs[0], builder.node("NodeGroupOutput").inputs["Shader"])


def _color_by_level(builder: NodeBuilder) -> bpy.types.NodeSocket:
    """Return a color of its own for every level of detail."""
    node = builder.node("ShaderNodeCombineColor", {"mode": "HSV"})
    level = builder.attribute(LEVEL_ATTRIBUTE, is_scalar=True)
    builder.connect(builder.math("FRACT", builder.math("MULTIPLY", level, LEVEL_COLOR_STEP)), node.inputs[0])
    node.inputs[1].default_value, node.inputs[2].default_value = 0.65, 0.8
    return node.outputs[0]


def _color_by_height(builder: NodeBuilder, fraction: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return the color of a map for a fraction of the height range."""
    node = builder.node("ShaderNodeValToRGB", {"label": "Colors by Height"})
    elements = node.color_ramp.elements
    while len(elements) < len(MAP_COLORS):
        elements.new(1.0)
    for element, (position, color) in zip(elements, MAP_COLORS, strict=True):
        element.position, element.color = position, (*color, 1.0)
    builder.connect(fraction, node.inputs[0])
    return node.outputs[0]


class TextureMaterials:
    """The materials of the texture tiles of one store. Identified by custom properties, so that undo cannot make it wrong."""

    def __init__(self, identity: str) -> None:
        """identity: of the store and its content."""
        self._identity = identity

    def find(self, number: int) -> bpy.types.Material | None:
        """Return the material of a texture tile, None if there is none."""
        key = self._key(number)
        return next((item for item in bpy.data.materials if item.get(TEXTURE_KEY) == key and item.library is None), None)

    def ensure(self, number: int, name: str, tile: CodedTile) -> bpy.types.Material:
        """Return the material of a texture tile; create it, with packed images, if there is none. name: for a new material."""
        material = self.find(number)
        if material is None:
            key = self._key(number)
            color = _pack_image(name, tile.color, key)
            alpha = None if tile.alpha is None else _pack_image(f"{name} Alpha", tile.alpha, key, is_data=True)
            material = create_texture_material(name, color, alpha)
            material[TEXTURE_KEY] = key
        return material

    def _key(self, number: int) -> str:
        return f"{self._identity}#{number}"


def _last_use(material: bpy.types.Material) -> int:
    """Return the number of the last use of a material; 0 if the custom property is missing or has another value."""
    number = material.get(USED_KEY)
    return number if isinstance(number, int) and 0 <= number < MAX_USES else 0


def mark_used(materials: list[bpy.types.Material]) -> None:
    """Take note that materials are shown now."""
    last = max((_last_use(item) for item in bpy.data.materials if TEXTURE_KEY in item), default=0)
    for material in materials:
        material[USED_KEY] = last + 1


def remove_unused(max_unused: int = MAX_UNUSED, max_removed: int = MAX_REMOVED) -> None:
    """Remove the materials of texture tiles, and their images, that have not been used for the longest time."""
    unused = [item for item in bpy.data.materials if TEXTURE_KEY in item and item.users == 0 and item.library is None]
    unused.sort(key=_last_use)
    removed = unused[: max(len(unused) - max_unused, 0)][:max_removed]
    keys = {str(item[TEXTURE_KEY]) for item in removed}
    bpy.data.batch_remove(removed)
    bpy.data.batch_remove(
        [item for item in bpy.data.images if str(item.get(TEXTURE_KEY)) in keys and item.users == 0 and item.library is None]
    )


def _pack_image(name: str, content: bytes, key: str, is_data: bool = False) -> bpy.types.Image:
    """Create an image of the bytes of an image file, which Blender stores as they are."""
    image = bpy.data.images.new(name, 1, 1, is_data=is_data)
    image.pack(data=content, data_len=len(content))
    image.source = "FILE"
    image.colorspace_settings.name = "Non-Color" if is_data else "sRGB"
    image.alpha_mode = "CHANNEL_PACKED"
    image[TEXTURE_KEY] = key
    return image
