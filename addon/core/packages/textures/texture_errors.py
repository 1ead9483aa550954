"""How much viewers notice of errors of a texture: FLIP between the texture and a coded one, minified as images of the object show them."""

import math
from collections.abc import Iterator

import numpy as np

from ...imaging.colors import LINEAR_OF_BYTE, decode_signed_srgb, encode_signed_srgb
from ...imaging.flip import FlipImage, compare, filter_radius, prepare_image
from ...imaging.images import decode_normals, to_bytes
from ...imaging.mipmaps import Mipmaps, build_mipmaps
from ...jobs.chunks import map_ordered
from .enlarging import blur_as_enlarged, enlarge
from .visibility import BLOCK, FOOTPRINT_STEP, level_footprints

COLOR_ROLES = {"base_color", "emission"}
SMALLER_SIZES = 3  # sizes of the object in the image that errors are measured for in addition, each half of the one before
DATA_WEIGHT = 0.08  # Weight of errors of roughness and the like, which change images less than colors do.
LIGHTS = np.float32([[0.5, 0.5, 0.7071], [-0.5, 0.5, 0.7071]])  # in which errors of normals are seen
MIN_FRACTION = 0.1  # Resolutions that a smaller fraction of the object's pixels shows count as the next one.
STRIP_ROWS = 512  # compared at once
Strip = tuple[np.ndarray, slice]


def values_of_bytes(role: str) -> np.ndarray:
    """Return the value (256,) float32 of each byte of an image that is averaged when it is minified: linear colors, or data."""
    return LINEAR_OF_BYTE if role in COLOR_ROLES else np.arange(256, dtype=np.float32) / np.float32(255.0)


def to_values(role: str, image: np.ndarray) -> np.ndarray:
    """Return the values (H, W, 3) float32 of an image (H, W, 3) uint8, see `values_of_bytes`."""
    return values_of_bytes(role)[image]


def encode_bytes(role: str, values: np.ndarray) -> np.ndarray:
    """Return the image of values. Inverts `to_values`."""
    return to_bytes(encode_signed_srgb(values) if role in COLOR_ROLES else values)


class TextureErrors:
    """Measures errors of a texture.

    role: of the texture. mipmaps: of its values (H, W, 3), padded to whole tiles. visibility: (H / 8, W / 8, FOOTPRINT_LEVELS) float32, the
    fraction of the object's pixels that show a block at a level of footprints. All have row 0 at the top.
    """

    def __init__(self, role: str, mipmaps: Mipmaps, visibility: np.ndarray, pixels_per_degree: float) -> None:
        self._role, self._pixels_per_degree = role, pixels_per_degree
        self._sizes, self._shape = mipmaps.sizes.tolist(), visibility.shape[:2]
        self._weights = [merge_resolutions(halve_sizes(visibility, halvings), len(self._sizes)) for halvings in range(1 + SMALLER_SIZES)]
        self._references = {
            resolution: [list(map_ordered(self._prepare, self._cut(display))) for display in self._display(mipmaps.level(resolution))]
            for resolution in sorted({resolution for weights in self._weights for resolution in weights})
        }

    @property
    def finest(self) -> int:
        """The finest resolution that counts: the texture halved so many times."""
        return min(self._weights[0])

    def measure(self, image: np.ndarray, level: int) -> np.ndarray:
        """Return the error (1 + SMALLER_SIZES, H / 8, W / 8) of each block, times the fraction of the object's pixels that show it, in
        images of the object with the size of `visibility`, and in smaller ones.

        image: (ceil(H / 2^level), ceil(W / 2^level), 3) uint8. It is shown enlarged to the size of the texture.
        """
        mipmaps = build_mipmaps(blur_as_enlarged(image) if level else image, values_of_bytes(self._role))
        errors = np.zeros((len(self._weights), *self._shape))
        for resolution in self._references:
            if resolution >= level:
                values = mipmaps.level(resolution - level)
            else:
                width, height = self._sizes[resolution]
                values = to_values(self._role, enlarge(image, level - resolution)[:height, :width])
            displays = self._display(values)
            for display, references in zip(displays, self._references[resolution], strict=True):
                found = np.concatenate(list(map_ordered(self._compare, zip(references, self._cut(display), strict=True))))
                blocks = average_blocks(found, resolution, self._shape) / len(displays)
                for size, weights in zip(errors, self._weights, strict=True):
                    size += weights.get(resolution, 0.0) * blocks
        return errors if self._role in (*COLOR_ROLES, "alpha", "normal") else DATA_WEIGHT * errors

    def _display(self, values: np.ndarray) -> list[np.ndarray]:
        """Return linear images (H, W, 3) in which viewers notice errors."""
        if self._role in COLOR_ROLES:
            return [values]
        if self._role != "normal":
            return [decode_signed_srgb(values).astype(np.float32)]
        shading = np.maximum(decode_normals(values.reshape(-1, 3)) @ LIGHTS.T, 0.0).reshape(*values.shape[:2], -1)
        return [np.repeat(shading[..., light, None], 3, axis=2) for light in range(len(LIGHTS))]

    def _cut(self, display: np.ndarray) -> Iterator[Strip]:
        """Yield strips of an image (H, W, 3), and which of their rows are not only there because FLIP looks at them from others."""
        margin = 2 * filter_radius(self._pixels_per_degree)
        for start in range(0, len(display), STRIP_ROWS):
            first = max(start - margin, 0)
            kept = slice(start - first, min(start + STRIP_ROWS, len(display)) - first)
            yield display[first : start + STRIP_ROWS + margin], kept

    def _prepare(self, strip: Strip) -> FlipImage:
        return prepare_image(strip[0], self._pixels_per_degree, is_linear=True)

    def _compare(self, pair: tuple[FlipImage, Strip]) -> np.ndarray:
        reference, strip = pair
        return compare(reference, self._prepare(strip))[strip[1]]


