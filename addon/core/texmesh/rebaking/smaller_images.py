"""Images with fewer texels: means over the surface that shows them, of linear light, of data or of normals."""

from collections.abc import Iterator, Sequence
from enum import Enum

import numpy as np

from ...geometry.transforms import normalize
from ...imaging.colors import LINEAR_OF_BYTE, encode_signed_srgb
from ...imaging.images import dilate, to_bytes
from ...imaging.mipmaps import shrink_by_area

FRACTION_OF_BYTE = (np.arange(256) / 255.0).astype(np.float32)
COMPONENT_OF_BYTE = 2.0 * FRACTION_OF_BYTE - 1.0  # Components of normals.


class Content(Enum):
    """What the values of an image are: colors of opaque surfaces; colors with an opacity; numbers; or normals in tangent space."""

    COLOR, TRANSPARENT_COLOR, DATA, NORMAL = range(4)


VALUES = {
    Content.COLOR: LINEAR_OF_BYTE,
    Content.TRANSPARENT_COLOR: LINEAR_OF_BYTE,
    Content.DATA: FRACTION_OF_BYTE,
    Content.NORMAL: COMPONENT_OF_BYTE,
}


def shrink_image(
    pixels: np.ndarray, coverage: np.ndarray | None, content: Content, sizes: Sequence[tuple[int, int]]
) -> Iterator[np.ndarray]:
    """Yield an image in several sizes, as values (H, W, 3 or 4) float32: linear light, data, or unit normals. There is a fourth channel if
    alpha counts, which weights colors with an opacity.

    Args:
        pixels: (H, W, 3 or 4) uint8, row 0 at the bottom. coverage: (H, W), 1 at texels that count; texels without any are filled from
            their neighbors. None if all count. sizes: widths and heights, descending.
    """
    has_alpha = pixels.shape[2] == 4 and content in (Content.TRANSPARENT_COLOR, Content.DATA)
    alpha = FRACTION_OF_BYTE[pixels[..., 3]] if has_alpha else None
    weights = np.ones(pixels.shape[:2], np.float32) if coverage is None else coverage
    color_weights = weights * alpha if has_alpha and content is Content.TRANSPARENT_COLOR else weights
    planes = [shrink_by_area((VALUES[content][pixels[..., index]] * color_weights)[..., None], sizes[0]) for index in range(3)]
    planes += [shrink_by_area(plane[..., None], sizes[0]) for plane in (color_weights, *([alpha * weights, weights] if has_alpha else []))]
    shrunk = np.concatenate(planes, axis=2)
    for size in sizes:
        shrunk = shrink_by_area(shrunk, size)
        values = _divide(shrunk[..., :3], shrunk[..., 3])
        if content is Content.NORMAL:
            values = normalize(values).astype(np.float32)
        yield np.concatenate([values, _divide(shrunk[..., 4:5], shrunk[..., 5])], axis=2) if has_alpha else values


def to_pixels(values: np.ndarray, content: Content) -> np.ndarray:
    """Return values from `shrink_image` as the pixels (H, W, 3 or 4) uint8 of a file. Opaque pixels have no alpha."""
    colors, alpha = values[..., :3], values[..., 3:]
    if content is Content.NORMAL:
        colors = 0.5 + 0.5 * colors
    elif content is not Content.DATA:
        colors = encode_signed_srgb(colors)
    pixels = to_bytes(np.concatenate([colors, alpha], axis=2))
    return pixels[..., :3] if pixels.shape[2] == 4 and (pixels[..., 3] == 255).all() else pixels


def _divide(sums: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return means (H, W, C) of weighted sums; texels without a weight continue their neighbors."""
    means = sums / np.where(weights > 0.0, weights, 1.0)[..., None]
    return means if weights.min() > 0.0 or weights.max() <= 0.0 else dilate(means, np.minimum(weights, 1.0))
