"""Long work as generators of progress, and the clock that tells where the time went.

A long task is a generator function: it yields `Progress` between two steps and returns its result. Whoever runs it decides what a step
means: a script prints it, a window draws it, and both may stop the work between two steps by closing the generator.
"""

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

Result = TypeVar("Result")


@dataclass(frozen=True)
class Progress:
    """How far a task is: `fraction` from 0 to 1, `label` for people."""

    fraction: float
    label: str


Steps = Generator[Progress, None, Result]


def scaled(steps: Steps[Result], start: float, stop: float) -> Steps[Result]:
    """Run `steps` as one part of a larger task: its fractions 0..1 become `start`..`stop`. Returns what `steps` returns."""
    try:
        while True:
            step = next(steps)
            yield Progress(start + (stop - start) * min(max(step.fraction, 0.0), 1.0), step.label)
    except StopIteration as finished:
        return finished.value
    finally:
        steps.close()


def finish(steps: Steps[Result], on_progress: Callable[[Progress], None] | None = None) -> Result:
    """Run `steps` to the end in this thread and return its result. An exception from `on_progress` stops the work and passes on."""
    try:
        while True:
            step = next(steps)
            if on_progress is not None:
                on_progress(step)
    except StopIteration as finished:
        return finished.value
    finally:
        steps.close()


def time_left(seconds_so_far: float, fraction: float) -> float | None:
    """Seconds that remain if the work goes on at its mean pace, or None while too little is done to tell."""
    if fraction < 0.02 or seconds_so_far < 0.5:
        return None
    return seconds_so_far * (1.0 - fraction) / fraction


class StageClock:
    """Wall-clock seconds by stage name, summed over repeated stages."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent in this block to the stage `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
