"""Restores the missing parts of an image: diffusion for structure, synthesis for texture (Textures Revisited, section 5)."""

from dataclasses import dataclass, field

import numpy as np

from ..errors import ImageError
from ..imaging.diffusion import diffuse
from ..imaging.images import decode_normals
from ..jobs.chunks import slices
from ..jobs.progress import Progress, StageClock, Steps, subprogress
from .contours import join_contours
from .frequency_split import LowBand, choose_sub_bands
from .guidance import Look, build_guide, describe_page
from .levels import RADIUS, Page, build_levels
from .settings import RestoreSettings
from .texture import fill_texture
from .voting import complete
from .windows import Window, choose_areas, find_windows, group_windows

MIN_SIDE = 2 * RADIUS + 1
ROWS = 256  # rows of an image that are examined at once
MAX_VALUE = 1e12  # Squares of larger values leave single precision soon.
MIN_DEVIATION = 0.02  # The others are scaled to the deviation of the first map, or to this one if that is smaller.
MIN_EVENNESS = 0.5  # around a hole in which only copies of texture fit
FILLS_END = 0.25  # part of the time for the texture of holes that their completion by patches takes
MIN_SOURCES = 64  # pixels with a neighborhood that may be copied


@dataclass(frozen=True)
class Restoration:
    """The result of `restore`.

    Attributes:
        pixels: (H, W, C) float32, equal to the image outside the mask.
        sub_bands: number of sub-bands of the structure, -1 if all were.
        deviations: (K,) standard deviation of the autocorrelation for each number of sub-bands from 0 that was examined, empty if none was.
        hole_count: connected parts of the mask.
        seconds: by stage.
        stages: images (H, W, C) by name, if they were requested.
    """

    pixels: np.ndarray
    sub_bands: int
    deviations: np.ndarray
    hole_count: int
    seconds: dict[str, float]
    stages: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class _Options:
    """What all windows have in common.

    Attributes:
        settings: of the restoration.
        sub_bands: number of sub-bands of the structure.
        usable: (H, W) bool, pixels that may be copied.
        barriers: (H, W) bool, pixels that diffusion does not cross, or None.
        curves: (H, W) bool, pixels of contours that continue in holes, and the barriers.
    """

    settings: RestoreSettings
    sub_bands: int
    usable: np.ndarray
    barriers: np.ndarray | None
    curves: np.ndarray


def restore(
    image: np.ndarray,
    mask: np.ndarray,
    settings: RestoreSettings,
    *,
    source_mask: np.ndarray | None = None,
    barriers: np.ndarray | None = None,
    is_color: bool = True,
    further_maps: tuple[int, ...] = (),
    normal_channels: tuple[int, ...] = (),
    keep_stages: bool = False,
) -> Steps[Restoration]:
    """Fill the masked pixels of `image`.

    Args:
        image: (H, W, C) float32, within `MAX_VALUE` outside the mask: the 1 to 4 channels of one map, or those of several maps, in which
            the same pixels are copied. Colors are encoded for display (sRGB), so that errors count as much in shadows as in highlights;
            data is used as it is.
        mask: (H, W) bool, true where pixels are missing.
        settings: see `RestoreSettings`.
        source_mask: (H, W) bool, true where texture may be copied from; everywhere outside the mask by default.
        barriers: (H, W) bool, true at pixels that diffusion does not cross.
        is_color: the first three channels are sRGB colors; the split then follows CIE Y, otherwise the mean of all channels.
        further_maps: the first channel of each map after the first one, which alone decides about outlines and the split. The others count
            as much as the first one at most, however large their values are.
        normal_channels: the first one of each three channels that are normals 0.5 + 0.5 n, which are normalized again.
        keep_stages: return the images of the stages as well: first_fill, low, low_filled, high, high_filled; further maps are scaled there.

    Raises:
        ImageError: nothing or everything is masked, sizes differ, the image is too small, values are not finite or huge, too few pixels
            are left to copy texture from, or a normal map has less than three channels.
    """
    if any(channel + 3 > image.shape[2] for channel in normal_channels):
        raise ImageError(f"The normal map has {image.shape[2]} channels; three are necessary.")
    _check(image, mask, {"source mask": source_mask, "barrier mask": barriers})
    clock = StageClock()
    stages: dict[str, np.ndarray] = {}
    yield Progress(0.0, "Finding holes")
    with clock.stage("holes"):
        windows = find_windows(mask, settings.tileable)
    with clock.stage("first fill"):
        pixels = np.where(mask[..., None], np.float32(0.0), image).astype(np.float32, copy=False)
        means, scales = _balance(pixels, mask, further_maps)
        first = np.s_[..., : further_maps[0] if further_maps else image.shape[2]]
        curves = np.zeros_like(mask) if barriers is None else barriers.copy()
        for index, window in enumerate(windows):
            yield Progress(0.1 * index / len(windows), "Filling structure")
            smooth = diffuse(pixels[window.area], window.hole, _part(barriers, window), window.wrap)
            joined = join_contours(smooth[first], window.hole, ~mask[window.area])
            if joined.any():
                curves[window.area] |= joined
                smooth = diffuse(smooth, window.hole, curves[window.area], window.wrap)
            _write(pixels, window, smooth[window.hole])
    sub_bands, deviations = -1, np.zeros(0)
    if settings.split == "auto":
        yield Progress(0.1, "Choosing sub-bands")
        with clock.stage("kappa"):
            sub_bands, deviations = choose_sub_bands(pixels[first], is_color)
    elif settings.split == "manual" and settings.sub_bands < max(mask.shape):
        sub_bands = settings.sub_bands
    if keep_stages:
        stages["first_fill"] = pixels.copy()
    if sub_bands >= 0:
        options = _Options(settings, sub_bands, ~mask if source_mask is None else ~mask & source_mask, barriers, curves)
        yield from subprogress(_restore_texture(pixels, mask, windows, options, clock, stages), 0.15, 1.0)
    filled = pixels[mask]
    if further_maps:
        filled = filled / scales + means
        np.copyto(pixels, image, where=~mask[..., None])
    if sub_bands >= 0:
        filled = np.clip(filled, *_find_range(image, mask))
    for channel in normal_channels:
        filled[:, channel : channel + 3] = 0.5 + 0.5 * decode_normals(filled[:, channel:])
    pixels[mask] = filled
    return Restoration(pixels, sub_bands, deviations, len(windows), clock.seconds, stages)


