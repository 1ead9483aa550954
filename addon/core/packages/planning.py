"""How the bytes of a package are divided between mesh and texture, by the predicted FLIP error of renders (section V).

The error of a coarse mesh with the whole texture, and that of the finest mesh with a state of the textures, are measured in renders.
Together they are predicted as (m^p + t^p)^(1/p); p is fitted to renders with both. Thus a few dozen renders give the table of all
combinations.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from ..geometry.directions import fibonacci_sphere
from ..imaging.mipmaps import Mipmaps
from ..jobs.progress import Progress, Steps
from ..texmesh.perception.level_images import LevelImages, measure_difference, prepare_images
from ..texmesh.perception.views import frame_around, prepare_surface
from ..texmesh.textured_mesh import TexturedMesh
from .manifest import MAX_EXPONENT, MIN_EXPONENT, ErrorModel, combine_errors

MAX_IMAGE = 512  # pixels of the renders: larger objects are seen in parts, and their errors change little
VIEWS = 3
MIN_ERROR = 1e-6  # smaller measured errors count as this, relative to others
MIN_PREDICTED = 1e-3  # that matters in ratios of errors
DECIMALS = 4  # Decimals of predicted errors.
Textures = Sequence[Mipmaps | None]


@dataclass(frozen=True, eq=False)
class ErrorTable:
    """Mean FLIP errors over the pixels of the object.

    Attributes:
        level_errors: (K,) of levels with the whole texture, coarsest first.
        states: (P,) ascending, of the textures.
        texture_errors: (P,) of the finest level with them.
        exponent: p.
        residual: largest difference between predicted and measured errors of combinations.
    """

    level_errors: np.ndarray
    states: np.ndarray
    texture_errors: np.ndarray
    exponent: float
    residual: float

    def predict(self, predicted: np.ndarray) -> ErrorModel:
        """Return the errors of all levels and of all S states.

        predicted: (S,) sums of the errors of tiles; the ratios of measured errors to them are interpolated between measured states.
        """
        ratios = (self.texture_errors + MIN_PREDICTED) / (predicted[self.states] + MIN_PREDICTED)
        textures = (predicted + MIN_PREDICTED) * np.interp(np.arange(len(predicted)), self.states, ratios) - MIN_PREDICTED
        levels, textures = (np.minimum.accumulate(np.clip(errors, 0.0, 1.0)) for errors in (self.level_errors, textures))
        return ErrorModel(*(tuple(np.round(errors, DECIMALS).tolist()) for errors in (levels, textures)), round(self.exponent, DECIMALS))


class PlanRow(NamedTuple):
    """The best use of a number of bytes: a level, coarsest is 0, a state of the textures, and the predicted error."""

    byte_count: int
    level: int
    state: int
    error: float


def measure_errors(
    levels: Sequence[TexturedMesh],
    original: Textures,
    states: Sequence[int],
    decode: Callable[[int], Textures],
    pixels: int,
    pixels_per_degree: float,
) -> Steps[ErrorTable]:
    """Measure the errors of levels and of states of their textures against the finest level with the original textures.

    Args:
        levels: coarsest first. original: by material, linear. states: ascending. decode: returns the textures in a state. pixels: size of
            the object in the image.
    """
    size, frame, directions = min(pixels, MAX_IMAGE), frame_around(levels[-1].vertices), fibonacci_sphere(VIEWS)

    def open_level(level: int, textures: Textures) -> LevelImages:
        return LevelImages(prepare_surface(levels[level], textures, is_lit=True), frame, directions, pixels_per_degree, {})

    def error(images: LevelImages) -> float:
        return float(measure_difference(reference, images, size, range(VIEWS)).means.mean())

    total = len(levels) + len(states)
    yield Progress(0.0, "Comparing levels")
    reference = open_level(-1, original)
    prepare_images([reference], range(VIEWS), size)
    level_errors = np.zeros(len(levels))
    for index in range(len(levels) - 1):
        yield Progress(index / total, f"Comparing level {index + 1} of {len(levels)}")
        level_errors[index] = error(open_level(index, original))
    reference.forget_textures()
    del original  # before others are decoded: textures are most of the memory
    texture_errors, samples = np.zeros(len(states)), []
    partner: tuple[int, LevelImages] | None = None  # the last level that was combined with textures
    for index, state in enumerate(states):
        yield Progress((len(levels) + index) / total, f"Comparing textures {index + 1} of {len(states)}")
        textures = decode(state)
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
    return ErrorTable(level_errors, np.asarray(states, np.int64), texture_errors, exponent, residual)


def find_state_pixels(flips: np.ndarray, pixels: int, max_difference: float) -> tuple[float, ...]:
    """Return for each state of the textures the size of the object in the image, in pixels, up to which it looks like the last one; 0 for
    the last one, which is right at all sizes. Sizes never fall, and are at most `pixels`.

    Args:
        flips: (K, N), predicted errors of the states in images of `pixels` pixels, of half as many, and so on. Between these sizes the
            logarithms of errors are interpolated; below the smallest one, errors are taken to be proportional to the size.
    """
    sizes = np.log2(pixels) - np.arange(flips.shape[1])[::-1]
    errors = np.log2(np.maximum(flips - flips[-1:], MIN_ERROR)[:-1, ::-1] / max_difference)
    found = []
    for row in errors:
        step = int(np.argmax(row > 0.0))
        if row[step] <= 0.0:
            found.append(sizes[-1])
        elif step == 0:
            found.append(sizes[0] - row[0])
        else:
            found.append(sizes[step - 1] + row[step - 1] / (row[step - 1] - row[step]))
    return (*np.maximum.accumulate(np.round(np.exp2(found), 1)).tolist(), 0.0)


def make_plan(errors: Sequence[Sequence[float]], mesh_sizes: Sequence[int], state_sizes: Sequence[int]) -> tuple[PlanRow, ...]:
    """Return the best uses of growing numbers of bytes: of all levels and states those that no other is better than for as few bytes.

    Args:
        errors: (K, S). mesh_sizes: (K,), bytes of each level with all coarser ones. state_sizes: (S,).
    """
    rows = [
        PlanRow(int(mesh_sizes[level]) + int(state_sizes[state]), level, state, float(error))
        for level, row in enumerate(errors)
        for state, error in enumerate(row)
    ]
    plan: list[PlanRow] = []
    for row in sorted(rows, key=lambda row: (row.byte_count, row.error)):
        if not plan or row.error < plan[-1].error:
            plan.append(row)
    return tuple(plan)


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
