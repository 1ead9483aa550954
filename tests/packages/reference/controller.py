"""The controller of a client: which bytes to ask for next, so that sending ends at the time limit (sections III.B, III.C and V of the
paper).

`decide` is a pure function of the state and an event. The page has the same one in page/controller.js, with the same arithmetic in the same
order (only + - * / and comparisons of doubles), so both decide alike bit for bit. The caller tells every event at once, ticks about 20
times per second, and one at the limit.

Order. Level 0 and the table of increments come first, so that something is on the screen. What follows is chosen for each request, from the
bytes that are expected before the limit: the next levels, or increments of the next state of the textures, on the path that has the least
expected error if more or fewer bytes come (`sending_path`). So a level that will probably not come before the limit is not begun, one that
must not be missed goes before increments that gain little, and tiles that would be replaced before the limit are left out, and so is a
state with an increment that cannot come before it. Levels on the path within the length of the request come first, to save requests.

Time compensation. The paper's algorithm gives each of the n - j remaining fragments an equal part of the time that remains after fragment
j, so a deviation spreads evenly over them: with relative errors e_j of the estimated times, the last of n fragments ends

    Pi = e_n (T / n) prod_{j < n} (1 - e_j / (n - j))

after the limit T; with e the largest |e_j|, that is at most e (T / n) exp(e (1 + 1/2 + ... + 1 / (n - 1))), a harmonic sum. Here each
request takes FRACTION of the remaining time, so a deviation spreads over the remaining requests in proportion to their planned times, which
shrink geometrically: the factor behind e_n is T (1 - FRACTION (1 - e))^(n - 1) at most. Requests shorter than the delay of the line would
leave it idle, so the one that begins when less remains takes all of it; and the increment that is next, which takes g seconds, may be
longer than its request should be. So the last request is sent W seconds before the limit at most, and ends (our bound in place of eq. 8)

    -(g + W) <= Pi <= e W,    W = (1 + LEAD) delay + g / (1 - FRACTION)

after it. Parts of a level, which are of no use alone, are up to MAX_PARTS times as long: if one is the last request, W is the time that it
was planned to take. `mean_difference` is Lambda of eq. 9. At the limit the client stops: whole increments of a response that is running are
of use.

Several servers: a request goes to the server whose line is free first, and is as long as its measured rate allows; so bytes spread by
rates, the first ones, too. Increments that would take long are divided between servers, as levels are: a large tile must not depend on one
line. A response that is late and takes twice as long as from a server that is free is aborted, and its rest asked for there (`find_slow`).
A server that fails or is silent gets nothing for a while, and what it owes is asked for first, elsewhere if possible; what it owes of
increments is chosen again, as there may be less time for them.
When requests will not end before the limit, the newest are taken back, so that older ones get the whole line. Increments do not depend on
each other, so those behind a gap in the file are of use.
"""

from bisect import bisect_right
from dataclasses import replace

from reference.byte_intervals import Interval, insert, measure, subtract
from reference.sending_path import find_path, inspect_textures, list_increments
from reference.sending_servers import find_slow, is_paused, is_silent, look_ahead, measure_line, pause
from reference.sending_state import Event, Flight, Job, Request, Server, Span, State

from farfield.addon.core.packages.manifest import MESH, TEXTURES

FRACTION = 1.0 / 3.0  # of the remaining time for the next request
MAX_REQUEST, FIRST_REQUEST = 1.0, 0.3  # seconds that a request may take, with a rate that was measured and one that was not
SMALLEST = 15_000.0  # bytes of a request, as headers are a part of each, if its end need not be near the limit
LEAD = 1.5  # delays before the line is free that the next request is sent
EXCESS = 1.2  # of the time left, for all requests of a server, at which the newest is aborted
MEASURED = 0.2  # seconds after which a rate counts as measured
MAX_PARTS, PARTS = 3.0, 2.0  # lengths of a request: a span longer than the first is divided into parts of the second
MAX_GAP = 300  # bytes between increments that are asked for with them: another request would cost more


