"""What the controller of a client works with: what there is to send, its state, events and requests."""

from dataclasses import dataclass, field

from .manifest import MESH, TEXTURES, Manifest, Section

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
class Job:
    """What there is to send.

    first: spans without which nothing is shown: level 0 and the table of increments. levels: the sections of each, one behind the other;
    a level needs those of all coarser ones. plan: (level, number of increments, predicted error) ascending by bytes. begin: offset of the
    first increment. ends: offsets of the ends of the increments in textures.bin; None until the table has come.
    """

    first: tuple[Span, ...]
    levels: tuple[Span, ...]
    plan: tuple[tuple[int, int, float], ...]
    begin: int
    ends: tuple[int, ...] | None = None


@dataclass
class Server:
    """The measurements of a server: recent bytes and seconds of its line (two averages), the delay of its responses, when it was measured
    and heard last, failures in a row, when it failed last, until when others come first."""

    bytes: float
    seconds: float
    slow_bytes: float
    slow_seconds: float
    delay: float
    measured: float = 0.0  # seconds
    mark: float = 0.0
    heard: float = 0.0
    failures: int = 0
    failed: float = 0.0
    until: float = 0.0


@dataclass
class Flight:
    """A request that has not been answered wholly: asked for at `asked`, planned to end at `due`; `received` bytes have come."""

    id: int
    server: int
    span: Span
    asked: float
    due: float
    heard: float
    received: int = 0
    is_open: bool = False


@dataclass
class State:
    """The state of a client. Times are seconds since the user's wish; read it, but only `decide` changes it.

    level, asked: the level and the number of increments asked for. ended: when the last response ended. difference: sum of the absolute
    differences between planned and actual times of `responses` requests, `latest` is that of the last one.
    """

    limit: float
    patience: float
    keeps_refining: bool
    servers: list[Server]
    time: float = 0.0
    flights: list[Flight] = field(default_factory=list)
    pending: list[Span] = field(default_factory=list)
    next_id: int = 0
    mesh: int = 0
    asked: int = 0
    ended: float = 0.0
    difference: float = 0.0
    latest: float = 0.0
    responses: int = 0


@dataclass(frozen=True)
class Event:
    """What happened at `time`: nothing (id is -1), request `id` failed, or `received` bytes of its response have come altogether (0: its
    headers). A response whose last byte has come has ended."""

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


def build_job(manifest: Manifest) -> Job:
    """Return what `manifest` has to send. `ends` is None: add them when the table of increments has come."""
    levels = tuple(_span(level.positions, level.parents, level.wedges, level.uvs, level.corners) for level in manifest.levels)
    table = Span(TEXTURES, manifest.increments.offset, manifest.increments.end)
    plan = tuple((row.level, row.increment_count, row.flip) for row in manifest.plan)
    if not manifest.increment_count:
        return Job(levels[:1], levels, plan, manifest.first_increment, ())
    return Job((levels[0], table), levels, plan, manifest.first_increment)


def begin(
    job: Job, limit: float, rate: float | None = None, server_count: int = 1, patience: float = 0.0, keeps_refining: bool = False
) -> State:
    """Return the state before the first request.

    limit: seconds. rate: bytes per second that the user's line had before (B0 of the paper). patience: seconds after the limit for which
    responses are waited for. keeps_refining: go on after the limit until everything has come.
    """
    bytes_ = (rate or DEFAULT_RATE) * PRIOR_SECONDS
    servers = [Server(bytes_, PRIOR_SECONDS, bytes_, PRIOR_SECONDS, DEFAULT_DELAY) for _ in range(server_count)]
    return State(limit, patience, keeps_refining, servers, pending=list(job.first), mesh=job.levels[0].end)


def _span(*sections: Section) -> Span:
    """Return the span of sections of mesh.bin."""
    return Span(MESH, min(section.offset for section in sections), max(section.end for section in sections))
