"""A discrete-event model of servers and connections between them and a client.

Each server has a connection whose rate follows a trace and which its running responses divide equally, as TCP connections do; the client
may have an access connection that all servers share. Headers of a response come after the delay of the connection, then its bytes. A lost
response stops at a random byte forever. Not modeled: the slow start of new connections (a client keeps its connections open), and queues
that grow with load."""

import math
import random
from collections import deque
from dataclasses import dataclass

from reference.streaming_state import Event
from sending.traces import Trace

REPORT_INTERVAL = 0.05  # seconds between two reports of bytes, and between two ticks


@dataclass(frozen=True)
class Connection:
    """The connection to a server.

    delay: seconds from a request to the headers of its response. jitter: fraction of the delay that varies. overhead: bytes of headers of
    each response. loss: fraction of responses that stop midway. down: seconds [from, to) in which requests fail and responses stop.
    """

    trace: Trace
    delay: float = 0.06
    jitter: float = 0.1
    overhead: int = 400
    loss: float = 0.0
    down: tuple[float, float] = (math.inf, math.inf)

    def bytes_until(self, time: float) -> float:
        """Return how many bytes the connection carries from 0 to `time`."""
        begin, end = (min(moment, time) for moment in self.down)
        return self.trace.bytes_until(time) - (self.trace.bytes_until(end) - self.trace.bytes_until(begin))


@dataclass
class _Response:
    """left: bytes that have not come, headers included. stop: it stalls with so many left. reported: bytes of which the client knows."""

    id: int
    server: int
    size: int
    opens: float
    left: float
    stop: float
    is_open: bool = False
    reported: int = 0

    @property
    def received(self) -> int:
        return max(self.size - math.ceil(self.left - 1e-6), 0)


class Network:
    """Lines, running responses, and the time. alarm: there is a tick at this time. bytes: carried so far, headers included."""

    def __init__(self, connections: tuple[Connection, ...], access: Trace | None = None, seed: int = 0, alarm: float = math.inf) -> None:
        self.connections, self.access, self.alarm = connections, access, alarm
        self.time = 0.0
        self.bytes = 0.0
        self._random = random.Random(seed)
        self._responses: list[_Response] = []
        self._events: deque[Event] = deque()
        self._next_report = REPORT_INTERVAL

    def fetch(self, server: int, size: int) -> float:
        """Return when `size` bytes are received that are requested now, alone, and not lost."""
        begin = self.time + self.connections[server].delay
        self.time = self.connections[server].trace.time_of(self.connections[server].trace.bytes_until(begin) + size)
        self._next_report = self.time + REPORT_INTERVAL
        self.bytes += size
        return self.time

    def send(self, id: int, server: int, size: int) -> None:
        """Ask `server` for `size` bytes now."""
        connection = self.connections[server]
        opens = self.time + connection.delay * (1.0 + connection.jitter * abs(self._random.gauss(0.0, 1.0)))
        stop = self._random.uniform(0.0, size) if self._random.random() < connection.loss else -1.0
        self._responses.append(_Response(id, server, size, opens, size + connection.overhead, stop))

    def abort(self, id: int) -> None:
        """Stop the response to request `id`."""
        self._responses = [response for response in self._responses if response.id != id]
        self._events = deque(event for event in self._events if event.id != id)

    def advance(self) -> Event:
        """Let time pass until something happens, and return it; a tick if nothing else does."""
        while not self._events:
            self._move()
        return self._events.popleft()

    def _move(self) -> None:
        """Let time pass until something may happen or a rate changes, and note what has happened."""
        rates, end = self._rates()
        end = min(end, self._next_report, self.alarm if self.alarm > self.time else math.inf)
        for response in self._responses:
            if not response.is_open:
                end = min(end, response.opens)
            elif rates[response.server] > 0.0 and response.left > response.stop:
                end = min(end, self.time + (response.left - max(response.stop, 0.0)) / rates[response.server])
        for response in self._responses:
            if response.is_open and response.left > response.stop:
                carried = min(rates[response.server] * (end - self.time), response.left - max(response.stop, 0.0))
                response.left -= carried
                self.bytes += carried
                if response.left - max(response.stop, 0.0) < 1e-3:
                    response.left = max(response.stop, 0.0)
        self.time = end
        self._note()

    def _note(self) -> None:
        for response in self._responses:
            if not response.is_open and response.opens <= self.time:
                response.is_open = not self._is_down(response.server)
                self._events.append(Event(self.time, response.id, failed=not response.is_open))
            elif response.is_open and response.left == 0.0:
                self._events.append(Event(self.time, response.id, response.size))
        ended = {event.id for event in self._events if event.failed or event.received}
        self._responses = [response for response in self._responses if response.id not in ended]
        is_report = self.time >= self._next_report
        if is_report:
            self._next_report += REPORT_INTERVAL
            for response in self._responses:
                if response.received > response.reported:
                    response.reported = response.received
                    self._events.append(Event(self.time, response.id, response.received))
        if not self._events and (is_report or self.time == self.alarm):
            self._events.append(Event(self.time))

    def _rates(self) -> tuple[list[float], float]:
        """Return the rate of each running response of every server, and until when the rates hold."""
        totals, end, counts = [], math.inf, []
        for server, connection in enumerate(self.connections):
            count = sum(response.is_open and response.left > response.stop for response in self._responses if response.server == server)
            rate, until = connection.trace.rate(self.time)
            end = min(end, until, *(moment for moment in connection.down if moment > self.time))
            counts.append(count)
            totals.append(rate if count and not self._is_down(server) else 0.0)
        if self.access is not None:
            rate, until = self.access.rate(self.time)
            end = min(end, until)
            factor = min(1.0, rate / max(sum(totals), 1e-9))
            totals = [total * factor for total in totals]
        return [total / max(count, 1) for total, count in zip(totals, counts, strict=True)], end

    def _is_down(self, server: int) -> bool:
        begin, end = self.connections[server].down
        return begin <= self.time < end
