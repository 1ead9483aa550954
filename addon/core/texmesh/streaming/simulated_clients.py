"""Clients of packages in simulations: with time compensation as the page has it, without, and as the paper describes it."""

from dataclasses import replace

import numpy as np

from . import controller
from .manifest import MESH, TEXTURES
from .sending_state import DEFAULT_DELAY, DEFAULT_RATE, Event, Job, Request, Span, begin

PAPER_FRAGMENTS = 24  # into which a client as in the paper divides the tiles


class CompensatingClient:
    """The controller of the page."""

    def __init__(self, job: Job, limit: float, rate: float | None, servers: int, patience: float) -> None:
        self._job, self._known = job, replace(job, ends=None if job.ends else ())
        self._ends = np.array([job.begin, *(job.ends or ())])
        self._state = begin(job, limit, rate, servers, patience)

    def hear(self, event: Event) -> tuple[list[Request], list[int]]:
        """Return the requests to send after `event`, and the ids of those to abort. The first event is a tick: sending may begin."""
        self._state, requests, aborted = controller.decide(self._known, self._state, event)
        waits = [flight.span for flight in self._state.flights] + self._state.pending
        if not any(span.file == TEXTURES and span.start < self._job.begin for span in waits):
            self._known = self._job
        return requests, aborted

    def is_finished(self) -> bool:
        """Return whether nothing will be asked for anymore."""
        return controller.is_finished(self._known, self._state)

    def level(self) -> int:
        """Return the level that is shown, or -1."""
        return controller.received_level(self._known, self._state)

    def received(self) -> np.ndarray:
        """Return which increments have come, (N,) bool."""
        state, count = self._state, len(self._ends) - 1
        is_here = np.arange(count) < (0 if self._known.ends is None else state.asked)
        for span in state.pending + [replace(flight.span, start=flight.span.start + flight.received) for flight in state.flights]:
            if span.file == TEXTURES:
                is_here &= (self._ends[1:] <= span.start) | (self._ends[:-1] >= span.end)
        return is_here

    def mean_difference(self) -> float:
        """Return Lambda (eq. 9 of the paper), seconds."""
        return controller.mean_difference(self._state)


class _SequentialClient:
    """Asks for the first spans, then for those of a level, then for parts of the texture, one request after the other."""

    def __init__(self, job: Job, limit: float, rate: float | None) -> None:
        self.job, self.limit, self.rate = job, limit, rate or DEFAULT_RATE
        self.delay = DEFAULT_DELAY
        self.mask = np.zeros(len(job.ends or ()), bool)
        self.sizes = np.diff([job.begin, *(job.ends or ())])
        self.row: tuple[int, int] | None = None
        self.shown, self.next_id = -1, 0
        self.asked, self.opened, self.planned = 0.0, 0.0, 0.0
        self.differences: list[float] = []
        self.span: Span | None = None
        self.parts: np.ndarray | None = None
        self.queue = list(job.first)

    def hear(self, event: Event) -> tuple[list[Request], list[int]]:
        """Return the requests to send after `event`; it never aborts one."""
        if self.span is None:
            return self._send(event.time), []
        if event.id == self.next_id - 1 and not event.failed:
            if event.received == 0:
                self.opened = event.time
            elif self.parts is not None:
                self.mask |= self.parts & (np.cumsum(np.where(self.parts, self.sizes, 0)) <= event.received)
            if event.received == self.span.end - self.span.start:
                self._take(event.time)
                return self._send(event.time), []
        return ([Request(self.next_id - 1, 0, self.span)] if event.failed else []), []

    def is_finished(self) -> bool:
        """Return whether nothing will be asked for anymore."""
        return self.span is None and self.next_id > 0

    def level(self) -> int:
        """Return the level that is shown, or -1."""
        return self.shown

    def received(self) -> np.ndarray:
        """Return which increments have come, (N,) bool."""
        return self.mask.copy()

    def mean_difference(self) -> float:
        """Return Lambda (eq. 9 of the paper), seconds."""
        return float(np.mean(self.differences[:-1])) if len(self.differences) > 1 else 0.0

    def _take(self, time: float) -> None:
        self.differences.append(abs(time - self.asked - self.planned))
        self.measure(self.span.end - self.span.start, time)
        if self.parts is None and not self.queue:
            self.shown = self.row[0] if self.row else 0

    def _send(self, time: float) -> list[Request]:
        if not self.queue and self.row is None:
            self.row = self.choose_row(time)
            if self.row[0]:
                self.queue.append(Span(MESH, self.job.levels[1].start, self.job.levels[self.row[0]].end))
        if self.queue:
            self.span, self.parts = self.queue.pop(0), None
        else:
            self.parts = self.next_parts(time)
            self.span = None if self.parts is None else Span(TEXTURES, 0, int(self.sizes[self.parts].sum()))
        if self.span is None:
            return []
        self.asked, self.opened, self.next_id = time, time, self.next_id + 1
        self.planned = self.delay + (self.span.end - self.span.start) / self.rate
        return [Request(self.next_id - 1, 0, self.span)]

    def measure(self, size: int, time: float) -> None:
        """Learn from a response of `size` bytes that has ended."""

    def choose_row(self, time: float) -> tuple[int, int]:
        """Return the level and number of increments of the best row of the plan that fits into the rest of the time at the present rate."""
        budget = self.rate * (self.limit - time - 2.0 * self.delay)
        fitting = [row for row in self.job.plan if self._cost(row[0], row[1]) <= budget] or [(0, 0, 1.0)]
        return min(fitting, key=lambda row: row[2])[:2]

    def _cost(self, level: int, count: int) -> int:
        return self.job.levels[level].end - self.job.levels[0].end + int(self.sizes[:count].sum())

    def next_parts(self, time: float) -> np.ndarray | None:
        """Return which increments to ask for next, (N,) bool, or None at the end."""
        raise NotImplementedError


class FixedClient(_SequentialClient):
    """Decides once, by the initial rate: no time compensation."""

    def next_parts(self, time: float) -> np.ndarray | None:
        """Return the increments of the row of the plan, once."""
        count = self.row[1]
        return np.arange(len(self.mask)) < count if count and self.parts is None else None


class PaperClient(_SequentialClient):
    """One fragment after the other, as in the paper: tiles in PAPER_FRAGMENTS groups in their order, each with the quality of the set that
    the lookup table (here: a number of increments of the whole texture) has for the rest of the time at the rate of the fragments
    before."""

    def __init__(self, job: Job, limit: float, rate: float | None, tiles: np.ndarray) -> None:
        super().__init__(job, limit, rate)
        order = np.unique(tiles, return_inverse=True)[1]
        self.fragments = order * PAPER_FRAGMENTS // (order.max(initial=0) + 1)
        self.fragment = 0

    def measure(self, size: int, time: float) -> None:
        """Learn the rate and the delay of the response that has ended."""
        if time > self.opened > self.asked:
            self.delay = self.opened - self.asked
            self.rate = 0.5 * self.rate + 0.5 * size / (time - self.opened)

    def next_parts(self, time: float) -> np.ndarray | None:
        """Return the increments of the next fragment."""
        while self.fragment < PAPER_FRAGMENTS and len(self.mask):
            budget = self.rate * (self.limit - time - (PAPER_FRAGMENTS - self.fragment) * self.delay)
            sums = np.cumsum(np.where(self.fragments >= self.fragment, self.sizes, 0))
            count = int(np.searchsorted(sums, max(budget, 0.0), side="right"))
            parts = (self.fragments == self.fragment) & (np.arange(len(self.mask)) < count)
            self.fragment += 1
            if parts.any():
                return parts
        return None
