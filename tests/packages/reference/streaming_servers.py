"""What a client knows of its servers: the rates and delays of their connections, and whether they answer. See `controller`."""

from reference.streaming_state import InFlightRequest, Server, State

FAST, SLOW = 0.3, 2.0  # seconds that the averages of rates look back
GRACE = 0.1  # seconds without a byte that mean nothing
SILENCE = 0.5  # seconds after which a request is given up where there are other servers
MIN_PAUSE, MAX_PAUSE = 0.25, 16.0  # seconds without a request for a server that failed: alone, and where there are others
MIN_RATE = 1000.0  # bytes per second
LATE = 0.3  # seconds behind its plan after which a response may be taken over
TWICE, MIN_SAVING = 2.0, 0.2  # times as long, and seconds, that it takes more than from the server that takes it over
ENDLESS = 1e9  # seconds


def estimate_rate(state: State, index: int, horizon: float) -> float:
    """Return the bytes per second of server `index` that are to be expected for the next `horizon` seconds."""
    server = state.servers[index]
    is_open = any(request.is_open and request.server == index for request in state.in_flight)
    gap = max(0.0, state.time - server.mark - GRACE) if is_open else 0.0
    fast = server.bytes / (server.seconds + gap)
    slow = server.slow_bytes / (server.slow_seconds + gap)
    return (fast * FAST + slow * horizon) / (FAST + horizon)


def measure_rate(server: Server, count: int, seconds: float) -> None:
    """Learn that `count` bytes came in `seconds` on a connection that was never idle."""
    fast, slow = FAST / (FAST + seconds), SLOW / (SLOW + seconds)
    server.bytes = server.bytes * fast + count
    server.seconds = server.seconds * fast + seconds
    server.slow_bytes = server.slow_bytes * slow + count
    server.slow_seconds = server.slow_seconds * slow + seconds
    server.measured += seconds


def look_ahead(state: State, index: int) -> tuple[float, float, float]:
    """Return in how many seconds the line of a server is free, how many then remain for a new response, and its rate until then."""
    is_refining = state.keeps_refining and state.time >= state.limit
    left = ENDLESS if is_refining else max(state.limit - state.time, 0.0)
    rate = max(estimate_rate(state, index, left), MIN_RATE)
    delay, busy = state.servers[index].delay, 0.0
    for request in state.in_flight:
        if request.server == index:
            begins = busy if request.is_open else max(busy, request.sent + delay - state.time)
            busy = begins + (request.span.end - request.span.start - request.received) / rate
    return busy, left if is_refining else left - max(busy, delay), rate


def find_slow(state: State, index: int, start: float, rate: float) -> InFlightRequest | None:
    """Return the response of another server that server `index` would bring much sooner, if it began in `start` seconds at `rate`."""
    slow, most = None, MIN_SAVING
    if state.servers[index].measured:
        for other in range(len(state.servers)):
            busy, theirs = 0.0, look_ahead(state, other)[2]
            for request in state.in_flight:
                if request.server == other and other != index:
                    left = request.span.end - request.span.start - request.received
                    begins = busy if request.is_open else max(busy, request.sent + state.servers[other].delay - state.time)
                    busy = begins + left / theirs
                    saving = busy - TWICE * (start + left / rate)
                    if saving > most and state.time + busy > request.due + LATE:
                        slow, most = request, saving
    return slow


def is_silent(state: State, request: InFlightRequest) -> bool:
    """Return whether a request has been waited for too long."""
    server = state.servers[request.server]
    since = max(request.last_response, min(server.last_response, request.due))
    patience = max(SILENCE, 4.0 * server.delay) * (2 << min(server.failures, 3) if len(state.servers) == 1 else 1)
    return state.time - since > (patience if server.measured else 2.0 * patience)  # connecting takes longer


def pause(state: State, request: InFlightRequest) -> None:
    """Let the server of a request alone for a while."""
    server = state.servers[request.server]
    if state.time >= server.until:  # not one of several requests that fail together
        server.failed, server.until = state.time, state.time + min(MIN_PAUSE * (1 << 2 * min(server.failures, 3)), MAX_PAUSE)
        server.failures += 1


def is_paused(state: State, index: int) -> bool:
    """Return whether a server gets no request; if none may, each gets one again soon."""
    server = state.servers[index]
    is_needed = all(state.time < other.until for other in state.servers)
    return state.time < server.until and not (is_needed and state.time >= server.failed + MIN_PAUSE)
