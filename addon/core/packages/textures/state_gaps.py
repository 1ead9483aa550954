"""States of textures between two neighbors on the convex hull of errors over bytes.

There, one tile is replaced by a much larger variant, or by its finer tiles. Other replacements of it gain less per byte, but have fewer
bytes, and are the best for clients that have no time for more.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from .best_state import Choice, decide, list_choices, measure_error, measure_size
from .coding import CodedTexture

MAX_ERROR_FACTOR = 0.95  # between a state and the one before it
HIGHER_PRICES = np.geomspace(1.0, 300.0, 12)  # relative to the price at which both neighbors are equally good: for cheap finer tiles


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
