"""Line charts as pictures: (H, W, 3) float sRGB values in 0..1 with row 0 at the bottom, like those of `contact_sheet`."""

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from contact_sheet import INK, LINE, PAPER, write_words
from lettering import text_mask

WIDTH, HEIGHT = 720, 420
MARGIN = 3 * LINE  # around the frame, for title and numbers
FAINT = 0.8
COLOURS = ((0.80, 0.25, 0.15), (0.15, 0.40, 0.75), (0.20, 0.55, 0.25), (0.55, 0.30, 0.65), (0.75, 0.55, 0.10))
MOST_TICKS = 8
DOT = 3.5  # pixels, radius


def line_chart(title: str, across: str, lines: Mapping[str, Sequence[tuple[float, float]]]) -> np.ndarray:
    """A chart (HEIGHT, WIDTH, 3) of `lines` by name, each of points (x, y); `across` tells what x is. Points that are not finite are
    left out."""
    kept = {name: np.array([point for point in points if np.isfinite(point).all()], float).reshape(-1, 2) for name, points in lines.items()}
    together = np.concatenate([*kept.values(), np.empty((0, 2))])
    picture = np.full((HEIGHT, WIDTH, 3), PAPER)  # filled from the top here, turned at the end
    write_words(picture, title, LINE // 2, MARGIN)
    write_words(picture, across, HEIGHT - int(1.5 * LINE), WIDTH // 2)
    if len(together):
        x_ticks, y_ticks = (ticks(*each) for each in zip(together.min(axis=0), together.max(axis=0), strict=True))
        _draw_frame(picture, x_ticks, y_ticks)
        for number, (name, points) in enumerate(kept.items()):
            colour = COLOURS[number % len(COLOURS)]
            _draw_line(picture, _places(points, x_ticks, y_ticks), colour)
            write_words(picture, name, int(1.6 * LINE), MARGIN + number * (WIDTH - 2 * MARGIN) // max(len(kept), 1), colour)
    return picture[::-1]


def ticks(low: float, high: float) -> np.ndarray:
    """Round numbers, evenly apart, from at most `low` to at least `high`."""
    span = max(high - low, 0.01 * max(abs(high), 1.0))  # a single point has neighbours too
    rough = span / MOST_TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= rough)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return step * np.arange(first, max(last, first + 1) + 1)


def _places(points: np.ndarray, x_ticks: np.ndarray, y_ticks: np.ndarray) -> np.ndarray:
    """Columns and rows (N, 2) of `points`, counted from the top left."""
    x = MARGIN + (points[:, 0] - x_ticks[0]) / (x_ticks[-1] - x_ticks[0]) * (WIDTH - 2 * MARGIN)
    y = HEIGHT - MARGIN - (points[:, 1] - y_ticks[0]) / (y_ticks[-1] - y_ticks[0]) * (HEIGHT - 2 * MARGIN)
    return np.column_stack([x, y])


def _draw_frame(picture: np.ndarray, x_ticks: np.ndarray, y_ticks: np.ndarray) -> None:
    for x, _ in _places(np.column_stack([x_ticks, np.full_like(x_ticks, y_ticks[0])]), x_ticks, y_ticks).round().astype(int):
        picture[MARGIN : HEIGHT - MARGIN + 1, x] = FAINT
    for _, y in _places(np.column_stack([np.full_like(y_ticks, x_ticks[0]), y_ticks]), x_ticks, y_ticks).round().astype(int):
        picture[y, MARGIN : WIDTH - MARGIN + 1] = FAINT
    picture[MARGIN : HEIGHT - MARGIN + 1, MARGIN] = picture[HEIGHT - MARGIN, MARGIN : WIDTH - MARGIN + 1] = INK
    for tick in x_ticks:
        (place,) = _places(np.array([[tick, y_ticks[0]]]), x_ticks, y_ticks)
        words = f"{tick:g}"
        write_words(picture, words, HEIGHT - MARGIN + 4, int(place[0]) - text_mask(words, LINE).shape[1] // 2)
    for tick in y_ticks:
        (place,) = _places(np.array([[x_ticks[0], tick]]), x_ticks, y_ticks)
        words = f"{tick:g}"
        write_words(picture, words, int(place[1]) - LINE // 2, MARGIN - 6 - text_mask(words, LINE).shape[1])


def _draw_line(picture: np.ndarray, places: np.ndarray, colour: tuple[float, float, float]) -> None:
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    cover = np.zeros((HEIGHT, WIDTH))
    for start, stop in itertools.pairwise(places):
        along = stop - start
        share = np.clip(((columns - start[0]) * along[0] + (rows - start[1]) * along[1]) / max(along @ along, 1e-12), 0.0, 1.0)
        away = np.hypot(columns - start[0] - share * along[0], rows - start[1] - share * along[1])
        cover = np.maximum(cover, np.clip(1.5 - away, 0.0, 1.0))
    for x, y in places:
        cover = np.maximum(cover, np.clip(DOT + 0.5 - np.hypot(columns - x, rows - y), 0.0, 1.0))
    picture += cover[..., None] * (np.array(colour) - picture)
