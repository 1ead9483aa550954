"""How like its original a cloud looks: both rendered from held-out views under one lamp at the switch size, compared view by view.

At the switch size the level's error is one pixel. Every score is taken on the object's rectangle over mid-grey, see core.metrics.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

import environment

environment.import_farfield()

from contact_sheet import contact_sheet, enlarged
from farfield.addon.core import metrics
from farfield.addon.core.directions import held_out_views
from farfield.addon.core.progress import Progress, Steps
from studio import SKY_RADIANCE, SUN_ANGLE, SUN_DIRECTION, SUN_STRENGTH, bounds, studio

CELL = 300  # pixels that a picture on a sheet is enlarged to, about
BORDER = 8  # pixels around the object: the SSIM window and the render's pixel filter
SETTING = (
    f"Cycles, orthographic, no denoising; one sun of {SUN_STRENGTH:g} W/m2 from {SUN_DIRECTION} "
    f"over {math.degrees(SUN_ANGLE):.1f} degrees, grey sky of {SKY_RADIANCE:g}; the same for both; over mid-grey, sRGB"
)


@dataclass(frozen=True)
class Comparison:
    """V views of an original and its cloud.

    directions (V, 3), towards the viewer. originals, clouds (V, H, W, 4) float32: renders, scene-linear, premultiplied, row 0 at the
    bottom. ssim, alpha_iou (V,): scores. pixel_size: side of a pixel in scene units.
    """

    directions: np.ndarray
    originals: np.ndarray
    clouds: np.ndarray
    ssim: np.ndarray
    alpha_iou: np.ndarray
    pixel_size: float

    def figures(self) -> dict:
        """The scores as plain numbers for a report."""
        views = [
            {"direction": [round(float(value), 4) for value in direction], "ssim": round(float(ssim), 4), "alpha_iou": round(float(iou), 4)}
            for direction, ssim, iou in zip(self.directions, self.ssim, self.alpha_iou, strict=True)
        ]
        scores = {"mean_ssim": self.ssim.mean(), "worst_ssim": self.ssim.min(), "mean_alpha_iou": self.alpha_iou.mean()}
        scores["worst_alpha_iou"] = self.alpha_iou.min()
        rounded = {name: round(float(score), 4) for name, score in scores.items()}
        return {**rounded, "pixel_size": self.pixel_size, "setting": SETTING, "views": views}


def compare(
    originals: Sequence[bpy.types.Object],
    cloud: bpy.types.Object,
    pixel_size: float | None = None,
    directions: np.ndarray | None = None,
    samples: int = 64,
) -> Steps[Comparison]:
    """Render `originals` and `cloud` from every direction and compare them; each step is one render.

    `pixel_size` is the cloud's own error (property `farfield_error`) when left out; `directions` (V, 3) are twelve held-out views.
    """
    pixel_size = float(cloud["farfield_error"]) if pixel_size is None else pixel_size
    directions = held_out_views() if directions is None else directions
    center, radius = bounds(originals)
    size = math.ceil(2.0 * radius / pixel_size) + 2 * BORDER
    pictures = []
    with studio([*originals, cloud], samples) as room:
        for shown, name in ((list(originals), "original"), ([cloud], "cloud")):
            for number, direction in enumerate(directions, 1):
                yield Progress(len(pictures) / (2 * len(directions)), f"Rendering the {name}, view {number}")
                pictures.append(room.picture(shown, direction, center, pixel_size, size))
    stacked = np.stack(pictures).reshape(2, len(directions), size, size, 4)
    scores = np.array([score(original, picture) for original, picture in zip(*stacked, strict=True)])
    return Comparison(directions, stacked[0], stacked[1], scores[:, 0], scores[:, 1], pixel_size)


def sheet(title: str, comparison: Comparison, columns: Sequence[int] | None = None, close_up: np.ndarray | None = None) -> np.ndarray:
    """A contact sheet (H, W, 3) of a comparison: originals above, clouds below, single pixels enlarged.

    `columns` are the numbers of the views to show, all when left out. `close_up` (2, h, w, 4) are renders of both, shown in a last column.
    """
    columns = range(len(comparison.directions)) if columns is None else columns
    frame = metrics.crop_to_object(np.maximum(comparison.originals, comparison.clouds)[..., 3].max(axis=0), margin=2)
    pixels = max(span.stop - span.start for span in frame)
    factor = max(1, round(CELL / pixels))
    both = (comparison.originals, comparison.clouds)
    rows = [[enlarged(metrics.over_grey(views[view][frame]), factor) for view in columns] for views in both]
    labels = [[f"view {view + 1}", f"SSIM {comparison.ssim[view]:.2f}", f"IoU {comparison.alpha_iou[view]:.2f}"] for view in columns]
    if close_up is not None:
        for row, picture in zip(rows, close_up, strict=True):
            row.append(_centred(metrics.over_grey(picture), row[0].shape))
        labels.append(["rendered larger:", "nearer than the", "level is meant for"])
    return contact_sheet(title, rows, ["original", "cloud"], labels)


def score(original: np.ndarray, cloud: np.ndarray) -> tuple[float, float]:
    """SSIM and silhouette overlap of two renders (H, W, 4), on the rectangle that holds both."""
    window = metrics.crop_to_object(np.maximum(original[..., 3], cloud[..., 3]))
    return (
        metrics.ssim(metrics.over_grey(original[window]), metrics.over_grey(cloud[window])),
        metrics.alpha_iou(original[window][..., 3], cloud[window][..., 3]),
    )


def _centred(picture: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The middle of `picture`, cut or filled up with its corner's colour to `shape`."""
    canvas = np.broadcast_to(picture[0, 0], shape).copy()
    height, width = (min(have, want) for have, want in zip(picture.shape[:2], shape[:2], strict=True))
    from_y, from_x = (picture.shape[0] - height) // 2, (picture.shape[1] - width) // 2
    to_y, to_x = (shape[0] - height) // 2, (shape[1] - width) // 2
    canvas[to_y : to_y + height, to_x : to_x + width] = picture[from_y : from_y + height, from_x : from_x + width]
    return canvas