def halve_sizes(visibility: np.ndarray, halvings: int) -> np.ndarray:
    """Return the visibility in images whose sides are halved so many times: each pixel has more texels. See `TextureErrors`."""
    steps = round(halvings / FOOTPRINT_STEP)
    if not steps:
        return visibility
    moved = np.zeros_like(visibility)
    moved[..., steps:] = visibility[..., :-steps]
    moved[..., -1] += visibility[..., -steps:].sum(axis=2)
    return moved


def merge_resolutions(visibility: np.ndarray, count: int) -> dict[int, np.ndarray]:
    """Return the fraction (H / 8, W / 8) of pixels that show each block at a resolution of the texture, halved 0 to `count` - 1 times.

    Resolutions that less than MIN_FRACTION of all show are counted as the next finer one that is left, or the finest of those.

    visibility: see `TextureErrors`.
    """
    halvings = np.clip(np.rint(np.log2(level_footprints())), 0, count - 1).astype(np.int64)
    fractions = np.bincount(halvings, visibility.sum(axis=(0, 1)), count)
    kept = np.flatnonzero(fractions >= MIN_FRACTION * fractions.sum())
    kept = kept if fractions.any() else np.array([0])
    owners = kept[np.maximum(np.searchsorted(kept, halvings, side="right") - 1, 0)]
    return {resolution: visibility[..., owners == resolution].sum(axis=2, dtype=np.float64) for resolution in kept.tolist()}


def average_blocks(values: np.ndarray, resolution: int, shape: tuple[int, int]) -> np.ndarray:
    """Return the means (R, C) = `shape` over the blocks of a texture of `values` (H, W) at this resolution."""
    side = BLOCK >> resolution
    if side == 0:
        scale = (1 << resolution) // BLOCK
        return values.repeat(scale, axis=0).repeat(scale, axis=1)[: shape[0], : shape[1]]
    rows, columns = math.ceil(len(values) / side), math.ceil(values.shape[1] / side)
    padded = np.pad(values, ((0, rows * side - len(values)), (0, columns * side - values.shape[1])), mode="edge")
    return padded.reshape(rows, side, columns, side).mean(axis=(1, 3))[: shape[0], : shape[1]]
