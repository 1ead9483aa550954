"""Images with fewer texels: means over the surface that shows them, of linear light, of data or of normals."""

import math
from collections.abc import Iterator, Sequence
from enum import Enum

import numpy as np

from ...geometry.transforms import normalize
from ...imaging.colors import LINEAR_OF_BYTE, encode_signed_srgb
from ...imaging.images import dilate, to_bytes
from ...imaging.mipmaps import shrink_by_area
from ...jobs.chunks import slices

STRIP_ROWS = 512  # Rows of texels that are worked on at once.
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
        pixels: (H, W, 3 or 4) uint8, row 0 at the bottom. coverage: (H, W) bool, the texels that count; texels without any are filled from
            their neighbors. None if all count. sizes: widths and heights, descending.
    """
    has_alpha = pixels.shape[2] == 4 and content in (Content.TRANSPARENT_COLOR, Content.DATA)
    count = math.gcd(len(pixels), sizes[0][1])  # Parts in which whole rows of texels become whole rows of pixels.
    texel_rows, rows = len(pixels) // count, sizes[0][1] // count
    strips = []
    for part in slices(count, max(STRIP_ROWS // texel_rows, 1)):
        strip = slice(part.start * texel_rows, part.stop * texel_rows)
        weights = None if coverage is None else coverage[strip]
        height = (min(part.stop, count) - part.start) * rows
        strips.append(_shrink_strip(pixels[strip], weights, content, has_alpha, (sizes[0][0], height)))
    shrunk = np.concatenate(strips)
    for size in sizes:
        shrunk = shrink_by_area(shrunk, size)
        values = _divide(shrunk[..., :3], shrunk[..., 3])
        if content is Content.NORMAL:
            values = normalize(values).astype(np.float32, copy=False)
        yield np.concatenate([values, _divide(shrunk[..., 4:5], shrunk[..., 5])], axis=2) if has_alpha else values


def _shrink_strip(pixels: np.ndarray, coverage: np.ndarray | None, content: Content, has_alpha: bool, size: tuple[int, int]) -> np.ndarray:
    """Return the weighted means (h, w, 4 or 6) of the colors of `pixels` (H, W, 3 or 4), of their weights, and of alpha and its weights."""
    weights = np.ones((*pixels.shape[:2], 1), np.float32) if coverage is None else coverage[..., None].astype(np.float32)
    alpha = FRACTION_OF_BYTE[pixels[..., 3:]] if has_alpha else None
    color_weights = weights * alpha if has_alpha and content is Content.TRANSPARENT_COLOR else weights
    planes = [VALUES[content][pixels[..., :3]] * color_weights, color_weights, *([alpha * weights, weights] if has_alpha else [])]
    return np.concatenate([shrink_by_area(plane, size) for plane in planes], axis=2)


def to_pixels(values: np.ndarray, content: Content) -> np.ndarray:
    """Return values from `shrink_image` as the pixels (H, W, 3 or 4) uint8 of a file. Opaque pixels have no alpha."""
    pixels = np.concatenate([_encode(values[strip], content) for strip in slices(len(values), STRIP_ROWS)])
    return pixels[..., :3] if pixels.shape[2] == 4 and (pixels[..., 3] == 255).all() else pixels


def _encode(values: np.ndarray, content: Content) -> np.ndarray:
    colors, alpha = values[..., :3], values[..., 3:]
    if content is Content.NORMAL:
        colors = 0.5 + 0.5 * colors
    elif content is not Content.DATA:
        colors = encode_signed_srgb(colors)
    return to_bytes(np.concatenate([colors, alpha], axis=2))


def _divide(sums: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return means (H, W, C) of weighted sums; texels without a weight continue their neighbors."""
    means = sums / np.where(weights > 0.0, weights, 1.0)[..., None]
    return means if weights.min() > 0.0 or weights.max() <= 0.0 else dilate(means, np.minimum(weights, 1.0))
