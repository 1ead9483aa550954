"""Switch distances: from where a coarser level looks the same as its finer neighbor (section IV, measured with FLIP).

What a viewer sees depends on the size of a pixel on the object. It is the error of a level in the sense of clouds: a level shows while a
pixel is larger than its error, `geometry.cameras` converts errors to distances of a camera and back.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...geometry.directions import fibonacci_sphere
from ...jobs.memory import release_memory
from ...jobs.progress import Progress, Steps
from ..settings import TexmeshSettings
from .level_images import TIERS, Difference, LevelComparison, LevelImages, measure_difference
from .views import ViewedSurface, frame_around

MIN_IMAGE = 1  # pixels per side of the smallest image that is compared
COVERED_IMAGE = (1920, 1080)  # pixels of the image whose covered fraction determines the level in glTF
SIZES = (32, 64, 128, 256, 512, 1024, 2048)  # pixels per side, of a first search
RELATIVE_PRECISION = 0.03  # Relative precision of sizes.
CLOSE_RATIO = 0.97  # A size is not enlarged any more from this fraction of the visible difference on.
AIMED_RATIO = 0.985  # at the next size that is tried
MIN_PART, MAX_PART = 0.15, 0.85  # The next size is within this part of the interval between two sizes.
MIN_SWITCH_RATIO = 1.25  # Ratio of the sizes at two switches in a row; a level between closer ones would hardly be shown.
PAIR_FACTOR = 0.55  # Time that the comparison of a pair of levels takes, relative to the finer pair before it.


@dataclass(frozen=True)
class Switch:
    """From where on a coarse level may replace its finer neighbor.

    Attributes:
        pixel_size: the smallest size of a pixel in the object's unit at which they look the same, `farfield_error` of the coarse level.
        pixels: side of the object's image there.
        difference, local_difference: mean and 95th percentile of FLIP over the object's pixels, of the views where they are largest.
        limit: "nearest" if they look the same even in the largest image that was compared, "farthest" if they differ even in the smallest,
            "" otherwise.
    """

    pixel_size: float
    pixels: int
    difference: float
    local_difference: float
    limit: Literal["", "nearest", "farthest"]


def open_images(levels: Sequence[ViewedSurface], settings: TexmeshSettings, opened: Sequence[LevelImages] = ()) -> list[LevelImages]:
    """Return the images of `levels` of one object, finest first, in all views around it. Those of the first ones may be `opened` already,
    others are not rendered yet."""
    frame, directions = frame_around(levels[0].vertices), fibonacci_sphere(settings.views)
    added = [LevelImages(level, frame, directions, settings.pixels_per_degree) for level in levels[len(opened) :]]
    return [*opened, *added]


def find_switches(images: Sequence[LevelImages], settings: TexmeshSettings, gap: int = 0) -> Steps[list[Switch]]:
    """Return a switch for each of the levels but the first, finest first: from where on it may replace its finer neighbor.

    The search goes from small images to larger ones up to the first in which a difference is seen, so that none is seen from farther away.
    It ends `gap` pixels below the size at which the finer neighbor replaces its own, so that sizes of images do not increase along the
    chain: no level switches nearer than a finer one. With a gap, every level is shown from some distances, down to one pixel.
    """
    search, switches, largest = _PairSearch(images, settings), [], settings.max_image
    for index in range(1, len(images)):
        yield Progress(1.0 - PAIR_FACTOR ** (index - 1), f"Comparing level {index} of {len(images) - 1}")
        switches.append(search.run(index - 1, index, largest))
        largest = max(switches[-1].pixels - gap, MIN_IMAGE)
        search.release(index - 1)
    search.release(len(images) - 1)
    return switches


def find_shown_levels(images: Sequence[LevelImages], settings: TexmeshSettings) -> Steps[tuple[list[int], list[Switch]]]:
    """Return the indices of the levels that are shown from some distance, ascending from 0, and the switch of each but the first.

    See `find_switches`. Sizes of images at switches decrease at least by MIN_SWITCH_RATIO. A level is left out if a coarser one can replace
    the level before it in images that are nearly as large. If only the level itself can be replaced in these, the coarser one waits for
    smaller images.
    """
    search, shown, switches = _PairSearch(images, settings), [0], []
    for index in range(1, len(images)):
        yield Progress(1.0 - PAIR_FACTOR ** (index - 1), f"Comparing level {index} of {len(images) - 1}")
        switch = search.run(shown[-1], index, switches[-1].pixels if switches else settings.max_image)
        while switches and switch.pixels > (farthest := _next_pixels(switches[-1].pixels)):
            instead = search.run(shown[-2], index, switches[-2].pixels if len(switches) > 1 else settings.max_image)
            if instead.pixels <= farthest:
                switch = search.run(shown[-1], index, max(farthest, MIN_IMAGE))
                break
            search.release(shown.pop())
            switches.pop()
            switch = instead
        if switches and switch.pixels > _next_pixels(switches[-1].pixels):  # that of the smallest image
            break
        search.release(shown[-1])
        shown.append(index)
        switches.append(switch)
    search.release(len(images) - 1)
    return shown, switches


def _next_pixels(pixels: int) -> int:
    """Return the largest size of images at the switch after one at `pixels`, 0 if there is none."""
    return int(pixels / MIN_SWITCH_RATIO)


def level_coverages(pixel_sizes: Sequence[float], bounds: np.ndarray) -> tuple[float, ...]:
    """Return the fractions of an image of COVERED_IMAGE pixels down to which levels show, descending; the last one shows at any size.

    Args:
        pixel_sizes: at the switches to all levels but the finest, finest first. bounds: (2, 3), the lowest and highest position.
    """
    radius = 0.5 * float(np.linalg.norm(bounds[1] - bounds[0]))
    return (*(screen_coverage(size, radius, COVERED_IMAGE) for size in pixel_sizes), 0.0)


def screen_coverage(pixel_size: float, radius: float, image_size: tuple[int, int]) -> float:
    """Return the fraction of an image that an object covers where a pixel on it has the size `pixel_size`: that of a disc, at most 1.

    For MSFT_screencoverage of glTF. radius: of the object's bounding sphere, in its unit. image_size: width and height in pixels.
    """
    if radius >= pixel_size * np.hypot(*image_size):
        return 1.0
    return float(min(np.pi * (radius / pixel_size) ** 2 / (image_size[0] * image_size[1]), 1.0))


class _PairSearch:
    """Searches for the switches of pairs of levels with `images`, each beginning with the views where the last one found differences."""

    def __init__(self, images: Sequence[LevelImages], settings: TexmeshSettings) -> None:
        self._images, self._settings, self._ranking = images, settings, list(range(settings.views))

    def run(self, fine: int, coarse: int, largest: int) -> Switch:
        """Return the switch of two levels at up to `largest` pixels."""
        comparison = LevelComparison(self._images[fine], self._images[coarse], self._settings, self._ranking)
        switch = _search(comparison, largest)
        self._ranking = comparison.ranking
        return switch

    def release(self, index: int) -> None:
        """Release the large images of a level; those of the original, with which other levels may be compared, are kept."""
        if index:
            self._images[index].forget_larger(TIERS[0][0])
            release_memory()


def _search(comparison: LevelComparison, largest: int) -> Switch:
    """Return the switch of a pair of levels at up to `largest` pixels."""
    settings = comparison.settings
    same, seen = MIN_IMAGE, None
    found: Difference | None = None
    ratio = seen_ratio = 0.0
    for size in _climb(largest):
        difference = comparison.examine(size)
        if difference.is_seen(settings):
            seen, seen_ratio = size, float(difference.measure_ratios(settings).max())
            break
        same, found, ratio = size, difference, float(difference.measure_ratios(settings).max())
    limit = "nearest" if seen is None and same == settings.max_image else ""
    while seen is not None and seen - same > max(1.0, RELATIVE_PRECISION * same) and ratio < CLOSE_RATIO:
        size = _guess_crossing(same, ratio, seen, seen_ratio)
        difference = comparison.examine(size)
        if difference.is_seen(settings):
            seen, seen_ratio = size, float(difference.measure_ratios(settings).max())
        else:
            same, found, ratio = size, difference, float(difference.measure_ratios(settings).max())
    if found is None:
        found = measure_difference(comparison.fine, comparison.coarse, same, range(settings.views))
        limit = "farthest" if found.is_seen(settings) else ""
    return Switch(comparison.fine.frame.side / same, same, float(found.means.max()), float(found.highs.max()), limit)


def _climb(largest: int) -> list[int]:
    """Return the sizes, up to `largest`, at which a difference is looked for first."""
    return [size for size in SIZES if size < largest] + [largest]


def _guess_crossing(same: int, ratio: float, seen: int, seen_ratio: float) -> int:
    """Return a size between `same` and `seen` at which a difference, which is a power of the size, is just not seen. ratio, seen_ratio:
    differences at the two sizes, relative to the largest one that is not seen."""
    part = 0.5
    if ratio > 0.0 and seen_ratio > ratio:
        part = float(np.clip(math.log(AIMED_RATIO / ratio) / math.log(seen_ratio / ratio), MIN_PART, MAX_PART))
    return min(max(round(same * (seen / same) ** part), same + 1), seen - 1)


@dataclass(eq=False)
class SwitchCheck:
    """The physical check of levels that are to be dropped, for `major_scales.keep_visible_scales`.

    images: of all levels, finest first. pixel_sizes: for each level the smallest size of a pixel at which it is shown, ascending, by
    `find_switches`, which has compared each level with the one before it.
    """

    images: Sequence[LevelImages]
    pixel_sizes: Sequence[float]
    settings: TexmeshSettings

    def __call__(self, fine: int, coarse: int) -> bool:
        """Return whether level `coarse` looks like level `fine` from the distance from which `fine` is shown on."""
        side = self.images[fine].frame.side
        nearest = max(self.pixel_sizes[fine], side / self.settings.max_image)
        if coarse == fine + 1:
            return bool(self.pixel_sizes[coarse] <= nearest)
        largest = max(int(side / nearest), MIN_IMAGE)
        comparison = LevelComparison(self.images[fine], self.images[coarse], self.settings, list(range(self.settings.views)))
        is_same = not any(comparison.examine(size).is_seen(self.settings) for size in _climb(largest))
        for level in self.images[1:]:
            level.forget_larger(TIERS[0][0])
        return is_same
