"""Random packages, events and lines for controllers of clients."""

import dataclasses
import random
from itertools import pairwise

import numpy as np

from farfield.addon.core.texmesh.streaming import controller
from farfield.addon.core.texmesh.streaming.allocation import ErrorTable, make_plan
from farfield.addon.core.texmesh.streaming.manifest import MESH, TEXTURES
from farfield.addon.core.texmesh.streaming.sending_state import Event, Job, Request, Span, State, begin
from farfield.addon.core.texmesh.streaming.simulation import SentPackage
from farfield.addon.core.texmesh.streaming.traces import Trace


def random_job(rng: random.Random, increment_count: int | None = None) -> Job:
    """A package with 1 to 5 levels, whose plan goes from the first level to the last one."""
    levels = rng.randint(1, 5)
    count = rng.randint(0, 300) if increment_count is None else increment_count
    spans, offset = [], 0
    for level in range(levels):
        spans.append(Span(MESH, offset, offset + int(rng.lognormvariate(8.5 + level, 0.7)) + 1))
        offset = spans[-1].end
    table = rng.randint(10, 20000)
    first = table + rng.randint(0, 5000)
    ends, end = [], first
    for _ in range(count):
        end += int(rng.lognormvariate(6.5, 1.0)) + 1
        ends.append(end)
    rows, error = [], 0.5
    cuts = sorted(rng.sample(range(20), levels - 1)) if levels > 1 else []
    for row in range(20):
        error *= rng.uniform(0.7, 0.95)
        rows.append((sum(cut <= row for cut in cuts), count * (row + 1) // 20, error))
    return Job((spans[0], Span(TEXTURES, 0, table)), tuple(spans), tuple(rows), first, tuple(ends))


class Exchange:
    """A client that is told what happens, by random: it keeps all events and decisions."""

    def __init__(self, rng: random.Random, job: Job, state: State, rate: float | None = None) -> None:
        self.rng, self.job, self.state, self.initial, self.rate = rng, job, state, state, rate
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
        """Decide after `event`. The table of increments has come when no flight or pending span reads it."""
        job = self.job if self.has_table else dataclasses.replace(self.job, ends=None)
        self.events.append((self.has_table, event))
        self.state, requests, aborted = controller.decide(job, self.state, event)
        self.decisions.append((requests, aborted))
        spans = [flight.span for flight in self.state.flights] + self.state.pending
        self.has_table = not any(span.file == TEXTURES and span.start < self.job.begin for span in spans)

    def random_event(self) -> Event:
        """A tick, a failure, or some or all of the bytes of a response."""
        if not self.state.flights or self.rng.random() < 0.1:
            return Event(self.time)
        flight = self.rng.choice(self.state.flights)
        if self.rng.random() < 0.03:
            return Event(self.time, flight.id, failed=True)
        size = flight.span.end - flight.span.start
        if not flight.is_open and self.rng.random() < 0.7:
            return Event(self.time, flight.id)
        is_last = self.rng.random() < 0.5
        return Event(self.time, flight.id, size if is_last else self.rng.randint(flight.received, size))


def random_exchange(seed: int, steps: int = 80) -> Exchange:
    """A whole exchange of a random client."""
    rng = random.Random(seed)
    job = random_job(rng)
    rate = rng.choice([None, rng.lognormvariate(12.5, 1.0)])
    limit, patience = rng.uniform(0.5, 10.0), rng.choice([0.0, 0.1, 1e9])
    exchange = Exchange(rng, job, begin(job, limit, rate, rng.randint(1, 3), patience, rng.random() < 0.2), rate)
    exchange.run(steps)
    return exchange


def make_package(
    texture_size: int = 1_000_000, increment_count: int = 1000, level_sizes: tuple[int, ...] = (20_000, 40_000, 80_000)
) -> SentPackage:
    """A package whose increments have equal sizes and falling gains, and whose plan is made like those of real ones."""
    sizes = np.full(increment_count, texture_size // increment_count)
    gains = np.linspace(2.0, 0.0, increment_count) * 0.3 / increment_count
    counts = np.unique(np.geomspace(increment_count / 100, increment_count, 12).astype(int))
    level_errors = np.array([0.2 * 0.3**level for level in range(len(level_sizes) - 1)] + [0.0])
    table = ErrorTable(level_errors, counts, 0.31 - np.cumsum(gains)[counts - 1], 2.0, 0.0)
    plan = tuple((row.level, row.increment_count, row.flip) for row in make_plan(table, np.cumsum(level_sizes).tolist(), sizes))
    offsets = [0, *np.cumsum(level_sizes).tolist()]
    spans = tuple(Span(MESH, start, end) for start, end in pairwise(offsets))
    job = Job((spans[0], Span(TEXTURES, 0, 6000)), spans, plan, 8000, tuple((8000 + np.cumsum(sizes)).tolist()))
    return SentPackage(job, gains, np.arange(increment_count) % 64, 2000)


def wavering_trace(rng: random.Random, rate: float, variation: float) -> Trace:
    """A line whose rate changes every 0.05 to 0.5 s within `rate` (1 - `variation`) to `rate` (1 + `variation`)."""
    times, rates, time = [], [], 0.0
    while time < 30.0:
        times.append(time)
        rates.append(rate * (1.0 + rng.uniform(-variation, variation)))
        time += rng.uniform(0.05, 0.5)
    return Trace("wavering", tuple(times), tuple(rates), time)
