"""Search for the error that uses up a budget, in few builds: the usage of a cloud is about a power of its error."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..jobs.progress import Steps, subprogress
from ..settings import describe
from .clustering.patches import Covering
from .settings import BillboardSettings

MAX_BUILDS = 6
MIN_FRACTION = 0.9  # The search ends when this fraction of the limit is used.
TARGET_FRACTION = 0.955  # The center of the accepted range, as a fraction of the limit.
MAX_COARSENING = 6.0  # Maximum factor of the error in one step.
MAX_REFINEMENT = 4.0  # Maximum divisor of the error in one step.
MIN_STEP = 1.05  # Factor of the error: below it, a count changes more by chance than by intent.
MIN_EXPONENT, MAX_EXPONENT = 0.3, 3.0
SATURATION_RATIO = 2.0  # An error smaller by this factor without more usage: even smaller errors would only enlarge the texture.
MIN_BRACKET_STEPS = 0.1  # A bracket narrower than this many MIN_STEPs, on a logarithmic scale, is not searched.
MIN_T, MAX_T = 0.15, 0.85  # Interpolation factors in a bracket: keep each try away from its ends, so that the bracket shrinks either way.
MIN_ERROR = next(item.minimum for item in describe(BillboardSettings) if item.name == "error")
MAX_ERROR = 0.5  # Half of the longest side: a plane through the center is not farther from any point.


@dataclass(frozen=True)
class Attempt:
    """One build during the search.

    relative_error: error of the finest level over the longest side. usage: consumed budget, in the budget's unit; infinite if no texture is
    large enough. coverings: of the finest levels, finest first.
    """

    relative_error: float
    usage: float
    coverings: list[Covering]


def search_error(
    build: Callable[[float], Steps[Attempt]],
    limit: float,
    guess: float,
    exponent: float,
    known: Sequence[Attempt] = (),
    max_builds: int = MAX_BUILDS,
) -> Steps[Attempt]:
    """Find the attempt with the largest usage within `limit`, or the one with the largest error if all exceed it.

    Args:
        build: makes the attempt with a given relative error.
        guess: first error, used if no attempt is `known`.
        exponent: the usage is about proportional to the error to the power of -`exponent`.
    """
    attempts = list(known)
    for index in range(max_builds):
        error = choose_next_error(attempts, limit, exponent) if attempts else guess
        if error is None:
            break
        if index == max_builds - 1 and all(attempt.usage > limit for attempt in attempts):
            error = MAX_ERROR
        # The number of builds is not known in advance: each takes half of the rest of the progress bar.
        attempts.append((yield from subprogress(build(error), 1.0 - 0.5**index, 1.0 - 0.5 ** (index + 1))))
    within = [attempt for attempt in attempts if attempt.usage <= limit]
    return max(within, key=lambda attempt: attempt.usage) if within else max(attempts, key=lambda attempt: attempt.relative_error)


def choose_next_error(attempts: Sequence[Attempt], limit: float, exponent: float) -> float | None:
    """Return the error to try after `attempts`, at least one; None if another build would not help."""
    over = [attempt for attempt in attempts if attempt.usage > limit]
    within = [attempt for attempt in attempts if attempt.usage <= limit]
    if not within:
        return _choose_larger_error(over, limit, exponent)
    if max(attempt.usage for attempt in within) >= MIN_FRACTION * limit:
        return None
    if not over:
        return _choose_smaller_error(within, limit, exponent)
    lower = max(over, key=lambda attempt: attempt.relative_error)
    upper = min(within, key=lambda attempt: attempt.relative_error)
    return _interpolate_error(lower, upper, limit)


def _choose_larger_error(over: Sequence[Attempt], limit: float, exponent: float) -> float | None:
    """Return a larger error than those of all attempts `over` the limit."""
    ordered = sorted(over, key=lambda attempt: -attempt.relative_error)
    coarsest = ordered[0]
    if coarsest.relative_error >= MAX_ERROR:
        return None
    step = MAX_COARSENING
    if limit > 0.0 and math.isfinite(coarsest.usage):
        step = _step_factor(coarsest.usage / (TARGET_FRACTION * limit), _fit_exponent(ordered, exponent), MAX_COARSENING)
    return min(MAX_ERROR, coarsest.relative_error * step)


def _choose_smaller_error(within: Sequence[Attempt], limit: float, exponent: float) -> float | None:
    """Return a smaller error than those of all attempts `within` the limit."""
    ordered = sorted(within, key=lambda attempt: attempt.relative_error)
    finest = ordered[0]
    is_saturated = any(other.relative_error >= SATURATION_RATIO * finest.relative_error and other.usage >= finest.usage for other in within)
    if is_saturated or finest.relative_error <= MIN_ERROR:
        return None
    step = _step_factor(TARGET_FRACTION * limit / finest.usage, _fit_exponent(ordered, exponent), MAX_REFINEMENT)
    return max(MIN_ERROR, finest.relative_error / step)


def _step_factor(usage_ratio: float, exponent: float, max_factor: float) -> float:
    """Return the factor of the error, MIN_STEP to `max_factor`, that changes the usage by `usage_ratio`."""
    return math.exp(min(max(math.log(usage_ratio) / exponent, math.log(MIN_STEP)), math.log(max_factor)))


def _fit_exponent(ordered: Sequence[Attempt], default: float) -> float:
    """Return the exponent of the power law through the first two of `ordered`, or `default` if there are fewer."""
    if len(ordered) < 2 or not math.isfinite(ordered[1].usage):
        return default
    exponent = math.log(ordered[1].usage / ordered[0].usage) / math.log(ordered[0].relative_error / ordered[1].relative_error)
    return min(max(exponent, MIN_EXPONENT), MAX_EXPONENT)


def _interpolate_error(lower: Attempt, upper: Attempt, limit: float) -> float | None:
    """Interpolate between the error of `lower`, which exceeds `limit`, and the larger one of `upper`, linearly in logarithms."""
    width = math.log(upper.relative_error / lower.relative_error)
    if width < MIN_BRACKET_STEPS * math.log(MIN_STEP):
        return None
    is_finite = math.isfinite(lower.usage)
    t = math.log(TARGET_FRACTION * limit / upper.usage) / math.log(lower.usage / upper.usage) if is_finite else 0.5
    return upper.relative_error * math.exp(-width * min(max(t, MIN_T), MAX_T))
