"""The controller of a client: what it asks for, and that it ends at the limit."""

import dataclasses
import math
import random
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import controller, streaming_servers
from reference.byte_intervals import insert, measure, subtract
from reference.streaming_path import describe_textures, estimate_errors, find_path, inspect_textures
from reference.streaming_state import Event, Span, TransferPlan, add_table, begin
from sending.network import REPORT_INTERVAL, Connection
from sending.simulation import StreamedPackage, simulate
from sending.traces import constant_trace
from streaming_scenarios import Exchange, hide_table, make_package, random_exchange, random_plan, wavering_trace

from farfield.addon.core.packages.increments import Increments
from farfield.addon.core.packages.manifest import MESH, TEXTURES

WAITING = 1e9  # seconds of patience


EXCHANGES = st.integers(0, 10**6).map(lambda number: number % 20)  # seeds of random exchanges, which several tests share


@given(EXCHANGES)
@settings(max_examples=20, deadline=None)
def test_requests_never_overlap_what_has_come_or_is_running(seed):
    exchange = random_exchange(seed)
    state = exchange.initial
    received = []  # spans
    for (is_known, event), decision in zip(exchange.events, exchange.decisions, strict=True):
        plan = exchange.plan if is_known else hide_table(exchange.plan)
        before = {running.id: running for running in state.in_flight}
        state, requests, aborted = controller.decide(plan, state, event)
        assert (requests, aborted) == decision
        if event.id in before and event.received:
            span = before[event.id].span
            received.append((span.file, span.start + before[event.id].received, span.start + event.received))
        for request in requests:
            running = [(f.span.file, f.span.start + f.received, f.span.end) for f in state.in_flight if f.id != request.id]
            for file, start, end in received + running:
                assert file != request.span.file or end <= request.span.start or start >= request.span.end


@given(EXCHANGES)
@settings(max_examples=20, deadline=None)
def test_requests_stay_within_the_package_and_end_with_increments(seed):
    """Those to several servers may end within one, of which others bring the rest."""
    exchange = random_exchange(seed)
    plan, is_alone = exchange.plan, len(exchange.initial.servers) == 1
    parts = [Span(MESH, 0, plan.levels[-1].end), *plan.first]
    for requests, _ in exchange.decisions:
        for request in requests:
            span = request.span
            assert 0 <= request.server < len(exchange.initial.servers)
            assert span.start < span.end
            if span.file == TEXTURES and span.start >= plan.begin:
                assert span.end in plan.ends or (not is_alone and span.end < plan.ends[-1])
            else:
                assert any(part.file == span.file and part.start <= span.start and span.end <= part.end for part in parts)


@given(EXCHANGES)
@settings(max_examples=20, deadline=None)
def test_time_never_goes_back_and_nothing_is_asked_for_after_the_limit(seed):
    exchange = random_exchange(seed)
    state = exchange.initial
    for is_known, event in exchange.events:
        plan = exchange.plan if is_known else hide_table(exchange.plan)
        late = dataclasses.replace(event, time=event.time - 0.3)  # a clock that went back
        after, _, _ = controller.decide(plan, state, late)
        assert after.time >= state.time
        state, requests, _ = controller.decide(plan, state, event)
        if event.time >= state.limit and not state.keeps_refining:
            assert all(
                any(span.file == request.span.file and span.start <= request.span.start < span.end for span in plan.first)
                for request in requests
            )


def test_states_are_not_changed():
    exchange = random_exchange(3)
    copy = dataclasses.asdict(exchange.state)
    controller.decide(exchange.plan, exchange.state, Event(exchange.time + 0.1))
    controller.decide(exchange.plan, exchange.state, Event(exchange.time + 20.0))
    assert dataclasses.asdict(exchange.state) == copy


