"""The PBR maps of a level as Blender images, and the material that shows them."""

import bpy
import numpy as np

from ...core.billboards.cloud import Level
from ...core.imaging.images import MIN_ALPHA, dilate, unpremultiply
from ...core.imaging.metrics import encode_srgb
from ..imaging.images import create_image
from .cloud_materials import COLOR, NORMAL, ROUGHNESS_METALLIC_DEPTH, create_cloud_material
from .level_maps import LevelTextures, PbrMaps

# Quads cast no shadow on surfaces within this many errors: quads of one surface overlap within that distance.
SHADOWLESS_ERRORS = 4.0


def create_textured_material(name: str, level: Level, textures: LevelTextures) -> bpy.types.Material:
    """Create a material with the images of `textures`, packed and named after it."""
    images = {}
    for side, maps in (("Front", textures.front), ("Back", textures.back)):
        for map_name, pixels in _encode_maps(maps, level.atlas.gutter).items():
            images[side, map_name] = create_image(f"{name} {side} {map_name}", pixels, is_data=map_name != COLOR)
    return create_cloud_material(name, images, SHADOWLESS_ERRORS * level.error)


def _encode_maps(maps: PbrMaps, gutter: int) -> dict[str, np.ndarray]:
    """Encode the maps of one side for 8-bit images: (H, W, 4) in 0..1, color as straight sRGB."""
    straight = unpremultiply(maps.color)
    alpha = np.clip(straight[..., 3:], 0.0, 1.0)
    color = dilate(straight[..., :3], maps.color[..., 3] * (maps.color[..., 3] > MIN_ALPHA), gutter // 2 + 1)
    parameters = maps.roughness_metallic_depth * np.float32([1.0, 1.0, 0.5]) + np.float32([0.0, 0.0, 0.5])
    opaque = np.ones_like(alpha)
    return {
        COLOR: np.concatenate([encode_srgb(color), alpha], axis=2),
        NORMAL: np.concatenate([0.5 + 0.5 * maps.normal, opaque], axis=2),
        ROUGHNESS_METALLIC_DEPTH: np.concatenate([parameters, opaque], axis=2),
    }
