"""What an artist would have got with Decimate at the same cost: visible differences of renders, and what they say about the choice."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..imaging import flip, metrics
from ..messages import format_count

MIN_ADVANTAGE = 0.05  # Relative difference of two visible differences; below, neither is better.
VISIBLE_ALPHA = 1.0 / 255.0


@dataclass(frozen=True)
class Difference:
    """Means over renders from several views: the visible difference (FLIP, 0 to 1), and the PSNR in decibels."""

    visible: float
    psnr: float


@dataclass(frozen=True)
class LevelComparison:
    """A level of a cloud and the decimated mesh with as many triangles, where the error of the level is one pixel.

    Attributes:
        level: its index, 0 is the finest.
        triangles: of the level.
        cloud: between the original and the level.
        decimate: between the original and the mesh; None if Decimate cannot reach so few triangles.
    """

    level: int
    triangles: int
    cloud: Difference
    decimate: Difference | None

    @property
    def prefers_decimate(self) -> bool:
        """Whether the mesh is clearly closer to the original, by both measures."""
        if self.decimate is None or self.decimate.psnr <= self.cloud.psnr:
            return False
        return self.decimate.visible < (1.0 - MIN_ADVANTAGE) * self.cloud.visible


def measure_difference(references: Sequence[np.ndarray], images: Sequence[np.ndarray]) -> Difference:
    """Return the difference of renders from several views: FLIP within the silhouettes of both, PSNR in the rectangle around them.

    Args:
        references, images: (H, W, 4) each, scene-linear and premultiplied; compared in front of mid-gray.
    """
    visible, psnr = [], []
    for reference, image in zip(references, images, strict=True):
        alpha = np.maximum(reference[..., 3], image[..., 3])
        if not (alpha > VISIBLE_ALPHA).any():
            continue
        window = metrics.crop_to_object(alpha)
        first, second = (metrics.composite_over_gray(pixels[window]) for pixels in (reference, image))
        difference = flip.compare(flip.prepare_image(first), flip.prepare_image(second))
        visible.append(float(difference[alpha[window] > VISIBLE_ALPHA].mean()))
        psnr.append(metrics.psnr(first, second))
    return Difference(float(np.mean(visible)), float(np.mean(psnr))) if visible else Difference(0.0, float("inf"))


def describe_comparison(levels: Sequence[LevelComparison]) -> str:
    """Return sentences about the levels and the decimated meshes with as many triangles, "" if there are no levels."""
    if not levels:
        return ""
    counts = _join([f"{level.triangles:,}" for level in levels])
    shown = _join([_percent(level.cloud.visible) for level in levels])
    meshes = _join(["-" if level.decimate is None else _percent(level.decimate.visible) for level in levels])
    text = f"Visible difference from the original at the switch distance: cloud {shown} %, "
    if any(level.decimate is not None for level in levels):
        text += f"decimated mesh of the same {counts} triangles {meshes} %."
    else:
        text = text.removesuffix(", ") + "."
    unreachable = [level.triangles for level in levels if level.decimate is None]
    if unreachable:
        text += f" Decimate cannot reach {format_count(max(unreachable), 'triangle')}."
    better = [level for level in levels if level.prefers_decimate]
    if better:
        where = "" if len(better) == len(levels) else f" at {_join([f'{level.triangles:,}' for level in better])} triangles"
        text += f" Decimate is the better choice{where}."
    return text


def _join(texts: Sequence[str]) -> str:
    return ", ".join(texts)


def _percent(value: float) -> str:
    return f"{100.0 * value:.1f}"
