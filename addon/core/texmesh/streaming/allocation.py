"""How the bytes of a package are divided between mesh and texture, by the predicted FLIP error of renders (section V).

The error of a coarse mesh with the whole texture, and that of the finest mesh with a part of the texture, are measured in renders. Together
they are predicted as (m^p + t^p)^(1/p); p is fitted to renders with both. Thus a few dozen renders give the table of all combinations.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from ...geometry.directions import fibonacci_sphere
from ...imaging.mipmaps import Mipmaps
from ...jobs.progress import Progress, Steps
from ..perception.level_images import LevelImages, measure_difference, prepare_images
from ..perception.views import frame_around, prepare_surface
from ..textured_mesh import TexturedMesh
from .manifest import PlanRow

MAX_IMAGE = 512  # pixels of the renders: larger objects are seen in parts, and their errors change little
VIEWS = 3
MIN_EXPONENT, MAX_EXPONENT = 1.0, 8.0
MIN_ERROR = 1e-6  # smaller measured errors count as this, relative to others
COUNTS = 96  # numbers of increments that are tried for the plan, and those that were measured
MAX_ROWS = 64  # of the plan
MIN_GAIN = 0.98  # error of a row of the plan relative to the row before, at most
Textures = Sequence[Mipmaps | None]


@dataclass(frozen=True, eq=False)
class ErrorTable:
    """Mean FLIP errors over the pixels of the object.

    level_errors: (K,) of levels with the whole texture, coarsest first. counts: (P,) ascending numbers of increments. texture_errors: (P,)
    of the finest level with them. exponent: p. residual: largest difference between predicted and measured errors of combinations.
    """

    level_errors: np.ndarray
    counts: np.ndarray
    texture_errors: np.ndarray
    exponent: float
    residual: float

    def predict(self, level: np.ndarray | int, byte_counts: np.ndarray, at_counts: np.ndarray) -> np.ndarray:
        """Return the error with a level and textures of `byte_counts` bytes, where those of `counts` are `at_counts`.

        Errors are linear in the logarithm of the bytes between measured ones.
        """
        texture = np.interp(np.log(np.maximum(byte_counts, 1)), np.log(np.maximum(at_counts, 1)), self.texture_errors)
        return combine_errors(self.level_errors[level], texture, self.exponent)


def combine_errors(first: np.ndarray | float, second: np.ndarray | float, exponent: float) -> np.ndarray:
    """Return the error of two independent causes: the sum with `exponent` 1, the larger one with a large exponent."""
    largest = np.maximum(np.maximum(first, second), 1e-12)
    return largest * ((first / largest) ** exponent + (second / largest) ** exponent) ** (1.0 / exponent)


def measure_errors(
    levels: Sequence[TexturedMesh],
    original: Textures,
    counts: Sequence[int],
    decode: Callable[[int], Textures],
    pixels: int,
    pixels_per_degree: float,
) -> Steps[ErrorTable]:
    """Measure the errors of levels and of parts of their textures against the finest level with the original textures.

    Args:
        levels: coarsest first. original: by material, linear. counts: ascending numbers of increments. decode: returns the textures with
            the first so many increments. pixels: size of the object in the image.
    """
    size, frame, directions = min(pixels, MAX_IMAGE), frame_around(levels[-1].vertices), fibonacci_sphere(VIEWS)

    def open_level(level: int, textures: Textures) -> LevelImages:
        return LevelImages(prepare_surface(levels[level], textures, is_lit=True), frame, directions, pixels_per_degree, {})

    def error(images: LevelImages) -> float:
        return float(measure_difference(reference, images, size, range(VIEWS)).means.mean())

    total = len(levels) + len(counts)
    yield Progress(0.0, "Comparing levels")
    reference = open_level(-1, original)
    prepare_images([reference], range(VIEWS), size)
    level_errors = np.zeros(len(levels))
    for index in range(len(levels) - 1):
        yield Progress(index / total, f"Comparing level {index + 1} of {len(levels)}")
        level_errors[index] = error(open_level(index, original))
    reference.forget_textures()
    del original  # before others are decoded: textures are most of the memory
    texture_errors, samples = np.zeros(len(counts)), []
    partner: tuple[int, LevelImages] | None = None  # the last level that was combined with textures
    for index, count in enumerate(counts):
        yield Progress((len(levels) + index) / total, f"Comparing textures {index + 1} of {len(counts)}")
        textures = decode(count)
        texture_errors[index] = error(reference.replace_textures(textures))
        level = _nearest(level_errors[:-1], texture_errors[index])
        if level is not None:
            if partner is None or partner[0] != level:
                partner = level, open_level(level, textures)
            samples.append((level_errors[level], texture_errors[index], error(partner[1].replace_textures(textures))))
            partner[1].forget_textures()
        del textures
    level_errors, texture_errors = (np.minimum.accumulate(errors) for errors in (level_errors, texture_errors))
    exponent, residual = _fit_exponent(np.array(samples).reshape(-1, 3))
    return ErrorTable(level_errors, np.asarray(counts, np.int64), texture_errors, exponent, residual)


def make_plan(table: ErrorTable, mesh_sizes: Sequence[int], increment_sizes: np.ndarray) -> tuple[PlanRow, ...]:
    """Return the best uses of growing numbers of bytes.

    Args:
        mesh_sizes: bytes of each level, coarsest first. increment_sizes: (N,).
    """
    ends = np.concatenate([[0], np.cumsum(increment_sizes)]).astype(np.int64)
    at_counts = ends[table.counts]
    first, last = int(table.counts[0]), int(table.counts[-1])
    wanted = np.geomspace(max(ends[first], 1), max(ends[last], 1), COUNTS)
    counts = np.unique(np.concatenate([table.counts, np.clip(np.searchsorted(ends, wanted), first, last)]))
    levels = np.repeat(np.arange(len(mesh_sizes)), len(counts))
    counts = np.tile(counts, len(mesh_sizes))
    byte_counts = np.asarray(mesh_sizes, np.int64)[levels] + ends[counts]
    errors = table.predict(levels, ends[counts], at_counts)
    order = np.lexsort((errors, byte_counts))
    rows: list[PlanRow] = []
    for index in order.tolist():
        if not rows or errors[index] < rows[-1].flip:
            rows.append(PlanRow(int(byte_counts[index]), int(levels[index]), int(counts[index]), round(float(errors[index]), 6)))
    return _thin_rows(rows)


def _nearest(errors: np.ndarray, error: float) -> int | None:
    """Return the level whose error is nearest to that of a texture, where the way they combine matters most; None if there is none."""
    if not len(errors) or error <= 0.0:
        return None
    return int(np.abs(np.log(np.maximum(errors, MIN_ERROR) / error)).argmin())


def _fit_exponent(samples: np.ndarray) -> tuple[float, float]:
    """Return the exponent that predicts the third column from the first two best, relative to it, and the largest difference; 2 without
    samples. Small errors add nearly up, and large ones do not: absolute differences would fit the large ones only."""
    if not len(samples):
        return 2.0, 0.0

    def predict(exponent: float) -> np.ndarray:
        return combine_errors(samples[:, 0], samples[:, 1], exponent)

    def loss(exponent: float) -> float:
        return float((np.log(predict(exponent) / np.maximum(samples[:, 2], MIN_ERROR)) ** 2).sum())

    found = minimize_scalar(loss, bounds=(MIN_EXPONENT, MAX_EXPONENT), method="bounded")
    return float(found.x), float(np.abs(predict(found.x) - samples[:, 2]).max())


def _thin_rows(rows: list[PlanRow]) -> tuple[PlanRow, ...]:
    """Return at most MAX_ROWS rows: those whose error is clearly smaller than that of the row before, and the last."""
    gain = MIN_GAIN
    while True:
        kept = [rows[0]]
        for row in rows[1:-1]:
            if row.flip <= gain * kept[-1].flip:
                kept.append(row)
        kept += rows[-1:] if len(rows) > 1 else []
        if len(kept) <= MAX_ROWS:
            return tuple(kept)
        gain *= MIN_GAIN
