"""The controller of a client: which bytes to ask for next, so that sending ends at the time limit (sections III.B, III.C and V of the
paper).

`decide` is a pure function of the state and an event. The page has the same one in page/controller.js, with the same arithmetic in the same
order (only + - * / and comparisons of doubles), so both decide alike bit for bit. The caller tells every event at once, ticks about 20
times per second, and one at the limit.

Order. Level 0 and the table of increments come first, so that something is on the screen. What follows is chosen for each request, from the
bytes that are expected before the limit: the next levels, or increments of the next state of the textures, on the path that has the least
expected error if more or fewer bytes come (`streaming_path`). So a level that will probably not come before the limit is not begun, one
that must not be missed goes before increments that gain little, and tiles that would be replaced before the limit are left out, and so is a
state with an increment that cannot come before it. Levels on the path within the length of the request come first, to save requests.

Time compensation. The paper's algorithm gives each of the n - j remaining fragments an equal part of the time that remains after fragment
j, so a deviation spreads evenly over them: with relative errors e_j of the estimated times, the last of n fragments ends

    Pi = e_n (T / n) prod_{j < n} (1 - e_j / (n - j))

after the limit T; with e the largest |e_j|, that is at most e (T / n) exp(e (1 + 1/2 + ... + 1 / (n - 1))), a harmonic sum. Here each
request takes FRACTION of the remaining time, so a deviation spreads over the remaining requests in proportion to their planned times, which
shrink geometrically: the factor behind e_n is T (1 - FRACTION (1 - e))^(n - 1) at most. Requests shorter than the delay of the connection
would leave it idle, so the one that begins when less remains takes all of it; and the increment that is next, which takes g seconds, may be
longer than its request should be. So the last request is sent W seconds before the limit at most, and ends (our bound in place of eq. 8)

    -(g + W) <= Pi <= e W,    W = (1 + LEAD) delay + g / (1 - FRACTION)

after it. Parts of a level, which are of no use alone, are up to MAX_PARTS times as long: if one is the last request, W is the time that it
was planned to take. `mean_difference` is Lambda of eq. 9. At the limit the client stops: whole increments of a running response are of use.

Several servers: a request goes to the server whose connection is free first, and is as long as its measured rate allows; so bytes spread by
rates, the first ones, too. Increments that would take long are divided between servers, as levels are: a large tile must not depend on one
connection. A response that is late and takes twice as long as from a server that is free is aborted, and its rest asked for there
(`find_slow`). A server that fails or is silent gets nothing for a while, and its unanswered bytes are requested first, elsewhere if
possible; unanswered increments are chosen again, as there may be less time for them.
When requests will not end before the limit, the newest are taken back, so that older ones get the whole connection. Increments do not
depend on each other, so those behind a gap in the file are of use.
"""

from bisect import bisect_right
from dataclasses import replace

from reference.byte_intervals import Interval, insert, measure, subtract
from reference.streaming_path import find_path, inspect_textures, list_increments
from reference.streaming_servers import find_slow, is_paused, is_silent, look_ahead, measure_rate, pause
from reference.streaming_state import Event, InFlightRequest, Request, Server, Span, State, TransferPlan

from farfield.addon.core.packages.manifest import MESH, TEXTURES

FRACTION = 1.0 / 3.0  # The next request takes this part of the remaining time.
MAX_REQUEST, FIRST_REQUEST = 1.0, 0.3  # seconds that a request may take, with a rate that was measured and one that was not
SMALLEST = 15_000.0  # bytes of a request, as headers are a part of each, if its end need not be near the limit
LEAD = 1.5  # delays before the connection is free that the next request is sent
EXCESS = 1.2  # The newest request of a server is aborted if all of its requests take this multiple of the time left.
MEASURED = 0.2  # seconds after which a rate counts as measured
MAX_PARTS, PARTS = 3.0, 2.0  # lengths of a request: a span longer than the first is divided into parts of the second
MAX_GAP = 300  # bytes between increments that are asked for with them: another request would cost more


