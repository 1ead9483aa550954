"""Materials of packages as those of glTF files."""

from collections.abc import Callable, Sequence

import numpy as np

from ..files.glb import Document
from ..imaging.coded_images import encode
from .material_sources import MaterialSource

QUALITY = 95  # Quality of JPEG.
PACKED = ("occlusion", "roughness", "metallic")  # roles in the channels of one image


def describe_materials(materials: Sequence[MaterialSource]) -> Document:
    """Return the lists `materials`, `textures` and `images` of a document, see `files.glb`. Equal images are one."""
    contents: list[bytes] = []
    found: dict[tuple[int, ...], int] = {}

    def add(images: Sequence[np.ndarray | None], join: Callable[[], np.ndarray]) -> Document:
        """Return a reference to the texture that `join` makes of `images`."""
        key = tuple(map(id, images))
        if key not in found:
            found[key] = len(contents)
            image = join()
            contents.append(encode(image, "png" if image.shape[2] == 4 else "jpeg", QUALITY))
        return {"index": found[key]}

    described = [_describe(material, add) for material in materials]
    textures = [{"source": index} for index in range(len(contents))]
    return {"materials": described, "textures": textures, "images": [{"content": content} for content in contents]}


def _describe(material: MaterialSource, add: Callable[[Sequence[np.ndarray | None], Callable[[], np.ndarray]], Document]) -> Document:
    shading, images = material.shading, material.images
    surface: Document = {
        "baseColorFactor": list(material.base_color),
        "metallicFactor": shading.metallic,
        "roughnessFactor": shading.roughness,
    }
    result: Document = {"name": material.name, "pbrMetallicRoughness": surface}
    color, alpha = images.get("base_color"), images.get("alpha")
    if color is not None or alpha is not None:
        surface["baseColorTexture"] = add([color, alpha], lambda: _join_alpha(color, alpha))
    packed = [images.get(role) for role in PACKED]
    if any(image is not None for image in packed):
        texture = add(packed, lambda: np.stack(_match(packed), axis=2))
        surface |= {"metallicRoughnessTexture": texture} if any(image is not None for image in packed[1:]) else {}
        result |= {"occlusionTexture": texture} if packed[0] is not None else {}
    for role, name, factors in (("normal", "normalTexture", {"scale": shading.normal_scale}), ("emission", "emissiveTexture", {})):
        image = images.get(role)
        if image is not None:
            result[name] = add([image], lambda image=image: image) | factors
    strength, extensions = max(1.0, *shading.emission), {}
    if any(shading.emission):
        result["emissiveFactor"] = [value / strength for value in shading.emission]
    if strength > 1.0:
        extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
    if shading.is_unlit:
        extensions["KHR_materials_unlit"] = {}
    result |= {"extensions": extensions} if extensions else {}
    result |= {"alphaMode": shading.alpha_mode.upper()} if shading.alpha_mode != "opaque" else {}
    result |= {"alphaCutoff": shading.alpha_cutoff} if shading.alpha_mode == "mask" else {}
    return result | ({"doubleSided": True} if material.is_double_sided else {})


def _join_alpha(color: np.ndarray | None, alpha: np.ndarray | None) -> np.ndarray:
    """Return an image (H, W, 3 or 4) uint8 of a color and an opacity, of which one may be missing."""
    if alpha is None:
        return color
    colors, opacity = (np.full_like(alpha, 255), alpha[..., 0]) if color is None else (color, _resize(alpha[..., 0], color.shape))
    return np.dstack([colors, opacity])


def _match(images: Sequence[np.ndarray | None]) -> list[np.ndarray]:
    """Return the first channels (H, W) uint8 of images with the size of the largest one; white where one is missing."""
    shape = max((image.shape[:2] for image in images if image is not None), key=np.prod)
    return [np.full(shape, 255, np.uint8) if image is None else _resize(image[..., 0], shape) for image in images]


def _resize(values: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    """Return `values` (H, W) with as many rows and columns as `shape`, the nearest ones."""
    rows, columns = ((np.arange(count) * size) // count for count, size in zip(shape[:2], values.shape, strict=True))
    return values[rows][:, columns]
