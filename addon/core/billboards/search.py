"""The error that uses up a budget, in few builds: what a cloud takes falls about as a power of its error."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..progress import Steps, scaled
from ..settings import describe
from .patches import Covering
from .settings import BillboardSettings

MOST_BUILDS = 6
ENOUGH = 0.9  # of the limit: nothing nearer is looked for
AIM = 0.955  # of the limit: the middle of what is near enough
MOST_COARSER = 6.0  # times the error in one step
MOST_FINER = 4.0
LEAST_STEP = 1.05  # times the error: less changes a count by chance more than by intent
LEAST_POWER, MOST_POWER = 0.3, 3.0
NOTHING_GAINED = 2.0  # times finer without taking more: finer errors would only make texture
SMALLEST, LARGEST = next((item.minimum, item.maximum) for item in describe(BillboardSettings) if item.name == "error")


@dataclass(frozen=True)
class Attempt:
    """share: the error of the finest level over the longest side. used: what it takes of the budget, in the budget's unit; infinite where
    no texture is large enough. coverings: those of the finest levels, finest first."""

    share: float
    used: float
    coverings: list[Covering]


def search(
    build: Callable[[float], Steps[Attempt]],
    limit: float,
    guess: float,
    power: float,
    known: Sequence[Attempt] = (),
    most_builds: int = MOST_BUILDS,
) -> Steps[Attempt]:
    """The attempt that takes most of `limit` and not more; where every error takes more, the one with the largest error.

    Args:
        build: makes the attempt with a given error.
        guess: the error to begin with, where nothing is `known`.
        power: what is used falls about as the error to the power of -`power`.
    """
    attempts = list(known)
    for number in range(most_builds):
        share = next_share(attempts, limit, power) if attempts else guess
        if share is None:
            break
        if number == most_builds - 1 and all(attempt.used > limit for attempt in attempts):
            share = LARGEST
        # How many builds it will be is not known: each takes half of what is left of the bar.
        attempts.append((yield from scaled(build(share), 1.0 - 0.5**number, 1.0 - 0.5 ** (number + 1))))
    return best_of(attempts, limit)


def best_of(attempts: Sequence[Attempt], limit: float) -> Attempt:
    """The first of `attempts` that takes most of `limit` and not more, or else the one with the largest error."""
    within = [attempt for attempt in attempts if attempt.used <= limit]
    return max(within, key=lambda attempt: attempt.used) if within else max(attempts, key=lambda attempt: attempt.share)


def next_share(attempts: Sequence[Attempt], limit: float, power: float) -> float | None:
    """The error to try after `attempts`, at least one; None where another would bring nothing."""
    over = [attempt for attempt in attempts if attempt.used > limit]
    within = [attempt for attempt in attempts if attempt.used <= limit]
    if not within:
        return _coarser(over, limit, power)
    if max(attempt.used for attempt in within) >= ENOUGH * limit:
        return None
    if not over:
        return _finer(within, limit, power)
    return _between(max(over, key=lambda attempt: attempt.share), min(within, key=lambda attempt: attempt.share), limit)


def _coarser(over: Sequence[Attempt], limit: float, power: float) -> float | None:
    """A larger error than all of those that are `over` the limit."""
    ordered = sorted(over, key=lambda attempt: -attempt.share)
    coarsest = ordered[0]
    if coarsest.share >= LARGEST:
        return None
    fitting = limit > 0.0 and math.isfinite(coarsest.used)
    step = _step(coarsest.used / (AIM * limit), _power(ordered, power), MOST_COARSER) if fitting else MOST_COARSER
    return min(LARGEST, coarsest.share * step)


def _finer(within: Sequence[Attempt], limit: float, power: float) -> float | None:
    """A smaller error than all of those `within` the limit."""
    ordered = sorted(within, key=lambda attempt: attempt.share)
    finest = ordered[0]
    in_vain = any(other.share >= NOTHING_GAINED * finest.share and other.used >= finest.used for other in within)
    if in_vain or finest.share <= SMALLEST:
        return None
    return max(SMALLEST, finest.share / _step(AIM * limit / finest.used, _power(ordered, power), MOST_FINER))


def _step(ratio: float, power: float, most: float) -> float:
    """The factor of the error, LEAST_STEP to `most`, that changes what is used by `ratio`."""
    return math.exp(min(max(math.log(ratio) / power, math.log(LEAST_STEP)), math.log(most)))


def _power(ordered: Sequence[Attempt], power: float) -> float:
    """The power seen between the first two of `ordered`, or else `power`."""
    if len(ordered) < 2 or not math.isfinite(ordered[1].used):
        return power
    seen = math.log(ordered[1].used / ordered[0].used) / math.log(ordered[0].share / ordered[1].share)
    return min(max(seen, LEAST_POWER), MOST_POWER)


def _between(over: Attempt, within: Attempt, limit: float) -> float | None:
    """An error between that of `over`, which took too much, and the larger one of `within`, on a straight line between the logarithms."""
    width = math.log(within.share / over.share)
    if width < 0.1 * math.log(LEAST_STEP):
        return None
    part = math.log(AIM * limit / within.used) / math.log(over.used / within.used) if math.isfinite(over.used) else 0.5
    return within.share * math.exp(-width * min(max(part, 0.15), 0.85))
