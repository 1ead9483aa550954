"""Traces of connections and the simulated network: what connections carry, and when."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sending.network import Connection, Network
from sending.traces import Trace, burst_trace, cellular_trace, constant_trace, ramp_trace, read_trace, step_trace

from farfield.addon.core.errors import FileError

GENERATORS = {
    "step": step_trace,
    "ramp": ramp_trace,
    "burst": burst_trace,
    "3G": lambda rng, duration, rate: cellular_trace(rng, duration, 3, rate),
    "4G": lambda rng, duration, rate: cellular_trace(rng, duration, 4, rate),
}


@pytest.mark.parametrize("kind", GENERATORS)
def test_generated_traces_have_the_wanted_mean(kind):
    for seed in range(20):
        trace = GENERATORS[kind](np.random.default_rng(seed), 10.0, 2e5)
        assert trace.name == kind
        assert trace.mean_rate == pytest.approx(2e5)
        assert min(trace.rates) > 0.0
        assert list(trace.times) == sorted(trace.times)


def test_cellular_rates_vary_about_as_much_as_intended():
    def variation(generation: int) -> float:
        traces = [cellular_trace(np.random.default_rng(seed), 60.0, generation, 1e5) for seed in range(40)]
        return float(np.mean([np.std(trace.rates) / np.mean(trace.rates) for trace in traces]))

    assert 0.4 < variation(3) < 0.7
    assert 0.3 < variation(4) < 0.6


@given(st.integers(0, 1000), st.floats(0.0, 50.0))
@settings(deadline=None)
def test_bytes_are_the_integral_of_rates(seed, time):
    trace = burst_trace(np.random.default_rng(seed), 7.0, 1e5)
    total, now = 0.0, 0.0
    while now < time:
        rate, end = trace.rate(now)
        assert end > now
        total += rate * (min(end, time) - now)
        now = end
    assert trace.bytes_until(time) == pytest.approx(total, rel=1e-6, abs=1e-3)
    assert trace.time_of(trace.bytes_until(time)) == pytest.approx(time, abs=1e-6)


def test_files_of_rates_and_of_packets(tmp_path):
    (tmp_path / "rates.txt").write_text("# seconds, bytes per second\n0 1000\n1.5 2000\n3.0 500\n")
    assert read_trace(tmp_path / "rates.txt") == Trace("rates", (0.0, 1.5, 3.0), (1000.0, 2000.0, 500.0), 4.5)
    (tmp_path / "packets.txt").write_text("".join(f"{time}\n" for time in range(1000)))  # 1500 bytes per millisecond: 12 Mbit/s
    assert read_trace(tmp_path / "packets.txt").mean_rate == pytest.approx(1.5e6)


@pytest.mark.parametrize(
    "content", ["", "a b\n", "1 2 3\n", "0 1\n0 2\n", "1 5\n0 5\n", "0 -1\n", "0 0\n", "1e300\n", "0 nan\n", "1\n2 3\n"]
)
def test_other_files_are_refused(tmp_path, content):
    (tmp_path / "trace.txt").write_text(content)
    with pytest.raises(FileError, match="is not a trace"):
        read_trace(tmp_path / "trace.txt")


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(FileError, match="cannot be read"):
        read_trace(tmp_path / "none.txt")


def receive(network: Network, ids: set[int]) -> dict[int, float]:
    """When each of the responses ended or failed (negative)."""
    ends = {}
    received = dict.fromkeys(ids, 0)
    while set(ends) != ids and network.time < 100.0:
        event = network.advance()
        if event.id in ids:
            assert event.received >= received[event.id]
            received[event.id] = event.received
            if event.failed or event.received == 1000:
                ends[event.id] = -event.time if event.failed else event.time
    return ends


def test_response_takes_a_delay_and_its_bytes():
    network = Network((Connection(constant_trace(1000.0), 0.5, jitter=0.0, overhead=100),))
    network.send(7, 0, 1000)
    assert receive(network, {7})[7] == pytest.approx(0.5 + 1.1)


def test_responses_divide_a_line():
    network = Network((Connection(constant_trace(1000.0), 0.5, jitter=0.0, overhead=0),))
    network.send(1, 0, 1000)
    network.send(2, 0, 1000)
    assert receive(network, {1, 2}) == {1: pytest.approx(2.5), 2: pytest.approx(2.5)}


def test_servers_divide_the_access_line():
    connections = (Connection(constant_trace(1000.0), 0.5, jitter=0.0, overhead=0),) * 2
    network = Network(connections, access=constant_trace(500.0))
    network.send(1, 0, 1000)
    network.send(2, 1, 1000)
    assert receive(network, {1, 2}) == {1: pytest.approx(4.5), 2: pytest.approx(4.5)}


def test_server_that_is_down_fails_or_stops():
    network = Network((Connection(constant_trace(1000.0), 0.5, jitter=0.0, overhead=0, down=(1.0, 2.0)),))
    network.send(1, 0, 1000)
    assert receive(network, {1})[1] == pytest.approx(2.5)  # half a second before, the rest after
    network = Network((Connection(constant_trace(1000.0), 0.5, jitter=0.0, down=(0.0, 2.0)),))
    network.send(1, 0, 1000)
    assert receive(network, {1})[1] == pytest.approx(-0.5)


def test_lost_responses_never_end():
    network = Network((Connection(constant_trace(1000.0), 0.1, loss=1.0),))
    network.send(1, 0, 1000)
    assert receive(network, {1}) == {}


def test_there_is_a_tick_at_the_alarm():
    network = Network((Connection(constant_trace(1000.0)),), alarm=0.333)
    assert 0.333 in {network.advance().time for _ in range(12)}
