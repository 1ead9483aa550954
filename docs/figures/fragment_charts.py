"""The fragments of the paper as an image: Figure 9, the lookup table of bytes against the threshold, and a map of qualities."""

from typing import Any

import numpy as np

from farfield.addon.bridge.overlays.line_chart import HEIGHT, LINE_HEIGHT, PAPER_GRAY, draw_line_chart, draw_text

SCALES = (4, 8, 12, 16)  # The scales of the lookup table.
MAP_PIXELS = 11  # per fragment
GAP = 10


def draw_fragments(figures: dict[str, Any]) -> np.ndarray:
    """Return an image (H, W, 3) uint8, row 0 at the top, of the figures that `bench_packages.py --only fragments` measured."""
    figure_9, lookup = figures["figure_9"], figures["lookup"]
    curves = {
        name: [(float(quality), size) for quality, size in zip(figure_9["qualities"], sizes, strict=True)]
        for name, sizes in figure_9["bytes"].items()
    }
    thresholds = lookup["thresholds"]
    tables = {
        f"scale {scale}, Q {lookup['qualities'][scale]:g}": [
            (threshold, size / 1e3) for threshold, size in zip(thresholds, lookup["bytes"][scale], strict=True)
        ]
        for scale in SCALES
    }
    charts = [
        draw_line_chart("Bytes of a fragment of 32 pixels (Figure 9)", "quality", curves),
        draw_line_chart("Lookup table: kB of all fragments of spot", "threshold", tables),
    ]
    return _to_bytes(np.concatenate([*(chart[::-1] for chart in charts), draw_map(lookup["map"])], axis=1))


def draw_map(found: dict[str, Any]) -> np.ndarray:
    """Return the map of qualities (HEIGHT, W, 3), dark for low ones."""
    qualities = np.array(found["qualities"], float)
    low, high = qualities.min(), qualities.max()
    shades = 0.15 + 0.8 * (qualities - low) / max(high - low, 1.0)
    image = np.full((HEIGHT, qualities.shape[1] * MAP_PIXELS + 2 * GAP, 3), PAPER_GRAY)
    top = 3 * LINE_HEIGHT
    tile = shades.repeat(MAP_PIXELS, axis=0).repeat(MAP_PIXELS, axis=1)[: HEIGHT - top]
    image[top : top + len(tile), GAP : GAP + tile.shape[1]] = tile[..., None]
    draw_text(image, f"Qualities {low:g} to {high:g} of the fragments", LINE_HEIGHT // 2, GAP)
    draw_text(image, f"at scale {found['scale']}, threshold {found['threshold']:g}", int(1.6 * LINE_HEIGHT), GAP)
    return image


def _to_bytes(image: np.ndarray) -> np.ndarray:
    return np.rint(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
