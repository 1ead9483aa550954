"""The relightable material: built-in nodes and images that decode a cloud's textures, so it renders the same without Farfield.

The radiance of a texel from a view under a light is the sum over the components of its weight times the basis at that view and light. The
basis is stored in one image. A tile holds all lights, padded so that the texture unit can interpolate them. There is one tile per view,
also padded, and one block of tiles per component. Four lookups interpolate the views, the texture unit interpolates the lights. With local
PCA, texels belong to clusters, and the blocks of each cluster form one column of the image.
"""

from dataclasses import dataclass

import bpy

from ....core.btf.reflectance.lobes import GrazingFresnel
from ....core.btf.tables import LookupTables
from ...billboards.cloud_materials import create_two_sided_material
from ...shading.node_builder import NodeBuilder, SocketOrValue
from ...shading.solid_view import show_image
from .nodes.lobe_nodes import TexelLobes, add_dome_response, add_sun_response, decode_facing_normal
from .nodes.parallax_nodes import parallax_uv
from .nodes.radiance_nodes import build_sun_group
from .nodes.shadow_nodes import build_visibility_lookup
from .nodes.table_nodes import (
    BLACK,
    call_group,
    flatten_pairs,
    map_uv,
    offset_to_cluster,
    sample_image,
    sample_weights,
    split_weights,
    view_table_uv,
    weighted_scalar_sum,
    weighted_sum,
)

SUNS = 4
MIN_SUN_COSINE = 0.99  # A shadow ray within this cosine of a Sun direction belongs to that Sun, whose disc has some width.
AMBIENT = "farfield_ambient"  # Custom property of the level object: radiance of uniform World lighting.
LAYOUT = "farfield_btf_layout"  # Custom property of the material: LAYOUT_KEYS of `core.btf.tables.LookupTables`, and a version.
VERSION = 2  # Version of the layout of the images.
DOME_FRESNEL = "farfield_dome_fresnel"  # Custom property of the material: strength and power of the Fresnel term under the dome.
LAYOUT_KEYS = (
    *("views_per_side", "views_upper", "lights_per_side", "lights_upper", "clusters", "components", "alpha_components"),
    *("shadows_per_side", "shadows_upper", "shadow_components"),
)
# Labels of image nodes; weights have several nodes, indexed from 0.
WEIGHTS, CHROMATICITY, EMISSION, DOME = "Weights", "Chromaticity", "Emission", "Dome"
CLUSTERS = "Clusters"
DIFFUSE, SPECULAR, NORMALS = "Diffuse", "Specular", "Normals"
ALPHA_WEIGHTS, ALPHA_BASIS, PBR_COLOR = "Alpha Weights", "Alpha Basis", "PBR Color"


def sun_direction_property(index: int) -> str:
    """Return the custom property for the world-space direction to Sun `index`."""
    return f"farfield_sun_direction_{index}"


def sun_color_property(index: int) -> str:
    """Return the custom property for color times strength of Sun `index`."""
    return f"farfield_sun_color_{index}"


def sun_node_labels(index: int) -> tuple[str, str, str]:
    """Return the labels of the nodes that decode Sun `index`, add its lobes, and look up its visibility."""
    return f"Sun {index + 1}", f"Sun {index + 1} Lobes", f"Sun {index + 1} Shadow"


@dataclass(frozen=True)
class BtfImages:
    """Images of a relightable material.

    Attributes:
        weights: Images of blocks with four components each.
        clusters: Cluster index of each texel, in all channels; None if all texels have the same components.
        chromaticity: Factor of the decoded radiance; its alpha is the sky visibility of the lobes.
        emission: Emitted radiance; None if nothing emits light.
        basis: Lookup table of the color components, see `core.btf.tables`.
        dome: The same under the dome.
        alpha_weights: Images of blocks with four components of alpha each.
        alpha_basis: Lookup table of the components of alpha.
        pbr_color: PBR base color map, to whose alpha the decoded alpha is added; None if there is none.
        diffuse: Albedo of the diffuse lobe, and roughness as alpha; None if there are no lobes.
        specular: F0 of the specular lobe, and F90 - F0 as alpha; None if there are no lobes.
        normals: PBR normal map; None if there are no lobes.
        depth: PBR map with depth in its third channel, for parallax mapping; None if there is none.
        dome_fresnel: Grazing reflectance under uniform World lighting.
        shadow_weights: Images of blocks; empty if Suns are always visible to the lobes.
        shadow_basis: Lookup table of the visibility of Suns; None if they are always visible.
    """

    weights: list[bpy.types.Image]
    clusters: bpy.types.Image | None
    chromaticity: bpy.types.Image
    emission: bpy.types.Image | None
    basis: bpy.types.Image
    dome: bpy.types.Image
    alpha_weights: list[bpy.types.Image]
    alpha_basis: bpy.types.Image
    pbr_color: bpy.types.Image | None
    diffuse: bpy.types.Image | None
    specular: bpy.types.Image | None
    normals: bpy.types.Image | None
    depth: bpy.types.Image | None
    dome_fresnel: GrazingFresnel
    shadow_weights: list[bpy.types.Image]
    shadow_basis: bpy.types.Image | None