def decide(job: Job, state: State, event: Event) -> tuple[State, list[Request], list[int]]:
    """Return the state after `event`, the requests to send, and the ids of those to abort. What has come of aborted ones is kept."""
    state = _copy(state)
    state.time = max(state.time, event.time)
    for flight in state.flights:
        if flight.id == event.id:
            _hear(job, state, flight, event)
    is_over = state.time >= state.limit + state.patience and not state.keeps_refining
    aborted = []
    for flight in state.flights[::-1]:  # the newest first
        was_silent = is_silent(state, flight)
        if was_silent:
            pause(state, flight)
        if was_silent or (not _is_first(job, flight.span) and (is_over or _is_excess(state, flight))):
            _owe(job, state, flight)
            aborted.append(flight.id)
    requests: list[Request] = []
    while _ask(job, state, requests, aborted):
        pass
    return state, requests, aborted


def is_finished(job: Job, state: State) -> bool:
    """Return whether no response is waited for and nothing will be asked for anymore."""
    if state.flights or any(_is_first(job, span) for span in state.pending):
        return False
    is_over = state.time >= state.limit and not state.keeps_refining
    has_textures = job.ends is not None and not subtract(job.states[-1], state.asked)
    return is_over or (has_textures and not state.pending and state.mesh == job.levels[-1].end)


def list_received(state: State) -> list[Interval]:
    """Return the bytes of increments that have come."""
    waits = [(flight.span.start + flight.received, flight.span.end) for flight in state.flights if flight.span.file == TEXTURES]
    return subtract(state.asked, sorted(waits))


def received_level(job: Job, state: State) -> int:
    """Return the finest level that has come with all coarser ones, or -1."""
    starts = [flight.span.start + flight.received for flight in state.flights if flight.span.file == MESH]
    starts += [span.start for span in state.pending if span.file == MESH]
    return _level_up_to(job, min([state.mesh, *starts]))


def mean_difference(state: State) -> float:
    """Return Lambda (eq. 9 of the paper), seconds: the mean difference between planned and actual times of all requests but the last."""
    return (state.difference - state.latest) / max(state.responses - 1, 1)


def _level_up_to(job: Job, offset: int) -> int:
    """Return the finest level that ends at `offset` at most, or -1."""
    return bisect_right(job.levels, offset, key=lambda span: span.end) - 1


def _copy(state: State) -> State:
    return replace(
        state,
        servers=[replace(server) for server in state.servers],
        flights=[replace(flight) for flight in state.flights],
        pending=list(state.pending),
        asked=list(state.asked),
    )


def _hear(job: Job, state: State, flight: Flight, event: Event) -> None:
    server = state.servers[flight.server]
    if event.failed:
        pause(state, flight)
        _owe(job, state, flight)
        return
    is_busy = any(other.is_open and other.server == flight.server for other in state.flights)
    size = flight.span.end - flight.span.start
    received = min(max(event.received, flight.received), size)
    fresh = received - flight.received
    if not flight.is_open:
        flight.is_open = True
        server.delay += (state.time - flight.asked - server.delay) * (0.25 if server.measured else 1.0)
    if not is_busy:
        server.mark, fresh = state.time, 0  # bytes that come with the headers took a time that nobody measured
    measure_line(server, fresh, state.time - server.mark)
    server.mark = flight.heard = server.heard = state.time
    flight.received = received
    if received == size:
        state.flights = [other for other in state.flights if other.id != flight.id]
        state.latest = abs(state.time - flight.due)
        state.difference += state.latest
        state.responses += 1
        state.ended = state.time
        server.failures = 0


def _is_excess(state: State, flight: Flight) -> bool:
    """Return whether `flight` and the older ones of its server will not end before the limit, so that it takes from them in vain."""
    is_alone = all(other.server != flight.server or other.id >= flight.id for other in state.flights)
    if is_alone or flight.span.file == MESH or state.keeps_refining:
        return False
    return look_ahead(state, flight.server)[0] > EXCESS * max(state.limit - state.time, 0.0)


def _owe(job: Job, state: State, flight: Flight) -> None:
    """Put the rest of a request back: to be asked for first, or chosen again if it is of increments."""
    state.flights = [other for other in state.flights if other.id != flight.id]
    rest = replace(flight.span, start=flight.span.start + flight.received)
    if rest.file == TEXTURES and not _is_first(job, rest):
        state.asked = subtract(state.asked, [(rest.start, rest.end)])
    else:
        state.pending.insert(0, rest)


def _is_first(job: Job, span: Span) -> bool:
    return any(span.file == first.file and first.start <= span.start < first.end for first in job.first)


