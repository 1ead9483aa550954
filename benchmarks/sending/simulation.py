"""Simulations of sending a package over connections whose rates change, with a report."""

import json
import math
from dataclasses import asdict, dataclass

import numpy as np
from reference.streaming_path import describe_textures, estimate_errors
from reference.streaming_state import Event, Span, TransferPlan, add_table, build_plan
from sending.clients import CompensatingClient, FixedClient, PaperClient
from sending.network import Connection, Network
from sending.traces import Trace

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.packages.increments import Increments
from farfield.addon.core.packages.manifest import Manifest, encode_manifest

CLIENTS = ("compensating", "fixed", "paper")
MAX_ROUNDS = 20.0  # limits after which a simulation ends


@dataclass(frozen=True, eq=False)
class StreamedPackage:
    """What a simulation needs of a package. plan: with the table of increments. manifest_size: bytes."""

    plan: TransferPlan
    increments: Increments
    manifest_size: int

    def error(self, level: int, received: np.ndarray) -> float:
        """Return the predicted error with `level` (-1: nothing is shown, error 1) and the received increments, (N,) bool."""
        return 1.0 if level < 0 else estimate_errors(self.plan, describe_textures(self._missing_bytes(received)))[level]

    def is_complete(self, level: int, received: np.ndarray) -> bool:
        """Return whether the finest level and the last state of the textures are there."""
        return level == len(self.plan.levels) - 1 and self._missing_bytes(received)[-1] == 0

    def _missing_bytes(self, received: np.ndarray) -> list[int]:
        sizes = np.where(received, 0, self.increments.sizes)
        return [int(sizes[self.increments.are_in(state)].sum()) for state in range(len(self.plan.sizes))]

    def best(self, byte_count: float) -> tuple[int, int, float]:
        """Return the level, the last complete state of the textures and the error of the best use of `byte_count` bytes. What is left of
        them is used for a part of a later state."""
        table = sum(_size(span) for span in self.plan.first[1:])
        best = (-1, -1, 1.0)
        sizes = np.array([0, *self.plan.sizes])
        steps = np.array([self.plan.sizes, *self.plan.steps])  # from nothing, and from each state
        for level, span in enumerate(self.plan.levels):
            rest = byte_count - table - span.end
            if rest < 0.0:
                break
            errors = np.array([1.0, *self.plan.errors[level]])
            fractions = np.clip((rest - sizes[:, None]) / np.maximum(steps, 1), 0.0, 1.0)
            found = errors[:, None] + (errors[1:] - errors[:, None]) * fractions
            found[(sizes > rest)[:, None] | (steps <= 0)] = np.inf
            states = [state for state, size in enumerate(sizes.tolist()) if size <= rest]
            state = int(min(states, key=lambda index: errors[index])) - 1
            error = min(float(found.min()), float(errors[state + 1]))
            best = (level, state, error) if best[0] < 0 or error < best[2] else best
        return best


@dataclass(frozen=True)
class StreamingReport:
    """What a client got.

    Attributes:
        client: one of CLIENTS.
        trace: the names of the traces.
        limit: seconds.
        finished: when it stopped, seconds.
        deviation: Pi, seconds after the limit (negative: before it).
        mean_difference: Lambda of eq. 9, seconds.
        is_complete: whether everything was received.
        requests, aborted: how many there were.
        byte_count: bytes that the connections carried, headers of responses included.
        useful_bytes: bytes of the level and increments at the end.
        level, increments, error: at the limit, or at the end if that is earlier.
        oracle_bytes, oracle_level, oracle_state, oracle_error: of a client that knows the trace; its bytes are those that connections can
            carry after the manifest is received, which names the mirrors.
        first_seen: when level 0 was there, infinite if never.
        first_textured: when the first increment was there, infinite if never.
    """

    client: str
    trace: str
    limit: float
    finished: float
    deviation: float
    mean_difference: float
    is_complete: bool
    requests: int
    aborted: int
    byte_count: float
    useful_bytes: int
    level: int
    increments: int
    error: float
    oracle_bytes: float
    oracle_level: int
    oracle_state: int
    oracle_error: float
    first_seen: float
    first_textured: float

    @property
    def lateness(self) -> float:
        """How late sending ended, a fraction of the limit."""
        return max(self.deviation, 0.0) / self.limit

    def to_json(self) -> str:
        """Return the report as JSON; times that never came are null."""
        values = {key: None if isinstance(value, float) and math.isinf(value) else value for key, value in asdict(self).items()}
        return json.dumps(values, indent=1)

    def to_text(self) -> str:
        """Return the report as a few lines of text."""
        side = "after" if self.deviation > 0.0 else "before"
        return (
            f"{self.client} client over {self.trace}: ended {abs(self.deviation):.3f} s {side} the limit of {self.limit:g} s "
            f"({100.0 * self.deviation / self.limit:+.2f} %), mean difference of requests {self.mean_difference:.3f} s\n"
            f"{self.requests} requests, {self.aborted} aborted, {self.byte_count / 1e6:.3f} MB carried, "
            f"{self.useful_bytes / 1e6:.3f} MB used\n"
            f"level {self.level} and {self.increments} increments: predicted error {self.error:.4f}; with the trace known before: level "
            f"{self.oracle_level}, state {self.oracle_state} of the textures, {self.oracle_error:.4f}\n"
            f"shown after {self.first_seen:.2f} s, with texture after {self.first_textured:.2f} s"
        )


