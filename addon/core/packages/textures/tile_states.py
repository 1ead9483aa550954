"""States of all textures, from a coarse and cheap one to complete ones, and the order of their tiles in the file.

A state shows every part of a texture by one tile of its pyramid in one variant. For a price per byte, the best state is found from the
finest level up: a tile is better than its four children if its error and the price of its bytes are less than theirs. As the price falls,
a tile is in a few states one after the other, and is then replaced by finer ones. Such states lie on the convex hull of errors over bytes.
Where neighbors on the hull differ much in size, one tile is replaced by a much larger variant, or by its finer tiles. Other replacements of
it gain less per byte, but have fewer bytes, and are the best for clients that have no time for more; such states are added in between.

In the file, a tile stands where the first state that has it adds it; of the tiles that a state adds, those that later states keep longest
come first. So the tiles that a state needs beyond an earlier one are few contiguous ranges of the file, and a client can leave out those
that would be replaced before the state that it has the time for.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..manifest import MAX_STATES
from .best_state import Choice, choose_state, decide, list_choices, measure_error, measure_size
from .coding import COMPLETE, CodedTexture

BYTE_FACTOR = 1.2  # between neighboring states, at most where there are so many; tiles are in several of them
PRICES = np.geomspace(1.0, 1e-12, 241)  # Prices of a byte, in error.
MIN_PRICE_FACTOR = 1.0001  # between prices whose states differ much, so that others are looked for between
FACTOR_STEP = 1.05  # by which states grow faster if there are too many
MAX_ERROR_FACTOR = 0.95  # between a state and the one before it
HIGHER_PRICES = np.geomspace(1.0, 300.0, 12)  # relative to the price at which both neighbors are equally good: for cheap finer tiles


class OrderedTiles(NamedTuple):
    """N tiles in the order of the file, and the first and the last state (N,) int64 that have each."""

    choices: list[Choice]
    firsts: np.ndarray
    lasts: np.ndarray


def choose_states(textures: Sequence[CodedTexture]) -> list[list[Choice]]:
    """Return states with growing numbers of bytes; the last one has the complete textures."""
    complete = [
        Choice(index, 0, COMPLETE, row, column)
        for index, texture in enumerate(textures)
        for row, column in np.argwhere(texture.used).tolist()
    ]
    candidates, factor = _list_best_states(textures), BYTE_FACTOR
    while len(states := _select_states(textures, candidates, complete, factor)) > MAX_STATES:
        factor *= FACTOR_STEP
    return states


def _list_best_states(textures: Sequence[CodedTexture]) -> list[list[Choice]]:
    """Return the best states for falling prices, all of them where neighbors differ in size by more than BYTE_FACTOR."""
    found = [choose_state(textures, price) for price in PRICES]
    states = found[:1]
    for (high, first), (low, last) in pairwise(zip(PRICES.tolist(), found, strict=True)):
        states += [*_find_between(textures, high, low, first, last), last]
    return states


def _find_between(textures: Sequence[CodedTexture], high: float, low: float, first: list[Choice], last: list[Choice]) -> list[list[Choice]]:
    """Return the best states for prices between `high`, whose state is `first`, and `low` with `last`, if these differ much in size."""
    is_near = measure_size(textures, last) <= BYTE_FACTOR * measure_size(textures, first)
    if is_near or high < MIN_PRICE_FACTOR * low:
        return []
    price = math.sqrt(high * low)
    state = choose_state(textures, price)
    return [*_find_between(textures, high, price, first, state), state, *_find_between(textures, price, low, state, last)]


def _select_states(
    textures: Sequence[CodedTexture], candidates: Sequence[list[Choice]], complete: list[Choice], factor: float
) -> list[list[Choice]]:
    """Return those of the `candidates`, and others in gaps, whose bytes grow by about `factor`, and the `complete` state."""
    sizes = [*(measure_size(textures, state) for state in candidates), measure_size(textures, complete)]
    states, size = [candidates[0]], sizes[0]
    for state, own_size, next_size in zip(candidates[1:], sizes[1:-1], sizes[2:], strict=True):
        if size < own_size < sizes[-1] and next_size > factor * size:  # the largest one that is not too large, or the next one
            states += [*fill_gap(textures, states[-1], state, factor), state]
            size = own_size
    return [*states, *fill_gap(textures, states[-1], complete, factor), complete] if set(complete) != set(states[-1]) else states


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


def fill_gap(textures: Sequence[CodedTexture], first: Sequence[Choice], last: Sequence[Choice], factor: float) -> list[list[Choice]]:
    """Return states between `first` and `last` by falling errors, whose bytes grow by `factor` or more.

    Each replaces one tile of `first` that `last` does not have.
    """
    (size, error), (last_size, last_error) = [(measure_size(textures, state), measure_error(textures, state)) for state in (first, last)]
    if last_size <= factor**2 * size or error <= last_error:
        return []
    price = (error - last_error) / (last_size - size)
    candidates = []
    for tile in sorted(set(first) - set(last)):
        others = [choice for choice in first if choice != tile]
        rest = size - measure_size(textures, [tile]), error - measure_error(textures, [tile])
        for tiles in _list_replacements(textures[tile.texture], tile, price):
            candidates.append((rest[0] + measure_size(textures, tiles), rest[1] + measure_error(textures, tiles), others + tiles))
    states = []
    for new_size, new_error, state in sorted(candidates):
        if factor * size <= new_size <= last_size / factor and last_error < new_error < MAX_ERROR_FACTOR * error:
            states.append(state)
            size, error = new_size, new_error
    return states


def _list_replacements(texture: CodedTexture, tile: Choice, price: float) -> Iterator[list[Choice]]:
    """Yield what can be shown instead of a tile: its other variants, and finer tiles."""
    is_coded = np.isfinite(texture.errors[(tile.level, slice(None), *texture.pyramid.covered(tile.level, tile.row, tile.column))])
    for variant in np.flatnonzero(is_coded.all(axis=(1, 2))).tolist():
        yield [tile._replace(variant=variant)]
    if tile.level == 0:
        return
    is_reached = np.zeros(texture.pyramid.shapes[tile.level], bool)
    is_reached[tile.row, tile.column] = True
    for factor in HIGHER_PRICES:
        decisions = decide(texture, price * float(factor))
        decisions.splits[tile.level][tile.row, tile.column] = True
        yield list(list_choices(texture, tile.texture, decisions, tile.level, is_reached))
