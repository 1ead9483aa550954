"""Images with rebaked textures of levels: what they are made from, and how materials use them."""

from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.imaging.colors import encode_signed_srgb
from ...core.imaging.images import unpremultiply
from ..geometry.meshes import find_material
from ..imaging.color_spaces import SRGB, find_scene_linear_space, read_linear_pixels
from ..imaging.images import INDEPENDENT_ALPHA, lossless_alpha_mode
from ..lod_sets import KIND
from ..shading.socket_sources import ScopedSocket
from ..shading.texture_uses import read_texture_use
from .color_images import MAX_SIDE, find_color_image, scaled_copy
from .sources import TexturedSource

TEXTURE = "texmesh_texture"  # the KIND of the images


@dataclass(frozen=True)
class RebakeTextures:
    """What textures of one object are rebaked from. textures: per material (H, W, 3 or 4) float32, scene-linear, with premultiplied colors
    if alpha weights them; the same array for materials with the same image; None where the image stays. remarks: sentences why it stays."""

    textures: tuple[np.ndarray | None, ...]
    remarks: tuple[str, ...]


def read_rebake_textures(source: TexturedSource) -> RebakeTextures:
    """Read the textures of an object, with alpha where there is some."""
    textures, remarks, read = [], [], {}
    leaves_image = bool(source.mesh.uvs.min() < 0.0 or source.mesh.uvs.max() > 1.0)
    for key, texture in zip(source.evaluated.materials, source.textures, strict=True):
        material = None if key is None else find_material(key)
        image, _ = find_color_image(material)
        if texture is None or image is None:
            textures.append(None)
            continue
        reason = _describe_refusal(material, image, leaves_image)
        if reason:
            remarks.append(f'Levels keep the image "{image.name}": {reason}.')
            textures.append(None)
            continue
        if image.name not in read:
            read[image.name] = _add_alpha(image, texture)
        textures.append(read[image.name])
    return RebakeTextures(tuple(textures), tuple(dict.fromkeys(remarks)))


def create_rebaked_image(name: str, pixels: np.ndarray, source: bpy.types.Image) -> bpy.types.Image:
    """Create a packed image of `pixels` (H, W, 3 or 4), as in `RebakeTextures`, that a material can use in place of `source`: with the
    depth of `source`, and colors as sRGB values, floats, or data."""
    height, width = pixels.shape[:2]
    has_alpha, is_data, is_float = pixels.shape[2] == 4, source.colorspace_settings.is_data, source.is_float
    image = bpy.data.images.new(name, width, height, alpha=has_alpha, float_buffer=is_float, is_data=is_data)
    # Before the pixels: setting these afterwards would erase them.
    image.colorspace_settings.name = source.colorspace_settings.name if is_data else find_scene_linear_space() if is_float else SRGB
    if has_alpha:
        is_independent = source.alpha_mode in INDEPENDENT_ALPHA
        image.alpha_mode = lossless_alpha_mode(source.alpha_mode, is_float)
        pixels = pixels if is_independent or is_float else unpremultiply(pixels)
    colors = pixels[..., :3] if is_float or is_data else encode_signed_srgb(np.clip(pixels[..., :3], 0.0, 1.0))
    alpha = pixels[..., 3:] if has_alpha else np.ones((height, width, 1), np.float32)
    image.use_half_precision = source.use_half_precision
    image.pixels.foreach_set(np.concatenate([colors, alpha], axis=2).astype(np.float32).ravel())
    image.update()
    image.pack()
    image[KIND] = TEXTURE
    return image


def use_rebaked_image(material: bpy.types.Material, image: bpy.types.Image) -> None:
    """Let all nodes of `material` that show its color image show `image` instead."""
    replaced, _ = find_color_image(material)
    for node in _nodes_with(material, replaced):
        node.image = image


def find_rebaked_images(materials: list[bpy.types.Material]) -> list[bpy.types.Image]:
    """Return the rebaked images that `materials` use, each once."""
    trees = [material.node_tree for material in materials if material.node_tree is not None]
    images = (node.image for tree in trees for node in tree.nodes if node.type == "TEX_IMAGE" and node.image is not None)
    return list(dict.fromkeys(image for image in images if image.get(KIND) == TEXTURE))


def _describe_refusal(material: bpy.types.Material, image: bpy.types.Image, leaves_image: bool) -> str:
    """Return why an image cannot be rebaked, "" if it can."""
    nodes = list(_nodes_with(material, image))
    if image.source not in ("FILE", "GENERATED"):
        return "it has tiles or frames"
    if not nodes:
        return f'the material "{material.name}" has it within a node group'
    if not all(_is_placed_by_uvs(node) for node in nodes):
        return f'the material "{material.name}" places it with more than a UV map'
    if leaves_image and any(node.extension != "REPEAT" for node in nodes):
        return "the UV map leaves it, and it is not repeated there"
    return ""


def _is_placed_by_uvs(node: bpy.types.Node) -> bool:
    """Return whether an image node shows its image where a UV map says, and nowhere else."""
    use = read_texture_use(ScopedSocket(node.outputs["Color"]))
    return not use.unread and not use.is_moved


def _nodes_with(material: bpy.types.Material, image: bpy.types.Image | None) -> Iterator[bpy.types.Node]:
    return (node for node in material.node_tree.nodes if node.type == "TEX_IMAGE" and node.image is not None and node.image == image)


def _add_alpha(image: bpy.types.Image, colors: np.ndarray) -> np.ndarray:
    """Return `colors` (H, W, 3) of an image, with alpha if it shows and is not 1 everywhere."""
    if image.alpha_mode == "NONE" or image.channels not in (2, 4):
        return colors
    with scaled_copy(image, MAX_SIDE) as copy:
        pixels = read_linear_pixels(copy)
    if (pixels[..., 3] >= 1.0).all():
        return colors
    if image.alpha_mode not in INDEPENDENT_ALPHA and not image.is_float:  # those of floats are premultiplied
        pixels[..., :3] *= pixels[..., 3:]
    return pixels
