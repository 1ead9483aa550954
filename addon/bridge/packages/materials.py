"""Materials as packages draw them: factors and images of the shader nearest to the output."""

from dataclasses import dataclass

import bpy
import numpy as np

from ...core.imaging.colors import LINEAR_OF_BYTE
from ...core.packages.material_sources import MaterialSource
from ...core.packages.shading import Shading
from ..shading.color_products import ColorProduct, read_product, read_source_product
from ..shading.material_channels import BSDFS, DEFAULT_BSDF
from ..shading.socket_sources import ScopedSocket, find_source
from ..shading.surface_reader import MaterialSurface, choose_textures, read_surface
from ..shading.texture_uses import TextureUse
from .images import PackageImages

GRAY = (0.8, 0.8, 0.8, 1.0)
FLAT = (128, 128, 255)  # a normal map without relief
# Inputs that the package has, or that name what it has.
STORED_INPUTS = {"Base Color", "Roughness", "Metallic", "Emission Color", "Emission Strength", "Normal", "Alpha"}
BLACK = ColorProduct((0.0, 0.0, 0.0))


@dataclass(frozen=True, eq=False)
class ReadMaterial:
    """A material that was read.

    Attributes:
        source: what the package has of it.
        placement: an image that lies on the surface like all others, None without images.
        lacking: labels of what the package lacks.
    """

    source: MaterialSource
    placement: TextureUse | None
    lacking: tuple[str, ...]


def read_material(material: bpy.types.Material | None, images: PackageImages) -> ReadMaterial:
    """Read a material; None is gray.

    Raises:
        FileError: an image has no pixels, for instance because its file is missing.
    """
    if material is None:
        return ReadMaterial(MaterialSource("", GRAY, False, {}), None, ())
    return _Reader(material, images).read()


class _Reader:
    """Reads one material. Images that lie elsewhere than the first one are left out and named."""

    def __init__(self, material: bpy.types.Material, images: PackageImages) -> None:
        self.material, self.images, self.surface = material, images, read_surface(material)
        self.found: dict[str, np.ndarray] = {}
        self.placement: TextureUse | None = None
        self.lacking: list[str] = []

    def read(self) -> ReadMaterial:
        """Return the material."""
        surface, material = self.surface, self.material
        mixed = [label for label in surface.unread if label not in STORED_INPUTS]
        self.lacking += [label for label in mixed if label != "Add Shader" or surface.emission is None]
        is_unlit = surface.is_shadeless or (surface.shader is not None and surface.shader.type == "EMISSION")
        color = self.take("base_color", _read_color(surface))
        opacity = self.take("alpha", _without_unused_alpha(surface.alpha))[0]
        shading = Shading(is_unlit=is_unlit) if is_unlit else self.read_shading()
        if "alpha" in self.found or opacity < 1.0:
            mode = "blend" if surface.alpha_cutoff is None else "mask"
            cutoff = min(max(surface.alpha_cutoff or 0.0, 0.0), 1.0)
            shading = Shading(**{**vars(shading), "alpha_mode": mode, "alpha_cutoff": cutoff})
        source = MaterialSource(material.name, (*color, opacity), not material.use_backface_culling, self.found, shading)
        return ReadMaterial(source, self.placement, tuple(dict.fromkeys(self.lacking)))

    def read_shading(self) -> Shading:
        """Return the factors of the shader, and take its images."""
        shader, groups = self.surface.shader, self.surface.groups
        if shader is None:
            return Shading(self.material.roughness, self.material.metallic)
        known = BSDFS.get(shader.type, DEFAULT_BSDF)
        inputs = {item.name: read_product(item, groups) for item in shader.inputs if item.type in ("RGBA", "VALUE")}

        def read_number(value: str | float) -> ColorProduct:
            return inputs.get(value, ColorProduct((0.5,) * 3)) if isinstance(value, str) else ColorProduct((value,) * 3)

        roughness, metallic = (
            min(max(self.take(role, read_number(value))[0], 0.0), 1.0)
            for role, value in (("roughness", known.roughness), ("metallic", known.metallic))
        )
        emission = self.take("emission", _read_emission(self.surface))
        normal_scale = self.read_normals(next((item for item in shader.inputs if item.name == "Normal"), None))
        self.take("occlusion", _read_occlusion(self.material))
        return Shading(roughness, metallic, emission, normal_scale)

    def read_normals(self, socket: bpy.types.NodeSocket | None) -> float:
        """Take the normal map before an input, and return the scale of its slopes."""
        source = None if socket is None else find_source(ScopedSocket(socket, self.surface.groups))
        while source is not None and not source.is_constant and source.node.type == "BUMP":
            self.lacking.append(source.node.label or source.node.bl_label)
            source = source.input("Normal")
        if source is None or source.is_constant:
            return 1.0
        if source.node.type != "NORMAL_MAP" or source.node.space != "TANGENT":
            self.lacking.append("Normal")
            return 1.0
        strength = read_product(source.node.inputs["Strength"], source.groups)
        self.lacking += [] if strength.is_constant else ["Strength"]
        self.take("normal", read_product(source.node.inputs["Color"], source.groups))
        return strength.factor[0] if strength.is_constant else 1.0

    def take(self, role: str, product: ColorProduct) -> tuple[float, float, float]:
        """Take the image of a product, and return its other factors. An image with one value only is a factor."""
        use, _, unread = choose_textures(product, ColorProduct())
        self.lacking += [*unread, *(["vertex colors"] if product.attributes else [])]
        if use is None:
            return product.factor
        if self.placement is not None and not use.is_placed_like(self.placement):
            self.lacking.append(f'the image "{use.image.name}"')
            return product.factor
        self.placement = self.placement or use
        image = self.images.read_role(role, use)
        first = image[0, 0]
        if role == "base_color" or not (image == first).all():
            self.found[role] = image
        elif role == "emission":
            return tuple(float(factor * LINEAR_OF_BYTE[value]) for factor, value in zip(product.factor, first, strict=True))
        elif role != "normal":
            return tuple(factor * float(first[0]) / 255.0 for factor in product.factor)
        elif tuple(first.tolist()) != FLAT:
            self.found[role] = image
        return product.factor


