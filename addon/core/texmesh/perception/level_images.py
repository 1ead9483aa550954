"""Images of the levels of an object as FLIP compares them, rendered when they are needed first and shared by all comparisons."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...imaging.flip import FlipImage, compare, filter_radius, prepare_image
from ...imaging.mipmaps import Mipmaps, build_mipmaps, resize_by_area
from ...jobs.chunks import map_ordered
from ..settings import TexmeshSettings
from .views import BACKGROUND, Frame, PlacedSamples, Render, ViewedSurface, place_samples, render, shade

# Renders for images up to a size: samples per side, and the divisor of the number of views. Differences are largest in the same views
# at all sizes, so that larger images are compared only where smaller ones differ most. Only images of the first row are so small that they
# need halved renders.
TIERS = ((128, 256, 1), (256, 512, 3), (512, 1024, 3), (1024, 2048, 4), (2048, 3072, 4))
MIN_SAMPLES = 2  # per pixel along each side, where a render has them
MIN_THREADED_SIZE = 64  # Images of this size or larger are made in several threads; smaller ones are not worth it.
VIEWS_AT_ONCE = 2
PERCENTILE = 95.0  # Percentile that is the local difference.


@dataclass(frozen=True)
class Difference:
    """Mean and 95th percentile (N,) of FLIP over the object's pixels in each of N views."""

    means: np.ndarray
    highs: np.ndarray

    def is_seen(self, settings: TexmeshSettings) -> bool:
        """Return whether the difference can be seen in any view."""
        return bool((self.measure_ratios(settings) > 1.0).any())

    def measure_ratios(self, settings: TexmeshSettings) -> np.ndarray:
        """Return the differences (N,) relative to the largest ones that cannot be seen."""
        return np.maximum(self.means / settings.max_difference, self.highs / settings.max_local_difference)


@dataclass(eq=False)
class LevelImages:
    """The images of one level.

    Attributes:
        surface: the level.
        frame: the square that all images of the object show.
        directions: (N, 3), towards the viewer of each view.
        pixels_per_degree: of the display.
        placed: where the samples of renders are, by view and samples per side, None not to keep it for other textures.
        renders: by view and samples per side.
        images: as FLIP compares them, and their coverage, by view and pixels per side.
    """

    surface: ViewedSurface
    frame: Frame
    directions: np.ndarray
    pixels_per_degree: float
    placed: dict[tuple[int, int], PlacedSamples] | None = None
    renders: dict[tuple[int, int], Mipmaps] = field(default_factory=dict)
    images: dict[tuple[int, int], tuple[FlipImage, np.ndarray]] = field(default_factory=dict)

    def get(self, view: int, size: int) -> tuple[FlipImage, np.ndarray]:
        """Return the image of a view with `size` pixels per side as FLIP compares it, and its coverage (bool),
        with a border of background as wide as the viewer's blur."""
        if (view, size) not in self.images:
            samples = next(samples for limit, samples, _ in TIERS if size <= limit)
            if (view, samples) not in self.renders:
                full = self._render(view, samples)
                layers = np.concatenate([full.colors, full.coverage[..., None]], axis=2)
                self.renders[view, samples] = build_mipmaps(layers, min_side=1 if samples == TIERS[0][1] else samples)
            mipmaps = self.renders[view, samples]
            level = int((mipmaps.sizes[:, 0] >= MIN_SAMPLES * size).sum()) - 1
            layers = resize_by_area(mipmaps.level(max(level, 0)), size)
            padding = filter_radius(self.pixels_per_degree)
            colors = np.full((size + 2 * padding, size + 2 * padding, 3), BACKGROUND, np.float32)
            colors[padding : padding + size, padding : padding + size] = layers[..., :3]
            coverage = np.pad(layers[..., 3] > 0.0, padding)
            self.images[view, size] = prepare_image(colors, self.pixels_per_degree, is_linear=True), coverage
        return self.images[view, size]

    def replace_textures(self, textures: Sequence[Mipmaps | None]) -> "LevelImages":
        """Return images of the level with other textures of the same sizes. They share `placed`."""
        return replace(self, surface=replace(self.surface, textures=textures), renders={}, images={})

    def forget_textures(self) -> None:
        """Release textures and renders. Images that are there stay; `replace_textures` makes others."""
        self.surface, self.renders = replace(self.surface, textures=()), {}

    def _render(self, view: int, samples: int) -> Render:
        if self.placed is None:
            return render(self.surface, self.directions[view], self.frame, samples)
        if (view, samples) not in self.placed:
            self.placed[view, samples] = place_samples(self.surface, self.directions[view], self.frame, samples)
        return shade(self.placed[view, samples], self.surface.textures)

    def forget_larger(self, size: int) -> None:
        """Release renders and images that are larger than `size` pixels per side."""
        self.renders = {key: value for key, value in self.renders.items() if key[1] <= MIN_SAMPLES * size}
        self.images = {key: value for key, value in self.images.items() if key[1] <= size}


def measure_difference(fine: LevelImages, coarse: LevelImages, size: int, views: Sequence[int]) -> Difference:
    """Return the difference of two levels in images with `size` pixels per side, in each of `views`."""
    prepare_images([fine, coarse], views, size)
    means, highs = [], []
    for view in views:
        (first, first_coverage), (second, second_coverage) = fine.get(view, size), coarse.get(view, size)
        errors = compare(first, second)[first_coverage | second_coverage]
        means.append(float(errors.mean()) if len(errors) else 0.0)
        highs.append(float(np.percentile(errors, PERCENTILE)) if len(errors) else 0.0)
    return Difference(np.array(means), np.array(highs))


@dataclass(eq=False)
class LevelComparison:
    """Two levels that are compared at several sizes.

    ranking: all views, those first in which a difference was seen last, or was largest. Sizes that need fewer views than others must follow
    on smaller ones, which rank the views.
    """

    fine: LevelImages
    coarse: LevelImages
    settings: TexmeshSettings
    ranking: list[int]

    def examine(self, size: int) -> Difference:
        """Return the difference in images with `size` pixels per side. It ends with the first views in which it is seen; others are not
        looked at then."""
        divisor = next(divisor for limit, _, divisor in TIERS if size <= limit)
        views = self.ranking[: -(-self.settings.views // divisor)]
        parts: list[Difference] = []
        for start in range(0, len(views), VIEWS_AT_ONCE):
            parts.append(measure_difference(self.fine, self.coarse, size, views[start : start + VIEWS_AT_ONCE]))
            if parts[-1].is_seen(self.settings):
                break
        result = Difference(np.concatenate([part.means for part in parts]), np.concatenate([part.highs for part in parts]))
        order = np.argsort(-result.measure_ratios(self.settings), kind="stable")
        examined = [views[index] for index in order]
        self.ranking = examined + [view for view in self.ranking if view not in examined]
        return result


def prepare_images(levels: Sequence[LevelImages], views: Sequence[int], size: int) -> None:
    """Make the images of `levels` that are missing, several at once."""
    missing = [(level, view) for view in views for level in levels if (view, size) not in level.images]
    is_threaded = size >= MIN_THREADED_SIZE and len(missing) > 1
    for _ in (map_ordered if is_threaded else map)(lambda item: item[0].get(item[1], size), missing):
        pass
