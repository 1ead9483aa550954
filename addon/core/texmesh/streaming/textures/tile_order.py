"""The order of tiles: from a coarse and cheap state of all textures to complete ones, those first that improve the image most per byte.

A state shows every part of a texture by one tile of its pyramid at one quality. For a price per byte, the best state is found from the
finest level up: a tile is better than its four children if its error and the price of its bytes are less than theirs. Later tiles replace
earlier ones, so there are few states, whose bytes grow by equal factors.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..tile_pyramid import sum_tiles
from .coding import CodedTexture

BYTE_FACTOR = 4.0  # about, between states
BISECTIONS = 40
MIN_PRICE, MAX_PRICE = 1e-14, 1.0  # of a byte, in error


class Choice(NamedTuple):
    """A tile of a state: texture, level, quality index, and row and column in the level."""

    texture: int
    level: int
    quality: int
    row: int
    column: int


class QueuedTiles(NamedTuple):
    """Tiles in their order, and by how much each lowers the error, (N,) float64."""

    choices: list[Choice]
    gains: np.ndarray


def order_tiles(textures: Sequence[CodedTexture]) -> QueuedTiles:
    """Return all tiles that are sent, in their order. The last state has the whole textures at the highest quality."""
    states = _choose_states(textures)
    left = [texture.missing_errors.copy() for texture in textures]
    shown = [np.full((2, *texture.pyramid.shapes[0]), -1) for texture in textures]  # level and quality of each tile of level 0
    queue: list[Choice] = []
    gains: list[float] = []
    for index, state in enumerate(states):
        is_last = index == len(states) - 1
        found = []
        for choice in state:
            covered = (choice.texture, *textures[choice.texture].pyramid.covered(choice.level, choice.row, choice.column))
            gain = float((left[covered[0]] - _errors(textures, choice))[covered[1:]].sum())
            is_shown = (shown[covered[0]][(slice(None), *covered[1:])] == np.array([choice.level, choice.quality])[:, None, None]).all()
            if not is_shown and (is_last or gain > 0.0):
                found.append((-gain / _size(textures, choice), choice, max(gain, 0.0), covered))
        for _, choice, gain, covered in sorted(found):
            queue.append(choice)
            gains.append(gain)
            left[covered[0]][covered[1:]] = _errors(textures, choice)[covered[1:]]
            shown[covered[0]][(slice(None), *covered[1:])] = np.array([choice.level, choice.quality])[:, None, None]
    return QueuedTiles(queue, np.array(gains))


def choose_state(textures: Sequence[CodedTexture], price: float) -> list[Choice]:
    """Return the state with the least sum of errors and bytes times `price`."""
    choices = []
    for index, texture in enumerate(textures):
        best, qualities, splits = [], [], []
        for level, sizes in enumerate(texture.sizes):
            costs = sum_tiles(texture.errors[level], level) + price * sizes
            qualities.append(costs.argmin(axis=0))
            own = costs.min(axis=0)
            children = sum_tiles(best[-1], 1) if best else np.full(own.shape, np.inf)
            splits.append(children < own)
            best.append(np.minimum(own, children))
        choices += [Choice(index, *found) for found in _descend(texture, qualities, splits)]
    return choices


def _descend(texture: CodedTexture, qualities: list[np.ndarray], splits: list[np.ndarray]) -> Iterator[tuple[int, int, int, int]]:
    """Yield level, quality, row and column of the tiles in which the pyramid ends, from the coarsest down."""
    is_reached = np.ones(texture.pyramid.shapes[-1], bool)
    for level in reversed(range(len(qualities))):
        is_used = sum_tiles(texture.used.astype(np.int64), level) > 0
        ends = is_reached & is_used & ~splits[level]
        for row, column in np.argwhere(ends).tolist():
            yield level, int(qualities[level][row, column]), row, column
        if level:
            rows, columns = texture.pyramid.shapes[level - 1]
            is_reached = (is_reached & splits[level]).repeat(2, axis=0).repeat(2, axis=1)[:rows, :columns]


def _choose_states(textures: Sequence[CodedTexture]) -> list[list[Choice]]:
    """Return states, from the one with the fewest bytes to complete textures."""
    first = choose_state(textures, MAX_PRICE)
    last = [
        Choice(index, 0, len(texture.sizes[0]) - 1, row, column)
        for index, texture in enumerate(textures)
        for row, column in np.argwhere(texture.used).tolist()
    ]
    smallest, largest = (sum(_size(textures, choice) for choice in state) for state in (first, last))
    count = max(round(math.log(largest / smallest) / math.log(BYTE_FACTOR)), 1) if largest > smallest else 0
    targets = [smallest * (largest / smallest) ** (index / count) for index in range(1, count)]
    states = [first, *(_fit_state(textures, target) for target in targets)]
    return [*states, last] if last != first else states


def _fit_state(textures: Sequence[CodedTexture], byte_count: float) -> list[Choice]:
    """Return the best state with at most about so many bytes."""
    low, high = math.log(MIN_PRICE), math.log(MAX_PRICE)
    for _ in range(BISECTIONS):
        center = 0.5 * (low + high)
        if sum(_size(textures, choice) for choice in choose_state(textures, math.exp(center))) <= byte_count:
            high = center
        else:
            low = center
    return choose_state(textures, math.exp(high))


def _size(textures: Sequence[CodedTexture], choice: Choice) -> int:
    return int(textures[choice.texture].sizes[choice.level][choice.quality, choice.row, choice.column])


def _errors(textures: Sequence[CodedTexture], choice: Choice) -> np.ndarray:
    return textures[choice.texture].errors[choice.level, choice.quality]
