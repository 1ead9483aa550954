"""The materials of texture tiles: each has one or two packed images, as coded in the store, and is kept for a while after its last use."""

import bpy

from ...core.bdam.textures.tile_blocks import CodedTile
from .materials import create_texture_material

TEXTURE_KEY = "farfield_bdam_texture"  # custom property of materials and images: the store, and the number of the tile
USED_KEY = "farfield_bdam_used"  # custom property of materials: counts up with every use
MAX_UNUSED = 64  # materials of texture tiles that are kept without users
MAX_REMOVED = 8  # unused materials that are removed at a time


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


def mark_used(materials: list[bpy.types.Material]) -> None:
    """Take note that materials are shown now."""
    last = max((int(item.get(USED_KEY, 0)) for item in bpy.data.materials if TEXTURE_KEY in item), default=0)
    for material in materials:
        material[USED_KEY] = last + 1


def remove_unused(max_unused: int = MAX_UNUSED, max_removed: int = MAX_REMOVED) -> None:
    """Remove the materials of texture tiles, and their images, that have not been used for the longest time."""
    unused = [item for item in bpy.data.materials if TEXTURE_KEY in item and item.users == 0 and item.library is None]
    unused.sort(key=lambda item: int(item.get(USED_KEY, 0)))
    removed = unused[: max(len(unused) - max_unused, 0)][:max_removed]
    keys = {item[TEXTURE_KEY] for item in removed}
    bpy.data.batch_remove(removed)
    bpy.data.batch_remove([item for item in bpy.data.images if item.get(TEXTURE_KEY) in keys and item.users == 0 and item.library is None])


def _pack_image(name: str, content: bytes, key: str, is_data: bool = False) -> bpy.types.Image:
    """Create an image of the bytes of an image file, which Blender stores as they are."""
    image = bpy.data.images.new(name, 1, 1, is_data=is_data)
    image.pack(data=content, data_len=len(content))
    image.source = "FILE"
    image.colorspace_settings.name = "Non-Color" if is_data else "sRGB"
    image.alpha_mode = "CHANNEL_PACKED"
    image[TEXTURE_KEY] = key
    return image
