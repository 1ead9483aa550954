"""The ratios in the report of a benchmark.

They are figures whose names say so: `ratio`, `time_ratio`, `seam_over_best`, `ratio_to_best_peer`. Where figures of Farfield stand next to
the same figures of another program, their ratio is named `flip_over_decimate`.
"""

import math
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

RATIO = re.compile(r"(?:.*_)?ratios?(?:_.*)?|(?:.+_)?over_.+|.+_to_best_.+")
OWN = ("farfield", "cloud")  # Names of the figures of Farfield next to those of other programs.
MEASURES = ("flip", "bytes", "seconds", "cpu_seconds", "vertices")  # Figures that are compared with those of other programs.
BOUND = re.compile(r"max_.*|min_.*")  # Names of limits, which are no measurements.


class Ratio(NamedTuple):
    """All values of one ratio in one part of a benchmark: their number, geometric mean, and limits."""

    part: str
    name: str
    count: int
    mean: float
    least: float
    largest: float


def find_ratios(report: dict[str, Any]) -> list[Ratio]:
    """Return the ratios in a report, whose first level are the parts, in the order in which they appear."""
    values: dict[tuple[str, str], list[float]] = {}
    for part, figures in report.items():
        for name, value in _walk(figures, part):
            values.setdefault((part, name), []).append(value)
    return [
        Ratio(*key, len(found), math.exp(math.fsum(map(math.log, found)) / len(found)), min(found), max(found))
        for key, found in values.items()
    ]


def _walk(figures: Any, name: str) -> Iterator[tuple[str, float]]:
    """Yield the name and the value of each positive number that is a ratio; numbers below one named `ratios` have that as their name."""
    if isinstance(figures, dict):
        yield from _compare(figures)
        for key, value in figures.items():
            if not BOUND.fullmatch(key):
                is_named = RATIO.fullmatch(key) or not RATIO.fullmatch(name)
                yield from _walk(value, key if is_named else name)
    elif isinstance(figures, list):
        for value in figures:
            yield from _walk(value, name)
    elif (
        isinstance(figures, int | float)
        and not isinstance(figures, bool)
        and figures > 0.0
        and math.isfinite(figures)
        and RATIO.fullmatch(name)
    ):
        yield name, float(figures)


def _compare(figures: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield the ratios of the measures of Farfield to those of other programs that stand next to it."""
    own = next((name for name in OWN if isinstance(figures.get(name), dict)), None)
    for peer, others in figures.items() if own else ():
        if peer != own and isinstance(others, dict):
            for measure in MEASURES:
                value, other = figures[own].get(measure), others.get(measure)
                if isinstance(value, int | float) and isinstance(other, int | float) and value > 0.0 and other > 0.0:
                    yield f"{measure}_over_{peer}", value / other
