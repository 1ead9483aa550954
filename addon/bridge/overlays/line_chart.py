"""Line charts as images: (H, W, 3) float sRGB values in 0..1 with row 0 at the bottom."""

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from .text_raster import INK_GRAY, LINE_HEIGHT, PAPER_GRAY, draw_text, rasterize_text

WIDTH, HEIGHT = 720, 420
MARGIN = 3 * LINE_HEIGHT  # around the frame, for title and tick labels
GRID_GRAY = 0.8
COLORS = ((0.80, 0.25, 0.15), (0.15, 0.40, 0.75), (0.20, 0.55, 0.25), (0.55, 0.30, 0.65), (0.75, 0.55, 0.10))
MAX_TICKS = 8
DOT_RADIUS = 3.5  # pixels


def draw_line_chart(title: str, x_label: str, lines: Mapping[str, Sequence[tuple[float, float]]]) -> np.ndarray:
    """Return a chart (HEIGHT, WIDTH, 3) of `lines`, sequences of points (x, y) by name. Points that are not finite are skipped."""
    finite = {
        name: np.array([point for point in points if np.isfinite(point).all()], float).reshape(-1, 2) for name, points in lines.items()
    }
    all_points = np.concatenate([*finite.values(), np.empty((0, 2))])
    image = np.full((HEIGHT, WIDTH, 3), PAPER_GRAY)  # filled with row 0 at the top, flipped at the end
    draw_text(image, title, LINE_HEIGHT // 2, MARGIN)
    draw_text(image, x_label, HEIGHT - int(1.5 * LINE_HEIGHT), WIDTH // 2)
    if len(all_points):
        x_ticks, y_ticks = (round_ticks(*limits) for limits in zip(all_points.min(axis=0), all_points.max(axis=0), strict=True))
        _draw_frame(image, x_ticks, y_ticks)
        for index, (name, points) in enumerate(finite.items()):
            color = COLORS[index % len(COLORS)]
            _draw_line(image, _to_pixels(points, x_ticks, y_ticks), color)
            draw_text(image, name, int(1.6 * LINE_HEIGHT), MARGIN + index * (WIDTH - 2 * MARGIN) // max(len(finite), 1), color)
    return image[::-1]


def round_ticks(low: float, high: float) -> np.ndarray:
    """Return equidistant round numbers that include `low` to `high`."""
    span = max(high - low, 0.01 * max(abs(high), 1.0))  # a single point gets ticks around it
    min_step = span / MAX_TICKS
    power = 10.0 ** math.floor(math.log10(min_step))
    step = next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= min_step)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return step * np.arange(first, max(last, first + 1) + 1)


def _to_pixels(points: np.ndarray, x_ticks: np.ndarray, y_ticks: np.ndarray) -> np.ndarray:
    """Return the columns and rows (N, 2) of `points`, counted from the top left."""
    x = MARGIN + (points[:, 0] - x_ticks[0]) / (x_ticks[-1] - x_ticks[0]) * (WIDTH - 2 * MARGIN)
    y = HEIGHT - MARGIN - (points[:, 1] - y_ticks[0]) / (y_ticks[-1] - y_ticks[0]) * (HEIGHT - 2 * MARGIN)
    return np.column_stack([x, y])


def _draw_frame(image: np.ndarray, x_ticks: np.ndarray, y_ticks: np.ndarray) -> None:
    for x, _ in _to_pixels(np.column_stack([x_ticks, np.full_like(x_ticks, y_ticks[0])]), x_ticks, y_ticks).round().astype(int):
        image[MARGIN : HEIGHT - MARGIN + 1, x] = GRID_GRAY
    for _, y in _to_pixels(np.column_stack([np.full_like(y_ticks, x_ticks[0]), y_ticks]), x_ticks, y_ticks).round().astype(int):
        image[y, MARGIN : WIDTH - MARGIN + 1] = GRID_GRAY
    image[MARGIN : HEIGHT - MARGIN + 1, MARGIN] = image[HEIGHT - MARGIN, MARGIN : WIDTH - MARGIN + 1] = INK_GRAY
    for tick in x_ticks:
        (pixel,) = _to_pixels(np.array([[tick, y_ticks[0]]]), x_ticks, y_ticks)
        label = f"{tick:g}"
        draw_text(image, label, HEIGHT - MARGIN + 4, int(pixel[0]) - rasterize_text(label, LINE_HEIGHT).shape[1] // 2)
    for tick in y_ticks:
        (pixel,) = _to_pixels(np.array([[x_ticks[0], tick]]), x_ticks, y_ticks)
        label = f"{tick:g}"
        draw_text(image, label, int(pixel[1]) - LINE_HEIGHT // 2, MARGIN - 6 - rasterize_text(label, LINE_HEIGHT).shape[1])


def _draw_line(image: np.ndarray, pixels: np.ndarray, color: tuple[float, float, float]) -> None:
    """Draw a line with dots at its points, `pixels` (N, 2) columns and rows, with antialiasing."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    coverage = np.zeros((HEIGHT, WIDTH))
    for start, stop in itertools.pairwise(pixels):
        segment = stop - start
        t = np.clip(((columns - start[0]) * segment[0] + (rows - start[1]) * segment[1]) / max(segment @ segment, 1e-12), 0.0, 1.0)
        distance = np.hypot(columns - start[0] - t * segment[0], rows - start[1] - t * segment[1])
        coverage = np.maximum(coverage, np.clip(1.5 - distance, 0.0, 1.0))
    for x, y in pixels:
        coverage = np.maximum(coverage, np.clip(DOT_RADIUS + 0.5 - np.hypot(columns - x, rows - y), 0.0, 1.0))
    image += coverage[..., None] * (np.array(color) - image)
