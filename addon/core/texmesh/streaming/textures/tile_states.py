"""States of all textures, from a coarse and cheap one to complete ones, and the order of their tiles in the file.

A state shows every part of a texture by one tile of its pyramid at one quality. For a price per byte, the best state is found from the
finest level up: a tile is better than its four children if its error and the price of its bytes are less than theirs. As the price falls,
a tile is in a few states one after the other, and is then replaced by finer ones.

In the file, a tile stands where the first state that has it adds it; of the tiles that a state adds, those that later states keep longest
come first. So the tiles that a state needs beyond an earlier one are few contiguous ranges of the file, and a client can leave out those
that would be replaced before the state that it has the time for.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..manifest import MAX_STATES
from ..tile_pyramid import sum_tiles
from .coding import CodedTexture

BYTE_FACTOR = 1.2  # between neighboring states, at most where there are so many; tiles are in several of them
PRICES = np.geomspace(1.0, 1e-12, 241)  # of a byte, in error


class Choice(NamedTuple):
    """A tile of a state: texture, level, quality index, and row and column in the level."""

    texture: int
    level: int
    quality: int
    row: int
    column: int


class OrderedTiles(NamedTuple):
    """N tiles in the order of the file, and the first and the last state (N,) int64 that have each."""

    choices: list[Choice]
    firsts: np.ndarray
    lasts: np.ndarray


def choose_states(textures: Sequence[CodedTexture]) -> list[list[Choice]]:
    """Return states with growing numbers of bytes; the last one has the whole textures at the highest quality."""
    last = [
        Choice(index, 0, len(texture.sizes[0]) - 1, row, column)
        for index, texture in enumerate(textures)
        for row, column in np.argwhere(texture.used).tolist()
    ]
    candidates = [choose_state(textures, price) for price in PRICES]
    sizes = [sum(_size(textures, choice) for choice in state) for state in candidates]
    total = sum(_size(textures, choice) for choice in last)
    factor = max(BYTE_FACTOR, (total / sizes[0]) ** (1.0 / (MAX_STATES - 2))) if sizes[0] else BYTE_FACTOR
    states, size = [candidates[0]], sizes[0]
    for index, state in enumerate(candidates[1:], 1):
        next_size = sizes[index + 1] if index + 1 < len(sizes) else total
        if size < sizes[index] < total and next_size > factor * size:  # the largest one that is not too large, or the next one
            states.append(state)
            size = sizes[index]
    return [*states, last] if set(last) != set(states[-1]) else states


def order_tiles(states: Sequence[Sequence[Choice]]) -> OrderedTiles:
    """Return the tiles of all states in the order of the file."""
    spans: list[list] = []  # first state, last state, tile
    running: dict[Choice, list] = {}
    for index, state in enumerate(states):
        running = {choice: running.get(choice) or [index, index, choice] for choice in state}
        for span in running.values():
            span[1] = index
            if span[0] == index:
                spans.append(span)
    spans.sort(key=lambda span: (span[0], -span[1], span[2]))
    firsts, lasts = (np.array([span[column] for span in spans], np.int64) for column in (0, 1))
    return OrderedTiles([span[2] for span in spans], firsts, lasts)


def measure_state(textures: Sequence[CodedTexture], state: Sequence[Choice]) -> float:
    """Return the predicted mean FLIP error of the object's pixels due to the textures in a state."""
    error = 0.0
    for choice in state:
        covered = textures[choice.texture].pyramid.covered(choice.level, choice.row, choice.column)
        error += float(textures[choice.texture].errors[(choice.level, choice.quality, *covered)].sum())
    return error


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


def _size(textures: Sequence[CodedTexture], choice: Choice) -> int:
    return int(textures[choice.texture].sizes[choice.level][choice.quality, choice.row, choice.column])