@given(st.integers(0, 10**6), st.booleans())
@settings(max_examples=15, deadline=None)
def test_everything_comes_once_if_there_is_time(seed, keeps_refining):
    """All levels and the last state of the textures, and never a byte twice."""
    rng = random.Random(seed)
    plan = random_plan(rng)
    limit = 0.1 if keeps_refining else 1e4
    exchange = Exchange(rng, plan, begin(plan, limit, 1e5, rng.randint(1, 3), keeps_refining=keeps_refining))
    exchange.tell(Event(0.0))
    for _ in range(3000):
        known = plan if exchange.has_table else hide_table(plan)
        if controller.is_finished(known, exchange.state):
            break
        exchange.time += 0.02
        in_flight = exchange.state.in_flight
        exchange.tell(
            Event(exchange.time, in_flight[0].id, in_flight[0].span.end - in_flight[0].span.start) if in_flight else Event(exchange.time)
        )
    state = exchange.state
    assert controller.is_finished(plan, state)
    assert not subtract(plan.states[-1], controller.list_received(state))
    assert controller.received_level(plan, state) == len(plan.levels) - 1
    assert state.mesh == plan.levels[-1].end
    sent = [request.span for requests, _ in exchange.decisions for request in requests]
    sizes = {file: sum(span.end - span.start for span in sent if span.file == file) for file in (MESH, TEXTURES)}
    assert sizes[MESH] == plan.levels[-1].end
    table = sum(span.end - span.start for span in plan.first if span.file == TEXTURES)
    assert plan.sizes[-1] + table <= sizes[TEXTURES] == measure(state.requested) + table <= sum(plan.sizes) + 300 * len(sent) + table


def test_first_requests_are_level_0_and_the_table():
    plan = hide_table(make_package().plan)
    _, requests, _ = controller.decide(plan, begin(plan, 5.0), Event(0.0))
    assert [request.span for request in requests] == list(plan.first)


@pytest.mark.parametrize("rate", [2e5, *(pytest.param(rate, marks=pytest.mark.exhaustive) for rate in (1e5, 4e5))])
def test_constant_rate_ends_within_one_increment_of_the_limit(rate):
    package = make_package(texture_size=3_000_000, increment_count=3000)
    report = simulate(package, (Connection(constant_trace(rate), 0.05, jitter=0.0, overhead=0),), 5.0, rate=rate, patience=WAITING)
    assert -0.01 * 5.0 <= report.deviation <= 0.002 * 5.0
    assert report.useful_bytes >= 0.8 * report.oracle_bytes
    assert report.error <= 1.35 * report.oracle_error


@given(st.integers(0, 10**6), st.floats(0.0, 0.5), st.floats(0.02, 0.15), st.floats(2.0, 8.0))
@settings(max_examples=15, deadline=None)
def test_deviation_is_within_its_bound(seed, variation, delay, limit):
    """-(g + W) <= Pi <= e W, of the docstring. Estimates are means of rates within b (1 - v) to b (1 + v), and off by bytes that are
    reported up to REPORT_INTERVAL late."""
    rng = random.Random(seed)
    rate = 5e5
    package = make_package(texture_size=6_000_000, increment_count=3000)
    connection = Connection(wavering_trace(rng, rate, variation), delay, jitter=0.0, overhead=0)
    report = simulate(package, (connection,), limit, rate=rate, patience=WAITING)
    slowest = rate * (1.0 - variation)
    increment = 2000 / slowest
    window = (1.0 + controller.LEAD) * delay + increment / (1.0 - controller.FRACTION)
    error = (1.0 + variation) * (1.0 + REPORT_INTERVAL / streaming_servers.FAST) / (1.0 - variation) - 1.0
    if not report.is_complete:
        assert report.deviation >= -(increment + window + REPORT_INTERVAL)
        assert report.deviation <= error * window + 1e-6


@given(st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=40))
def test_deviation_of_even_parts_is_the_harmonic_product(errors):
    """The formula that the docstring gives for the paper's algorithm."""
    count, left = len(errors), 1.0
    for position, error in enumerate(errors):
        planned = left / (count - position)
        left -= planned * (1.0 + error)
    product = math.prod(1.0 - error / (count - 1 - position) for position, error in enumerate(errors[:-1]))
    assert -left == pytest.approx(errors[-1] / count * product, abs=1e-9)
    largest = max(map(abs, errors))
    assert abs(left) <= largest / count * math.exp(largest * sum(1.0 / rest for rest in range(1, count))) + 1e-9


def ask_all(plan: TransferPlan, limit: float, rate: float) -> list[Span]:
    """The spans that a client asks for if each comes when the next one is asked for, at `rate`."""
    state, sent, time = begin(plan, limit, rate), [], 0.0
    event = Event(0.0)
    while time < limit:
        state, requests, _ = controller.decide(plan, state, event)
        sent += [request.span for request in requests]
        if not state.in_flight:
            break
        running = state.in_flight[0]
        size = running.span.end - running.span.start
        if running.is_open:
            time += size / rate
        event = Event(time, running.id, size if running.is_open else 0)
    return sent


