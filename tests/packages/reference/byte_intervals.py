"""Sets of bytes of a file, as ascending, disjoint intervals [start, end)."""

from collections.abc import Sequence

Interval = tuple[int, int]


def measure(intervals: Sequence[Interval]) -> int:
    """Return the number of bytes."""
    return sum(end - start for start, end in intervals)


def insert(intervals: Sequence[Interval], start: int, end: int) -> list[Interval]:
    """Return the intervals with [start, end)."""
    before = [item for item in intervals if item[1] < start]
    after = [item for item in intervals if item[0] > end]
    joined = [item for item in intervals if item[1] >= start and item[0] <= end]
    if joined:
        start, end = min(start, joined[0][0]), max(end, joined[-1][1])
    return [*before, (start, end), *after]


def subtract(intervals: Sequence[Interval], others: Sequence[Interval]) -> list[Interval]:
    """Return the parts of the intervals that are in none of the others."""
    left: list[Interval] = []
    for start, end in intervals:
        for begin, stop in others:
            if stop <= start or begin >= end:
                continue
            if begin > start:
                left.append((start, begin))
            start = stop
            if start >= end:
                break
        if start < end:
            left.append((start, end))
    return left
