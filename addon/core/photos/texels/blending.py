"""Seams between photographs, blended in windows in which the surface continues across the seams of the UV map."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ...imaging.blending import Layer, blend_bands, find_links, solve_screened_poisson
from ...jobs.chunks import map_ordered
from ...jobs.progress import Progress, Steps
from ..photographs.surface import Surface
from .face_visibility import SeenTexels
from .painter import TexelPainter
from .surface_windows import SurfaceWindow, SurfaceWindows
from .texel_map import TexelMap

WINDOW, MARGIN = 512, 64  # texels; the margin is what the coarsest band and the screening length reach
BANDS = 5
SCREENING_LENGTH = 32.0  # texels over which gradients outweigh colors


@dataclass(frozen=True)
class BlendedSurface:
    """The texture before its seams are blended.

    Attributes:
        painter: samples photographs.
        map: the texels of the mesh.
        surface: the mesh.
        colors: (N, 3) float32 of all texels.
        known: (N,) bool, texels that have a color.
    """

    painter: TexelPainter
    map: TexelMap
    surface: Surface
    colors: np.ndarray
    known: np.ndarray


def blend_windows(blended: BlendedSurface, blend: Callable[[SurfaceWindow], np.ndarray]) -> Steps[np.ndarray]:
    """Return the colors (N, 3) of all texels; `blend` returns those of the pixels of a window, by one of the functions below."""
    result = blended.colors.copy()
    windows = SurfaceWindows(blended.map, blended.surface, WINDOW, MARGIN)
    done, total = 0, max(int(np.count_nonzero(blended.map.triangles >= 0)), 1)

    def blend_own(window: SurfaceWindow) -> tuple[np.ndarray, np.ndarray]:
        own = window.is_own & blended.known[window.tile.texels]
        return window.tile.texels[own], blend(window)[own]

    for texels, colors in map_ordered(blend_own, windows):
        result[texels] = colors
        done += len(texels)
        yield Progress(done / total, "Blending seams")
    return result


def blend_labels(blended: BlendedSurface, labels: np.ndarray, window: SurfaceWindow) -> np.ndarray:
    """Return the colors (N, 3) of the pixels of a window: the photographs of the `labels` of all texels, -1 for none, blended in bands.

    Texels without a photograph keep their color, as one more image (Textures Revisited, section 4.2).
    """
    own = labels[window.tile.texels]
    return _blend_fractions(blended, window, ((index, (own == index).astype(np.float32)) for index in np.unique(own[own >= 0])))


def blend_masks(blended: BlendedSurface, masks: np.ndarray, window: SurfaceWindow) -> np.ndarray:
    """Return the colors (N, 3) of the pixels of a window: photographs in their `masks` (K, T) of triangles, by weight where they overlap,
    blended in bands (Textures Revisited, section 4.2)."""
    tile = window.tile
    used = [index for index, mask in enumerate(masks) if mask[tile.triangles].any()]
    points, total = blended.painter.locate(tile), np.zeros(len(tile.triangles), np.float32)

    def see(index: int) -> SeenTexels:
        return blended.painter.see(index, tile, points, np.flatnonzero(masks[index][tile.triangles]))

    for index in used:
        seen = see(index)
        total[seen.indices] += seen.weights

    def find_fractions() -> Iterator[tuple[int, np.ndarray]]:
        for index in used:
            fraction, seen = np.zeros(len(total), np.float32), see(index)
            fraction[seen.indices] = seen.weights / np.maximum(total[seen.indices], 1e-30)
            yield index, fraction

    return _blend_fractions(blended, window, find_fractions())


def blend_gradients(blended: BlendedSurface, labels: np.ndarray, window: SurfaceWindow) -> np.ndarray:
    """Return the colors (N, 3) of the pixels of a window with the gradients of the photographs of the `labels` of all texels, -1 for none,
    and colors near those that they have (screened Poisson)."""
    tile = window.tile
    known = blended.known[tile.texels]
    rows = np.flatnonzero(known)[np.argsort(window.pixels[known])]
    own, colors = labels[tile.texels], blended.colors[tile.texels]
    links = find_links(window.to_image(known))
    first, second = rows[links.first], rows[links.second]
    sums, counts = np.zeros((len(first), 3), np.float32), np.zeros(len(first), np.float32)
    points = blended.painter.locate(tile)
    for index in np.unique(own[own >= 0]):
        is_seen, sampled = _sample(blended.painter, index, window, points)
        used = np.flatnonzero(((own[first] == index) | (own[second] == index)) & is_seen[first] & is_seen[second])
        sums[used] += sampled[second[used]] - sampled[first[used]]
        counts[used] += 1.0
    differences = np.where(counts[:, None] > 0.0, sums / np.maximum(counts, 1.0)[:, None], colors[second] - colors[first])
    result = colors.copy()
    result[rows] = solve_screened_poisson(links, differences, colors[rows], SCREENING_LENGTH)
    return result


def shrink_masks(masks: np.ndarray, triangles: np.ndarray, vertex_count: int) -> np.ndarray:
    """Return `masks` (K, T) bool of `triangles` (T, 3) without the outermost ring of triangles of each (Textures Revisited, section 4.2):
    those with a vertex at a triangle outside of the mask."""
    result = np.empty_like(masks)
    for mask, shrunken in zip(masks, result, strict=True):
        is_outer = np.zeros(vertex_count, bool)
        is_outer[triangles[~mask]] = True
        shrunken[:] = ~is_outer[triangles].any(axis=1)
    return result


def _blend_fractions(blended: BlendedSurface, window: SurfaceWindow, fractions: Iterator[tuple[int, np.ndarray]]) -> np.ndarray:
    """Return the colors (N, 3) of the pixels of a window, given the fraction (N,) of each used photograph; the rest is that of the colors
    that the pixels have."""
    tile, points = window.tile, blended.painter.locate(window.tile)

    def find_layers() -> Iterator[Layer]:
        rest = blended.known[tile.texels].astype(np.float32)
        for index, fraction in fractions:
            is_seen, colors = _sample(blended.painter, index, window, points)
            fraction = np.where(is_seen, fraction, np.float32(0.0))
            rest -= fraction
            yield Layer(window.to_image(colors), window.to_image(is_seen), window.to_image(fraction))
        known = blended.known[tile.texels]
        colors = np.where(known[:, None], blended.colors[tile.texels], np.float32(0.0))
        yield Layer(window.to_image(colors), window.to_image(known), window.to_image(np.maximum(rest, 0.0)))

    return window.from_image(blend_bands(find_layers(), (*window.shape, 3), BANDS))


def _sample(painter: TexelPainter, index: int, window: SurfaceWindow, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which pixels (N,) of a window at `points` (N, 3) a photograph shows, and its colors (N, 3) there."""
    seen = painter.see(index, window.tile, points, np.arange(len(points)))
    is_seen, colors = np.zeros(len(points), bool), np.zeros((len(points), 3), np.float32)
    is_seen[seen.indices] = True
    colors[seen.indices] = painter.sample(index, seen.positions)
    return is_seen, colors
