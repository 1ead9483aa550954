"""Materials of binary glTF files: colors, textures with their placement and repetition, and transparency."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import GeometryError

TEXTURE_TRANSFORM, UNLIT = "KHR_texture_transform", "KHR_materials_unlit"
WRAPS = {"repeat": 10497, "mirror": 33648, "clamp": 33071}
LINEAR, NEAREST, TRILINEAR = 9729, 9728, 9987
OPAQUE, MASK, BLEND = "OPAQUE", "MASK", "BLEND"
FLIP = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 1.0]])  # between v upwards and v downwards
MAX_SHEAR = 1e-5  # Relative to the scale of a placement; below, it is rounding.
Placement = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class GlbTexture:
    """How a material uses an image.

    Attributes:
        image: index into the images of the scene.
        wrap: what the image shows beyond its sides, along u and along v: a key of WRAPS.
        is_nearest: whether its pixels are squares, instead of interpolated.
        placement: (2, 3) from the texture coordinates of the mesh to those of the image, v upwards; None if they are the same. It moves,
            turns and scales, see `is_placement`.
    """

    image: int
    wrap: tuple[str, str] = ("repeat", "repeat")
    is_nearest: bool = False
    placement: Placement | None = None


@dataclass(frozen=True)
class GlbMaterial:
    """A material.

    Attributes:
        name: any text.
        base_color: scene-linear RGBA, multiplied with the texture and with the colors of vertices.
        texture: of the base color, and of alpha unless `alpha_mode` is OPAQUE.
        is_double_sided: whether back faces show.
        alpha_mode: OPAQUE, MASK or BLEND.
        alpha_cutoff: alpha from which a surface with a MASK is visible.
        is_unlit: whether it shows its base color without light.
    """

    name: str
    base_color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    texture: GlbTexture | None = None
    is_double_sided: bool = False
    alpha_mode: str = OPAQUE
    alpha_cutoff: float = 0.5
    is_unlit: bool = False


@dataclass(frozen=True)
class UvRange:
    """The range of the texture coordinates in a file, v downwards, that their smallest and largest stored value represent."""

    offset: tuple[float, float] = (0.0, 0.0)
    scale: tuple[float, float] = (1.0, 1.0)


UNIT_RANGE = UvRange()


def is_placement(matrix: np.ndarray) -> bool:
    """Return whether glTF can represent a matrix (2, 3) of texture coordinates: it does not shear, and has no scale of 0."""
    return _split(FLIP @ np.vstack([matrix, [0.0, 0.0, 1.0]]) @ FLIP) is not None


def encode_materials(materials: Sequence[GlbMaterial], ranges: Sequence[UvRange]) -> dict[str, Any]:
    """Return the materials, textures and samplers of a document.

    ranges: of the stored texture coordinates, by material.

    Raises:
        GeometryError: a texture is sheared.
    """
    samplers: dict[tuple[tuple[str, str], bool], int] = {}
    textures: dict[tuple[int, int], int] = {}
    encoded = []
    for material, uv_range in zip(materials, ranges, strict=True):
        reference = None
        if material.texture is not None:
            used = material.texture
            sampler = samplers.setdefault((used.wrap, used.is_nearest), len(samplers))
            reference = {"index": textures.setdefault((used.image, sampler), len(textures)), **_encode_placement(material, uv_range)}
        encoded.append(_encode_material(material, reference))
    result: dict[str, Any] = {"materials": encoded}
    if textures:
        result["textures"] = [{"sampler": sampler, "source": image} for image, sampler in textures]
        result["samplers"] = [_encode_sampler(*key) for key in samplers]
    return result


def _encode_sampler(wrap: tuple[str, str], is_nearest: bool) -> dict[str, int]:
    magnified, minified = (NEAREST, NEAREST) if is_nearest else (LINEAR, TRILINEAR)
    return {"magFilter": magnified, "minFilter": minified, "wrapS": WRAPS[wrap[0]], "wrapT": WRAPS[wrap[1]]}


def _encode_material(material: GlbMaterial, texture: dict[str, Any] | None) -> dict[str, Any]:
    surface: dict[str, Any] = {"baseColorFactor": list(material.base_color), "metallicFactor": 0.0}
    if texture is not None:
        surface["baseColorTexture"] = texture
    result: dict[str, Any] = {"name": material.name, "pbrMetallicRoughness": surface}
    if material.is_unlit:
        result["extensions"] = {UNLIT: {}}
    if material.alpha_mode != OPAQUE:
        result["alphaMode"] = material.alpha_mode
    if material.alpha_mode == MASK:
        result["alphaCutoff"] = material.alpha_cutoff
    return {**result, "doubleSided": True} if material.is_double_sided else result


def _encode_placement(material: GlbMaterial, uv_range: UvRange) -> dict[str, Any]:
    """Return the transform from stored texture coordinates to those of the image as an extension; nothing if they are the same."""
    if material.texture.placement is None and uv_range == UNIT_RANGE:
        return {}
    placement = np.eye(2, 3) if material.texture.placement is None else material.texture.placement
    stored = np.array([[uv_range.scale[0], 0.0, uv_range.offset[0]], [0.0, uv_range.scale[1], uv_range.offset[1]], [0.0, 0.0, 1.0]])
    found = _split(FLIP @ np.vstack([placement, [0.0, 0.0, 1.0]]) @ FLIP @ stored)
    if found is None:
        raise GeometryError(f'The material "{material.name}" shears its texture, which glTF cannot store; place it otherwise.')
    offset, rotation, scale = found
    turned = {"rotation": rotation} if rotation else {}
    return {"extensions": {TEXTURE_TRANSFORM: {"offset": offset, **turned, "scale": scale}}}


def _split(matrix: np.ndarray) -> tuple[list[float], float, list[float]] | None:
    """Return offset, rotation (radians) and scale of an affine matrix (3, 3) of texture coordinates, v downwards: it scales first, then
    rotates from v to u, then moves. None if it cannot be divided like this."""
    first, second = matrix[:2, 0], matrix[:2, 1]
    rotation = math.atan2(-first[1], first[0])
    scale = float(np.hypot(*first)), float(second @ [math.sin(rotation), math.cos(rotation)])
    shear = abs(float(second @ [math.cos(rotation), -math.sin(rotation)]))
    if min(map(abs, scale)) <= 0.0 or not shear <= MAX_SHEAR * abs(scale[1]):
        return None
    return matrix[:2, 2].tolist(), rotation, list(scale)