def decide(plan: TransferPlan, state: State, event: Event) -> tuple[State, list[Request], list[int]]:
    """Return the state after `event`, the requests to send, and the ids of those to abort. Received bytes of aborted ones are kept."""
    state = _copy(state)
    state.time = max(state.time, event.time)
    for request in state.in_flight:
        if request.id == event.id:
            _on_response(plan, state, request, event)
    is_over = state.time >= state.limit + state.patience and not state.keeps_refining
    aborted = []
    for request in state.in_flight[::-1]:  # the newest first
        was_silent = is_silent(state, request)
        if was_silent:
            pause(state, request)
        if was_silent or (not _is_first(plan, request.span) and (is_over or _is_excess(state, request))):
            _requeue(plan, state, request)
            aborted.append(request.id)
    requests: list[Request] = []
    while _next_request(plan, state, requests, aborted):
        pass
    return state, requests, aborted


def is_finished(plan: TransferPlan, state: State) -> bool:
    """Return whether no response is waited for and nothing will be asked for anymore."""
    if state.in_flight or any(_is_first(plan, span) for span in state.pending):
        return False
    is_over = state.time >= state.limit and not state.keeps_refining
    has_textures = plan.ends is not None and not subtract(plan.states[-1], state.requested)
    return is_over or (has_textures and not state.pending and state.mesh == plan.levels[-1].end)


def list_received(state: State) -> list[Interval]:
    """Return the received bytes of increments."""
    waits = [(request.span.start + request.received, request.span.end) for request in state.in_flight if request.span.file == TEXTURES]
    return subtract(state.requested, sorted(waits))


def received_level(plan: TransferPlan, state: State) -> int:
    """Return the finest received level of which all coarser ones are received, or -1."""
    starts = [request.span.start + request.received for request in state.in_flight if request.span.file == MESH]
    starts += [span.start for span in state.pending if span.file == MESH]
    return _level_up_to(plan, min([state.mesh, *starts]))


def mean_difference(state: State) -> float:
    """Return Lambda (eq. 9 of the paper), seconds: the mean difference between planned and actual times of all requests but the last."""
    return (state.difference - state.latest) / max(state.responses - 1, 1)


def _level_up_to(plan: TransferPlan, offset: int) -> int:
    """Return the finest level that ends at `offset` at most, or -1."""
    return bisect_right(plan.levels, offset, key=lambda span: span.end) - 1


def _copy(state: State) -> State:
    return replace(
        state,
        servers=[replace(server) for server in state.servers],
        in_flight=[replace(request) for request in state.in_flight],
        pending=list(state.pending),
        requested=list(state.requested),
    )


def _on_response(plan: TransferPlan, state: State, request: InFlightRequest, event: Event) -> None:
    server = state.servers[request.server]
    if event.failed:
        pause(state, request)
        _requeue(plan, state, request)
        return
    is_busy = any(other.is_open and other.server == request.server for other in state.in_flight)
    size = request.span.end - request.span.start
    received = min(max(event.received, request.received), size)
    fresh = received - request.received
    if not request.is_open:
        request.is_open = True
        server.delay += (state.time - request.sent - server.delay) * (0.25 if server.measured else 1.0)
    if not is_busy:
        server.mark, fresh = state.time, 0  # bytes that come with the headers took a time that nobody measured
    measure_rate(server, fresh, state.time - server.mark)
    server.mark = request.last_response = server.last_response = state.time
    request.received = received
    if received == size:
        state.in_flight = [other for other in state.in_flight if other.id != request.id]
        state.latest = abs(state.time - request.due)
        state.difference += state.latest
        state.responses += 1
        state.ended = state.time
        server.failures = 0


def _is_excess(state: State, request: InFlightRequest) -> bool:
    """Return whether `request` and the older ones of its server will not end before the limit, so that it takes from them in vain."""
    is_alone = all(other.server != request.server or other.id >= request.id for other in state.in_flight)
    if is_alone or request.span.file == MESH or state.keeps_refining:
        return False
    return look_ahead(state, request.server)[0] > EXCESS * max(state.limit - state.time, 0.0)


