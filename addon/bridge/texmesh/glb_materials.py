"""Copies of materials with nodes that Blender's glTF exporter reads.

The exporter follows few nodes: a Principled BSDF, images with one Mapping, and products with constants and one color attribute. All other
trees that mean the same are rewritten as such. What glTF cannot store is named.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...compat import enable_nodes, uses_nodes
from .. import lod_crossfade
from ..shading.color_products import CHANNELS, ONES, ColorProduct, read_product, read_source_product
from ..shading.material_channels import BSDFS, DEFAULT_BSDF
from ..shading.node_builder import NodeBuilder, SocketOrValue
from ..shading.socket_sources import ScopedSocket, find_source
from ..shading.surface_reader import MaterialSurface, choose_textures, find_output, read_surface
from ..shading.texture_uses import TextureUse
from .glb_images import GlbImages

COLORS = "farfield_glb_colors"  # The color attribute of exported meshes.
EXTENSIONS = {"repeat": "REPEAT", "mirror": "MIRROR", "clamp": "EXTEND"}
IGNORED = {"Weight", "Subsurface Radius", "Thin Wall"}  # inputs of a Principled BSDF that the exporter never reads
MAX_SHEAR = 1e-5  # Relative to the scale of a placement; below, it is rounding.
BLACK = (0.0, 0.0, 0.0)
# Inputs that a network of nodes may determine which only the exporter knows, and the extension that it then writes.
NETWORKS = {
    "Anisotropic": "KHR_materials_anisotropy",
    "Anisotropic Rotation": "KHR_materials_anisotropy",
    "Tangent": "KHR_materials_anisotropy",
    "Thin Film Thickness": "KHR_materials_iridescence",
    "Thin Film IOR": "KHR_materials_iridescence",
}
# Inputs that change the look above 0, and the extension that stores them if any version of the exporter does.
WEIGHTS = {"Subsurface Weight": "", "Diffuse Roughness": "", "Thin Film Thickness": "KHR_materials_iridescence"}
LAMBERTIAN = {"BSDF_DIFFUSE", "BSDF_TRANSLUCENT", "SUBSURFACE_SCATTERING", "BSDF_TOON"}  # without reflections
REFRACTIVE = {"BSDF_GLASS", "BSDF_REFRACTION"}
STORED_SHADERS = {"BSDF_PRINCIPLED", "BSDF_DIFFUSE", "BSDF_GLOSSY", "BSDF_METALLIC", "EMISSION", *REFRACTIVE}
Value = str | float | tuple[float, float, float]  # the name of an input, or a constant


@dataclass(frozen=True)
class VertexColors:
    """Names and outputs of color attributes that the base color and the opacity of a material are multiplied with."""

    colors: tuple[tuple[str, str], ...] = ()
    alphas: tuple[tuple[str, str], ...] = ()

    @property
    def is_used(self) -> bool:
        """Whether there are any."""
        return bool(self.colors or self.alphas)


@dataclass(eq=False)
class GlbMaterial:
    """A material for Blender's exporter.

    Attributes:
        copy: the material that is exported.
        vertex_colors: what meshes need as their color attribute COLORS.
        cuts: placements (2, 3) of images that show nothing beyond their sides, by UV map.
        lacking: labels of what the copy lacks.
        extended: labels of what the file has only if the exporter writes an extension for it, by label.
        is_unlit: whether it is shown without light.
    """

    copy: bpy.types.Material
    vertex_colors: VertexColors = VertexColors()
    cuts: list[tuple[str, np.ndarray]] = field(default_factory=list)
    lacking: list[str] = field(default_factory=list)
    extended: dict[str, str] = field(default_factory=dict)
    is_unlit: bool = False


def rewrite_for_glb(result: GlbMaterial, images: GlbImages) -> None:
    """Rewrite a copy of a material so that Blender's exporter stores it as far as glTF can.

    Raises:
        FileError: an image of its color or opacity is missing or cannot be read.
    """
    _Writer(result, images).write()


class _Writer:
    """Rewrites the nodes of a copy of a material."""

    def __init__(self, result: GlbMaterial, images: GlbImages) -> None:
        self.result, self.images, copy = result, images, result.copy
        self.surface = read_surface(copy)
        if not uses_nodes(copy) or copy.node_tree is None:
            enable_nodes(copy)
            copy.node_tree.nodes.clear()
            self.constants = {"Base Color": self.surface.color.factor, "Roughness": copy.roughness, "Metallic": copy.metallic}
        else:
            self.constants = {}
            lod_crossfade.remove_from_material(copy)
        self.builder = NodeBuilder(copy.node_tree)

    def write(self) -> None:
        """Replace the surface by a new Principled BSDF with the same look."""
        surface, result = self.surface, self.result
        output = find_output(self.builder.tree)
        result.lacking += surface.mixed
        if surface.shader is None and not self.constants:
            return
        shader = self.builder.node("ShaderNodeBsdfPrincipled")
        result.is_unlit = surface.is_shadeless
        for name, value in (self.constants or _list_values(surface)).items():
            target = shader.inputs.get(name)
            if target is None:  # such as what only another method for subsurface scattering has
                continue
            if isinstance(value, str):
                self.transfer(ScopedSocket(surface.shader.inputs[value], surface.groups), target)
            else:
                self.builder.connect(value, target)
        if surface.shader is not None:
            self.write_color_and_alpha(shader)
            self.write_emission(shader)
            weight, color = shader.inputs["Sheen Weight"], shader.inputs["Sheen Tint"]
            if weight.default_value > 0.0 and not (weight.links or color.links):  # the exporter ignores the weight
                color.default_value = [weight.default_value * value for value in color.default_value[:3]] + [1.0]
            self.name_losses(shader, output)
        for other in [node for node in self.builder.tree.nodes if node.type == "OUTPUT_MATERIAL" and node != output]:
            self.builder.tree.nodes.remove(other)
        output = output or self.builder.node("ShaderNodeOutputMaterial")
        output.target, output.is_active_output = "ALL", True
        self.builder.connect(shader.outputs[0], output.inputs["Surface"])
        self.check_occlusion()
        result.lacking[:] = dict.fromkeys(result.lacking)

    def transfer(self, source: ScopedSocket, target: bpy.types.NodeSocket) -> None:
        """Let an input of the new shader have the value of an input of the old one."""
        found = find_source(source)
        if target.name in NETWORKS and not found.is_constant and not source.groups:
            self.builder.tree.links.new(source.socket.links[0].from_socket, target)
            self.result.extended[target.name] = NETWORKS[target.name]
        elif target.type == "VECTOR":
            self.transfer_normal(found, target)
        elif target.name not in ("Base Color", "Alpha"):
            product = read_source_product(found)
            if product.attributes or (product.unread and not product.textures):
                self.result.lacking.append(target.name if product.attributes else product.unread[0])
                return
            use, _, unread = choose_textures(product, ColorProduct())
            if target.name == "Emission Strength" and use is not None:
                use, unread = None, (*unread, target.name)
            self.result.lacking += unread
            if self.is_there(use):
                self.write_product(product.factor, use, target)

    def transfer_normal(self, source: ScopedSocket, target: bpy.types.NodeSocket) -> None:
        """Let the new shader have a normal map of the old one."""
        lacking = self.result.lacking
        while not source.is_constant and source.node.type == "BUMP":
            lacking.append(source.node.label or source.node.bl_label)
            source = source.input("Normal")
        if source.is_constant:
            return
        is_map = source.node.type == "NORMAL_MAP" and source.node.space == "TANGENT"
        color = read_product(source.node.inputs["Color"], source.groups) if is_map else ColorProduct()
        use, _, unread = choose_textures(color, ColorProduct())
        lacking += [*unread, *([target.name] if use is None else [])]
        if use is not None and self.is_there(use):
            strength = read_product(source.node.inputs["Strength"], source.groups)
            lacking += [] if strength.is_constant else ["Strength"]
            normal_map = self.builder.node("ShaderNodeNormalMap")
            self.builder.connect(strength.factor[0], normal_map.inputs["Strength"])
            self.write_product(ONES, use, normal_map.inputs["Color"])
            self.builder.connect(normal_map.outputs[0], target)

    def write_color_and_alpha(self, shader: bpy.types.Node) -> None:
        """Write the inputs Base Color and Alpha, which one image stores, with the colors of vertices."""
        surface, name = self.surface, _list_values(self.surface).get("Base Color")
        is_read = isinstance(name, str)
        color = read_product(surface.shader.inputs[name], surface.groups) if is_read else ColorProduct(name or ONES)
        alpha = surface.alpha
        shown = tuple(use for use in alpha.textures if use.channel != "Alpha" or use.image.alpha_mode != "NONE")
        alpha = ColorProduct(alpha.factor, shown, alpha.attributes, alpha.unread)
        use, opacity, unread = choose_textures(color, alpha)
        is_opaque = not alpha.attributes and opacity is None and alpha.factor[0] >= 1.0
        self.result.lacking += [*unread, *(["a color above 1"] if max(color.factor) > 1.0 else [])]
        self.result.vertex_colors = VertexColors(color.attributes, alpha.attributes)
        has_colors = bool(color.attributes or alpha.attributes)
        factor = tuple(np.clip(color.factor, 0.0, 1.0).tolist())
        drops_alpha = not is_opaque and opacity is None
        self.write_product(factor, use, shader.inputs["Base Color"], has_colors, drops_alpha)
        if not is_opaque:
            self.write_product(alpha.factor, opacity, shader.inputs["Alpha"], bool(alpha.attributes), cutoff=surface.alpha_cutoff)

    def write_emission(self, shader: bpy.types.Node) -> None:
        """Write the light of an Emission that is added to the old shader, unless that emits light itself."""
        added, strength = self.surface.emission, shader.inputs["Emission Strength"]
        is_dark = strength.default_value == 0.0 or (
            not shader.inputs["Emission Color"].links and not any(shader.inputs["Emission Color"].default_value[:3])
        )
        if added is not None and is_dark:
            self.result.lacking.remove("Add Shader")
            for name in ("Color", "Strength"):
                self.transfer(ScopedSocket(added.node.inputs[name], added.groups), shader.inputs[f"Emission {name}"])

    def name_losses(self, shader: bpy.types.Node, output: bpy.types.Node) -> None:
        """Name what glTF cannot store of the old shader and of the output."""
        lacking, old = self.result.lacking, self.surface.shader
        if old.type not in STORED_SHADERS:
            lacking.append(old.bl_label)
        if old.type == "BSDF_PRINCIPLED":
            for name, extension in WEIGHTS.items():
                item = old.inputs.get(name)
                if item is not None and (item.links or item.default_value > 0.0):
                    self.result.extended[name] = extension
            coat = shader.inputs["Coat Weight"]
            if (coat.links or coat.default_value > 0.0) and (
                old.inputs["Coat Tint"].links or any(value < 1.0 for value in old.inputs["Coat Tint"].default_value[:3])
            ):
                lacking.append("Coat Tint")
        lacking += ["Displacement"] if output.inputs["Displacement"].links else []
        if output.inputs["Volume"].links:
            self.result.extended["Volume"] = "KHR_materials_volume"

    def is_there(self, use: TextureUse | None) -> bool:
        """Return whether the file of an image can be read, and note if it cannot."""
        if use is None or all(use.image.size):
            return True
        self.result.lacking.append(f'the missing image "{use.image.name}"')
        return False

    def check_occlusion(self) -> None:
        """Note images that are missing of a node for glTF alone, such as one of occlusion."""
        for node in self.builder.tree.nodes:
            if node.type == "GROUP" and node.node_tree is not None and node.node_tree.name.startswith("glTF"):
                for item in node.inputs:
                    for use in read_product(item).textures if item.links else ():
                        self.is_there(use)

    def write_product(
        self,
        factor: tuple[float, float, float],
        use: TextureUse | None,
        target: bpy.types.NodeSocket,
        has_colors: bool = False,
        drops_alpha: bool = False,
        cutoff: float | None = None,
    ) -> None:
        """Let an input be the product of a factor, an image and the color attribute of meshes, above a cutoff if there is one."""
        is_color, builder = target.type == "RGBA", self.builder
        multiply = builder.multiply_colors if is_color else lambda first, second: builder.math("MULTIPLY", first, second)
        value: SocketOrValue | None = None if use is None else self.write_texture(use, is_color and target.name != "Color", drops_alpha)
        if has_colors:
            node = builder.node("ShaderNodeVertexColor", {"layer_name": COLORS})
            shown = node.outputs["Color" if is_color else "Alpha"]
            value = shown if value is None else multiply(shown, value)
        constant = factor if is_color else factor[0]
        if value is None:
            value = constant
        elif factor != ONES:
            value = multiply(constant, value)
        if cutoff is not None:
            value = builder.math("SUBTRACT", 1.0, builder.math("LESS_THAN", value, cutoff))
        builder.connect(value, target)

    def write_texture(self, use: TextureUse, is_color: bool, drops_alpha: bool) -> bpy.types.NodeSocket:
        """Add an image with its placement, and return the output that is used."""
        builder, placement = self.builder, _split(use.matrix)
        if use.image.source == "TILED":
            self.result.lacking.append(f'further tiles of the image "{use.image.name}"')
        if placement is None:
            self.result.lacking.append("Mapping")
        if use.is_cut:
            self.result.cuts.append((use.uv_map, use.matrix))
        node = builder.node("ShaderNodeTexImage", {"image": self.images.prepare(use.image, is_color, drops_alpha)})
        node.interpolation = "Closest" if use.is_nearest else "Linear"
        node.extension = EXTENSIONS[use.wrap[0]] if use.wrap[0] == use.wrap[1] else "EXTEND"
        if use.uv_map:
            coordinates = builder.node("ShaderNodeUVMap", {"uv_map": use.uv_map}).outputs[0]
        else:
            coordinates = builder.node("ShaderNodeTexCoord").outputs["UV"]
        if placement is not None and use.is_moved:
            mapping = builder.node("ShaderNodeMapping", {"vector_type": "POINT"})
            for target, value in zip(mapping.inputs, (coordinates, *placement), strict=True):
                builder.connect(value, target)
            coordinates = mapping.outputs[0]
        if use.wrap[0] != use.wrap[1]:
            coordinates = self.wrap(coordinates, use.wrap)
        builder.connect(coordinates, node.inputs["Vector"])
        if use.channel in CHANNELS:
            return builder.separate_color(node.outputs["Color"])[CHANNELS.index(use.channel)]
        return node.outputs[use.channel]

    def wrap(self, coordinates: bpy.types.NodeSocket, kinds: tuple[str, str]) -> bpy.types.NodeSocket:
        """Return coordinates that are wrapped differently along u and v, with the nodes that the exporter knows."""
        parts = self.builder.separate(coordinates)[:2]
        for axis, kind in enumerate(kinds):
            if kind == "mirror":
                parts[axis] = self.builder.math("PINGPONG", parts[axis], 1.0)
            elif kind == "repeat":
                parts[axis] = self.builder.math("WRAP", parts[axis], 0.0)
                parts[axis].node.inputs[2].default_value = 1.0
        return self.builder.combine(*parts, 0.0)


def _list_values(surface: MaterialSurface) -> Mapping[str, Value]:
    """Return what inputs of a Principled BSDF stand for the shader of a surface."""
    shader = surface.shader
    if shader.type == "BSDF_PRINCIPLED":
        return {item.name: item.name for item in shader.inputs if item.name in shader.inputs and item.name not in IGNORED}
    if surface.is_shadeless:
        return {"Base Color": "Color", "Metallic": 0.0, "Roughness": 0.9}
    if shader.type == "EMISSION":  # black and without reflections, as the exporter stores it
        light = {"Emission Color": "Color", "Emission Strength": "Strength"}
        return {"Base Color": BLACK, "Metallic": 1.0, "Roughness": 1.0, **light}
    known = BSDFS.get(shader.type, DEFAULT_BSDF)
    found: dict[str, Value] = {"Base Color": known.color, "Roughness": known.roughness, "Metallic": known.metallic, "Normal": "Normal"}
    found |= {"IOR": "IOR", "Transmission Weight": 1.0} if shader.type in REFRACTIVE else {}
    found |= {"Specular IOR Level": 0.0} if shader.type in LAMBERTIAN else {}
    return {name: value for name, value in found.items() if not isinstance(value, str) or value in shader.inputs}


def _split(matrix: np.ndarray) -> tuple[tuple[float, float, float], ...] | None:
    """Return location, rotation (radians) and scale of an affine matrix (2, 3) of texture coordinates: it scales first, then rotates, then
    moves. None if it cannot be divided like this."""
    first, second = matrix[:, 0], matrix[:, 1]
    angle = float(np.arctan2(first[1], first[0]))
    angle -= np.pi * np.sign(angle) if abs(angle) > 0.5 * np.pi + MAX_SHEAR else 0.0  # Mirrored images have negative scales instead.
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    scaled = turn.T @ np.stack([first, second], axis=1)
    scales = np.diag(scaled)
    if not np.abs(scales).min() > 0.0 or not abs(scaled[0, 1]) <= MAX_SHEAR * abs(scales[1]):
        return None
    return (*matrix[:, 2].tolist(), 0.0), (0.0, 0.0, angle), (*scales.tolist(), 1.0)