def _balance(pixels: np.ndarray, mask: np.ndarray, further_maps: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Subtract the means of the known pixels from the channels of further maps, and scale each of these maps so that its standard
    deviation, of all of its channels together, is that of the first map at most.

    Changes `pixels` (H, W, C). Returns the means and the scales (C,) float32, 0 and 1 for the first map.
    """
    means, scales = np.zeros(pixels.shape[2], np.float32), np.ones(pixels.shape[2], np.float32)
    if not further_maps:
        return means, scales
    sums, squares, count = np.zeros(pixels.shape[2]), np.zeros(pixels.shape[2]), np.count_nonzero(~mask)
    for rows in slices(len(pixels), ROWS):
        known = pixels[rows][~mask[rows]].astype(np.float64)
        sums, squares = sums + known.sum(axis=0), squares + np.square(known).sum(axis=0)
    variances = np.maximum(squares / count - (sums / count) ** 2, 0.0)
    starts = (0, *further_maps)
    deviations = np.sqrt(np.add.reduceat(variances, starts))
    for start, stop, deviation in zip(further_maps, (*further_maps[1:], pixels.shape[2]), deviations[1:], strict=True):
        means[start:stop] = sums[start:stop] / count
        scales[start:stop] = min(1.0, max(deviations[0], MIN_DEVIATION) / max(deviation, 1e-12))
        pixels[..., start:stop] -= means[start:stop]
        pixels[..., start:stop] *= scales[start:stop]
    return means, scales


def _restore_texture(
    pixels: np.ndarray, mask: np.ndarray, windows: list[Window], options: "_Options", clock: StageClock, stages: dict[str, np.ndarray]
) -> Steps[None]:
    """Split the smoothly filled `pixels`, and write structure plus texture into the holes of all `windows`. Adds images to `stages` unless
    it is empty."""
    with clock.stage("split"):
        low_band = LowBand(pixels, options.sub_bands)
    if stages:
        low = low_band.evaluate(np.arange(pixels.shape[0]), np.arange(pixels.shape[1]))
        stages |= {"low": low, "low_filled": low.copy(), "high": pixels - low, "high_filled": pixels - low}
    results = []
    groups, total, done = group_windows(windows), int(mask.sum()), 0
    for group in groups:
        count = sum(int(window.hole.sum()) for window in group)
        start, stop = done / total, (done + count) / total
        fills_stop = start + FILLS_END * (stop - start)
        structures, pages, fills, looks, numbers = [], [], [], [], []
        for index, window in enumerate(group):
            with clock.stage("structure"):
                low = low_band.evaluate(window.rows, window.columns)
                structures.append(diffuse(low, window.hole, _part(options.barriers, window), window.wrap))
            pages.append(Page(pixels[window.area] - low, window.hole, ~mask[window.area], options.usable[window.area], window.wrap))
            if options.settings.method == "regions":
                looks.append(describe_page(pages[-1], options.curves[window.area]))
                with clock.stage("patches"):
                    steps = _build_fills(pixels[window.area], structures[-1], pages[-1], looks[-1], options.settings.seed)
                    parts = (start + (fills_stop - start) * part / len(group) for part in (index, index + 1))
                    found = yield from subprogress(steps, *parts)
                numbers.append([len(group) + len(fills) + number for number in range(len(found))])
                fills += found
        with clock.stage("pyramid"):
            pages += fills + _further_pages(pixels, mask, low_band, pages, options)
            levels = build_levels(pages, options.settings.pyramid_levels)
            sources = int(levels[0].valid.sum())
            if sources < MIN_SOURCES:
                raise ImageError(
                    f"Only {sources} pixels with unmasked neighborhoods of {MIN_SIDE} x {MIN_SIDE} pixels can be copied; at least "
                    f"{MIN_SOURCES} are necessary. Mask less, extend the source mask, or use Diffusion Only."
                )
        with clock.stage("texture"):
            guide = build_guide(levels[0], pages, looks, numbers) if fills else None
            yield from subprogress(fill_texture(pages, levels, guide, options.settings), fills_stop if fills else start, stop)
        done += count
        for index, (window, structure) in enumerate(zip(group, structures, strict=True)):
            texture = levels[0].page(index)
            results.append((window, (structure + texture)[window.hole]))
            if stages:
                _write(stages["low_filled"], window, structure[window.hole])
                _write(stages["high_filled"], window, texture[window.hole])
    for window, values in results:  # at the end, so that no hole copies from another one
        _write(pixels, window, values)


def _build_fills(pixels: np.ndarray, structure: np.ndarray, page: Page, look: Look, seed: int) -> Steps[list[Page]]:
    """Return pages with fills of the hole of `page`, without their `structure` (H, W, C): that of `pixels` (H, W, C), and one by patches,
    unless all surroundings are texture. A pixel of the hole may only be copied from the same pixel of a fill."""
    nothing = np.zeros_like(page.hole)
    is_texture = float(look.evenness[page.hole].min()) > MIN_EVENNESS
    fills = [pixels] if is_texture else [pixels, (yield from complete(pixels, page, seed))]
    return [Page(fill - structure, nothing, ~nothing, nothing, page.wrap) for fill in fills]


def _further_pages(pixels: np.ndarray, mask: np.ndarray, low_band: LowBand, pages: list[Page], options: "_Options") -> list[Page]:
    """Return parts of the image to copy from, if the windows `pages` have too little and the image has more."""
    if any(page.hole.shape == mask.shape for page in pages):
        return []
    sources = sum(int(page.usable.sum()) for page in pages)
    width = max(page.hole.shape[1] for page in pages)
    generator = np.random.default_rng([options.settings.seed, sources, width])
    further = []
    for area in choose_areas(mask.shape, width, sources, generator):
        structure = low_band.evaluate(*(np.arange(part.start, part.stop) for part in area))
        known = ~mask[area]
        further.append(Page(pixels[area] - structure, np.zeros_like(known), known, options.usable[area]))
    return further


def _check(image: np.ndarray, mask: np.ndarray, others: dict[str, np.ndarray | None]) -> None:
    height, width = image.shape[:2]
    if min(height, width) < MIN_SIDE:
        raise ImageError(f"The image has {width} x {height} pixels; at least {MIN_SIDE} x {MIN_SIDE} are necessary.")
    for name, other in ({"mask": mask} | others).items():
        if other is not None and other.shape != (height, width):
            raise ImageError(
                f"The {name} has {other.shape[1]} x {other.shape[0]} pixels and the image {width} x {height}; they must have the same size."
            )
    if not mask.any():
        raise ImageError("No pixel is masked; mark the missing part of the image in the mask.")
    if mask.all():
        raise ImageError("Every pixel is masked; leave some of the image to copy from.")
    for rows in slices(height, ROWS):
        if not (np.abs(image[rows][~mask[rows]]) <= MAX_VALUE).all():
            raise ImageError(f"The image has NaN or infinite pixels, or some beyond {MAX_VALUE:g}, outside the mask; mask them, too.")


def _find_range(image: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and the largest values (C,) of the known pixels."""
    parts = (image[rows][~mask[rows]] for rows in slices(len(image), ROWS) if not mask[rows].all())
    lowest, highest = zip(*((part.min(axis=0), part.max(axis=0)) for part in parts), strict=True)
    return np.min(lowest, axis=0), np.max(highest, axis=0)


def _part(array: np.ndarray | None, window: Window) -> np.ndarray | None:
    return None if array is None else array[window.area]


def _write(image: np.ndarray, window: Window, values: np.ndarray) -> None:
    """Write the `values` (N, C) of the pixels of the hole of a window into `image`."""
    rows, columns = np.nonzero(window.hole)
    image[window.rows[rows], window.columns[columns]] = values
