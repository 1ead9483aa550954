"""Textures of refit levels: rebaked in the core, and added to the scene as images of the materials of levels."""

from collections.abc import Sequence
from dataclasses import dataclass

import bpy

from ...bridge.texmesh.color_images import find_color_image
from ...bridge.texmesh.rebaked_images import RebakeTextures, create_rebaked_image, read_rebake_textures
from ...bridge.texmesh.sources import TexturedSource
from ...core.jobs.progress import Steps
from ...core.texmesh.level_chain import LevelChain
from ...core.texmesh.rebaking.rebake import RebakedTextures, rebake_textures
from ...core.texmesh.settings import TexmeshSettings


def read_textures(sources: Sequence[TexturedSource], settings: TexmeshSettings) -> list[RebakeTextures | None]:
    """Return what textures are rebaked from, None for each object if they are not."""
    is_used = settings.rebake_textures and settings.vertices == "optimized"
    return [read_rebake_textures(source) if is_used else None for source in sources]


def rebake_chain(source: TexturedSource, chain: LevelChain, textures: RebakeTextures) -> Steps[RebakedTextures]:
    """Return the textures of all levels but the first, which is the original."""
    levels = chain.levels[1:]
    return (
        yield from rebake_textures(source.mesh, textures.textures, [level.mesh for level in levels], [level.pixel_size for level in levels])
    )


@dataclass(frozen=True)
class LevelImages:
    """Images of levels: per level those of material slots. remarks: sentences about them."""

    levels: list[dict[int, bpy.types.Image]]
    remarks: list[str]


def create_images(
    name: str, materials: Sequence[bpy.types.Material | None], textures: RebakeTextures, rebaked: RebakedTextures
) -> LevelImages:
    """Create the images of the levels of the object `name`, named after object and level, and after their originals if there are several.
    materials: by slot."""
    sources = {slot: find_color_image(material)[0] for slot, material in enumerate(materials)}
    has_several = len({sources[slot] for images in rebaked.levels for slot, pixels in enumerate(images) if pixels is not None}) > 1
    levels: list[dict[int, bpy.types.Image]] = [{}]
    for number, images in enumerate(rebaked.levels, 1):
        created: dict[int, bpy.types.Image] = {}
        for slot, pixels in enumerate(images):
            if pixels is not None:
                suffix = f" {sources[slot].name}" if has_several else ""
                if id(pixels) not in created:
                    created[id(pixels)] = create_rebaked_image(f"{name} L{number}{suffix}", pixels, sources[slot])
        levels.append({slot: created[id(pixels)] for slot, pixels in enumerate(images) if pixels is not None})
    return LevelImages(levels, [*_describe_sizes(name, levels), *textures.remarks, *_describe_repeated(name, sources, rebaked)])


def _describe_sizes(name: str, levels: Sequence[dict[int, bpy.types.Image]]) -> list[str]:
    sizes = [" and ".join(dict.fromkeys(f"{image.size[0]} x {image.size[1]}" for image in images.values())) for images in levels[1:]]
    return [f'Textures of the levels of "{name}" have {", ".join(filter(None, sizes))} pixels.'] if any(sizes) else []


def _describe_repeated(name: str, sources: dict[int, bpy.types.Image | None], rebaked: RebakedTextures) -> list[str]:
    images = dict.fromkeys(sources[slot].name for slot in rebaked.repeated if sources.get(slot) is not None)
    return [f'Levels keep the image "{image}": the UV map of "{name}" uses parts of it more than once.' for image in images]
