"""Line charts as images: (H, W, 3) float sRGB values in 0..1 with row 0 at the bottom.

The outlines of Blender's own font are filled with NumPy, so that text needs no font file and no other package.
"""

import itertools
import math
from collections.abc import Mapping, Sequence

import bpy
import numpy as np

from ...core.imaging.raster import rasterize
from ..geometry.mesh_arrays import read_loop_triangles, read_loop_vertices, read_positions

WIDTH, HEIGHT = 720, 420
LINE_HEIGHT = 20  # pixels
MARGIN = 3 * LINE_HEIGHT  # around the frame, for title and tick labels
PAPER_GRAY, GRID_GRAY, INK_GRAY = 0.93, 0.8, 0.12
COLORS = ((0.80, 0.25, 0.15), (0.15, 0.40, 0.75), (0.20, 0.55, 0.25), (0.55, 0.30, 0.65), (0.75, 0.55, 0.10))
MAX_TICKS = 8
DOT_RADIUS = 3.5  # pixels
SUPERSAMPLES = 4  # Samples per pixel of text, along each axis.
FONT_SIZE_FRACTION = 0.72  # font size relative to the line height
BASELINE_FRACTION = 0.28  # distance of the baseline from the lower edge relative to the line height


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
        window, segment = _find_window(start, stop), stop - start
        x, y = columns[window] - start[0], rows[window] - start[1]
        t = np.clip((x * segment[0] + y * segment[1]) / max(segment @ segment, 1e-12), 0.0, 1.0)
        distance = np.hypot(x - t * segment[0], y - t * segment[1])
        coverage[window] = np.maximum(coverage[window], np.clip(1.5 - distance, 0.0, 1.0))
    for point in pixels:
        window = _find_window(point, point)
        distance = np.hypot(columns[window] - point[0], rows[window] - point[1])
        coverage[window] = np.maximum(coverage[window], np.clip(DOT_RADIUS + 0.5 - distance, 0.0, 1.0))
    image += coverage[..., None] * (np.array(color) - image)


def _find_window(start: np.ndarray, stop: np.ndarray) -> tuple[slice, slice]:
    """Return the rows and columns of the pixels that a dot or a segment between two points (2,) may cover."""
    first = np.floor(np.minimum(start, stop) - 2.0 * DOT_RADIUS).astype(int).clip(0)
    last = np.ceil(np.maximum(start, stop) + 2.0 * DOT_RADIUS).astype(int)
    return slice(first[1], last[1]), slice(first[0], last[0])


def rasterize_text(text: str, height: int) -> np.ndarray:
    """Return the ink coverage of each pixel of `text`: (height, W) float64 in 0..1, row 0 at the top, in Blender's own font."""
    vertices, triangles = _text_outline(text)
    scale = FONT_SIZE_FRACTION * height * SUPERSAMPLES
    points = vertices * scale + [0.0, BASELINE_FRACTION * height * SUPERSAMPLES]
    width = int(np.ceil(points[:, 0].max() / SUPERSAMPLES)) + 1 if len(points) else 1
    samples = np.zeros((height * SUPERSAMPLES, width * SUPERSAMPLES), bool)
    for _, pixels, _ in rasterize(points[triangles], samples.shape[::-1]):
        samples.reshape(-1)[pixels] = True
    return samples.reshape(height, SUPERSAMPLES, width, SUPERSAMPLES).mean(axis=(1, 3))[::-1]


def draw_text(image: np.ndarray, text: str, y: int, x: int, color: float | tuple[float, float, float] = INK_GRAY) -> None:
    """Draw `text` into `image`, row 0 at the top, with its upper left corner at (x, y). Text beyond the image is clipped."""
    mask = rasterize_text(text, LINE_HEIGHT)[: image.shape[0] - y, : image.shape[1] - x]
    area = image[y : y + mask.shape[0], x : x + mask.shape[1]]
    area += mask[..., None] * (np.asarray(color) - area)


def _text_outline(text: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the filled outline of `text`: vertices (V, 2), in units of the font size from the baseline, and triangles (T, 3)."""
    curve = bpy.data.curves.new("Farfield Label", "FONT")
    curve.body = text
    text_object = bpy.data.objects.new(curve.name, curve)
    mesh = bpy.data.meshes.new_from_object(text_object)
    try:
        loops, _ = read_loop_triangles(mesh)
        return read_positions(mesh)[:, :2].astype(np.float64), read_loop_vertices(mesh)[loops]
    finally:
        bpy.data.meshes.remove(mesh)
        bpy.data.curves.remove(curve)