def _read_color(surface: MaterialSurface) -> ColorProduct:
    """Return the base color, which is that of the light where a shader only emits."""
    shader = surface.shader
    if shader is not None and shader.type == "BSDF_PRINCIPLED":
        return read_product(shader.inputs["Base Color"], surface.groups)
    if shader is not None and shader.type == "EMISSION" and not surface.is_shadeless:
        return surface.color.times(read_product(shader.inputs["Strength"], surface.groups))
    return surface.color


def _without_unused_alpha(alpha: ColorProduct) -> ColorProduct:
    """Return an opacity without images whose alpha is switched off."""
    shown = tuple(use for use in alpha.textures if use.channel != "Alpha" or use.image.alpha_mode != "NONE")
    return ColorProduct(alpha.factor, shown, alpha.attributes, alpha.unread)


def _read_emission(surface: MaterialSurface) -> ColorProduct:
    """Return the light that a shader emits, or a shader that is added to it."""
    sockets = [(surface.shader, surface.groups, "Emission Color", "Emission Strength")]
    if surface.emission is not None:
        sockets.append((surface.emission.node, surface.emission.groups, "Color", "Strength"))
    for node, groups, color_name, strength_name in sockets:
        color, strength = (node.inputs.get(name) for name in (color_name, strength_name))
        if color is not None and strength is not None:
            light = read_product(color, groups).times(read_product(strength, groups))
            if any(light.factor):
                return light
    return BLACK


def _read_occlusion(material: bpy.types.Material) -> ColorProduct:
    """Return the ambient occlusion, an input of a group that Blender's glTF importer adds."""
    for node in material.node_tree.nodes:
        if node.type == "GROUP" and node.node_tree is not None and node.node_tree.name.startswith("glTF"):
            socket = node.inputs.get("Occlusion")
            if socket is not None and socket.links:
                return read_source_product(find_source(ScopedSocket(socket)))
    return ColorProduct()