@dataclass(frozen=True)
class _TexelInputs:
    """Sockets that all lights share.

    Attributes:
        view: UV of the view on its octahedral map.
        weights: Pairs of color and alpha, per block.
        cluster_offset: Offset to the column of the cluster; None without clusters.
        chromaticity: Factor of the decoded radiance.
        lobes: Lobes of the texel; None if there are none.
    """

    view: SocketOrValue
    weights: list[tuple[SocketOrValue, SocketOrValue]]
    cluster_offset: SocketOrValue | None
    chromaticity: SocketOrValue
    lobes: TexelLobes | None


def build_relightable_material(name: str, images: BtfImages, tables: LookupTables, blend_texels: bool) -> bpy.types.Material:
    """Create a material that emits the radiance of the cloud under the Suns and the uniform World lighting of its object.

    blend_texels: blend clustered texels randomly per sample instead of not at all.
    """
    material, builder = create_two_sided_material(name)
    material[LAYOUT] = {"version": VERSION, **{name: int(getattr(tables, name)) for name in LAYOUT_KEYS}}
    material[DOME_FRESNEL] = [images.dome_fresnel.strength, images.dome_fresnel.power]
    material.cycles.emission_sampling = "NONE"
    suns = [builder.object_attribute(sun_direction_property(index)) for index in range(SUNS)]
    viewer = _viewer_direction(builder, suns)
    view = map_uv(builder, tables.views_upper, viewer)
    cluster_offset, texel_uv, is_clustered = None, None, images.clusters is not None
    if is_clustered:
        texel_uv = _texel_uv(builder, images.clusters, blend_texels)
        cluster = sample_image(builder, images.clusters, CLUSTERS, texel_uv, closest=True)[1]
        cluster_offset = builder.math("MULTIPLY", cluster, tables.cluster_step)
    weights = sample_weights(builder, images.weights, WEIGHTS, images.chromaticity.size[1], texel_uv, is_clustered)
    scalar_weights = split_weights(builder, weights, tables.components)
    chromaticity, sky_visibility = sample_image(builder, images.chromaticity, CHROMATICITY)
    texel = _TexelInputs(view, weights, cluster_offset, chromaticity, _texel_lobes(builder, images, viewer))
    color = _add_dome(builder, images, tables, texel, scalar_weights, sky_visibility)
    color = _add_suns(builder, name, images, tables, texel, suns, color)
    if images.emission is not None:
        color = builder.vector("ADD", color, sample_image(builder, images.emission, EMISSION)[0])
    _add_output(builder, color, _decode_alpha(builder, tables, images, view))
    builder.arrange()
    show_image(material, images.pbr_color)
    return material


def _add_dome(
    builder: NodeBuilder,
    images: BtfImages,
    tables: LookupTables,
    texel: _TexelInputs,
    scalar_weights: list[SocketOrValue],
    sky_visibility: SocketOrValue,
) -> SocketOrValue:
    """Return the radiance under the uniform World lighting of the object."""
    uv = offset_to_cluster(builder, view_table_uv(builder, tables.dome, texel.view), texel.cluster_offset)
    decoded = weighted_sum(builder, images.dome, DOME, uv, tables.dome.component_step, scalar_weights)
    radiance = builder.vector("MULTIPLY", decoded, texel.chromaticity)
    if texel.lobes is not None:
        radiance = add_dome_response(builder, texel.lobes, sky_visibility, images.dome_fresnel, radiance)
    return builder.vector("MULTIPLY", _clamp_negative(builder, radiance), builder.object_attribute(AMBIENT))


def _add_suns(
    builder: NodeBuilder,
    name: str,
    images: BtfImages,
    tables: LookupTables,
    texel: _TexelInputs,
    suns: list[bpy.types.NodeSocket],
    color: SocketOrValue,
) -> SocketOrValue:
    """Return `color` plus the radiance under all Suns."""
    sun_group = build_sun_group(name, tables, images.basis, len(texel.weights), texel.cluster_offset is not None)
    add_visibility = build_visibility_lookup(builder, name, tables, images.shadow_weights, images.chromaticity.size[1], images.shadow_basis)
    for index, sun in enumerate(suns):
        sun_label, lobes_label, shadow_label = sun_node_labels(index)
        operands = (texel.view, sun, *flatten_pairs(texel.weights), *([] if texel.cluster_offset is None else [texel.cluster_offset]))
        radiance = builder.vector("MULTIPLY", call_group(builder, sun_group, operands, sun_label), texel.chromaticity)
        visibility = 1.0 if add_visibility is None else add_visibility(sun, shadow_label)
        if texel.lobes is not None:
            radiance = add_sun_response(builder, texel.lobes, sun, visibility, radiance, lobes_label)
        clamped = _clamp_negative(builder, radiance)
        radiance = builder.vector("MULTIPLY", clamped, builder.object_attribute(sun_color_property(index)))
        color = builder.vector("ADD", color, radiance)
    return color


