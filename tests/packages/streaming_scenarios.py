"""Random packages, events and connections for controllers of clients."""

import random
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
from reference import controller
from reference.streaming_state import Event, Request, Span, State, TransferPlan, add_table, begin
from sending.simulation import StreamedPackage
from sending.traces import Trace

from farfield.addon.core.packages.increments import Increments
from farfield.addon.core.packages.manifest import MESH, TEXTURES


def random_plan(rng: random.Random, increment_count: int | None = None) -> TransferPlan:
    """A package with 1 to 5 levels, and 1 to 12 states of its textures, if it has increments."""
    levels = rng.randint(1, 5)
    count = rng.randint(0, 300) if increment_count is None else increment_count
    spans, offset = [], 0
    for level in range(levels):
        spans.append(Span(MESH, offset, offset + int(rng.lognormvariate(8.5 + level, 0.7)) + 1))
        offset = spans[-1].end
    table = rng.randint(10, 20000)
    states = rng.randint(1, min(count, 12)) if count else 1
    sizes = [int(rng.lognormvariate(6.5, 1.0)) + 1 for _ in range(count)]
    cuts = sorted(rng.sample(range(1, count), states - 1)) if count else []
    firsts = [bisect_right(cuts, index) for index in range(count)]
    lasts = [min(first + int(rng.expovariate(0.5)), states - 1) for first in firsts]
    errors = make_errors(
        [0.3 * rng.uniform(0.3, 0.6) ** level for level in range(levels)], [rng.uniform(0.6, 0.9) ** k for k in range(states)]
    )
    first = (spans[0], Span(TEXTURES, 0, table)) if count else (spans[0],)
    return add_table(TransferPlan(first, tuple(spans), errors, table + rng.randint(0, 5000)), sizes, firsts, lasts)


def make_errors(level_errors: Sequence[float], texture_errors: Sequence[float]) -> tuple[tuple[float, ...], ...]:
    """Errors of all levels with all states of the textures, which never rise."""
    errors = np.hypot.outer(np.minimum.accumulate(level_errors), np.minimum.accumulate(texture_errors))
    return tuple(tuple(row) for row in np.minimum(errors, 1.0).tolist())


def hide_table(plan: TransferPlan) -> TransferPlan:
    """The plan before the table of increments has come."""
    return replace(plan, ends=None, states=(), sizes=(), steps=()) if plan.ends else plan


class Exchange:
    """A client that is told what happens, by random: it keeps all events and decisions."""

    def __init__(self, rng: random.Random, plan: TransferPlan, state: State, rate: float | None = None) -> None:
        self.rng, self.plan, self.state, self.initial, self.rate = rng, plan, state, state, rate
        self.time = 0.0
        self.has_table = False
        self.events: list[tuple[bool, Event]] = []
        self.decisions: list[tuple[list[Request], list[int]]] = []

    def run(self, steps: int) -> None:
        """Decide at the beginning and after each of `steps` random events."""
        self.tell(Event(0.0))
        for _ in range(steps):
            self.time += self.rng.expovariate(20.0)
            self.tell(self.random_event())

    def tell(self, event: Event) -> None:
        """Decide after `event`. The table of increments has come when no running or pending span reads it."""
        plan = self.plan if self.has_table else hide_table(self.plan)
        self.events.append((self.has_table, event))
        self.state, requests, aborted = controller.decide(plan, self.state, event)
        self.decisions.append((requests, aborted))
        spans = [running.span for running in self.state.in_flight] + self.state.pending
        self.has_table = not any(span.file == TEXTURES and span.start < self.plan.begin for span in spans)

    def random_event(self) -> Event:
        """A tick, a failure, or some or all of the bytes of a response."""
        if not self.state.in_flight or self.rng.random() < 0.1:
            return Event(self.time)
        running = self.rng.choice(self.state.in_flight)
        if self.rng.random() < 0.03:
            return Event(self.time, running.id, failed=True)
        size = running.span.end - running.span.start
        if not running.is_open and self.rng.random() < 0.7:
            return Event(self.time, running.id)
        is_last = self.rng.random() < 0.5
        return Event(self.time, running.id, size if is_last else self.rng.randint(running.received, size))


@cache
def random_exchange(seed: int, steps: int = 80) -> Exchange:
    """A whole exchange of a random client, which nobody changes."""
    rng = random.Random(seed)
    plan = random_plan(rng)
    rate = rng.choice([None, rng.lognormvariate(12.5, 1.0)])
    limit, patience = rng.uniform(0.5, 10.0), rng.choice([0.0, 0.1, 1e9])
    exchange = Exchange(rng, plan, begin(plan, limit, rate, rng.randint(1, 3), patience, rng.random() < 0.2), rate)
    exchange.run(steps)
    return exchange


def make_package(
    texture_size: int = 1_000_000, increment_count: int = 1000, level_sizes: tuple[int, ...] = (20_000, 40_000, 80_000)
) -> StreamedPackage:
    """A package whose increments have equal sizes, half of which each state replaces, and whose states grow by equal factors."""
    sizes = np.full(increment_count, texture_size // increment_count)
    counts = np.unique(np.geomspace(increment_count / 100, increment_count / 2, 12).astype(int))
    firsts = np.searchsorted(np.cumsum(counts) * (increment_count / counts.sum()), np.arange(increment_count), side="right").clip(max=11)
    positions = np.arange(increment_count) - np.searchsorted(firsts, firsts)
    lasts = np.where(positions < np.bincount(firsts)[firsts] / 2, firsts + 2, firsts).clip(max=firsts.max())
    texture_errors = np.geomspace(0.3, 0.01, len(counts))
    errors = make_errors([0.2 * 0.3**level for level in range(len(level_sizes) - 1)] + [0.0], texture_errors.tolist())
    offsets = [0, *np.cumsum(level_sizes).tolist()]
    spans = tuple(Span(MESH, start, end) for start, end in pairwise(offsets))
    plan = TransferPlan((spans[0], Span(TEXTURES, 0, 6000)), spans, errors, 8000)
    zeros = np.zeros(increment_count, np.int64)
    increments = Increments(zeros, np.arange(increment_count) % 64, zeros, sizes, firsts, lasts)
    return StreamedPackage(add_table(plan, sizes.tolist(), firsts.tolist(), lasts.tolist()), increments, 2000)


def wavering_trace(rng: random.Random, rate: float, variation: float) -> Trace:
    """A connection whose rate changes every 0.05 to 0.5 s within `rate` (1 - `variation`) to `rate` (1 + `variation`)."""
    times, rates, time = [], [], 0.0
    while time < 30.0:
        times.append(time)
        rates.append(rate * (1.0 + rng.uniform(-variation, variation)))
        time += rng.uniform(0.05, 0.5)
    return Trace("wavering", tuple(times), tuple(rates), time)
