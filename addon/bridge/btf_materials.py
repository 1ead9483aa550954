"""The shader that decodes a relightable cloud: ordinary nodes and images, so that it renders the same where Farfield is not installed.

A texel's colour from a view under a light is the sum over the components of its weight times the basis at that view and light. The basis
lies in one image: tiles of lights, bordered so that the texture unit can interpolate them; one tile for every view, bordered as well; one
block of these for every component. Four taps find the views around, the texture unit the lights. With local components, texels are in
clusters, and the blocks of each cluster are a column of that image.
"""

from dataclasses import dataclass

import bpy

from ..compat import give_nodes
from ..core.btf.lobes import Grazing
from ..core.btf.tables import Tables
from .cloud_materials import set_two_sided
from .lobe_nodes import TexelLobes, add_dome, add_lobes, facing_normal
from .node_groups import new_group
from .relief_nodes import seen_place
from .shadow_nodes import shadow_finder
from .table_nodes import (
    BLACK,
    in_column,
    in_views,
    paired,
    pairs,
    place_node,
    scalars,
    sum_of_numbers,
    texture,
    weight_sockets,
    weight_textures,
    weighted_sum,
)
from .wiring import Operand, Wiring

SUNS = 4
ALONG = 0.99  # cosine from which on a ray of shadow counts as one to a sun, whose disc has some width
AMBIENT = "farfield_ambient"  # on the level object: colour of the dome
LAYOUT = "farfield_btf"  # on the material: the numbers of `core.btf.tables.Tables` that tell what its images hold, and a version
VERSION = 2  # of what stands where in the images
GRAZING = "farfield_grazing"  # on the material: strength and power of the rim under a dome
# Labels of image nodes; of weights there are several, numbered from 0.
WEIGHTS, TINTS, GLOW, BASIS, DOME = "Weights", "Tints", "Glow", "Basis", "Dome"
LAYOUT_NUMBERS = (
    *("views", "views_upper", "lights", "lights_upper", "clusters", "components", "alpha_components"),
    *("shadows", "shadows_upper", "shadow_components"),
)
CLUSTERS = "Clusters"
DIFFUSE, SPECULAR, NORMALS = "Diffuse", "Specular", "Normals"
ALPHA_WEIGHTS, ALPHA_BASIS, PLAIN = "Alpha Weights", "Alpha Basis", "Plain"


def sun_property(number: int) -> str:
    """The custom property that holds the direction towards sun `number`, in world space."""
    return f"farfield_sun_{number}"


def light_property(number: int) -> str:
    """The custom property that holds colour times strength of sun `number`."""
    return f"farfield_light_{number}"


def sun_labels(number: int) -> tuple[str, str, str]:
    """The labels of the nodes that decode sun `number`, add its lobes, and find its shadow."""
    return f"Sun {number + 1}", f"Sun {number + 1} Lobes", f"Sun {number + 1} Shadow"


@dataclass(frozen=True)
class BtfImages:
    """weights, alpha_weights: images of blocks, four components each. tints: what the colours are multiplied by, and the openness of lobes.
    glow: what shines by itself.

    clusters: the number of each texel's cluster, in all channels; None where all have the same components.

    basis, dome, alpha_basis: tables, see `core.btf.tables`.
    plain: the plain colour map, whose alpha the components of alpha come on top of; None where there is none.
    diffuse, specular: colours of the lobes, with roughness and rim as alpha; normals: the plain normal map. None where there are no lobes.
    relief: the plain map with depths, by which normals are looked up from aslant; None where they are not.
    grazing: how they shine at the rim under a dome.
    shadow_weights: of blocks as well, and shadow_basis, a table; none where suns reach the lobes always.
    """

    weights: list[bpy.types.Image]
    clusters: bpy.types.Image | None
    tints: bpy.types.Image
    glow: bpy.types.Image | None
    basis: bpy.types.Image
    dome: bpy.types.Image
    alpha_weights: list[bpy.types.Image]
    alpha_basis: bpy.types.Image
    plain: bpy.types.Image | None
    diffuse: bpy.types.Image | None
    specular: bpy.types.Image | None
    normals: bpy.types.Image | None
    relief: bpy.types.Image | None
    grazing: Grazing
    shadow_weights: list[bpy.types.Image]
    shadow_basis: bpy.types.Image | None


