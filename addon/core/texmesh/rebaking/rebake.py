"""Textures of refit levels, rebaked from the original.

Paper, section I: coarse levels for static use need no subset of the fine vertices, and no texture of the original's size.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...jobs.progress import Steps, subprogress
from ..textured_mesh import TexturedMesh
from .image_sizes import choose_halvings
from .level_texture import OriginalSurface, build_weighted_mipmaps, rebake_texture
from .uv_layout import repeats_texture


@dataclass(frozen=True)
class RebakedTextures:
    """Textures of levels. levels: per level and material an image (H, W, C) float32 like those of the original, None where the level keeps
    the original's. Materials with the same image share the array. repeated: materials that use parts of their texture more than once, so
    that it cannot be rebaked."""

    levels: tuple[tuple[np.ndarray | None, ...], ...]
    repeated: tuple[int, ...]


def rebake_textures(
    fine: TexturedMesh, textures: Sequence[np.ndarray | None], levels: Sequence[TexturedMesh], pixel_sizes: Sequence[float]
) -> Steps[RebakedTextures]:
    """Return a texture for each of the `levels` of `fine` and each material, as small as the level's distance allows.

    Args:
        textures: per material an image (H, W, C) float32, scene-linear, row 0 at the bottom, with colors that are premultiplied by alpha if
            it has that; the same array for materials with the same image, and None for materials that keep theirs. levels: in the space of
            `fine`, with nearly the same texture coordinates. pixel_sizes: of each level, the smallest size of a pixel at which it is shown,
            in the object's unit.
    """
    images: list[np.ndarray] = []
    material_groups = np.full(max(len(textures), int(fine.materials.max()) + 1), -1)
    for material, texture in enumerate(textures):
        if texture is not None:
            match = next((index for index, image in enumerate(images) if image is texture), len(images))
            images += [texture] if match == len(images) else []
            material_groups[material] = match
    groups = material_groups[fine.materials]
    repeated = [group for group, image in enumerate(images) if repeats_texture(fine.corner_uvs[groups == group], image.shape[1::-1])]
    original = OriginalSurface(fine, groups)
    used = [group for group in range(len(images)) if group not in repeated and (groups == group).any()]
    islands = [original.match_islands(level) for level in levels] if used else []
    baked: dict[tuple[int, int], np.ndarray] = {}
    tasks = len(used) * len(levels)
    for group in used:
        mipmaps = build_weighted_mipmaps(images[group], fine.corner_uvs[groups == group])
        for index, (level, pixel_size) in enumerate(zip(levels, pixel_sizes, strict=True)):
            triangles = np.flatnonzero(material_groups[level.materials] == group)
            if not len(triangles):
                continue
            halvings = choose_halvings(level, triangles, pixel_size, images[group].shape[1::-1])
            steps = rebake_texture(original, group, mipmaps, level, islands[index], triangles, halvings)
            done = used.index(group) * len(levels) + index
            baked[index, group] = yield from subprogress(steps, done / tasks, (done + 1) / tasks)
    by_material = material_groups[: len(textures)].tolist()
    by_level = tuple(tuple(baked.get((index, group)) for group in by_material) for index in range(len(levels)))
    return RebakedTextures(by_level, tuple(material for material, group in enumerate(by_material) if group in repeated))