def _ask(job: Job, state: State, requests: list[Request], aborted: list[int]) -> bool:
    """Send one more request, if there is something to ask for and a server whose line will be free soon."""
    lines = []
    owes_first = len(state.servers) == 1 and any(_is_first(job, span) for span in state.pending)
    for index, server in enumerate(state.servers):
        busy, rest, rate = look_ahead(state, index)
        if not is_paused(state, index) and (owes_first or busy <= LEAD * server.delay):
            lines.append((max(busy, server.delay), index, rest, rate))
    for start, index, rest, rate in sorted(lines):
        slow = find_slow(state, index, start, rate)
        if slow is not None:
            _owe(job, state, slow)
            aborted.append(slow.id)
        span = _take(job, state, rest, rate, state.servers[index])
        if span is not None:
            due = state.time + start + (span.end - span.start) / rate
            state.flights.append(Flight(state.next_id, index, span, state.time, due, state.time))
            requests.append(Request(state.next_id, index, span))
            state.next_id += 1
            return True
    return False


def _take(job: Job, state: State, rest: float, rate: float, server: Server) -> Span | None:
    """Return the next span to ask for from `server`, which has `rest` seconds at `rate`, and remove it from what is owed."""
    longest = MAX_REQUEST if server.measured >= MEASURED else FIRST_REQUEST
    for position, span in enumerate(state.pending):
        if _is_first(job, span):
            return _cut(state, position, span.end if len(state.servers) == 1 else min(span.end, span.start + int(longest * rate)))
    if rest <= 0.0 or job.ends is None:
        return None
    shortest = server.delay if state.patience or len(state.servers) > 1 else max(server.delay, SMALLEST / rate)
    seconds = rest if rest <= shortest else max(min(rest * FRACTION, longest), shortest)
    wanted, possible = seconds * rate, rest * rate
    span, position = _choose(job, state, wanted)
    end = span.end
    if (span.file == MESH or len(state.servers) > 1) and end - span.start > min(MAX_PARTS * wanted, possible):
        end = span.start + int(min(PARTS * wanted, possible))
    if end == span.start:
        return None
    if position is not None:
        return _cut(state, position, end)
    if span.file == MESH:
        state.mesh = end
    else:
        state.asked = insert(state.asked, span.start, end)
    return replace(span, end=end)


def _choose(job: Job, state: State, wanted: float) -> tuple[Span, int | None]:
    """Return what the best path goes to within `wanted` bytes, and its position if it is owed."""
    owed = sum(span.end - span.start for span in state.pending)
    level = _level_up_to(job, min([state.mesh, *(span.start for span in state.pending)]))
    if level + 1 < len(job.levels):
        owed += max(job.levels[level + 1].end - state.mesh, 0)
    textures, spent = inspect_textures(job, state.asked), measure(state.asked)
    budget = _budget(state)
    next_level, target = find_path(job, level, textures, spent, owed, budget, wanted)
    if next_level == level or (not state.asked and textures.state < 0):  # something of the textures first
        return _missing_span(job, state, textures.missing[target], wanted, budget), None
    if state.pending:
        return state.pending[0], 0
    return Span(MESH, state.mesh, job.levels[next_level].end), None


def _cut(state: State, position: int, end: int) -> Span:
    """Return a pending span up to `end`, and keep its rest."""
    span = state.pending[position]
    state.pending[position : position + 1] = [replace(span, start=end)] if end < span.end else []
    return replace(span, end=end)


def _budget(state: State) -> float:
    """Return the bytes that can be asked for and come before the limit."""
    budget = 0.0
    for index in range(len(state.servers)):
        _, rest, rate = look_ahead(state, index)
        if not is_paused(state, index):
            budget += max(rest, 0.0) * rate
    return budget


def _missing_span(job: Job, state: State, missing: list[Interval], wanted: float, possible: float) -> Span:
    """Return the first of the missing increments, with short gaps between them: up to `wanted` bytes, or one of up to `possible` bytes."""
    first = last = job.begin
    for start, end in list_increments(job, missing):
        if first == last:
            if end - start <= possible:
                first, last = start, end
        elif end - first > wanted or start - last > MAX_GAP or any(begin < start and stop > last for begin, stop in state.asked):
            break
        else:
            last = end
    return Span(TEXTURES, first, last)
