"""Comparison of relightable clouds with their source and with baselines, from held-out views under held-out Sun directions."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.billboards.level_objects import pbr_material
from farfield.addon.bridge.btf.levels.emission_levels import link_suns
from farfield.addon.core.geometry.directions import held_out_views
from farfield.addon.core.imaging import metrics
from farfield.addon.core.jobs.progress import Progress, Steps
from lib.comparison import CELL_PIXELS, MARGIN_PIXELS
from lib.contact_sheet import draw_contact_sheet, enlarge
from lib.studio import SKY_RADIANCE, Studio, bounding_sphere, open_studio
from lib.studio_lights import StudioLight

SCORE_NAMES = ("psnr", "ssim", "alpha_iou")


@dataclass(frozen=True)
class Candidate:
    """Objects to compare with the source.

    face_viewer: called with the direction towards the viewer before each render, for objects that must turn to it. relightable: whether
    the objects have relightable materials, which must be linked to the studio's lights.
    """

    name: str
    objects: list[bpy.types.Object]
    face_viewer: Callable[[np.ndarray], None] = lambda _direction: None
    relightable: bool = False


@dataclass(frozen=True)
class RelightingComparison:
    """P pairs of view and Sun direction. views, suns (P, 3). names of C candidates, the source first; renders (C, P, H, W, 4) float32,
    scene-linear, premultiplied, row 0 at the bottom. pixel_size in scene units."""

    views: np.ndarray
    suns: np.ndarray
    names: list[str]
    renders: np.ndarray
    pixel_size: float

    def compute_scores(self) -> np.ndarray:
        """Return the scores (C - 1, P, 3) in the order of SCORE_NAMES, on the rectangle that contains both objects, over mid-gray, sRGB."""
        return np.array([[score_renders(*pair) for pair in zip(self.renders[0], renders, strict=True)] for renders in self.renders[1:]])

    def mean_scores(self) -> dict[str, dict[str, float]]:
        """Return the mean scores by candidate."""
        means = self.compute_scores().mean(axis=1)
        return {
            name: dict(zip(SCORE_NAMES, np.round(mean, 4).tolist(), strict=True)) for name, mean in zip(self.names[1:], means, strict=True)
        }


def held_out_pairs(count: int, upper_hemisphere: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return view directions (count, 3) and Sun directions (count, 3) that no bake uses; above the horizon if `upper_hemisphere`."""
    views = held_out_views(count)
    suns = np.random.default_rng(count).permutation(held_out_views(count, seed=1))
    if upper_hemisphere:
        views, suns = (np.column_stack([xyz[:, :2], np.maximum(np.abs(xyz[:, 2]), 0.05)]) for xyz in (views, suns))
    return tuple(xyz / np.linalg.norm(xyz, axis=1, keepdims=True) for xyz in (views, suns))


def copy_with_pbr_material(level: bpy.types.Object) -> bpy.types.Object:
    """Return a copy of a relightable level with its PBR material, linked to the scene's collection."""
    copy = level.copy()
    copy.data = level.data.copy()
    copy.animation_data_clear()
    copy.data.materials[0] = pbr_material(level)
    bpy.context.scene.collection.objects.link(copy)
    return copy


def compare_relighting(
    sources: Sequence[bpy.types.Object],
    level: bpy.types.Object,
    others: Sequence[Candidate],
    pixel_size: float,
    pairs: tuple[np.ndarray, np.ndarray],
    samples: int,
    reference_samples: int | None = None,
    light: str = "sun",
) -> Steps[RelightingComparison]:
    """Render the sources, the relightable `level` and the `others` for every pair of view and Sun direction; each step is one render.

    light: one of LIGHT_KINDS, in the directions of the Suns. Renders take `samples` per pixel; `reference_samples`, if given, for the
    sources, so that their noise does not count. Relightable materials are not linked to any Sun light when this ends; link the user's
    lights again.
    """
    candidates = [Candidate("source", list(sources)), Candidate("relightable", [level], relightable=True), *others]
    relightable = [item for candidate in candidates if candidate.relightable for item in candidate.objects]
    center, radius = bounding_sphere(sources)
    size = math.ceil(2.0 * radius / pixel_size) + 2 * MARGIN_PIXELS
    views, suns = pairs
    renders = np.empty((len(candidates), len(views), size, size, 4), np.float32)
    with open_studio([item for candidate in candidates for item in candidate.objects], samples) as studio:
        studio_light = StudioLight(studio.work, studio, light)
        for item in relightable:
            link_suns(item, [studio.sun] if light == "sun" else [], [SKY_RADIANCE] * 3)
        for index, candidate in enumerate(candidates):
            studio.set_samples(samples if index or reference_samples is None else reference_samples)
            for pair, (view, sun) in enumerate(zip(views, suns, strict=True)):
                yield Progress((index + pair / len(views)) / len(candidates), f"Rendering: {candidate.name}, {pair + 1} of {len(views)}")
                renders[index, pair] = _render_candidate(studio, studio_light, candidate, view, sun, (center, radius), pixel_size, size)
        for item in relightable:
            link_suns(item, [], [0.0] * 3)
    return RelightingComparison(views, suns, [candidate.name for candidate in candidates], renders, pixel_size)


def score_renders(source: np.ndarray, candidate: np.ndarray) -> tuple[float, float, float]:
    """Return PSNR, SSIM and silhouette overlap of two renders (H, W, 4)."""
    first, second = crop_and_encode(source, candidate)
    return metrics.psnr(first, second), metrics.ssim(first, second), metrics.alpha_iou(source[..., 3], candidate[..., 3])


def crop_and_encode(source: np.ndarray, candidate: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Crop two renders (H, W, 4) to the rectangle that contains both objects; return them over mid-gray as sRGB values (h, w, 3)."""
    window = metrics.crop_to_object(np.maximum(source[..., 3], candidate[..., 3]))
    return metrics.composite_over_gray(source[window]), metrics.composite_over_gray(candidate[window])


def draw_relighting_sheet(title: str, comparison: RelightingComparison, columns: Sequence[int]) -> np.ndarray:
    """Return a contact sheet (H, W, 3): one row per candidate, one column for each of the pairs `columns`; single pixels enlarged."""
    frame = metrics.crop_to_object(comparison.renders[..., 3].max(axis=(0, 1)), margin=2)
    factor = max(1, round(CELL_PIXELS / max(span.stop - span.start for span in frame)))
    rows = [[enlarge(metrics.composite_over_gray(renders[pair][frame]), factor) for pair in columns] for renders in comparison.renders]
    scores = comparison.compute_scores()
    labels = [
        [f"pair {pair + 1}", *(f"{name} {scores[index, pair, 0]:.1f} dB" for index, name in enumerate(comparison.names[1:]))]
        for pair in columns
    ]
    return draw_contact_sheet(title, rows, comparison.names, labels)


def _render_candidate(
    studio: Studio,
    light: StudioLight,
    candidate: Candidate,
    view: np.ndarray,
    sun: np.ndarray,
    sphere: tuple[np.ndarray, float],
    pixel_size: float,
    size: int,
) -> np.ndarray:
    light.aim(sun, *sphere)
    candidate.face_viewer(view)
    return studio.render(candidate.objects, view, sphere[0], pixel_size, size)