def _add_output(builder: NodeBuilder, color: SocketOrValue, alpha: SocketOrValue) -> None:
    emission, transparent, mix = (
        builder.node(node_type) for node_type in ("ShaderNodeEmission", "ShaderNodeBsdfTransparent", "ShaderNodeMixShader")
    )
    builder.connect(color, emission.inputs["Color"])
    builder.connect(alpha, mix.inputs[0])
    builder.connect(transparent.outputs[0], mix.inputs[1])
    builder.connect(emission.outputs[0], mix.inputs[2])
    builder.connect(mix.outputs[0], builder.node("ShaderNodeOutputMaterial").inputs["Surface"])


def _clamp_negative(builder: NodeBuilder, color: SocketOrValue) -> SocketOrValue:
    return builder.vector("MAXIMUM", color, BLACK)


def _texel_lobes(builder: NodeBuilder, images: BtfImages, viewer: SocketOrValue) -> TexelLobes | None:
    """Return the lobes of the texel, or None if there are none."""
    if images.diffuse is None:
        return None
    diffuse, roughness = sample_image(builder, images.diffuse, DIFFUSE)
    f0, f90_minus_f0 = sample_image(builder, images.specular, SPECULAR)
    uv = None if images.depth is None else parallax_uv(builder, images.depth, viewer)
    normal, cosine = decode_facing_normal(builder, sample_image(builder, images.normals, NORMALS, uv)[0], viewer)
    return TexelLobes(viewer, normal, cosine, roughness, diffuse, f0, f90_minus_f0)


def _viewer_direction(builder: NodeBuilder, suns: list[bpy.types.NodeSocket]) -> bpy.types.NodeSocket:
    """Return the world-space direction to the viewer. For shadow rays the viewer is the light: shadows have the silhouette seen from there.

    Cycles traces shadow rays from the shaded point to the light: there, Incoming points away from the light. EEVEE renders from the light.
    """
    incoming = builder.node("ShaderNodeNewGeometry").outputs["Incoming"]
    outgoing = builder.vector("SCALE", incoming, -1.0)
    max_cosine: SocketOrValue = -1.0
    for sun in suns:
        max_cosine = builder.math("MAXIMUM", max_cosine, builder.vector("DOT_PRODUCT", outgoing, sun))
    is_shadow_ray = builder.node("ShaderNodeLightPath").outputs["Is Shadow Ray"]
    is_flipped = builder.math("MULTIPLY", builder.math("GREATER_THAN", max_cosine, MIN_SUN_COSINE), is_shadow_ray)
    return builder.vector("SCALE", incoming, builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", is_flipped, 2.0)))


def _texel_uv(builder: NodeBuilder, image: bpy.types.Image, blend: bool) -> bpy.types.NodeSocket:
    """Return the UV for textures that cannot be filtered. blend: move it randomly by up to half a pixel of `image`.

    The nearest pixel is then each of the four neighbors with the probability that equals its bilinear weight.
    """
    uv = builder.node("ShaderNodeUVMap").outputs[0]
    if not blend:
        return uv
    offsets = []
    for seed, size in enumerate(image.size):
        noise = builder.node("ShaderNodeTexWhiteNoise", {"noise_dimensions": "4D"})
        builder.connect(builder.node("ShaderNodeNewGeometry").outputs["Position"], noise.inputs["Vector"])
        builder.connect(float(seed), noise.inputs["W"])
        offsets.append(builder.math("DIVIDE", builder.math("SUBTRACT", noise.outputs["Value"], 0.5), float(size)))
    return builder.vector("ADD", uv, builder.combine(*offsets, 0.0))


def _decode_alpha(builder: NodeBuilder, tables: LookupTables, images: BtfImages, view: SocketOrValue) -> SocketOrValue:
    """Return the alpha, 0..1, of the silhouette from the view: the sum over its components plus the alpha of the PBR map."""
    weights = sample_weights(builder, images.alpha_weights, ALPHA_WEIGHTS, images.chromaticity.size[1])
    total = weighted_scalar_sum(builder, images.alpha_basis, ALPHA_BASIS, tables.alpha, view, weights)
    pbr_alpha = 0.0 if images.pbr_color is None else sample_image(builder, images.pbr_color, PBR_COLOR)[1]
    return builder.math("ADD", total, pbr_alpha, clamp=True)