def btf_material(name: str, images: BtfImages, tables: Tables, blend_texels: bool) -> bpy.types.Material:
    """A material that shines with what the suns and the dome of its object make of the cloud.

    blend_texels: texels in clusters are blended at random instead of not at all.
    """
    material = bpy.data.materials.new(name)
    material[LAYOUT] = {"version": VERSION, **{name: int(getattr(tables, name)) for name in LAYOUT_NUMBERS}}
    material[GRAZING] = [images.grazing.strength, images.grazing.power]
    set_two_sided(material)
    material.cycles.emission_sampling = "NONE"
    give_nodes(material)
    tree = material.node_tree
    tree.nodes.clear()
    wiring = Wiring(tree)
    suns = [wiring.of_object(sun_property(number)) for number in range(SUNS)]
    viewer = _towards_viewer(wiring, suns)
    view = place_node(wiring, tables.views_upper, viewer)
    column, texel, closest = None, None, images.clusters is not None
    if closest:
        texel = _texel_place(wiring, images.clusters, blend_texels)
        column = wiring.math("MULTIPLY", texture(wiring, images.clusters, CLUSTERS, texel, closest=True)[1], tables.column)
    weights = weight_textures(wiring, images.weights, WEIGHTS, images.tints.size[1], texel, closest)
    numbers = scalars(wiring, weights, tables.components)
    tint, openness = texture(wiring, images.tints, TINTS)
    lobes = _lobes_of(wiring, images, viewer)
    place = in_column(wiring, in_views(wiring, tables.dome, view), column)
    even = wiring.vector("MULTIPLY", weighted_sum(wiring, images.dome, DOME, place, tables.dome.step, numbers), tint)
    colour = wiring.vector(
        "MULTIPLY",
        _cut(wiring, even if lobes is None else add_dome(wiring, lobes, openness, images.grazing, even)),
        wiring.of_object(AMBIENT),
    )
    lamp = _lamp_group(name, tables, images.basis, len(weights), column is not None)
    find_shadow = shadow_finder(wiring, name, tables, images.shadow_weights, images.tints.size[1], images.shadow_basis)
    for number, sun in enumerate(suns):
        decoded, added, shadow = sun_labels(number)
        node = wiring.node("ShaderNodeGroup", {"node_tree": lamp, "label": decoded})
        operands = (view, sun, *pairs(weights), *([] if column is None else [column]))
        for operand, target in zip(operands, node.inputs, strict=True):
            wiring.connect(operand, target)
        shown = wiring.vector("MULTIPLY", node.outputs[0], tint)
        reached = 1.0 if find_shadow is None else find_shadow(sun, shadow)
        shown = shown if lobes is None else add_lobes(wiring, lobes, sun, reached, shown, added)
        colour = wiring.vector("ADD", colour, wiring.vector("MULTIPLY", _cut(wiring, shown), wiring.of_object(light_property(number))))
    if images.glow is not None:
        colour = wiring.vector("ADD", colour, texture(wiring, images.glow, GLOW)[0])
    alpha = _alpha(wiring, tables, images, view)
    emission, transparent, mixed = (
        wiring.node(kind) for kind in ("ShaderNodeEmission", "ShaderNodeBsdfTransparent", "ShaderNodeMixShader")
    )
    wiring.connect(colour, emission.inputs["Color"])
    wiring.connect(alpha, mixed.inputs[0])
    wiring.connect(transparent.outputs[0], mixed.inputs[1])
    wiring.connect(emission.outputs[0], mixed.inputs[2])
    wiring.connect(mixed.outputs[0], wiring.node("ShaderNodeOutputMaterial").inputs["Surface"])
    wiring.arrange()
    return material


def _cut(wiring: Wiring, colour: Operand) -> Operand:
    return wiring.vector("MAXIMUM", colour, BLACK)


def _lobes_of(wiring: Wiring, images: BtfImages, viewer: Operand) -> TexelLobes | None:
    """What the lobes of the texel are, where there are any."""
    if images.diffuse is None:
        return None
    diffuse, roughness = texture(wiring, images.diffuse, DIFFUSE)
    specular, rim = texture(wiring, images.specular, SPECULAR)
    place = None if images.relief is None else seen_place(wiring, images.relief, viewer)
    normal, facing = facing_normal(wiring, texture(wiring, images.normals, NORMALS, place)[0], viewer)
    return TexelLobes(viewer, normal, facing, roughness, diffuse, specular, rim)