def nested_plan(mesh_ends: tuple[int, ...], state_sizes: tuple[int, ...], errors: tuple[tuple[float, ...], ...]) -> TransferPlan:
    """A plan with increments of 100 bytes, whose states add to those before and replace nothing."""
    levels = tuple(Span(MESH, start, end) for start, end in pairwise((0, *mesh_ends)))
    plan = TransferPlan((levels[0], Span(TEXTURES, 0, 800)), levels, errors, 1000)
    firsts = [state for state, (start, end) in enumerate(pairwise((0, *state_sizes))) for _ in range(start, end, 100)]
    return add_table(plan, [100] * len(firsts), firsts, [len(state_sizes) - 1] * len(firsts))


def replaced_plan(state_sizes: tuple[int, ...], texture_errors: tuple[float, ...], are_single: bool = False) -> TransferPlan:
    """A plan with one level, of whose textures each state replaces all of those before: by increments of 100 bytes, or by a single one."""
    plan = TransferPlan((Span(MESH, 0, 1000), Span(TEXTURES, 0, 800)), (Span(MESH, 0, 1000),), (texture_errors,), 1000)
    if are_single:
        return add_table(plan, state_sizes, range(len(state_sizes)), range(len(state_sizes)))
    firsts = [state for state, size in enumerate(state_sizes) for _ in range(0, size, 100)]
    return add_table(plan, [100] * len(firsts), firsts, firsts)


def test_texture_begins_before_finer_levels_and_all_comes_in_order():
    errors = ((0.6, 0.5, 0.45), (0.5, 0.3, 0.25), (0.45, 0.25, 0.2), (0.4, 0.2, 0.1))
    plan = nested_plan((1000, 3000, 6000, 9000), (1500, 4000, 10_000), errors)
    sent = ask_all(plan, 60.0, 1e4)
    assert sent[2].file == TEXTURES
    for file, begin_ in ((MESH, 1000), (TEXTURES, 1000)):
        spans = [span for span in sent[2:] if span.file == file]
        assert [begin_, *(span.end for span in spans)] == [*(span.start for span in spans), max(span.end for span in spans)]
    assert sum(span.end - span.start for span in sent if span.file == MESH) == 9000
    assert sum(span.end - span.start for span in sent if span.file == TEXTURES) == 800 + 10_000


def walk(plan: TransferPlan, budget: float) -> list[tuple[int, int]]:
    """The levels and states on the best path from level 0 without textures for `budget` bytes, step by step."""
    asked, visited = [], [(0, -1)]
    while True:
        level, state = visited[-1]
        rest = budget - plan.levels[level].end + plan.levels[0].end - measure(asked)
        size = plan.levels[level + 1].end - plan.levels[level].end if level + 1 < len(plan.levels) else 0
        textures = inspect_textures(plan, asked)
        step = find_path(plan, level, textures, measure(asked), size, max(rest, 0.0), 1.0)
        if step[0] == level and step[1] == state:
            return visited
        if step[0] > level:
            visited.append((step[0], state))
        else:
            asked = union(asked, plan.states[step[1]])
            visited.append((level, step[1]))


def union(intervals, others):
    for start, end in others:
        intervals = insert(intervals, start, end)
    return intervals


def test_path_is_the_best_one_where_bytes_are_certain_to_come():
    plan = nested_plan((1000, 11_000), (2000, 4000, 10_000), ((0.5, 0.4, 0.38), (0.35, 0.2, 0.1)))
    path = walk(plan, 1e6)
    assert path[0] == (0, -1) and path[-1] == (1, 2)
    assert (1, -1) not in walk(plan, 3000.0)


def test_states_that_would_be_replaced_are_left_out():
    """Each state that comes costs all its bytes again."""
    plan = replaced_plan((400, 800, 1600, 3200, 6400, 12_800), (0.3, 0.2, 0.14, 0.1, 0.07, 0.05))
    for budget, last in ((2000.0, 2), (3800.0, 3), (7200.0, 4), (20_000.0, 5)):
        path = walk(plan, budget)
        states = [state for _, state in path]
        assert last in states
        assert sum(plan.sizes[state] for state in states[1 : states.index(last) + 1]) <= 1.6 * plan.sizes[last]


