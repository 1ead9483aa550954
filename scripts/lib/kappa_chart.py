"""The chart of the automatic split: how uneven the texture is if kappa sub-bands are structure (Textures Revisited, Figure 13)."""

import itertools
import math

import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.overlays.line_chart import (
    COLORS,
    GRID_GRAY,
    HEIGHT,
    INK_GRAY,
    LINE_HEIGHT,
    MARGIN,
    PAPER_GRAY,
    WIDTH,
    draw_text,
    rasterize_text,
    round_ticks,
)

LEFT = MARGIN + LINE_HEIGHT  # room for the labels of the decades
LINE_RADIUS, DOT_RADIUS = 1.0, 5.0  # pixels
MIN_DEVIATION = 1e-9  # smaller values, and zero, are drawn here
DASH = 6  # pixels


def draw_kappa_chart(deviations: np.ndarray, kappa: int, limit: float) -> np.ndarray:
    """Return a chart (H, W, 3) of sRGB values, row 0 at the bottom, with a logarithmic vertical axis.

    deviations: (K,) standard deviation of the autocorrelation for kappa from 0. kappa: the chosen one, which is marked; -1 for none.
    limit: the deviation below which kappa is chosen, a dashed line.
    """
    image = np.full((HEIGHT, WIDTH, 3), PAPER_GRAY)  # filled with row 0 at the top, flipped at the end
    heights = np.log10(np.maximum(np.nan_to_num(np.asarray(deviations, float)), MIN_DEVIATION))
    decades = np.arange(math.floor(min(heights.min(initial=0.0), math.log10(limit))), math.ceil(heights.max(initial=0.0)) + 1)
    ticks = round_ticks(0, max(len(heights) - 1, 1))
    ticks = ticks[ticks == ticks.round()]
    _draw_axes(image, ticks, decades)
    points = _to_pixels(np.column_stack([np.arange(len(heights)), heights]), ticks, decades)
    line_color, mark_color = COLORS[1], COLORS[0]
    for start, stop in itertools.pairwise(points):
        _blend(image, _coverage(start, stop, LINE_RADIUS), line_color)
    ((_, row),) = _to_pixels(np.array([[0.0, math.log10(limit)]]), ticks, decades).round().astype(int)
    for column in range(LEFT, WIDTH - MARGIN, 2 * DASH):
        image[row, column : min(column + DASH, WIDTH - MARGIN)] = mark_color
    draw_text(
        image, f"limit {limit:g}", row - LINE_HEIGHT, WIDTH - MARGIN - rasterize_text(f"limit {limit:g}", LINE_HEIGHT).shape[1], mark_color
    )
    label = "all sub-bands are structure"
    if 0 <= kappa < len(points):
        _blend(image, _coverage(points[kappa], points[kappa], DOT_RADIUS), mark_color)
        label = f"kappa = {kappa}"
    draw_text(image, label, int(1.6 * LINE_HEIGHT), LEFT, mark_color)
    return image[::-1]


def _to_pixels(points: np.ndarray, ticks: np.ndarray, decades: np.ndarray) -> np.ndarray:
    """Return the columns and rows (N, 2), counted from the top left, of points (N, 2) of kappa and a decimal logarithm."""
    x = LEFT + (points[:, 0] - ticks[0]) / (ticks[-1] - ticks[0]) * (WIDTH - MARGIN - LEFT)
    y = HEIGHT - MARGIN - (points[:, 1] - decades[0]) / (decades[-1] - decades[0]) * (HEIGHT - 2 * MARGIN)
    return np.column_stack([x, y])


def _draw_axes(image: np.ndarray, ticks: np.ndarray, decades: np.ndarray) -> None:
    """Draw the grid, both axes and their labels."""
    columns = _to_pixels(np.column_stack([ticks, np.full(len(ticks), decades[0])]), ticks, decades)[:, 0].round().astype(int)
    rows = _to_pixels(np.column_stack([np.full(len(decades), ticks[0]), decades]), ticks, decades)[:, 1].round().astype(int)
    image[MARGIN : HEIGHT - MARGIN + 1, columns] = GRID_GRAY
    image[rows, LEFT : WIDTH - MARGIN + 1] = GRID_GRAY
    image[MARGIN : HEIGHT - MARGIN + 1, LEFT] = image[HEIGHT - MARGIN, LEFT : WIDTH - MARGIN + 1] = INK_GRAY
    for tick, column in zip(ticks, columns, strict=True):
        text = f"{tick:g}"
        draw_text(image, text, HEIGHT - MARGIN + 4, column - rasterize_text(text, LINE_HEIGHT).shape[1] // 2)
    for decade, row in zip(decades, rows, strict=True):
        text = f"{10.0**decade:g}"
        draw_text(image, text, row - LINE_HEIGHT // 2, LEFT - 6 - rasterize_text(text, LINE_HEIGHT).shape[1])
    draw_text(image, "Standard deviation of the autocorrelation of the texture", LINE_HEIGHT // 2, LEFT)
    draw_text(image, "kappa, sub-bands of the structure", HEIGHT - int(1.5 * LINE_HEIGHT), WIDTH // 2 - 5 * LINE_HEIGHT)


def _coverage(start: np.ndarray, stop: np.ndarray, radius: float) -> np.ndarray:
    """Return how much of each pixel (HEIGHT, WIDTH) the line from `start` to `stop` covers."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    segment = stop - start
    t = ((columns - start[0]) * segment[0] + (rows - start[1]) * segment[1]) / max(segment @ segment, 1e-12)
    t = np.clip(t, 0.0, 1.0)
    return np.clip(radius + 0.5 - np.hypot(columns - start[0] - t * segment[0], rows - start[1] - t * segment[1]), 0.0, 1.0)


def _blend(image: np.ndarray, coverage: np.ndarray, color: tuple[float, float, float]) -> None:
    image += coverage[..., None] * (np.array(color) - image)
