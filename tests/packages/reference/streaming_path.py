"""The best order of levels and states of the textures for an uncertain number of bytes. See `controller`."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from reference.byte_intervals import Interval, measure, subtract
from reference.streaming_state import TransferPlan

# Bytes after which the client may have to stop, relative to the expected number, equally likely: small ones since connections fade, and
# because what comes is seen at once; most are near the expected number, since a state that does not become complete is of little use.
STOPS = (0.3, 0.5, 0.6, 0.7, 0.77, 0.84, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15, 1.2, 1.3, 1.5)
HEADERS = 400  # bytes of those of a response
MIN_ERROR = 1e-6
STRIDE = 6.0  # by which the bytes of states grow from one to the next on a path, behind the first


class Textures(NamedTuple):
    """What has been asked for of the textures. state: the last one that is complete, or -1. left: how many bytes each state lacks.
    missing: which these are."""

    state: int
    left: list[int]
    missing: list[list[Interval]]


def inspect_textures(plan: TransferPlan, requested: list[Interval]) -> Textures:
    """Return what has been asked for of the textures. requested: bytes of textures.bin."""
    missing = [subtract(state, requested) for state in plan.states]
    return describe_textures([measure(intervals) for intervals in missing], missing)


def describe_textures(left: list[int], missing: Sequence[list[Interval]] = ()) -> Textures:
    """Return the textures of which each state lacks so many bytes, and which."""
    complete = [state for state, count in enumerate(left) if not count]
    return Textures(complete[-1] if complete else -1, left, list(missing))


def list_increments(plan: TransferPlan, intervals: list[Interval]) -> Iterator[Interval]:
    """Yield the increments, or parts of some, that lie in intervals of textures.bin."""
    for start, end in intervals:
        begin, index = start, bisect_right(plan.ends, start)
        while begin < end:
            stop = min(plan.ends[index], end)
            yield begin, stop
            begin, index = stop, index + 1


def estimate_errors(plan: TransferPlan, textures: Textures) -> list[float]:
    """Return the error of each level with these textures: between those of the complete state and of a later one, by the bytes of the
    latter that have been asked for."""
    found = []
    for row in plan.errors:
        start = row[textures.state] if textures.state >= 0 else 1.0
        best = start
        for state in range(textures.state + 1, len(row)):
            step = plan.steps[textures.state][state] if textures.state >= 0 else plan.sizes[state]
            best = min(best, start + (row[state] - start) * (1.0 - textures.left[state] / step))
        found.append(best)
    return found


def find_path(
    plan: TransferPlan, level: int, textures: Textures, spent: int, remaining: int, budget: float, window: float
) -> tuple[int, int]:
    """Return the level that the best path has asked for after about `window` bytes, and the state of the textures that it goes to next.

    A path goes from `level` and `textures` to the best level and the last state. It goes to a state that differs between paths, and from
    there over states whose bytes grow by STRIDE; the tiles that only the states between have are left out. Each step is the next level, of
    which parts are of no use, or the next state on the path; each step to a state has HEADERS of its own, the levels have them once. No
    path but that to the last state goes to one with an increment of more than `budget` bytes, of which a part is of no use. The best path
    has the smallest sum, over STOPS, of errors relative to the best ones with as many bytes; it is found from its end backwards. A level
    that is longer than `window` is the first step or none.

    Args:
        level: the finest one of which nothing is left to ask for. spent: requested bytes of increments. remaining: bytes that are
            left of the next level. budget: bytes that are expected before the limit.
    """
    finest, last = len(plan.levels) - 1, len(plan.errors[0]) - 1
    meshes = [0] + [plan.levels[other].end - plan.levels[level + 1].end + remaining + HEADERS for other in range(level + 1, finest + 1)]
    present = estimate_errors(plan, textures)
    budget = min(budget, meshes[-1] + textures.left[last])
    stops = [budget * stop for stop in STOPS]
    weights = [1.0 / _least_error(plan, plan.levels[level].end + spent + stop) for stop in stops]
    best, found = -1.0, (level, last)
    for state in range(min(textures.state + 1, last), last + 1):
        if state < last and textures.left[state] > budget and _has_longer(plan, textures.missing[state], budget):
            continue
        states = _list_states(plan, textures, state)
        sizes = [0]
        for index, other in enumerate(states):
            sizes.append(sizes[-1] + HEADERS + (textures.left[other] if index == 0 else plan.steps[states[index - 1]][other]))
        errors = [[error, *(min(error, plan.errors[row][other]) for other in states)] for row, error in enumerate(present[level:], level)]
        cost, takes_level = _find_costs(meshes, sizes, errors, stops, weights)
        if best < 0.0 or cost < best:
            best, found = cost, (level + _walk(meshes, sizes, takes_level, window), states[0] if states else last)
        if textures.left[state] > stops[-1]:
            break  # later states will not come either
    return found


def _has_longer(plan: TransferPlan, intervals: list[Interval], size: float) -> bool:
    """Return whether an increment, or a part of one, in intervals of textures.bin has more than `size` bytes."""
    return any(end - start > size for start, end in list_increments(plan, intervals))


def _list_states(plan: TransferPlan, textures: Textures, state: int) -> list[int]:
    """Return the states on a path to `state` and then to the last one: first of all comes state 0, so that something is seen soon."""
    last = len(plan.errors[0]) - 1
    states = [0] if state > 0 and textures.state < 0 and plan.sizes[0] * STRIDE <= plan.sizes[state] else []
    if textures.state < state:
        states.append(state)
    while states and states[-1] < last:
        states.append(next((other for other in range(states[-1] + 1, last) if plan.sizes[other] >= STRIDE * plan.sizes[states[-1]]), last))
    return states


def _find_costs(
    meshes: list[int], sizes: list[int], errors: list[list[float]], stops: list[float], weights: list[float]
) -> tuple[float, list[list[bool]]]:
    """Return the cost of the best way through levels and states, and at which of them the next level is its next step.

    meshes, sizes: bytes of levels and of states from the beginning on. errors: of each level with each state.
    """
    rows, last = len(meshes) - 1, len(sizes) - 1
    takes_level = [[False] * len(sizes) for _ in meshes]
    costs: list[float] = []

    def add_cost(cost: float, start: float, end: float, error: float, rise: float) -> float:
        """Add the errors at the stops from `start` to `end`."""
        for stop, weight in zip(stops, weights, strict=True):
            if start <= stop < end:
                cost += weight * (error + (stop - start) * rise)
        return cost

    for row in range(rows, -1, -1):
        finer, costs = costs, [0.0] * len(sizes)
        for column in range(last, -1, -1):
            start, error = meshes[row] + sizes[column], errors[row][column]
            if start > stops[-1]:
                continue
            if column < last:
                step = sizes[column + 1] - sizes[column]
                costs[column] = add_cost(costs[column + 1], start, start + step, error, (errors[row][column + 1] - error) / step)
            if row < rows:
                cost = add_cost(finer[column], start, meshes[row + 1] + sizes[column], error, 0.0)
                takes_level[row][column] = column == last or cost < costs[column]
                if takes_level[row][column]:
                    costs[column] = cost
            elif column == last:
                costs[column] = add_cost(0.0, start, 2.0 * stops[-1] + 1.0, error, 0.0)
    return costs[0], takes_level


def _walk(meshes: list[int], sizes: list[int], takes_level: list[list[bool]], window: float) -> int:
    """Return by how many levels a way gets finer within `window` bytes."""
    row = column = 0
    while meshes[row] + sizes[column] < window:
        if takes_level[row][column]:
            if row + column and meshes[row + 1] + sizes[column] > window:
                break
            row += 1
        elif column < len(sizes) - 1:
            column += 1
        else:
            break
    return row


def _least_error(plan: TransferPlan, byte_count: float) -> float:
    """Return the least error with `byte_count` bytes of levels and increments."""
    least = 1.0
    for span, row in zip(plan.levels, plan.errors, strict=True):
        for size, error in zip(plan.sizes, row, strict=True):
            if span.end + size <= byte_count:
                least = min(least, error)
    return max(least, MIN_ERROR)
