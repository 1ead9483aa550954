"""What the controller of a client works with: what there is to send, its state, events and requests."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from reference.byte_intervals import Interval

from farfield.addon.core.packages.manifest import MESH, TEXTURES, Manifest, Section

DEFAULT_RATE = 250000.0  # bytes per second, if there is no history: 2 Mbit/s
DEFAULT_DELAY = 0.1  # seconds until the headers of a response come
PRIOR_SECONDS = 0.1  # weight of the initial rate


@dataclass(frozen=True)
class Span:
    """Bytes [start, end) of a file of the package."""

    file: str
    start: int
    end: int


@dataclass(frozen=True)
class TransferPlan:
    """What there is to send.

    first: spans without which nothing is shown: level 0 and the table of increments. levels: the sections of each, one behind the other;
    a level needs those of all coarser ones. errors: of each level with each state of the textures. begin: offset of the first increment.
    The others come from the table of increments, see `add_table`; until then, `ends` is None. ends: offsets of the ends of the increments
    in textures.bin. states: bytes of textures.bin that each state of the textures consists of. sizes: how many these are. steps: for each
    state and each later one, the bytes that only the later one has.
    """

    first: tuple[Span, ...]
    levels: tuple[Span, ...]
    errors: tuple[tuple[float, ...], ...]
    begin: int
    ends: tuple[int, ...] | None = None
    states: tuple[tuple[Interval, ...], ...] = ()
    sizes: tuple[int, ...] = ()
    steps: tuple[tuple[int, ...], ...] = ()


@dataclass
class Server:
    """The measurements of a server: recent bytes and seconds of its connection (two averages), the delay of its responses, when it was
    measured and heard last, failures in a row, when it failed last, until when others come first."""

    bytes: float
    seconds: float
    slow_bytes: float
    slow_seconds: float
    delay: float
    measured: float = 0.0  # seconds
    mark: float = 0.0
    last_response: float = 0.0
    failures: int = 0
    failed: float = 0.0
    until: float = 0.0


@dataclass
class InFlightRequest:
    """A request that has not been answered wholly: sent at `sent`, planned to end at `due`; of which `received` bytes are there."""

    id: int
    server: int
    span: Span
    sent: float
    due: float
    last_response: float
    received: int = 0
    is_open: bool = False


@dataclass
class State:
    """The state of a client. Times are seconds since the user's wish; read it, but only `decide` changes it.

    mesh: end of the levels that were requested. requested: bytes of increments that were requested. ended: when the last response ended.
    difference: sum of the absolute differences between planned and actual times of `responses` requests, `latest` is that of the last one.
    """

    limit: float
    patience: float
    keeps_refining: bool
    servers: list[Server]
    time: float = 0.0
    in_flight: list[InFlightRequest] = field(default_factory=list)
    pending: list[Span] = field(default_factory=list)
    next_id: int = 0
    mesh: int = 0
    requested: list[Interval] = field(default_factory=list)
    ended: float = 0.0
    difference: float = 0.0
    latest: float = 0.0
    responses: int = 0


@dataclass(frozen=True)
class Event:
    """What happened at `time`: nothing (id is -1), request `id` failed, or `received` bytes of its response are there altogether (0: its
    headers). A response ends with its last byte."""

    time: float
    id: int = -1
    received: int = 0
    failed: bool = False


@dataclass(frozen=True)
class Request:
    """Ask server `server` for `span`; name it `id` in events."""

    id: int
    server: int
    span: Span


def build_plan(manifest: Manifest) -> TransferPlan:
    """Return what `manifest` has to send, without the table of increments: add it when it is received."""
    levels = tuple(_span(level.positions, level.parents, level.wedges, level.uvs, level.corners) for level in manifest.levels)
    table = Span(TEXTURES, manifest.increments.offset, manifest.increments.end)
    if not manifest.increment_count:
        return add_table(TransferPlan(levels[:1], levels, manifest.errors.tabulate(), manifest.first_increment), (), (), ())
    return TransferPlan((levels[0], table), levels, manifest.errors.tabulate(), manifest.first_increment)


def add_table(plan: TransferPlan, sizes: Sequence[int], firsts: Sequence[int], lasts: Sequence[int]) -> TransferPlan:
    """Return `plan` with its increments: their bytes, and the first and the last state that has each."""
    count = len(plan.errors[0])
    ends: list[int] = []
    states: list[list[Interval]] = [[] for _ in range(count)]
    totals, steps = [0] * count, [[0] * count for _ in range(count)]
    end = plan.begin
    for size, first, last in zip(sizes, firsts, lasts, strict=True):
        start, end = end, end + size
        ends.append(end)
        for state in range(first, last + 1):
            begin = states[state].pop()[0] if states[state] and states[state][-1][1] == start else start
            states[state].append((begin, end))
            totals[state] += size
            for earlier in range(first):
                steps[earlier][state] += size
    rows = tuple(tuple(row) for row in steps)
    return replace(plan, ends=tuple(ends), states=tuple(tuple(state) for state in states), sizes=tuple(totals), steps=rows)


def find_target(manifest: Manifest, pixels: float) -> tuple[int, int]:
    """Return the coarsest level and the first state of the textures that look right where the object has so many pixels in the image."""
    sizes = [level.pixels for level in manifest.levels], manifest.state_pixels
    level, state = (next((index for index, size in enumerate(items) if size >= pixels), len(items) - 1) for items in sizes)
    return level, state


def limit_plan(plan: TransferPlan, level: int, state: int, is_direct: bool = False) -> TransferPlan:
    """Return `plan` up to a level and a state of the textures. is_direct: without the states before, which would only be replaced."""
    kept = slice(state if is_direct else 0, state + 1)
    errors, steps = (tuple(row[kept] for row in rows) for rows in (plan.errors[: level + 1], plan.steps[kept]))
    return replace(plan, levels=plan.levels[: level + 1], errors=errors, states=plan.states[kept], sizes=plan.sizes[kept], steps=steps)


def begin(
    plan: TransferPlan, limit: float, rate: float | None = None, server_count: int = 1, patience: float = 0.0, keeps_refining: bool = False
) -> State:
    """Return the state before the first request.

    limit: seconds. rate: bytes per second that the user's connection had before (B0 of the paper). patience: seconds after the limit for
    which responses are waited for. keeps_refining: go on after the limit until everything is received.
    """
    bytes_ = (rate or DEFAULT_RATE) * PRIOR_SECONDS
    servers = [Server(bytes_, PRIOR_SECONDS, bytes_, PRIOR_SECONDS, DEFAULT_DELAY) for _ in range(server_count)]
    return State(limit, patience, keeps_refining, servers, pending=list(plan.first), mesh=plan.levels[0].end)


def _span(*sections: Section) -> Span:
    """Return the span of sections of mesh.bin."""
    return Span(MESH, min(section.offset for section in sections), max(section.end for section in sections))
