"""The layers of the surface that a level shows, see `surface_layers`: as arrays, and as images or constants of its material."""

from collections.abc import Mapping
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.billboards.cloud import Level
from ...core.imaging.images import MIN_ALPHA, mean_over_coverage
from ...core.imaging.metrics import encode_srgb
from ..imaging.images import create_image
from ..shading.surface_layers import BLACK, COAT, DATA_LAYERS, DEFAULT_VALUES, HDR_LAYERS

MIN_DIFFERENCE = 1.0 / 512.0  # Half a step of an 8-bit image: smaller ones cannot be seen.
MAX_THICKNESS = 0.02  # Of a leaf, relative to twice the error; nothing gets through twice that.
MAX_PANES = 8.0  # Largest number of panes behind each other on one quad.
MIN_COVERAGE = 0.1  # Of texels whose values count; with less they are noisy.


@dataclass(frozen=True, eq=False)
class LayerMaps:
    """One layer of a level.

    Attributes:
        scale: what the values are multiplied with.
        sides: per side of SIDES values (H, W, 3) float32 in 0..1, scene-linear or data; without backs that nobody sees, or that are like
            the fronts; empty if all texels have the value `constant`.
        constant: the value of every texel if they have the same, in 0..1.
    """

    scale: float
    sides: Mapping[str, np.ndarray]
    constant: tuple[float, float, float] | None = None


def separate_glass(color: np.ndarray, transmission: np.ndarray, level: Level) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Separate what glass lets through from two renders (H, W, 4): `color`, in which glass is transparent, and `transmission`, in which
    it is opaque.

    Returns the color with the coverage of all surfaces including glass, the transmission weighted with it, and the mean (H, W) by which
    the latter made the color transparent. Several panes behind each other let through their product; the backs of solids are not seen, so
    that their fronts stand for both.
    """
    coverage = transmission[..., 3:]
    through = np.clip(coverage[..., 0] - color[..., 3], 0.0, 1.0)
    through[through < MIN_DIFFERENCE] = 0.0
    pane_color = np.clip(transmission[..., :3] / np.maximum(coverage, MIN_ALPHA), MIN_ALPHA, 1.0)
    mean = np.clip(through / np.maximum(coverage[..., 0], MIN_ALPHA), MIN_ALPHA, 1.0)
    panes = np.clip(np.log(mean) / np.minimum(np.log(pane_color.mean(axis=2)), -MIN_DIFFERENCE), 1.0, MAX_PANES)
    product = pane_color ** panes[..., None]
    product *= np.where(through > 0.0, mean / product.mean(axis=2), 0.0)[..., None]
    for x, y, width, height in level.atlas.rectangles[level.solid]:
        product[y : y + height, x : x + width] **= 2
    opaque_color = np.concatenate([color[..., :3], coverage], axis=2)
    return opaque_color, np.concatenate([np.clip(product, 0.0, 1.0) * coverage, coverage], axis=2), through


def shade_translucency(render: np.ndarray, front_depth: np.ndarray, back_depth: np.ndarray, level: Level) -> np.ndarray:
    """Return a `render` (H, W, 4) of the translucency, darkened where surfaces on the same quad keep the light from each other.

    Light along the normal reaches a texel where both sides of the quad show the same surface, such as a leaf: where the depths in their
    renders (H, W, 4) agree. Light at an angle passes other texels, so that the mean of the quad counts for it.
    """
    depths = [render[..., 2] / np.maximum(render[..., 3], MIN_ALPHA) for render in (front_depth, back_depth)]
    free = np.clip(2.0 - np.abs(depths[0] - depths[1]) / MAX_THICKNESS, 0.0, 1.0)
    shaded = render.copy()
    shaded[..., :3] *= free[..., None]
    for x, y, width, height in level.atlas.rectangles:
        area = (slice(y, y + height), slice(x, x + width), slice(3))
        total = float(render[area].sum())
        if total > 0.0:
            shaded[area] *= float(shaded[area].sum()) / total
    return shaded


def compute_layer(name: str, renders: Mapping[str, np.ndarray], level: Level) -> LayerMaps | None:
    """Compute a layer from its premultiplied `renders` (H, W, 4) by side; None if no texel has it."""
    quads = level.atlas.quad_map
    sides = {side: mean_over_coverage(render, maximum=np.inf, regions=quads) for side, render in renders.items()}
    known = np.concatenate([sides[side][render[..., 3] > MIN_COVERAGE] for side, render in renders.items()])
    if not len(known):
        return None
    largest = float(known.max())
    scale = 1.0 if name not in HDR_LAYERS or largest <= 0.0 else largest
    if name == COAT and known[:, 0].max() < MIN_DIFFERENCE:
        for values in (known, *sides.values()):
            values[..., 1] = DEFAULT_VALUES[COAT][1]
    tolerance = MIN_DIFFERENCE * scale
    if np.abs(known - DEFAULT_VALUES[name]).max() < tolerance or (largest < MIN_DIFFERENCE and DEFAULT_VALUES[name] == BLACK):
        return None
    if np.ptp(known, axis=0).max() < tolerance:
        return LayerMaps(scale, {}, tuple((known.mean(axis=0) / scale).tolist()))
    scaled = {side: np.clip(values / scale, 0.0, 1.0) for side, values in sides.items()}
    if len(scaled) > 1 and _is_alike(*(np.dstack([scaled[side], renders[side][..., 3]]) for side in scaled)):
        del scaled["back"]
    return LayerMaps(scale, scaled)


def _is_alike(front: np.ndarray, back: np.ndarray) -> bool:
    """Return whether the values of both sides differ by no visible amount where both have some, and cover the same."""
    both = np.minimum(front[..., 3], back[..., 3]) > MIN_COVERAGE
    is_covered_alike = np.abs(front[..., 3] - back[..., 3]).mean() < MIN_DIFFERENCE
    return bool(is_covered_alike and both.any() and np.abs(front - back)[both].max() < 2.0 * MIN_DIFFERENCE)


def create_layer_images(name: str, layer: str, maps: LayerMaps) -> dict[str, bpy.types.Image]:
    """Create packed images of the sides of a layer, named after the level called `name`; by side, "Front" and "Back"."""
    images, is_data = {}, layer in DATA_LAYERS
    for side, values in maps.sides.items():
        encoded = values if is_data else encode_srgb(values)
        pixels = np.concatenate([encoded, np.ones_like(encoded[..., :1])], axis=2)
        images[side.title()] = create_image(f"{name} {side.title()} {layer.title()}", pixels, is_data)
    return images
