"""Textures from photographs as images and materials."""

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import bpy
import numpy as np

from ...compat import enable_nodes
from ...core.photos.photo_texture import PhotoTexture
from ...core.photos.texels.pages import FIRST_TILE, PageLayout
from ..imaging.images import EXTENSIONS, create_image, open_tiles, pack_tiles, save_pixels
from ..shading.solid_view import show_image

IMAGE_NODE_OFFSET = (-330, 0)  # from the shader
OVERLAY_PROPERTY = "farfield_photo_overlay"  # custom property of images that `create_overlay_image` made
TEXTURE_PROPERTY = "farfield_photo_texture"  # custom property of materials that `assign_texture` made
MAPS = {
    "Confidence": lambda page, _: page.confidence,
    "Source": lambda page, photograph_count: (page.source + 1.0) / photograph_count,
    "Holes": lambda page, _: page.holes,
}


def create_overlay_image(name: str, colors: np.ndarray) -> bpy.types.Image:
    """Create an 8-bit image of sRGB-encoded `colors` (H, W, 3) that files keep. If the name is taken, it has a number."""
    image = create_image(name, _to_pixels(colors), is_data=False)
    image[OVERLAY_PROPERTY] = True
    image.use_fake_user = True
    return image


def replace_overlay_image(name: str, image: bpy.types.Image) -> None:
    """Let `image` take the place of an earlier overlay with this name, if there is one."""
    former = bpy.data.images.get(name)
    if former is not None and former != image and OVERLAY_PROPERTY in former and former.library is None:
        former.user_remap(image)
        bpy.data.images.remove(former)
        image.name = name


def assign_texture(objects: list[bpy.types.Object], image: bpy.types.Image, name: str, *, has_alpha: bool = False) -> bpy.types.Material:
    """Give `objects` one new material that shows `image`, in place of all their materials.

    Replaced materials that nothing else uses get a fake user, so that files keep them; those that this function made do not.
    """
    material = create_material(name, image, has_alpha)
    replaced = dict.fromkeys(slot.material for item in objects for slot in item.material_slots if slot.material is not None)
    for slot in [slot for item in objects for slot in item.material_slots if slot.link == "OBJECT"]:
        slot.material = None  # or the material would count this object as a user for ever
    for mesh in dict.fromkeys(item.data for item in objects):
        mesh.materials.clear()
        mesh.materials.append(material)
        mesh.polygons.foreach_set("material_index", np.zeros(len(mesh.polygons), np.int32))
    for item in objects:
        for slot in item.material_slots:
            slot.link = "DATA"
    keep_unused(replaced)
    return material


def keep_unused(materials: Iterable[bpy.types.Material]) -> None:
    """Give those of `materials` that nothing uses a fake user, so that files keep them, unless this tool made them."""
    for old in materials:
        if old.users == 0 and old.is_editable and TEXTURE_PROPERTY not in old:
            old.use_fake_user = True


def create_material(name: str, image: bpy.types.Image, has_alpha: bool) -> bpy.types.Material:
    """Create a matte material that shows `image`, with its transparency if it `has_alpha`."""
    material = bpy.data.materials.new(name)
    material[TEXTURE_PROPERTY] = True
    enable_nodes(material)
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    texture = add_texture(tree, shader, image)
    if has_alpha:
        tree.links.new(texture.outputs["Alpha"], shader.inputs["Alpha"])
    shader.inputs["Roughness"].default_value = 1.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    show_image(material, image)
    return material


def add_texture(tree: bpy.types.NodeTree, shader: bpy.types.Node, image: bpy.types.Image) -> bpy.types.Node:
    """Add a node of `image` to a node tree as the base color of its `shader`."""
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    texture.location = [origin + offset for origin, offset in zip(shader.location, IMAGE_NODE_OFFSET, strict=True)]
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    return texture


def create_textures(
    layout: PageLayout, texture: PhotoTexture, names: Sequence[str], *, has_alpha: bool = False
) -> dict[int, bpy.types.Image]:
    """Create a packed 8-bit image for each group of pages; `names` by group. With `has_alpha`, holes are transparent."""
    images = {}
    for group in dict.fromkeys(layout.groups):
        tiles = layout.find_tiles(group)
        pages = map(texture.page, tiles.values())
        pictures = (_to_pixels(page.colors, page.holes if has_alpha else None) for page in pages)
        images[group] = _create_tiles(names[group], list(tiles), pictures, is_data=False)
    return images


def create_maps(layout: PageLayout, texture: PhotoTexture, names: Sequence[str], photograph_count: int) -> None:
    """Create the images of confidence, source and holes of each group, which files keep although nothing uses them."""
    for group in dict.fromkeys(layout.groups):
        tiles = layout.find_tiles(group)
        for name, read in MAPS.items():
            pages = map(texture.page, tiles.values())
            pictures = (_to_pixels(read(page, photograph_count)[..., None]) for page in pages)
            _create_tiles(f"{names[group]} {name}", list(tiles), pictures, is_data=True).use_fake_user = True


def _create_tiles(name: str, tiles: list[int], pictures: Iterator[np.ndarray], *, is_data: bool) -> bpy.types.Image:
    """Create a packed image with pixels (H, W, 4) of each tile; a tiled one unless tile 1001 is the only one."""
    if tiles == [FIRST_TILE]:
        return create_image(name, next(pictures), is_data=is_data)
    with tempfile.TemporaryDirectory() as folder:
        paths = {tile: Path(folder, f"tile.{tile}.{EXTENSIONS[False]}") for tile in tiles}
        for path, picture in zip(paths.values(), pictures, strict=True):
            save_pixels(picture, path, is_float=False)
        image = open_tiles(name, paths, "Non-Color" if is_data else "sRGB", "CHANNEL_PACKED")
        pack_tiles(image, EXTENSIONS[False])
    return image


def _to_pixels(values: np.ndarray, transparent: np.ndarray | None = None) -> np.ndarray:
    """Return pixels (H, W, 4) float32 of colors (H, W, 3) or gray values (H, W, 1), with zero alpha where they are `transparent` (H, W)."""
    pixels = np.ones((*values.shape[:2], 4), np.float32)
    pixels[..., :3] = values
    if transparent is not None:
        pixels[transparent, 3] = 0.0
    return pixels
