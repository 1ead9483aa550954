"""The image that gives a material its color, as an array."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np

from ...compat import uses_nodes
from ..imaging.color_spaces import read_linear_pixels
from ..imaging.images import check_pixels
from ..shading.socket_sources import ScopedSocket, find_source
from ..shading.surface_reader import find_output, list_color_inputs, read_surface
from ..shading.texture_uses import read_texture_use

MAX_SIDE = 4096  # pixels; larger images are halved until they fit


def find_color_images(material: bpy.types.Material | None) -> list[tuple[bpy.types.Image, str]]:
    """Return the images of all image textures that the color of the surface of a material depends on, each once, the nearest one first,
    with the names of the UV maps that they use ("" for the active one).

    Links are followed from the active output, through groups and reroutes. Images for roughness, normals and other inputs do not count.
    """
    if material is None or not uses_nodes(material) or material.node_tree is None:
        return []
    output = find_output(material.node_tree)
    found: dict[bpy.types.Image, str] = {}
    for source in () if output is None else _image_outputs(ScopedSocket(output.inputs["Surface"])):
        found.setdefault(source.node.image, read_texture_use(source).uv_map)
    return list(found.items())


def read_plain_color(material: bpy.types.Material | None) -> np.ndarray | None:
    """Return the constant color of a material as an image of one pixel (1, 1, 3) float32, scene-linear, None if it has another color."""
    if material is None:
        return None
    color = read_surface(material).color
    return np.array(color.factor, np.float32).reshape(1, 1, 3) if color.is_constant else None


def read_color_image(image: bpy.types.Image) -> tuple[np.ndarray, bool]:
    """Return the colors (H, W, 3) float32 of an image, scene-linear, row 0 at the bottom, and whether it was scaled down to MAX_SIDE.

    Raises:
        FileError: it has no pixels, for instance because its file is missing.
    """
    check_pixels(image)
    with scaled_copy(image, MAX_SIDE) as source:
        return _read_colors(source), source != image


@contextmanager
def scaled_copy(image: bpy.types.Image, max_side: int) -> Iterator[bpy.types.Image]:
    """Yield an image of at most `max_side` pixels per side: `image` itself, or a copy that is removed afterwards."""
    side = max(image.size)
    if side <= max_side:
        yield image
        return
    copy = image.copy()
    try:
        copy.scale(*(max(1, round(length * max_side / side)) for length in image.size))
        yield copy
    finally:
        bpy.data.images.remove(copy)


def _read_colors(image: bpy.types.Image) -> np.ndarray:
    return np.ascontiguousarray(read_linear_pixels(image)[..., :3])


def _image_outputs(surface: ScopedSocket) -> Iterator[ScopedSocket]:
    """Yield the outputs of image texture nodes before the input `surface`, depth-first, that determine colors."""
    visited: set[ScopedSocket] = set()
    pending = [surface]
    while pending:
        source = find_source(pending.pop())
        if source.is_constant or source in visited:
            continue
        visited.add(source)
        if source.node.type != "TEX_IMAGE":
            pending += [ScopedSocket(item, source.groups) for item in _color_inputs(source.node)]
        elif source.node.image is not None:
            yield source


def _color_inputs(node: bpy.types.Node) -> list[bpy.types.NodeSocket]:
    """Return the linked inputs of a node that determine its color, in the order in which a stack should hold them: the nearest one last."""
    linked = [item for item in node.inputs if item.links]
    shaders = [item for item in linked if item.type == "SHADER"]
    colors = [item for item in list_color_inputs(node) if item.links]
    if any(item.type == "SHADER" for item in node.outputs):
        return shaders[::-1] or colors[:1]
    if colors:
        return colors[:1]
    if node.type.startswith("TEX_"):  # their vectors are positions
        return []
    first = [item for item in linked if item.type in ("RGBA", "SHADER")]
    return [*(item for item in reversed(linked) if item not in first), *reversed(first)]