def build_streamed_package(manifest: Manifest, increments: Increments) -> StreamedPackage:
    """Return what simulations need of a package."""
    plan = add_table(build_plan(manifest), *(values.tolist() for values in (increments.sizes, increments.firsts, increments.lasts)))
    return StreamedPackage(plan, increments, len(encode_manifest(manifest)))


def simulate_package(
    manifest: Manifest,
    increments: Increments,
    traces: Trace | tuple[Trace, ...],
    limit: float,
    client: str = "compensating",
    rate: float | None = None,
    delay: float = 0.06,
    loss: float = 0.0,
    patience: float = 0.0,
    seed: int = 0,
) -> StreamingReport:
    """Return what a client gets from a package over a connection with a trace, or from several servers with a trace each.

    limit: seconds since the user's wish. client, rate, patience, seed: see `simulate`. delay: seconds until a response begins. loss:
    fraction of responses that stop midway.

    Raises:
        SettingsError: see `simulate`.
    """
    connections = tuple(Connection(trace, delay, loss=loss) for trace in ((traces,) if isinstance(traces, Trace) else traces))
    return simulate(build_streamed_package(manifest, increments), connections, limit, client, rate, patience, seed=seed)


def simulate(
    package: StreamedPackage,
    connections: tuple[Connection, ...],
    limit: float,
    client: str = "compensating",
    rate: float | None = None,
    patience: float = 0.0,
    access: Trace | None = None,
    seed: int = 0,
) -> StreamingReport:
    """Return what a client gets from `package`.

    connections: one per server. limit: seconds since the user's wish; the manifest is fetched first. client: one of CLIENTS. rate: bytes
    per second that the client had before, None if it knows nothing. patience: seconds after the limit for which that with time compensation
    waits for running responses; the others wait for all that they have asked for. access: trace of the client's own connection. seed: of
    losses and jitter.

    Raises:
        SettingsError: there is no such client, no connection, or no time.
    """
    if client not in CLIENTS or not connections or not limit > 0.0:
        raise SettingsError(
            f"A client {client!r} with {len(connections)} connections and {limit:g} s is impossible; choose one of {', '.join(CLIENTS)}."
        )
    plan = package.plan
    agent = {
        "compensating": lambda: CompensatingClient(plan, limit, rate, len(connections), patience),
        "fixed": lambda: FixedClient(package.plan, package.increments, limit, rate),
        "paper": lambda: PaperClient(package.plan, package.increments, limit, rate),
    }[client]()
    course = _Course(Network(connections, access, seed, limit + patience), agent)
    course.run(package.manifest_size, limit)
    level, received = course.at_limit
    oracle_bytes = _possible_bytes(connections, access, course.begin, limit)
    oracle = package.best(oracle_bytes)
    sizes = np.diff([plan.begin, *plan.ends])
    return StreamingReport(
        client=client,
        trace=" + ".join(connection.trace.name for connection in connections),
        limit=limit,
        finished=course.finished,
        deviation=course.finished - limit,
        mean_difference=agent.mean_difference(),
        is_complete=package.is_complete(level, received),
        requests=course.requests,
        aborted=course.aborted,
        byte_count=course.network.bytes,
        useful_bytes=int(sizes[received].sum()) + (0 if level < 0 else plan.levels[level].end),
        level=level,
        increments=int(received.sum()),
        error=package.error(level, received),
        oracle_bytes=oracle_bytes,
        oracle_level=oracle[0],
        oracle_state=oracle[1],
        oracle_error=oracle[2],
        first_seen=course.first_seen,
        first_textured=course.first_textured,
    )


class _Course:
    """What happens to a client: see `StreamingReport`. begin: when the manifest is received. at_limit: the received level and increments
    at the limit or at the end."""

    def __init__(self, network: Network, agent: CompensatingClient | FixedClient | PaperClient) -> None:
        self.network, self.agent = network, agent
        self.at_limit = (-1, agent.received())
        self.requests = self.aborted = 0
        self.begin, self.finished, self.first_seen, self.first_textured = 0.0, 0.0, math.inf, math.inf

    def run(self, manifest_size: int, limit: float) -> None:
        """Fetch the manifest and then what the client asks for, until it is finished."""
        event = Event(self.network.fetch(0, manifest_size))
        self.begin = event.time
        while True:
            self._tell(event, limit)
            if self.agent.is_finished() or event.time > MAX_ROUNDS * limit:
                return
            event = self.network.advance()

    def _tell(self, event: Event, limit: float) -> None:
        requests, aborted = self.agent.on_response(event)
        for id in aborted:
            self.network.abort(id)
        for request in requests:
            self.network.send(request.id, request.server, request.span.end - request.span.start)
        self.requests += len(requests)
        self.aborted += len(aborted)
        if event.id >= 0 or aborted or not self.finished:
            self.finished = event.time
        level, received = self.agent.level(), self.agent.received()
        if event.time <= limit:
            self.at_limit = (level, received)
        self.first_seen = min(self.first_seen, event.time if level >= 0 else math.inf)
        self.first_textured = min(self.first_textured, event.time if received.any() else math.inf)


def _possible_bytes(connections: tuple[Connection, ...], access: Trace | None, begin: float, limit: float) -> float:
    """Return the bytes that all connections can carry before the limit, after the manifest, which comes at `begin`, and a delay."""
    total, opens = 0.0, limit
    for connection in connections:
        opens = min(opens, begin + connection.delay)
        total += max(connection.bytes_until(limit) - connection.bytes_until(begin + connection.delay), 0.0)
    return total if access is None else min(total, access.bytes_until(limit) - access.bytes_until(opens))


def _size(span: Span) -> int:
    return span.end - span.start
