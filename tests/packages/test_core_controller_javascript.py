"""The page's controller decides like the one in Python, bit for bit."""

import dataclasses
import json
import shutil
import subprocess
from pathlib import Path

import pytest
from reference import controller, streaming_servers
from reference.streaming_state import State, TransferPlan
from streaming_scenarios import Exchange, hide_table, random_exchange

from farfield.addon.core.packages.planning import ErrorModel
from lib import environment

pytestmark = pytest.mark.once
PAGE = environment.ROOT / "addon" / "core" / "packages" / "page" / "controller.js"
RUNNER = """
import { readFileSync } from "node:fs";
const { addTable, begin, decide, estimateRate, isFinished, meanDifference, receivedLevel } = await import(process.argv[2]);
const results = JSON.parse(readFileSync(process.argv[3])).map(({ plan, table, settings, events }) => {
  const complete = addTable(plan, table);
  let state = begin(plan, settings);
  return events.map(([isKnown, event]) => {
    const known = isKnown ? complete : plan;
    const [next, requests, aborted] = decide(known, state, event);
    state = next;
    const counts = [receivedLevel(known, state), state.mesh, state.requested.flat()];
    const figures = [...counts, Number(isFinished(known, state))];
    const rates = state.servers.map((_, index) => estimateRate(state, index, 1.5));
    return [requests, aborted, figures, rates, state.servers.map((server) => server.delay), meanDifference(state), state.ended];
  });
});
process.stdout.write(JSON.stringify(results));
"""


def encode_vector(seed: int) -> tuple[dict, list]:
    """A scenario as the page gets it, and all decisions and figures of the controller in Python."""
    exchange = random_exchange(seed)
    first = exchange.initial
    settings = {"limit": first.limit, "rate": exchange.rate or 0, "servers": len(first.servers)}
    settings |= {"patience": first.patience, "keepsRefining": first.keeps_refining}
    events = [[has_table, dataclasses.asdict(event)] for has_table, event in exchange.events]
    plan = dataclasses.asdict(hide_table(exchange.plan))
    return {"plan": plan, "table": list_increments(exchange.plan), "settings": settings, "events": events}, replay(exchange)


def list_increments(plan: TransferPlan) -> dict[str, list[int]]:
    """The table of increments of a plan."""
    starts = (plan.begin, *plan.ends)[:-1] if plan.ends else ()
    found = [[index for index, state in enumerate(plan.states) if any(a <= start < b for a, b in state)] for start in starts]
    sizes = [end - start for start, end in zip(starts, plan.ends, strict=True)]
    return {"sizes": sizes, "firsts": [states[0] for states in found], "lasts": [states[-1] for states in found]}


def replay(exchange: Exchange) -> list:
    """Decisions and figures after each event, as JSON has them."""
    state, results = exchange.initial, []
    for has_table, event in exchange.events:
        plan = exchange.plan if has_table else hide_table(exchange.plan)
        state, requests, aborted = controller.decide(plan, state, event)
        sent = [{"id": request.id, "server": request.server, **dataclasses.asdict(request.span)} for request in requests]
        results.append([sent, aborted, *figures(plan, state)])
    return results


def figures(plan: TransferPlan, state: State) -> list:
    counts = [controller.received_level(plan, state), state.mesh, [offset for interval in state.requested for offset in interval]]
    rates = [streaming_servers.estimate_rate(state, index, 1.5) for index in range(len(state.servers))]
    delays = [server.delay for server in state.servers]
    return [[*counts, int(controller.is_finished(plan, state))], rates, delays, controller.mean_difference(state), state.ended]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed, so the page's controller is not compared")
@pytest.mark.parametrize("seeds", [range(15), pytest.param(range(15, 120), marks=pytest.mark.exhaustive)])
def test_page_decides_like_python(tmp_path: Path, seeds: range):
    vectors, expected = zip(*(encode_vector(seed) for seed in seeds), strict=True)
    (tmp_path / "vectors.json").write_text(json.dumps(vectors))
    (tmp_path / "runner.mjs").write_text(RUNNER)
    command = ["node", str(tmp_path / "runner.mjs"), PAGE.as_uri(), str(tmp_path / "vectors.json")]
    found = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    assert len({len(vector["plan"]["errors"][0]) for vector in vectors}) > 5, "few numbers of states"
    for seed, ours, theirs in zip(seeds, expected, found, strict=True):
        for index, (one, other) in enumerate(zip(ours, theirs, strict=True)):
            assert json.loads(json.dumps(one)) == other, f"seed {seed}, event {index}"
    kinds = {len(decision[0]) for decisions in expected for decision in decisions}
    assert {0, 1, 2} <= kinds
    assert any(decision[1] for decisions in expected for decision in decisions), "no request was aborted"
    assert any(decision[2][1] > 1 for decisions in expected for decision in decisions), "no level was chosen"


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed, so the page's plan is not compared")
def test_page_predicts_errors_like_python(tmp_path: Path):
    model = ErrorModel((0.31, 0.12, 0.0), (0.55, 0.2, 0.04, 0.0), 2.7)
    level = {key: [0, 9, 0] for key in ("positions", "parents", "wedges", "uvs", "corners")}
    manifest = {
        "levels": [level] * 3,
        "increments": [0, 9, 0],
        "increment_count": 4,
        "errors": dataclasses.asdict(model),
        "first_increment": 9,
    }
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    (tmp_path / "runner.mjs").write_text("""
import { readFileSync } from "node:fs";
const { buildPlan } = await import(process.argv[2]);
process.stdout.write(JSON.stringify(buildPlan(JSON.parse(readFileSync(process.argv[3]))).errors));
""")
    command = ["node", str(tmp_path / "runner.mjs"), PAGE.as_uri(), str(tmp_path / "manifest.json")]
    found = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    for ours, theirs in zip(model.tabulate(), found, strict=True):
        assert theirs == pytest.approx(ours, rel=1e-12)
