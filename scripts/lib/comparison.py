"""Comparison of a cloud with its source: both are rendered from held-out views under one light and scored view by view.

By default a pixel is as large as the level's error, as at the switch distance. Scores are taken over mid-gray on the rectangle that
contains both objects; see `farfield.addon.core.imaging.metrics`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.core.geometry.directions import held_out_views
from farfield.addon.core.imaging import metrics
from farfield.addon.core.jobs.progress import Progress, Steps
from lib.contact_sheet import draw_contact_sheet, enlarge
from lib.studio import SKY_RADIANCE, SUN_ANGLE, SUN_DIRECTION, SUN_STRENGTH, bounding_sphere, open_studio

CELL_PIXELS = 300  # approximate size of an enlarged render on a sheet
MARGIN_PIXELS = 8  # around the object, for the SSIM window and the render's pixel filter
RENDER_SETUP = (
    f"Cycles, orthographic, no denoising; one Sun light of {SUN_STRENGTH:g} W/m2 from {SUN_DIRECTION} "
    f"with an angle of {math.degrees(SUN_ANGLE):.1f} degrees, uniform World lighting of {SKY_RADIANCE:g}, the same for both; "
    "scored over mid-gray, sRGB"
)


@dataclass(frozen=True)
class Comparison:
    """V views of a source and its cloud.

    directions (V, 3), towards the viewer. source_renders, cloud_renders (V, H, W, 4) float32: scene-linear, premultiplied, row 0 at the
    bottom. ssim, alpha_iou (V,): scores. pixel_size: side of a pixel in scene units.
    """

    directions: np.ndarray
    source_renders: np.ndarray
    cloud_renders: np.ndarray
    ssim: np.ndarray
    alpha_iou: np.ndarray
    pixel_size: float

    def to_report(self) -> dict:
        """Return the scores as plain numbers for a JSON report."""
        views = [
            {"direction": [round(float(value), 4) for value in direction], "ssim": round(float(ssim), 4), "alpha_iou": round(float(iou), 4)}
            for direction, ssim, iou in zip(self.directions, self.ssim, self.alpha_iou, strict=True)
        ]
        scores = {"mean_ssim": self.ssim.mean(), "worst_ssim": self.ssim.min(), "mean_alpha_iou": self.alpha_iou.mean()}
        scores["worst_alpha_iou"] = self.alpha_iou.min()
        rounded = {name: round(float(score), 4) for name, score in scores.items()}
        return {**rounded, "pixel_size": self.pixel_size, "render_setup": RENDER_SETUP, "views": views}


def compare_cloud(
    sources: Sequence[bpy.types.Object],
    level: bpy.types.Object,
    pixel_size: float | None = None,
    directions: np.ndarray | None = None,
    samples: int = 64,
) -> Steps[Comparison]:
    """Render `sources` and `level` of their cloud from every direction and compare them; each step is one render.

    `pixel_size` is the level's error by default (its property `farfield_error`); `directions` (V, 3) are twelve held-out views by default.
    """
    pixel_size = float(level["farfield_error"]) if pixel_size is None else pixel_size
    directions = held_out_views() if directions is None else directions
    center, radius = bounding_sphere(sources)
    size = math.ceil(2.0 * radius / pixel_size) + 2 * MARGIN_PIXELS
    renders = []
    with open_studio([*sources, level], samples) as studio:
        for visible, name in ((list(sources), "source"), ([level], "cloud")):
            for number, direction in enumerate(directions, 1):
                yield Progress(len(renders) / (2 * len(directions)), f"Rendering the {name}, view {number}")
                renders.append(studio.render(visible, direction, center, pixel_size, size))
    stacked = np.stack(renders).reshape(2, len(directions), size, size, 4)
    scores = np.array([score_renders(source, cloud) for source, cloud in zip(*stacked, strict=True)])
    return Comparison(directions, stacked[0], stacked[1], scores[:, 0], scores[:, 1], pixel_size)


def draw_comparison_sheet(
    title: str, comparison: Comparison, columns: Sequence[int] | None = None, close_up: np.ndarray | None = None
) -> np.ndarray:
    """Return a contact sheet (H, W, 3) of a comparison: the source above, the cloud below, single pixels enlarged.

    `columns` are the indices of the views to show, all by default. `close_up` (2, h, w, 4) are renders of both for a last column.
    """
    columns = range(len(comparison.directions)) if columns is None else columns
    frame = metrics.crop_to_object(np.maximum(comparison.source_renders, comparison.cloud_renders)[..., 3].max(axis=0), margin=2)
    pixels = max(span.stop - span.start for span in frame)
    factor = max(1, round(CELL_PIXELS / pixels))
    both = (comparison.source_renders, comparison.cloud_renders)
    rows = [[enlarge(metrics.composite_over_gray(renders[view][frame]), factor) for view in columns] for renders in both]
    labels = [[f"view {view + 1}", f"SSIM {comparison.ssim[view]:.2f}", f"IoU {comparison.alpha_iou[view]:.2f}"] for view in columns]
    if close_up is not None:
        for row, render in zip(rows, close_up, strict=True):
            row.append(_crop_or_pad(metrics.composite_over_gray(render), row[0].shape))
        labels.append(["close-up:", "nearer than the", "switch distance"])
    return draw_contact_sheet(title, rows, ["source", "cloud"], labels)


def score_renders(source: np.ndarray, cloud: np.ndarray) -> tuple[float, float]:
    """Return SSIM and silhouette overlap of two renders (H, W, 4) on the rectangle that contains both objects."""
    window = metrics.crop_to_object(np.maximum(source[..., 3], cloud[..., 3]))
    return (
        metrics.ssim(metrics.composite_over_gray(source[window]), metrics.composite_over_gray(cloud[window])),
        metrics.alpha_iou(source[window][..., 3], cloud[window][..., 3]),
    )


def _crop_or_pad(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return the center of `image`, cropped to `shape` or padded with the color of its corner."""
    canvas = np.broadcast_to(image[0, 0], shape).copy()
    height, width = (min(old, new) for old, new in zip(image.shape[:2], shape[:2], strict=True))
    from_y, from_x = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
    to_y, to_x = (shape[0] - height) // 2, (shape[1] - width) // 2
    canvas[to_y : to_y + height, to_x : to_x + width] = image[from_y : from_y + height, from_x : from_x + width]
    return canvas
