"""What an object of some size on screen needs: levels and states of the textures, and nothing beyond is asked for."""

import dataclasses
import json
import random
import shutil
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import controller
from reference.byte_intervals import measure, subtract
from reference.streaming_state import Event, TransferPlan, begin, find_target, limit_plan
from streaming_scenarios import Exchange, hide_table, random_plan
from test_core_controller_javascript import PAGE, list_increments

from farfield.addon.core.packages.manifest import MESH, TEXTURES
from farfield.addon.core.packages.planning import find_state_pixels


def run_to_end(exchange: Exchange) -> None:
    """Answer all requests, the oldest first, until the client has what its plan allows."""
    for _ in range(3000):
        if controller.is_finished(exchange.plan if exchange.has_table else hide_table(exchange.plan), exchange.state):
            return
        exchange.time += 0.02
        running = exchange.state.in_flight
        exchange.tell(Event(exchange.time, running[0].id, running[0].span.end - running[0].span.start) if running else Event(exchange.time))
    raise AssertionError("the client does not end")


def measure_requests(exchange: Exchange, file: str) -> int:
    spans = [request.span for requests, _ in exchange.decisions for request in requests]
    return sum(span.end - span.start for span in spans if span.file == file)


@pytest.mark.parametrize(
    ("pixels", "target"), [(5, (0, 0)), (15, (0, 1)), (16, (1, 1)), (64, (1, 1)), (71, (1, 2)), (72, (2, 2)), (200, (2, 3))]
)
def test_a_size_needs_the_first_level_and_state_that_look_right(pixels, target):
    manifest = SimpleNamespace(
        levels=[SimpleNamespace(pixels=size) for size in (15.0, 71.0, 0.0)], state_pixels=(10.0, 70.0, 100.0, 0.0), state_count=4
    )
    assert find_target(manifest, pixels) == target


def test_states_look_right_up_to_the_size_where_their_error_is_seen():
    """Errors double with the size of the object."""
    last = np.full((1, 4), 0.001)
    first = np.array([[0.08, 0.04, 0.02, 0.01], [0.04, 0.02, 0.01, 0.005], [0.008, 0.004, 0.002, 0.001]])
    found = find_state_pixels(np.concatenate([first + 0.001, last]), 512, 0.02)
    assert found == (128.0, 256.0, 512.0, 0.0)  # not beyond the size that was measured
    worse = find_state_pixels(np.concatenate([8.0 * first[:1] + 0.001, last]), 512, 0.02)
    assert worse == (16.0, 0.0)


@given(st.integers(0, 10**6))
@settings(max_examples=15, deadline=None)
def test_nothing_beyond_the_limits_is_asked_for_until_they_grow(seed):
    rng = random.Random(seed)
    complete = random_plan(rng)
    level, state = rng.randrange(len(complete.levels)), rng.randrange(len(complete.errors[0]))
    plan = limit_plan(complete, level, state)
    exchange = Exchange(rng, plan, begin(plan, 0.1, 1e5, rng.randint(1, 3), keeps_refining=True))
    exchange.tell(Event(0.0))
    run_to_end(exchange)
    assert exchange.state.mesh == complete.levels[level].end
    allowed = sorted({interval for intervals in complete.states[: state + 1] for interval in intervals})
    count = sum(len(requests) for requests, _ in exchange.decisions)
    beyond = exchange.state.requested
    for interval in allowed:
        beyond = subtract(beyond, [interval])
    assert measure(beyond) <= 300 * count  # short gaps between what is needed
    exchange.plan = complete
    exchange.tell(Event(exchange.time))
    run_to_end(exchange)
    assert exchange.state.mesh == measure_requests(exchange, MESH) == complete.levels[-1].end
    assert not subtract(complete.states[-1], controller.list_received(exchange.state))
    table = sum(span.end - span.start for span in complete.first if span.file == TEXTURES)
    assert measure_requests(exchange, TEXTURES) == measure(exchange.state.requested) + table


@given(st.integers(0, 10**6))
@settings(max_examples=15, deadline=None)
def test_a_direct_plan_asks_for_no_tile_that_would_be_replaced(seed):
    rng = random.Random(seed)
    complete = random_plan(rng)
    plan = limit_plan(complete, len(complete.levels) - 1, len(complete.errors[0]) - 1, is_direct=True)
    exchange = Exchange(rng, plan, begin(plan, 0.1, 1e5, keeps_refining=True))
    exchange.tell(Event(0.0))
    run_to_end(exchange)
    count = sum(len(requests) for requests, _ in exchange.decisions)
    assert measure(complete.states[-1]) <= measure(exchange.state.requested) <= measure(complete.states[-1]) + 300 * count


RUNNER = """
import { readFileSync } from "node:fs";
const { addTable, begin, findTarget, limitPlan, takeKept } = await import(process.argv[2]);
const { cases, manifest, sizes, kept } = JSON.parse(readFileSync(process.argv[3]));
const plans = cases.map(({ plan, table, limits }) => limitPlan(addTable(plan, table), ...limits));
const { plan, table, mesh, textures } = kept, complete = addTable(plan, table);
const state = takeKept(complete, begin(complete, { limit: 5 }), mesh, textures);
const targets = sizes.map((size) => findTarget(manifest, size));
process.stdout.write(JSON.stringify([plans, targets, [state.mesh, state.pending, state.requested]]));
"""


def describe(plan: TransferPlan) -> list:
    return json.loads(json.dumps([plan.levels, plan.errors, plan.states, plan.sizes, plan.steps], default=dataclasses.asdict))


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed, so the page's plans are not compared")
def test_page_limits_plans_like_python_and_takes_what_was_kept(tmp_path):
    cases, expected = [], []
    for seed in range(20):
        rng = random.Random(seed)
        complete = random_plan(rng)
        limits = rng.randrange(len(complete.levels)), rng.randrange(len(complete.errors[0])), seed % 2 == 0
        cases.append({"plan": dataclasses.asdict(hide_table(complete)), "table": list_increments(complete), "limits": limits})
        expected.append(describe(limit_plan(complete, *limits)))
    complete = random_plan(random.Random(3), 40)
    cut = complete.levels[0].end + 5 if len(complete.levels) > 1 else 5
    textures = [[0, complete.begin + 7], [complete.begin + 50, complete.begin + 90]]
    kept = {"plan": dataclasses.asdict(hide_table(complete)), "table": list_increments(complete), "mesh": [[0, cut]], "textures": textures}
    manifest = {"levels": [{"pixels": size} for size in (15.0, 71.0, 0.0)], "state_pixels": [10.0, 70.0, 100.0, 0.0]}
    sizes = [5, 15, 16, 71, 72, 1e9]
    (tmp_path / "cases.json").write_text(json.dumps({"cases": cases, "manifest": manifest, "sizes": sizes, "kept": kept}))
    (tmp_path / "runner.mjs").write_text(RUNNER)
    command = ["node", str(tmp_path / "runner.mjs"), PAGE.as_uri(), str(tmp_path / "cases.json")]
    plans, targets, taken = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    names = ("levels", "errors", "states", "sizes", "steps")
    assert [[plan[name] for name in names] for plan in plans] == expected
    assert targets == [[0, 0], [0, 1], [1, 1], [1, 2], [2, 2], [2, 3]]
    pending = [] if cut > complete.levels[0].end else [{"file": MESH, "start": 5, "end": complete.levels[0].end}]
    assert taken == [max(cut, complete.levels[0].end), pending, [[complete.begin, complete.begin + 7], textures[1]]]