def test_error_of_a_part_is_between_those_of_states():
    plan = replaced_plan((400, 1600, 6400), (0.3, 0.2, 0.1))
    for level_error, left in (
        (1.0, [400, 1600, 6400]),
        (0.3, [0, 1600, 6400]),
        (0.25, [0, 800, 6400]),
        (0.2, [0, 0, 6400]),
        (0.15, [0, 0, 3200]),
    ):
        assert estimate_errors(plan, describe_textures(left)) == pytest.approx([level_error])
    assert estimate_errors(plan, describe_textures([0, 0, 0])) == [0.1]


@given(st.integers(0, 10**6))
@settings(max_examples=60, deadline=None)
def test_states_and_their_steps_are_the_increments_of_the_table(seed):
    rng = random.Random(seed)
    plan = random_plan(rng, rng.randint(1, 60))
    for state, intervals in enumerate(plan.states):
        assert measure(intervals) == plan.sizes[state]
        assert all(first[1] < second[0] for first, second in pairwise(intervals))
        for earlier in range(state):
            assert measure(subtract(intervals, plan.states[earlier])) == plan.steps[earlier][state]


def test_large_level_is_begun_early_if_it_will_come_and_late_increments_gain_little():
    """Without level 1 the error hardly falls behind the first state, so that it is the level that must not be missed."""
    plan = nested_plan((1000, 11_000), (2000, 8000, 10_000), ((0.07, 0.068, 0.065), (0.03, 0.012, 0.01)))
    for budget in (12_000.0, 14_000.0, 20_000.0):
        assert walk(plan, budget)[:3] == [(0, -1), (0, 0), (1, 0)]


@given(st.integers(0, 10**6), st.floats(0.0, 1e6), st.floats(1.0, 1e6))
@settings(max_examples=60, deadline=None)
def test_path_goes_forward_within_the_package(seed, budget, window):
    rng = random.Random(seed)
    plan = random_plan(rng)
    level = rng.randrange(len(plan.levels))
    asked = []
    for start, end in zip((plan.begin, *plan.ends), plan.ends, strict=False):
        if rng.random() < 0.7:
            asked = insert(asked, start, end)
    owed = plan.levels[level + 1].end - plan.levels[level].end if level + 1 < len(plan.levels) else 0
    textures = inspect_textures(plan, asked)
    found = find_path(plan, level, textures, measure(asked), owed, budget, window)
    assert level <= found[0] < len(plan.levels)
    assert textures.state < found[1] < len(plan.sizes) or textures.state == found[1] == len(plan.sizes) - 1


def test_level_that_cannot_come_is_not_begun():
    plan = nested_plan((1000, 60_000), (2500, 10_000, 30_000, 100_000), ((0.5, 0.4, 0.35, 0.3), (0.4, 0.3, 0.2, 0.1)))
    sent = ask_all(plan, 2.0, 1e4)
    assert [span for span in sent if span.file == MESH] == [plan.levels[0]]
    assert sum(span.end - span.start for span in sent if span.file == TEXTURES) > 0.8 * 2e4
    assert any(span.file == MESH and span.start == 1000 for span in ask_all(plan, 20.0, 1e4))


def test_state_with_an_increment_that_cannot_come_is_not_gone_to():
    """The best states have one that is longer than the budget, until a part of it has come."""
    plan = replaced_plan((400, 1600, 30_000, 40_000), (0.3, 0.25, 0.02, 0.01), are_single=True)
    textures = inspect_textures(plan, list(plan.states[0]))
    assert find_path(plan, 0, textures, 400, 0, 29_000.0, 1e4)[1] == 1
    assert find_path(plan, 0, textures, 400, 0, 35_000.0, 1e4)[1] == 2
    part = (plan.begin + 2000, plan.begin + 17_000)  # A part of the increment of state 2.
    assert find_path(plan, 0, inspect_textures(plan, [*plan.states[0], part]), 15_400, 0, 29_000.0, 1e4)[1] == 2


