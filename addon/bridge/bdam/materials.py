"""Materials of large terrain: images of the ground, colors by slope, height or level of detail. All are shader nodes of Blender.

The material of a tile with a texture or a normal map has packed images, as coded in the store, and is kept for a while after its last use.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import bpy

from ...core.bdam.settings import ViewSettings
from ...core.bdam.store.curvature import EARTH_RADIUS
from ...core.bdam.view.engine import BdamEngine
from ...core.bdam.view.tile_maps import ShownMap, ShownMaps
from ..shading.ground import DEFAULTS, add_ground
from ..shading.node_builder import NodeBuilder, create_group, create_node_material, ensure_shared_group
from ..shading.solid_view import show_color, show_image
from ..sky import SHARED_SURFACE

GROUND_VERSION = 2
NORMAL_GROUP, NORMAL_VERSION, MIN_SQUARE = "Farfield Terrain Normal", 2, 1e-4
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
TEXTURE_KEY = "farfield_bdam_texture"  # custom property of materials and images: the store, and the number of the square or the tile
MAX_USES = 2**31 - 2  # The custom property stores larger numbers as floats.
USED_KEY = "farfield_bdam_used"  # custom property of materials: counts up with every use
MAX_UNUSED = 64  # materials of texture tiles that are kept without users
MAX_REMOVED = 8  # unused materials that are removed at a time


@dataclass(frozen=True)
class ImagePart:
    """The part of an image that a tile shows. scale, offset: see `ShownMap`."""

    image: bpy.types.Image
    scale: float = 1.0
    offset: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class TileImages:
    """The images of a tile, None where there is none. alpha: None if the color image contains it."""

    color: ImagePart | None
    alpha: ImagePart | None
    normal: ImagePart | None


def create_material(
    name: str, shading: str, root: bpy.types.Object, heights: tuple[float, float], cell_size: float, curvature: float = 0.0
) -> bpy.types.Material:
    """Create the material of a terrain below `root` for a shading other than "texture": "slope", "height" or "level".

    Its surface is a node group of its own, which the materials of tiles with normal maps share.

    heights: lowest and highest height above the root, with exaggeration. cell_size: distance between samples. curvature: the
    exaggeration where the curvature of the Earth lowers the ground, which colors by height do not count; 0 where it does not.
    """
    material, builder = create_node_material(name)
    material[MATERIAL_KEY] = shading
    show_color(material, MAP_COLORS[1][1] if shading == "height" else DEFAULTS["Grass"])
    surface = create_group(f"{SHARED_SURFACE}: {name}", (("Position", "Vector"), ("Normal", "Vector")), (("Shader", "Shader"),))
    inside = NodeBuilder(surface)
    inputs = inside.node("NodeGroupInput").outputs
    position = _raise(inside, inputs["Position"], curvature / (2.0 * EARTH_RADIUS)) if curvature else inputs["Position"]
    shader = _fill_surface(inside, shading, position, inputs["Normal"], heights, cell_size)
    inside.connect(shader, inside.node("NodeGroupOutput").inputs["Shader"])
    inside.arrange()
    _finish(builder, _place_surface(builder, surface, root, builder.node("ShaderNodeNewGeometry").outputs["Normal"]))
    return material


def _fill_surface(
    builder: NodeBuilder,
    shading: str,
    position: bpy.types.NodeSocket,
    normal: bpy.types.NodeSocket,
    heights: tuple[float, float],
    cell_size: float,
) -> bpy.types.NodeSocket:
    """Return the shader of the surface of a terrain; see `create_material`."""
    if shading == "level":
        return _shade(builder, _color_by_level(builder), None, normal)
    span = max(heights[1] - heights[0], 1e-6)
    if shading == "slope":
        levels = {"Rock Slope": ROCK_NORMAL, "Snow Height": heights[0] + SNOW_HEIGHT * span, "Sand Height": heights[0] - span}
        levels["Middle Height"] = heights[0] + 0.5 * span
        values = {"Size": 0.5 * span, "Bump Size": BUMP_SIZE * cell_size, "Distant Bumps": 0.0, **levels}
        return add_ground(builder, position, normal, values)
    fraction = builder.math("DIVIDE", builder.math("SUBTRACT", builder.separate(position)[2], heights[0]), span)
    fraction.node.label = "Height"
    return _shade(builder, _color_by_height(builder, fraction), None, normal)


def _raise(builder: NodeBuilder, position: bpy.types.NodeSocket, factor: float) -> bpy.types.NodeSocket:
    """Return a position whose height is larger by the square of the distance from the center times a factor."""
    level = builder.vector("MULTIPLY", position, (1.0, 1.0, 0.0))
    squared = builder.vector("DOT_PRODUCT", level, level)
    squared.node.label = "Curvature"
    return builder.vector("ADD", position, builder.combine(0.0, 0.0, builder.math("MULTIPLY", squared, factor)))


def create_tile_material(
    name: str, maps: TileImages, settings: ViewSettings, surface: bpy.types.NodeTree | None, root: bpy.types.Object
) -> bpy.types.Material:
    """Create the material of one tile with a texture, a normal map, or both.

    settings: how the terrain is shown, whose exaggeration and curvature count for normals. surface: of tiles without a texture, see
    `create_material`. root: of their terrain.
    """
    material, builder = create_node_material(name)
    if maps.normal is None:
        normal = builder.node("ShaderNodeNewGeometry").outputs["Normal"]
    else:
        group = builder.node("ShaderNodeGroup", {"node_tree": _ensure_normal_group(), "width": 200.0})
        builder.connect(_add_image(builder, maps.normal, "Normals").outputs["Color"], group.inputs["Color"])
        group.inputs["Exaggeration"].default_value = settings.exaggeration
        if settings.curvature:
            position = builder.node("ShaderNodeTexCoord", {"object": root}).outputs["Object"]
            builder.connect(builder.vector("SCALE", position, 1.0 / EARTH_RADIUS), group.inputs["Tilt"])
        normal = group.outputs["Normal"]
    if maps.color is None:
        _finish(builder, _place_surface(builder, surface, root, normal))
        show_color(material, DEFAULTS["Grass"])
        return material
    image = _add_image(builder, maps.color, "Texture")
    color = maps.color.image
    opacity = image.outputs["Alpha"] if color.channels == 4 and color.depth == 32 else None
    if maps.alpha is not None:
        opacity = _add_image(builder, maps.alpha, "Alpha").outputs["Color"]
    _finish(builder, _shade(builder, image.outputs["Color"], opacity, normal))
    show_image(material, color)
    return material


def find_surface(material: bpy.types.Material | None) -> bpy.types.NodeTree | None:
    """Return the node group with the surface of a material of `create_material`, None if the user has removed it."""
    nodes = material.node_tree.nodes if material is not None and material.node_tree is not None else ()
    groups = (node.node_tree for node in nodes if node.type == "GROUP" and node.node_tree is not None)
    return next((tree for tree in groups if {"Position", "Normal"} <= {item.name for item in tree.interface.items_tree}), None)


def _add_image(builder: NodeBuilder, part: ImagePart, label: str) -> bpy.types.Node:
    """Add a part of an image."""
    node = builder.node("ShaderNodeTexImage", {"image": part.image, "extension": "EXTEND", "label": label})
    if part.scale != 1.0:
        place = builder.node("ShaderNodeMapping", {"vector_type": "POINT"})
        place.inputs["Scale"].default_value, place.inputs["Location"].default_value = (part.scale,) * 3, (*part.offset, 0.0)
        builder.connect(builder.node("ShaderNodeTexCoord").outputs["UV"], place.inputs["Vector"])
        builder.connect(place.outputs[0], node.inputs["Vector"])
    return node


def _place_surface(
    builder: NodeBuilder, surface: bpy.types.NodeTree, root: bpy.types.Object, normal: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    """Return the shader of the surface of a terrain."""
    group = builder.node("ShaderNodeGroup", {"node_tree": surface, "width": 200.0})
    builder.connect(builder.node("ShaderNodeTexCoord", {"object": root}).outputs["Object"], group.inputs["Position"])
    builder.connect(normal, group.inputs["Normal"])
    return group.outputs["Shader"]


def _shade(
    builder: NodeBuilder, color: bpy.types.NodeSocket, opacity: bpy.types.NodeSocket | None, normal: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    """Return the shader of a color with an opacity, if there is one."""
    group = builder.node("ShaderNodeGroup", {"node_tree": _ensure_ground_group(), "width": 200.0})
    group.inputs["Alpha"].default_value, group.inputs["Roughness"].default_value = 1.0, ROUGHNESS
    builder.connect(color, group.inputs["Color"])
    builder.connect(normal, group.inputs["Normal"])
    if opacity is not None:
        builder.connect(opacity, group.inputs["Alpha"])
    return group.outputs["Shader"]


def _finish(builder: NodeBuilder, shader: bpy.types.NodeSocket) -> None:
    """Connect a shader to the surface."""
    builder.connect(shader, builder.node("ShaderNodeOutputMaterial").inputs["Surface"])
    builder.arrange()


def _ensure_ground_group() -> bpy.types.NodeTree:
    """Return the group from color to surface that all materials of terrains share."""
    inputs = (("Color", "Color"), ("Alpha", "Float"), ("Roughness", "Float"), ("Normal", "Vector"))
    return ensure_shared_group(SHARED_SURFACE, GROUND_VERSION, inputs, (("Shader", "Shader"),), _fill_ground_group)


def _fill_ground_group(builder: NodeBuilder) -> None:
    inputs = builder.node("NodeGroupInput").outputs
    principled = builder.node("ShaderNodeBsdfPrincipled")
    builder.connect(inputs["Color"], principled.inputs["Base Color"])
    for name in ("Alpha", "Roughness", "Normal"):
        builder.connect(inputs[name], principled.inputs[name])
    principled.inputs["Specular IOR Level"].default_value = 0.2
    builder.connect(principled.outputs[0], builder.node("NodeGroupOutput").inputs["Shader"])


def _ensure_normal_group() -> bpy.types.NodeTree:
    """Return the group from colors of normal maps, see `sample_normals`, to normals in world space."""
    inputs = (("Color", "Color"), ("Exaggeration", "Float"), ("Tilt", "Vector"))
    return ensure_shared_group(NORMAL_GROUP, NORMAL_VERSION, inputs, (("Normal", "Vector"),), _fill_normal_group)


def _fill_normal_group(builder: NodeBuilder) -> None:
    inputs = builder.node("NodeGroupInput").outputs
    red, green, _ = builder.separate_color(inputs["Color"])
    x, y = (builder.math("SUBTRACT", builder.math("MULTIPLY", value, 2.0), 1.0) for value in (red, green))
    flat = builder.math("ADD", builder.math("MULTIPLY", x, x), builder.math("MULTIPLY", y, y))
    z = builder.math("SQRT", builder.math("MAXIMUM", builder.math("SUBTRACT", 1.0, flat), MIN_SQUARE))
    tilts = builder.separate(inputs["Tilt"])  # by the curvature of the Earth
    x, y = (builder.math("ADD", value, builder.math("MULTIPLY", z, tilt)) for value, tilt in zip((x, y), tilts[:2], strict=True))
    local = builder.combine(x, y, builder.math("DIVIDE", z, inputs["Exaggeration"]))
    normal = builder.vector("NORMALIZE", builder.vector_transform(local, "NORMAL", "OBJECT", "WORLD"))
    builder.connect(normal, builder.node("NodeGroupOutput").inputs["Normal"])


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


class TileMaterials:
    """The materials of the tiles with maps of one terrain. Identified by custom properties, so that undo cannot make it wrong."""

    def __init__(self, engine: BdamEngine, root_name: str) -> None:
        """engine: of the store. root_name: of the terrain."""
        self._store, self._settings = engine.identity, engine.settings
        shown = f"{self._settings.shading}|{self._settings.exaggeration:g}|{self._settings.curvature:d}"
        self._identity = f"{engine.identity}|{root_name}|{shown}"

    def find_all(self, numbers: Iterable[int]) -> dict[int, bpy.types.Material]:
        """Return the materials of the squares `numbers`, as far as there are any."""
        known = {str(item[TEXTURE_KEY]): item for item in bpy.data.materials if TEXTURE_KEY in item and item.library is None}
        keys = {number: self._key(number) for number in numbers}
        return {number: known[key] for number, key in keys.items() if key in known}

    def create(self, number: int, name: str, shown: ShownMaps, material: bpy.types.Material, root: bpy.types.Object) -> None:
        """Create the material of the square `number`, with packed images, if it has maps.

        name: for a new material. material: of tiles of the terrain `root` without maps.
        """
        surface = find_surface(material)
        if shown.color is None and (shown.normal is None or surface is None):
            return
        parts = {"color": shown.color, "alpha": shown.color, "normal": shown.normal}
        images = TileImages(**{kind: self._ensure_image(name, kind, part) for kind, part in parts.items()})
        created = create_tile_material(f"{name} {shown.label}", images, self._settings, surface, root)
        created[TEXTURE_KEY] = self._key(number)

    def _ensure_image(self, name: str, kind: str, shown: ShownMap | None) -> ImagePart | None:
        """Return the image of a map; create it if there is none."""
        content = None if shown is None else shown.coded.alpha if kind == "alpha" else shown.coded.color
        if content is None:
            return None
        key = f"{self._store}|{kind}#{shown.number}"
        image = next((item for item in bpy.data.images if item.get(TEXTURE_KEY) == key and item.library is None), None)
        image = image or _pack_image(f"{name} {kind.title()} {shown.number}", content, key, is_data=kind == "alpha")
        return ImagePart(image, shown.scale, shown.offset)

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
    bpy.data.batch_remove(unused[: max(len(unused) - max_unused, 0)][:max_removed])
    bpy.data.batch_remove([item for item in bpy.data.images if TEXTURE_KEY in item and item.users == 0 and item.library is None])


def _pack_image(name: str, content: bytes, key: str, is_data: bool = False) -> bpy.types.Image:
    """Create an image of the bytes of an image file, which Blender stores as they are."""
    image = bpy.data.images.new(name, 1, 1, is_data=is_data)
    image.pack(data=content, data_len=len(content))
    image.source = "FILE"
    image.colorspace_settings.name = "Non-Color" if is_data else "sRGB"
    image.alpha_mode = "CHANNEL_PACKED"
    image[TEXTURE_KEY] = key
    return image
