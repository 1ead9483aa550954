"""Clients of packages in simulations: with time compensation as the page has it, without, and as the paper describes it."""

from dataclasses import replace

import numpy as np
from reference import controller
from reference.streaming_state import DEFAULT_DELAY, DEFAULT_RATE, Event, Request, Span, TransferPlan, begin

from farfield.addon.core.packages.increments import Increments
from farfield.addon.core.packages.manifest import MESH, TEXTURES

PAPER_FRAGMENTS = 24  # into which a client as in the paper divides the tiles


class CompensatingClient:
    """The controller of the page."""

    def __init__(self, plan: TransferPlan, limit: float, rate: float | None, servers: int, patience: float) -> None:
        self._plan, self._known = plan, replace(plan, ends=None if plan.ends else ())
        self._ends = np.array([plan.begin, *(plan.ends or ())])
        self._state = begin(plan, limit, rate, servers, patience)

    def on_response(self, event: Event) -> tuple[list[Request], list[int]]:
        """Return the requests to send after `event`, and the ids of those to abort. The first event is a tick: sending may begin."""
        self._state, requests, aborted = controller.decide(self._known, self._state, event)
        waits = [running.span for running in self._state.in_flight] + self._state.pending
        if not any(span.file == TEXTURES and span.start < self._plan.begin for span in waits):
            self._known = self._plan
        return requests, aborted

    def is_finished(self) -> bool:
        """Return whether nothing will be asked for anymore."""
        return controller.is_finished(self._known, self._state)

    def level(self) -> int:
        """Return the level that is shown, or -1."""
        return controller.received_level(self._known, self._state)

    def received(self) -> np.ndarray:
        """Return which increments are received, (N,) bool."""
        starts, ends = self._ends[:-1], self._ends[1:]
        is_here = np.zeros(len(ends), bool)
        for start, end in controller.list_received(self._state):
            is_here |= (start <= starts) & (ends <= end)
        return is_here

    def mean_difference(self) -> float:
        """Return Lambda (eq. 9 of the paper), seconds."""
        return controller.mean_difference(self._state)


class _SequentialClient:
    """Asks for the first spans, then for those of a level, then for parts of the texture, one request after the other."""

    def __init__(self, plan: TransferPlan, increments: Increments, limit: float, rate: float | None) -> None:
        self.plan, self.increments, self.limit, self.rate = plan, increments, limit, rate or DEFAULT_RATE
        self.delay = DEFAULT_DELAY
        self.mask = np.zeros(len(increments.sizes), bool)
        self.sizes = increments.sizes
        self.row: tuple[int, int] | None = None
        self.shown, self.next_id = -1, 0
        self.asked, self.opened, self.planned = 0.0, 0.0, 0.0
        self.differences: list[float] = []
        self.span: Span | None = None
        self.parts: np.ndarray | None = None
        self.queue = list(plan.first)

    def on_response(self, event: Event) -> tuple[list[Request], list[int]]:
        """Return the requests to send after `event`; it never aborts one."""
        if self.span is None:
            return self._send(event.time), []
        if event.id == self.next_id - 1 and not event.failed:
            if event.received == 0:
                self.opened = event.time
            elif self.parts is not None:
                self.mask |= self.parts & (np.cumsum(np.where(self.parts, self.sizes, 0)) <= event.received)
            if event.received == self.span.end - self.span.start:
                self._allocate(event.time)
                return self._send(event.time), []
        return ([Request(self.next_id - 1, 0, self.span)] if event.failed else []), []

    def is_finished(self) -> bool:
        """Return whether nothing will be asked for anymore."""
        return self.span is None and self.next_id > 0

    def level(self) -> int:
        """Return the level that is shown, or -1."""
        return self.shown

    def received(self) -> np.ndarray:
        """Return which increments are received, (N,) bool."""
        return self.mask.copy()

    def mean_difference(self) -> float:
        """Return Lambda (eq. 9 of the paper), seconds."""
        return float(np.mean(self.differences[:-1])) if len(self.differences) > 1 else 0.0

    def _allocate(self, time: float) -> None:
        self.differences.append(abs(time - self.asked - self.planned))
        self.measure(self.span.end - self.span.start, time)
        if self.parts is None and not self.queue:
            self.shown = self.row[0] if self.row else 0

    def _send(self, time: float) -> list[Request]:
        if not self.queue and self.row is None:
            self.row = self.choose_row(time)
            if self.row[0]:
                self.queue.append(Span(MESH, self.plan.levels[1].start, self.plan.levels[self.row[0]].end))
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
        """Return the level and the state of the textures that are best and fit into the rest of the time at the present rate."""
        budget = self.rate * (self.limit - time - 2.0 * self.delay) + self.plan.levels[0].end
        options = [(error, level, state) for level, row in enumerate(self.plan.errors) for state, error in enumerate(row)]
        fitting = [item for item in options if self.plan.levels[item[1]].end + self.plan.sizes[item[2]] <= budget]
        return min(fitting)[1:] if fitting else (0, 0)

    def next_parts(self, time: float) -> np.ndarray | None:
        """Return which increments to ask for next, (N,) bool, or None at the end."""
        raise NotImplementedError


class FixedClient(_SequentialClient):
    """Decides once, by the initial rate: no time compensation."""

    def next_parts(self, time: float) -> np.ndarray | None:
        """Return the increments of the state, once."""
        return self.increments.are_in(self.row[1]) if self.parts is None and len(self.mask) else None


class PaperClient(_SequentialClient):
    """One fragment after the other, as in the paper. A fragment is one of PAPER_FRAGMENTS parts of the increments, with the quality of the
    set that the lookup table (here: a state of the textures) has for the rest of the time at the rate of the fragments before."""

    def __init__(self, plan: TransferPlan, increments: Increments, limit: float, rate: float | None) -> None:
        super().__init__(plan, increments, limit, rate)
        self.left = PAPER_FRAGMENTS

    def measure(self, size: int, time: float) -> None:
        """Learn the rate and the delay of the response that has ended."""
        if time > self.opened > self.asked:
            self.delay = self.opened - self.asked
            self.rate = 0.5 * self.rate + 0.5 * size / (time - self.opened)

    def next_parts(self, time: float) -> np.ndarray | None:
        """Return the increments of the next fragment: an equal part of the bytes that the set lacks."""
        if not self.left:
            return None
        budget = self.rate * (self.limit - time - self.left * self.delay)
        missing = [self.increments.are_in(state) & ~self.mask for state in range(self.increments.state_count)]
        fitting = [wanted for wanted in missing if self.sizes[wanted].sum() <= budget]
        wanted = np.flatnonzero(fitting[-1] if fitting else missing[0])
        starts = np.cumsum(self.sizes[wanted]) - self.sizes[wanted]
        parts = np.zeros(len(self.mask), bool)
        parts[wanted[starts * self.left < self.sizes[wanted].sum()]] = True
        self.left -= 1
        return parts if parts.any() else None
