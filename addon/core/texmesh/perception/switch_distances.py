"""Switch distances: from where a coarser level looks the same as its finer neighbor (section IV, measured with FLIP).

What a viewer sees depends on the size of a pixel on the object. It is the error of a level in the sense of clouds: a level shows while a
pixel is larger than its error, `geometry.cameras` converts errors to distances of a camera and back.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ...imaging.flip import FlipImage, compare, filter_radius, prepare_image
from ...imaging.mipmaps import Mipmaps, build_mipmaps, resize_by_area
from ...jobs.progress import Progress, Steps
from .settings import PerceptionSettings
from .views import BACKGROUND, Frame, ViewedSurface, frame_around, render, turning_directions

MIN_IMAGE = 1  # pixels per side of the smallest image that is compared
SIZES = (32, 64, 128, 256, 512, 1024, 2048)  # pixels per side, of a first search
# Renders for images up to a size: samples per side, and the divisor of the number of views. Differences are largest in the same views
# at all sizes, so that larger images are compared only where smaller ones differ most.
TIERS = ((128, 256, 1), (512, 1024, 3), (1024, 2048, 4), (2048, 3072, 4))
MIN_SAMPLES = 2  # per pixel along each side, where a render has them
PERCENTILE = 95.0  # of the local difference
RELATIVE_PRECISION = 0.03  # of sizes


@dataclass(frozen=True)
class Switch:
    """From where on a coarse level may replace its finer neighbor.

    pixel_size: the smallest size of a pixel in the object's unit at which they look the same, `farfield_error` of the coarse level.
    pixels: side of the object's image there. difference, local_difference: mean and 95th percentile of FLIP over the object's pixels, of
    the views where they are largest. is_exact: False if they look the same even in the largest image that was compared, or differ even in
    the smallest.
    """

    pixel_size: float
    pixels: int
    difference: float
    local_difference: float
    limit: Literal["", "nearest", "farthest"]


@dataclass(frozen=True)
class Difference:
    """Mean and 95th percentile (N,) of FLIP over the object's pixels in each of N views."""

    means: np.ndarray
    highs: np.ndarray

    def is_seen(self, settings: PerceptionSettings) -> bool:
        """Return whether the difference can be seen in any view."""
        return bool(self.means.max() > settings.max_difference or self.highs.max() > settings.max_local_difference)

    def rank_views(self, settings: PerceptionSettings) -> np.ndarray:
        """Return the order of the views, the one with the largest difference first."""
        relative = np.maximum(self.means / settings.max_difference, self.highs / settings.max_local_difference)
        return np.argsort(-relative, kind="stable")


@dataclass(eq=False)
class LevelImages:
    """The images of one level, rendered when they are needed first."""

    surface: ViewedSurface
    frame: Frame
    directions: np.ndarray
    pixels_per_degree: float
    renders: dict[tuple[int, int], Mipmaps] = field(default_factory=dict)
    images: dict[tuple[int, int], tuple[FlipImage, np.ndarray]] = field(default_factory=dict)

    def get(self, view: int, size: int) -> tuple[FlipImage, np.ndarray]:
        """Return the image of a view with `size` pixels per side as FLIP compares it, and its coverage (bool),
        with a border of background as wide as the viewer's blur."""
        if (view, size) not in self.images:
            samples = next(samples for limit, samples, _ in TIERS if size <= limit)
            if (view, samples) not in self.renders:
                full = render(self.surface, self.directions[view], self.frame, samples)
                self.renders[view, samples] = build_mipmaps(np.concatenate([full.colors, full.coverage[..., None]], axis=2))
            mipmaps = self.renders[view, samples]
            level = int((mipmaps.sizes[:, 0] >= MIN_SAMPLES * size).sum()) - 1
            layers = resize_by_area(mipmaps.level(max(level, 0)), size)
            padding = filter_radius(self.pixels_per_degree)
            colors = np.full((size + 2 * padding, size + 2 * padding, 3), BACKGROUND, np.float32)
            colors[padding : padding + size, padding : padding + size] = layers[..., :3]
            coverage = np.pad(layers[..., 3] > 0.0, padding)
            self.images[view, size] = prepare_image(colors, self.pixels_per_degree, is_linear=True), coverage
        return self.images[view, size]

    def forget_larger(self, size: int) -> None:
        """Release renders and images that are larger than `size` pixels per side."""
        self.renders = {key: value for key, value in self.renders.items() if key[1] <= 2 * size}
        self.images = {key: value for key, value in self.images.items() if key[1] <= size}


