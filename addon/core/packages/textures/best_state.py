"""States of textures, and the best one for a price per byte.

A state shows every part of a texture by one tile of its pyramid in one variant.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..tile_pyramid import sum_tiles
from .coding import CodedTexture
from .texture_errors import SMALLER_SIZES


class Choice(NamedTuple):
    """A tile of a state.

    Attributes:
        texture, level, variant: indices.
        row, column: in the level.
    """

    texture: int
    level: int
    variant: int
    row: int
    column: int


class Decisions(NamedTuple):
    """What is best for each tile of each level: `variants`, (R', C') int64, and `splits`, (R', C') bool, whether finer tiles are better."""

    variants: list[np.ndarray]
    splits: list[np.ndarray]


def choose_state(textures: Sequence[CodedTexture], price: float) -> list[Choice]:
    """Return the state with the least sum of errors and bytes times `price`."""
    choices = []
    for index, texture in enumerate(textures):
        decisions = decide(texture, price)
        coarsest = np.ones(texture.pyramid.shapes[-1], bool)
        choices += list_choices(texture, index, decisions, len(texture.sizes) - 1, coarsest)
    return choices


def decide(texture: CodedTexture, price: float) -> Decisions:
    """Find the tiles that have the least sum of errors and bytes times `price`, from the finest level up."""
    decisions, best = Decisions([], []), np.empty(0)
    for level, (errors, sizes) in enumerate(zip(texture.tile_errors, texture.sizes, strict=True)):
        costs = errors + price * sizes
        own = costs.min(axis=0)
        children = sum_tiles(best, 1) if level else np.full(own.shape, np.inf)
        decisions.variants.append(costs.argmin(axis=0))
        decisions.splits.append(children < own)
        best = np.minimum(own, children)
    return decisions


def list_choices(texture: CodedTexture, index: int, decisions: Decisions, level: int, is_reached: np.ndarray) -> Iterator[Choice]:
    """Yield the tiles in which a part of the pyramid ends, from the coarsest down.

    index: of the texture. level: where the part begins, at the tiles `is_reached` (R', C') bool.
    """
    for finer in reversed(range(level + 1)):
        splits = decisions.splits[finer]
        for row, column in np.argwhere(is_reached & texture.used_tiles[finer] & ~splits).tolist():
            yield Choice(index, finer, int(decisions.variants[finer][row, column]), row, column)
        if finer:
            rows, columns = texture.pyramid.shapes[finer - 1]
            is_reached = (is_reached & splits).repeat(2, axis=0).repeat(2, axis=1)[:rows, :columns]


def measure_size(textures: Sequence[CodedTexture], state: Sequence[Choice]) -> int:
    """Return the bytes of the tiles of a state, or of a part of one."""
    return sum(int(textures[choice.texture].sizes[choice.level][choice.variant, choice.row, choice.column]) for choice in state)


def measure_error(textures: Sequence[CodedTexture], state: Sequence[Choice]) -> float:
    """Return the predicted mean FLIP error of the object's pixels due to the textures in a state, or to those tiles of a part of one."""
    return sum(float(textures[choice.texture].errors[_locate(textures, choice)].sum()) for choice in state)


def measure_smaller_errors(textures: Sequence[CodedTexture], state: Sequence[Choice]) -> np.ndarray:
    """Return the predicted errors (SMALLER_SIZES,) of a state where the object is smaller in the image, each time half as large."""
    return sum(
        (textures[choice.texture].smaller_errors[(slice(None), *_locate(textures, choice))].sum(axis=(1, 2)) for choice in state),
        np.zeros(SMALLER_SIZES),
    )


def _locate(textures: Sequence[CodedTexture], choice: Choice) -> tuple:
    """Return where the errors of a choice are in those of its texture."""
    return choice.level, choice.variant, *textures[choice.texture].pyramid.covered(choice.level, choice.row, choice.column)
