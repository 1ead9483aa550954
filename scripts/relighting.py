"""Original, relightable cloud and baselines side by side, from held-out views under held-out suns."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

import environment

environment.import_farfield()

from comparison import BORDER, CELL
from contact_sheet import contact_sheet, enlarged
from farfield.addon.bridge.btf_clouds import light_with, plain_material
from farfield.addon.core import metrics
from farfield.addon.core.directions import held_out_views
from farfield.addon.core.progress import Progress, Steps
from studio import SKY_RADIANCE, Studio, bounds, studio

SCORES = ("psnr", "ssim", "alpha_iou")


@dataclass(frozen=True)
class Contestant:
    """What is photographed: `objects`, which `face` turns to a viewer first where they need it.

    relightable: whether they wear relightable textures, which have to be told of the studio's lights.
    """

    name: str
    objects: list[bpy.types.Object]
    face: Callable[[np.ndarray], None] = lambda _direction: None
    relightable: bool = False


@dataclass(frozen=True)
class Relighting:
    """P pairs of view and sun. views, suns (P, 3). names of C contestants, the original first; pictures (C, P, H, W, 4) float32,
    scene-linear, premultiplied, row 0 at the bottom. pixel_size in scene units."""

    views: np.ndarray
    suns: np.ndarray
    names: list[str]
    pictures: np.ndarray
    pixel_size: float

    def scores(self) -> np.ndarray:
        """(C - 1, P, 3): see SCORES, on the rectangle that holds original and contestant, over mid-grey, sRGB."""
        return np.array([[score(*pair) for pair in zip(self.pictures[0], pictures, strict=True)] for pictures in self.pictures[1:]])

    def figures(self) -> dict[str, dict[str, float]]:
        """Mean scores by contestant."""
        means = self.scores().mean(axis=1)
        return {name: dict(zip(SCORES, np.round(mean, 4).tolist(), strict=True)) for name, mean in zip(self.names[1:], means, strict=True)}


def held_out_pairs(count: int, upper: bool) -> tuple[np.ndarray, np.ndarray]:
    """Views (count, 3) and suns (count, 3) that no bake has; above the horizon where `upper`."""
    views = held_out_views(count)
    suns = np.random.default_rng(count).permutation(held_out_views(count, seed=1))
    if upper:
        views, suns = (np.column_stack([each[:, :2], np.maximum(np.abs(each[:, 2]), 0.05)]) for each in (views, suns))
    return tuple(each / np.linalg.norm(each, axis=1, keepdims=True) for each in (views, suns))


def plain_twin(level: bpy.types.Object) -> bpy.types.Object:
    """A copy of a relightable level that wears its plain maps, beside it in the scene's collection."""
    twin = level.copy()
    twin.data = level.data.copy()
    twin.animation_data_clear()
    twin.data.materials[0] = plain_material(level)
    bpy.context.scene.collection.objects.link(twin)
    return twin


def relight(
    originals: Sequence[bpy.types.Object],
    level: bpy.types.Object,
    others: Sequence[Contestant],
    pixel_size: float,
    pairs: tuple[np.ndarray, np.ndarray],
    samples: int,
    reference_samples: int | None = None,
) -> Steps[Relighting]:
    """Photograph the originals, the relightable `level` and the `others` for every pair of view and sun; each step is one render.

    `samples` a pixel are for all; `reference_samples` for the originals, where their noise should not count.
    Relightable textures are without lamps when this ends: give them the user's again.
    """
    contestants = [Contestant("original", list(originals)), Contestant("relightable", [level], relightable=True), *others]
    relit = [item for contestant in contestants if contestant.relightable for item in contestant.objects]
    center, radius = bounds(originals)
    size = math.ceil(2.0 * radius / pixel_size) + 2 * BORDER
    views, suns = pairs
    pictures = np.empty((len(contestants), len(views), size, size, 4), np.float32)
    with studio([item for contestant in contestants for item in contestant.objects], samples) as room:
        for item in relit:
            light_with(item, [room.sun], [SKY_RADIANCE] * 3)
        for number, contestant in enumerate(contestants):
            room.take_samples(samples if number or reference_samples is None else reference_samples)
            for place, (view, sun) in enumerate(zip(views, suns, strict=True)):
                yield Progress(
                    (number + place / len(views)) / len(contestants), f"Rendering: {contestant.name}, {place + 1} of {len(views)}"
                )
                pictures[number, place] = _photograph(room, contestant, view, sun, center, pixel_size, size)
        for item in relit:
            light_with(item, [], [0.0] * 3)
    return Relighting(views, suns, [contestant.name for contestant in contestants], pictures, pixel_size)


def score(original: np.ndarray, picture: np.ndarray) -> tuple[float, float, float]:
    """PSNR, SSIM and overlap of silhouettes of two renders (H, W, 4)."""
    first, second = encoded(original, picture)
    return metrics.psnr(first, second), metrics.ssim(first, second), metrics.alpha_iou(original[..., 3], picture[..., 3])


def encoded(original: np.ndarray, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is compared of two renders (H, W, 4): the rectangle that holds both, over mid-grey, as sRGB values (h, w, 3)."""
    window = metrics.crop_to_object(np.maximum(original[..., 3], picture[..., 3]))
    return metrics.over_grey(original[window]), metrics.over_grey(picture[window])


def relighting_sheet(title: str, relighting: Relighting, columns: Sequence[int]) -> np.ndarray:
    """A contact sheet (H, W, 3): a row a contestant, a column for each of the pairs `columns`; single pixels enlarged."""
    frame = metrics.crop_to_object(relighting.pictures[..., 3].max(axis=(0, 1)), margin=2)
    factor = max(1, round(CELL / max(span.stop - span.start for span in frame)))
    rows = [[enlarged(metrics.over_grey(pictures[pair][frame]), factor) for pair in columns] for pictures in relighting.pictures]
    scores = relighting.scores()
    labels = [
        [f"pair {pair + 1}", *(f"{name} {scores[each, pair, 0]:.1f} dB" for each, name in enumerate(relighting.names[1:]))]
        for pair in columns
    ]
    return contact_sheet(title, rows, relighting.names, labels)


def _photograph(
    room: Studio, contestant: Contestant, view: np.ndarray, sun: np.ndarray, center: np.ndarray, pixel_size: float, size: int
) -> np.ndarray:
    room.shine_from(sun)
    contestant.face(view)
    return room.picture(contestant.objects, view, center, pixel_size, size)