def find_switches(levels: Sequence[ViewedSurface], settings: PerceptionSettings) -> Steps[list[Switch]]:
    """Return a switch for each of `levels` but the first, finest first: from where on it may replace its finer neighbor.

    Levels must be those of one object. The search goes from small images to larger ones up to the first in which a difference is seen, so
    that none is seen from farther away. Sizes of pixels grow along the chain.
    """
    frame = frame_around(levels[0].vertices)
    directions = turning_directions(settings.views)
    coarse = LevelImages(levels[0], frame, directions, settings.pixels_per_degree)
    switches: list[Switch] = []
    smallest = 0.0
    for index, level in enumerate(levels[1:]):
        fine, coarse = coarse, LevelImages(level, frame, directions, settings.pixels_per_degree)
        yield Progress(index / (len(levels) - 1), f"Comparing level {index + 1} of {len(levels) - 1}")
        switch = yield from _search(fine, coarse, settings, index, len(levels) - 1)
        smallest = max(smallest, switch.pixel_size)
        switches.append(replace(switch, pixel_size=smallest))
    return switches


def measure_difference(fine: LevelImages, coarse: LevelImages, size: int, views: Sequence[int]) -> Difference:
    """Return the difference of two levels in images with `size` pixels per side, in each of `views`."""
    means, highs = [], []
    for view in views:
        (first, first_coverage), (second, second_coverage) = fine.get(view, size), coarse.get(view, size)
        errors = compare(first, second)[first_coverage | second_coverage]
        means.append(float(errors.mean()) if len(errors) else 0.0)
        highs.append(float(np.percentile(errors, PERCENTILE)) if len(errors) else 0.0)
    return Difference(np.array(means), np.array(highs))


def screen_coverage(pixel_size: float, radius: float, image_size: tuple[int, int]) -> float:
    """Return the fraction of an image that an object covers where a pixel on it has the size `pixel_size`: that of a disc, at most 1.

    For MSFT_screencoverage of glTF. radius: of the object's bounding sphere, in its unit. image_size: width and height in pixels.
    """
    return float(min(np.pi * (radius / pixel_size) ** 2 / (image_size[0] * image_size[1]), 1.0))


def _search(fine: LevelImages, coarse: LevelImages, settings: PerceptionSettings, index: int, count: int) -> Steps[Switch]:
    """Return the switch of a pair of levels."""
    views: Sequence[int] = range(settings.views)
    same, seen = MIN_IMAGE, None
    found: Difference | None = None
    sizes = [size for size in SIZES if size < settings.max_image] + [settings.max_image]
    tier = 0
    for step, size in enumerate(sizes):
        while size > TIERS[tier][0]:
            tier += 1
            if found is not None:
                views = [views[position] for position in found.rank_views(settings)[: -(-settings.views // TIERS[tier][2])]]
        difference = measure_difference(fine, coarse, size, views)
        yield Progress((index + step / len(sizes)) / count, f"Comparing level {index + 1} of {count}")
        if difference.is_seen(settings):
            seen = size
            break
        same, found = size, difference
    limit = "" if seen is not None else "nearest"
    while seen is not None and seen - same > max(1.0, RELATIVE_PRECISION * same):
        size = (same + seen) // 2
        difference = measure_difference(fine, coarse, size, views)
        if difference.is_seen(settings):
            seen = size
        else:
            same, found = size, difference
    if found is None:
        found = measure_difference(fine, coarse, same, views)
        limit = "farthest" if found.is_seen(settings) else ""
    coarse.forget_larger(TIERS[0][0])
    return Switch(fine.frame.side / same, same, float(found.means.max()), float(found.highs.max()), limit)


@dataclass(eq=False)
class SwitchCheck:
    """The physical check of levels that are to be dropped, for `major_scales.keep_visible_scales`.

    images: of all levels, finest first. pixel_sizes: for each level the smallest size of a pixel at which it is shown, ascending.
    """

    images: Sequence[LevelImages]
    pixel_sizes: Sequence[float]
    settings: PerceptionSettings

    def __call__(self, fine: int, coarse: int) -> bool:
        """Return whether level `coarse` looks like level `fine` at the distance from which `fine` is shown."""
        nearest = self.images[fine].frame.side / self.settings.max_image
        size = max(int(self.images[fine].frame.side / max(self.pixel_sizes[fine], nearest)), MIN_IMAGE)
        difference = measure_difference(self.images[fine], self.images[coarse], size, range(self.settings.views))
        return not difference.is_seen(self.settings)