def test_long_increment_comes_from_all_servers():
    """Too long for any of them before the limit."""
    plan = replaced_plan((400, 60_000), (0.3, 0.02), are_single=True)
    sizes, indices = np.array([400, 60_000]), np.arange(2)
    package = StreamedPackage(plan, Increments(0 * indices, indices, 0 * indices, sizes, indices, indices), 1000)
    connections = tuple(Connection(constant_trace(6000.0), 0.05, jitter=0.0) for _ in range(4))
    report = simulate(package, connections, 5.0, rate=6000.0)
    assert report.is_complete and report.error == 0.02
    alone = simulate(package, connections[:1], 5.0, rate=6000.0)
    assert not alone.is_complete and alone.byte_count < 5000.0  # the connection is not filled with bytes of no use


def test_level_goes_before_increments_that_would_cost_it():
    plan = nested_plan((1000, 21_000), (2500, 5000, 20_000), ((0.5, 0.45, 0.4), (0.3, 0.2, 0.1)))
    sent = ask_all(plan, 3.7, 1e4)  # 37 kB: not enough for all increments and level 1
    assert sum(span.end - span.start for span in sent if span.file == MESH) == 21_000
    assert sum(span.end - span.start for span in sent if span.file == TEXTURES) < 800 + 20_000


@given(st.lists(st.tuples(st.integers(0, 60), st.integers(1, 9)), max_size=12), st.lists(st.tuples(st.integers(0, 60), st.integers(1, 9))))
def test_intervals_are_sets_of_bytes(first, second):
    def build(items):
        intervals = []
        for start, size in items:
            intervals = insert(intervals, start, start + size)
        return intervals, {byte for start, size in items for byte in range(start, start + size)}

    (ours, our_bytes), (theirs, their_bytes) = build(first), build(second)
    assert [byte for start, end in ours for byte in range(start, end)] == sorted(our_bytes)
    assert [byte for start, end in subtract(ours, theirs) for byte in range(start, end)] == sorted(our_bytes - their_bytes)
    assert measure(ours) == len(our_bytes)


def test_received_level_has_all_coarser_ones():
    plan = make_package().plan
    state = dataclasses.replace(begin(plan, 5.0), mesh=plan.levels[2].end, pending=[])
    assert controller.received_level(plan, state) == 2
    assert controller.received_level(plan, dataclasses.replace(state, pending=[plan.levels[1]])) == 0
    assert controller.received_level(plan, dataclasses.replace(state, pending=[Span(MESH, 100, 200)])) == -1


def test_what_is_silent_is_asked_for_again_from_another_server():
    plan = make_package().plan
    state, requests, _ = controller.decide(plan, begin(plan, 5.0, server_count=2), Event(0.0))
    silent = next(request for request in requests if request.server == 0)
    others = [request for request in requests if request.id != silent.id]
    state, _, _ = controller.decide(plan, state, Event(0.1, silent.id))
    state, _, _ = controller.decide(plan, state, Event(0.2, silent.id, 5000))
    rest, was_aborted = Span(MESH, silent.span.start + 5000, silent.span.end), False
    for tick in range(3, 40):
        events = [Event(0.1 * tick, other.id, other.span.end - other.span.start) for other in others] + [Event(0.1 * tick)]
        others = []
        for event in events:
            state, new, aborted = controller.decide(plan, state, event)
            others += [request for request in new if request.server == 1]
            was_aborted = was_aborted or silent.id in aborted
            if rest in [request.span for request in new]:
                assert was_aborted
                assert next(request.server for request in new if request.span == rest) == 1
                return
    raise AssertionError("it was waited for too long")


def test_server_that_failed_gets_nothing_for_a_while():
    plan = make_package().plan
    state, requests, _ = controller.decide(plan, begin(plan, 5.0), Event(0.0))
    state, more, _ = controller.decide(plan, state, Event(0.1, requests[0].id, failed=True))
    assert not more
    state, more, _ = controller.decide(plan, state, Event(0.1 + 0.9 * streaming_servers.MIN_PAUSE))
    assert not more
    state, more, _ = controller.decide(plan, state, Event(0.1 + 1.1 * streaming_servers.MIN_PAUSE))
    assert [request.span for request in more] == [requests[0].span]


def test_refining_goes_on_after_the_limit():
    plan = make_package().plan
    state = dataclasses.replace(begin(plan, 1.0, keeps_refining=True), pending=[])
    _, requests, _ = controller.decide(plan, state, Event(1.5))
    assert requests
    _, requests, _ = controller.decide(plan, dataclasses.replace(state, keeps_refining=False), Event(1.5))
    assert not requests