def _towards_viewer(wiring: Wiring, suns: list[bpy.types.NodeSocket]) -> bpy.types.NodeSocket:
    """Where a texel is seen from, in world space; the lamp is the viewer of a shadow, so that it has the silhouette which the lamp sees.

    Cycles follows rays of shadow from what is shaded to the lamp: there what comes in points away from it. In EEVEE the lamp looks.
    """
    incoming = wiring.node("ShaderNodeNewGeometry").outputs["Incoming"]
    away = wiring.vector("SCALE", incoming, -1.0)
    nearest: Operand = -1.0
    for sun in suns:
        nearest = wiring.math("MAXIMUM", nearest, wiring.vector("DOT_PRODUCT", away, sun))
    of_shadow = wiring.node("ShaderNodeLightPath").outputs["Is Shadow Ray"]
    turned = wiring.math("MULTIPLY", wiring.math("GREATER_THAN", nearest, ALONG), of_shadow)
    return wiring.vector("SCALE", incoming, wiring.math("SUBTRACT", 1.0, wiring.math("MULTIPLY", turned, 2.0)))


def _texel_place(wiring: Wiring, image: bpy.types.Image, blend: bool) -> bpy.types.NodeSocket:
    """The place in the UV map, for textures that cannot be filtered. Blended, it is moved by up to half a pixel of `image` at random.

    The nearest pixel is then each of the four around as often as bilinear filtering would weigh it.
    """
    place = wiring.node("ShaderNodeUVMap").outputs[0]
    if not blend:
        return place
    moves = []
    for seed, size in enumerate(image.size):
        noise = wiring.node("ShaderNodeTexWhiteNoise", {"noise_dimensions": "4D"})
        wiring.connect(wiring.node("ShaderNodeNewGeometry").outputs["Position"], noise.inputs["Vector"])
        wiring.connect(float(seed), noise.inputs["W"])
        moves.append(wiring.math("DIVIDE", wiring.math("SUBTRACT", noise.outputs["Value"], 0.5), float(size)))
    return wiring.vector("ADD", place, wiring.combine(*moves, 0.0))


def _lamp_group(name: str, tables: Tables, basis: bpy.types.Image, weight_images: int, in_columns: bool) -> bpy.types.NodeTree:
    """What one sun makes of a texel, for a sun of unit irradiance. in_columns: it is told where the column of the texel's cluster is."""
    inputs = [("View", "Vector"), ("Sun", "Vector"), *weight_sockets(weight_images), *([("Column", "Float")] if in_columns else [])]
    group = new_group(f"{name} Sun", inputs, [("Colour", "Color")])
    wiring = Wiring(group)
    view, sun, *rest = list(wiring.node("NodeGroupInput").outputs)[:-1]  # the last is the empty one that makes new sockets
    column = rest.pop() if in_columns else None
    light = place_node(wiring, tables.lights_upper, sun)
    wiring.connect(_under_sun(wiring, tables, basis, paired(rest), view, light, column), wiring.node("NodeGroupOutput").inputs[0])
    wiring.arrange()
    return group


def _under_sun(
    wiring: Wiring,
    tables: Tables,
    image: bpy.types.Image,
    weights: list[tuple[Operand, Operand]],
    view: Operand,
    light: Operand,
    column: Operand | None,
) -> Operand:
    """The sum over the components of weight times basis, interpolated between the views and lights around."""
    numbers = scalars(wiring, weights, tables.components)
    cell = wiring.vector("ADD", wiring.vector("SCALE", view, float(tables.views)), (0.5, 0.5, 0.0))
    low = wiring.vector("FLOOR", cell)
    share_x, share_y, _ = wiring.separate(wiring.vector("SUBTRACT", cell, low))
    in_tile = in_column(wiring, wiring.vector("ADD", wiring.vector("MULTIPLY", light, tables.light_scale), tables.light_start), column)
    total: Operand = BLACK
    for right, up in ((0, 0), (1, 0), (0, 1), (1, 1)):
        factor = wiring.math(
            "MULTIPLY",
            share_x if right else wiring.math("SUBTRACT", 1.0, share_x),
            share_y if up else wiring.math("SUBTRACT", 1.0, share_y),
        )
        tile = wiring.vector("MULTIPLY", wiring.vector("ADD", low, (float(right), float(up), 0.0)), tables.tile_scale)
        part = weighted_sum(wiring, image, BASIS, wiring.vector("ADD", tile, in_tile), tables.step, numbers)
        total = wiring.add_scaled(total, factor, part)
    return total


def _alpha(wiring: Wiring, tables: Tables, images: BtfImages, view: Operand) -> Operand:
    """The silhouette from the view: a sum over its own components, 0..1."""
    weights = weight_textures(wiring, images.alpha_weights, ALPHA_WEIGHTS, images.tints.size[1])
    total = sum_of_numbers(wiring, images.alpha_basis, ALPHA_BASIS, tables.alpha, view, weights)
    plain = 0.0 if images.plain is None else texture(wiring, images.plain, PLAIN)[1]
    return wiring.math("ADD", total, plain, clamp=True)