def _requeue(plan: TransferPlan, state: State, request: InFlightRequest) -> None:
    """Put the rest of a request back: to be requested first, or chosen again if it is of increments."""
    state.in_flight = [other for other in state.in_flight if other.id != request.id]
    rest = replace(request.span, start=request.span.start + request.received)
    if rest.file == TEXTURES and not _is_first(plan, rest):
        state.requested = subtract(state.requested, [(rest.start, rest.end)])
    else:
        state.pending.insert(0, rest)


def _is_first(plan: TransferPlan, span: Span) -> bool:
    return any(span.file == first.file and first.start <= span.start < first.end for first in plan.first)


def _next_request(plan: TransferPlan, state: State, requests: list[Request], aborted: list[int]) -> bool:
    """Send one more request, if there is something to ask for and a server whose connection will be free soon."""
    free = []
    needs_first = len(state.servers) == 1 and any(_is_first(plan, span) for span in state.pending)
    for index, server in enumerate(state.servers):
        busy, rest, rate = look_ahead(state, index)
        if not is_paused(state, index) and (needs_first or busy <= LEAD * server.delay):
            free.append((max(busy, server.delay), index, rest, rate))
    for start, index, rest, rate in sorted(free):
        slow = find_slow(state, index, start, rate)
        if slow is not None:
            _requeue(plan, state, slow)
            aborted.append(slow.id)
        span = _allocate(plan, state, rest, rate, state.servers[index])
        if span is not None:
            due = state.time + start + (span.end - span.start) / rate
            state.in_flight.append(InFlightRequest(state.next_id, index, span, state.time, due, state.time))
            requests.append(Request(state.next_id, index, span))
            state.next_id += 1
            return True
    return False


def _allocate(plan: TransferPlan, state: State, rest: float, rate: float, server: Server) -> Span | None:
    """Return the next span to ask for from `server`, which has `rest` seconds at `rate`, and remove it from the queue."""
    longest = MAX_REQUEST if server.measured >= MEASURED else FIRST_REQUEST
    for position, span in enumerate(state.pending):
        if _is_first(plan, span):
            return _cut(state, position, span.end if len(state.servers) == 1 else min(span.end, span.start + int(longest * rate)))
    if rest <= 0.0 or plan.ends is None:
        return None
    shortest = server.delay if state.patience or len(state.servers) > 1 else max(server.delay, SMALLEST / rate)
    seconds = rest if rest <= shortest else max(min(rest * FRACTION, longest), shortest)
    wanted, possible = seconds * rate, rest * rate
    span, position = _choose(plan, state, wanted)
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
        state.requested = insert(state.requested, span.start, end)
    return replace(span, end=end)


def _choose(plan: TransferPlan, state: State, wanted: float) -> tuple[Span, int | None]:
    """Return what the best path goes to within `wanted` bytes, and its position if it is queued."""
    remaining = sum(span.end - span.start for span in state.pending)
    level = _level_up_to(plan, min([state.mesh, *(span.start for span in state.pending)]))
    if level + 1 < len(plan.levels):
        remaining += max(plan.levels[level + 1].end - state.mesh, 0)
    textures, spent = inspect_textures(plan, state.requested), measure(state.requested)
    budget = _budget(state)
    next_level, target = find_path(plan, level, textures, spent, remaining, budget, wanted)
    if next_level == level or (not state.requested and textures.state < 0):  # something of the textures first
        return _missing_span(plan, state, textures.missing[target], wanted, budget), None
    if state.pending:
        return state.pending[0], 0
    return Span(MESH, state.mesh, plan.levels[next_level].end), None


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


def _missing_span(plan: TransferPlan, state: State, missing: list[Interval], wanted: float, possible: float) -> Span:
    """Return the first of the missing increments, with short gaps between them: up to `wanted` bytes, or one of up to `possible` bytes."""
    first = last = plan.begin
    for start, end in list_increments(plan, missing):
        if first == last:
            if end - start <= possible:
                first, last = start, end
        elif end - first > wanted or start - last > MAX_GAP or any(begin < start and stop > last for begin, stop in state.requested):
            break
        else:
            last = end
    return Span(TEXTURES, first, last)
