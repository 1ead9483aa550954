"""Choice of levels of detail: by their number, or by a budget of triangles, bytes or pixels, so that a renderer draws few triangles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ...errors import SettingsError
from .switch_distances import MIN_SWITCH_RATIO

RANGE_MARGIN = 2.0  # factor of pixel sizes beyond the smallest and the largest that count, when triangles are averaged over distances


@dataclass(frozen=True)
class LevelOption:
    """A level that can be chosen. pixel_size: the size of a pixel in the object's unit from which it may be shown; 0 for the original."""

    triangles: int
    byte_count: int
    pixel_size: float


@dataclass(frozen=True)
class LevelBudget:
    """What limits the chosen levels; None for no limit.

    count: number of levels. triangles, byte_count: of all chosen levels together. pixels: error of a level in pixels up to which it is
    shown; levels with a larger error in pixels at `pixel_size_at_farthest`, the size of a pixel at the farthest distance, are never shown.
    """

    count: int | None = None
    triangles: int | None = None
    byte_count: int | None = None
    pixels: float = 1.0
    pixel_size_at_farthest: float = math.inf


@dataclass(frozen=True)
class _Choice:
    """Chosen levels up to the last one: indices, what they use, and their triangles averaged over the logarithm of the distance."""

    indices: tuple[int, ...]
    triangles: int
    byte_count: int
    cost: float

    def is_no_better_than(self, other: "_Choice") -> bool:
        mine, best = ((len(item.indices), item.triangles, item.byte_count, item.cost) for item in (self, other))
        return all(value >= limit for value, limit in zip(mine, best, strict=True))


def choose_levels(options: Sequence[LevelOption], budget: LevelBudget) -> list[int]:
    """Return the indices of the chosen `options`, finest first.

    The finest level that fits the budget alone is always chosen. Among all choices that fit, it is the one with the smallest mean number of
    triangles over the logarithm of the distance, from the nearest switch to the farthest.

    Args:
        options: finest first, with ascending pixel sizes.

    Raises:
        SettingsError: there are no options, their pixel sizes do not ascend, the budget allows no level, or is not positive.
    """
    sizes = [option.pixel_size for option in options]
    if not options or sizes != sorted(sizes) or not all(0.0 <= size < math.inf for size in sizes):
        raise SettingsError("Levels to choose from need sizes of pixels from which they are shown that grow from fine to coarse.")
    if budget.pixels <= 0.0 or (budget.count is not None and budget.count < 1):
        raise SettingsError("A budget needs at least one level and a positive error in pixels.")
    usable = [index for index, size in enumerate(sizes) if size <= budget.pixels * budget.pixel_size_at_farthest]
    fitting = [index for index in usable if _fits(_Choice((index,), options[index].triangles, options[index].byte_count, 0.0), budget)]
    if not fitting:
        smallest = min(options, key=lambda option: option.byte_count)
        raise SettingsError(
            f"The budget is less than the smallest level, {smallest.triangles} triangles and {smallest.byte_count} bytes; increase it."
        )
    positive = [size for size in sizes if size > 0.0] or [1.0]
    logs = [math.log(max(size, positive[0] / RANGE_MARGIN)) for size in sizes]
    farthest = math.log(positive[-1] * RANGE_MARGIN)
    first = fitting[0]
    frontier = {first: [_Choice((first,), options[first].triangles, options[first].byte_count, 0.0)]}
    for last in fitting[1:]:
        option = options[last]
        grown = []
        for choices in frontier.values():
            for choice in choices:
                previous = choice.indices[-1]
                cost = choice.cost + options[previous].triangles * (logs[last] - logs[previous])
                triangles, byte_count = choice.triangles + option.triangles, choice.byte_count + option.byte_count
                grown.append(_Choice((*choice.indices, last), triangles, byte_count, cost))
        frontier[last] = _drop_dominated([choice for choice in grown if _fits(choice, budget)])
    complete = [choice for choices in frontier.values() for choice in choices]

    def total_cost(choice: _Choice) -> tuple[float, int]:
        return choice.cost + options[choice.indices[-1]].triangles * (farthest - logs[choice.indices[-1]]), len(choice.indices)

    return list(min(complete, key=total_cost).indices)


def skip_finest(chosen: Sequence[int], pixel_sizes: Sequence[float]) -> list[int]:
    """Return the `chosen` indices, 0 for the original first, without the next one if another follows so closely that it would be hardly
    shown. Refitting it would take as long as all others, and after refits the coarser one is shown from nearer still.

    pixel_sizes: of all levels, those from which they may be shown.
    """
    is_close = len(chosen) > 2 and pixel_sizes[chosen[2]] < MIN_SWITCH_RATIO * pixel_sizes[chosen[1]]
    return [chosen[0], *chosen[2 if is_close else 1 :]]


def _fits(choice: _Choice, budget: LevelBudget) -> bool:
    return (
        (budget.count is None or len(choice.indices) <= budget.count)
        and (budget.triangles is None or choice.triangles <= budget.triangles)
        and (budget.byte_count is None or choice.byte_count <= budget.byte_count)
    )


def _drop_dominated(choices: list[_Choice]) -> list[_Choice]:
    """Return the choices that end with the same level without those that are no better than another in any respect."""
    kept: list[_Choice] = []
    for choice in sorted(choices, key=lambda choice: (choice.cost, choice.triangles, choice.byte_count, len(choice.indices))):
        if not any(choice.is_no_better_than(other) for other in kept):
            kept.append(choice)
    return kept
