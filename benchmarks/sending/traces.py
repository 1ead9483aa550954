"""Traces of connections: the rate of a connection over time, generated or read from a file."""

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from farfield.addon.core.errors import FileError

PACKET_BYTES = 1500  # Bytes of one line of a file of Mahimahi.
PACKET_INTERVAL = 0.1  # seconds over which packets are averaged
MAX_TRACE_BYTES = 64 * 2**20
MAX_TRACE_SECONDS = 86400.0
STEP = 0.1  # seconds between two rates of generated cellular connections
MEGABIT = 125000.0  # bytes


@dataclass(frozen=True)
class Trace:
    """The rate of a connection.

    name: of the trace. times: seconds, ascending from 0. rates: bytes per second from each time to the next one. duration: seconds, after
    which it begins again; at least one rate is positive.
    """

    name: str
    times: tuple[float, ...]
    rates: tuple[float, ...]
    duration: float

    @cached_property
    def mean_rate(self) -> float:
        """Bytes per second."""
        return self._sums[-1] / self.duration

    @cached_property
    def _sums(self) -> tuple[float, ...]:
        """Bytes up to each time, and up to the end."""
        return tuple(np.concatenate([[0.0], np.cumsum(np.diff([*self.times, self.duration]) * self.rates)]).tolist())

    def rate(self, time: float) -> tuple[float, float]:
        """Return the rate at `time`, bytes per second, and until when it holds, seconds."""
        rounds, rest = divmod(time, self.duration)
        index = bisect_right(self.times, rest) - 1
        begin = rounds * self.duration
        end = begin + (self.times[index + 1] if index + 1 < len(self.times) else self.duration)
        return self.rates[index], max(end, math.nextafter(time, math.inf))

    def bytes_until(self, time: float) -> float:
        """Return how many bytes the connection carries from 0 to `time`."""
        rounds, rest = divmod(time, self.duration)
        index = bisect_right(self.times, rest) - 1
        return rounds * self._sums[-1] + self._sums[index] + (rest - self.times[index]) * self.rates[index]

    def time_of(self, byte_count: float) -> float:
        """Return when the connection has carried `byte_count` bytes since 0."""
        rounds, rest = divmod(byte_count, self._sums[-1])
        index = min(bisect_left(self._sums, rest), len(self.rates)) - 1
        if rest <= 0.0:
            return rounds * self.duration
        return rounds * self.duration + self.times[index] + (rest - self._sums[index]) / self.rates[index]


def constant_trace(rate: float) -> Trace:
    """Return a connection that always carries `rate` bytes per second."""
    return Trace("constant", (0.0,), (rate,), 1e6)


def step_trace(rng: np.random.Generator, duration: float, rate: float) -> Trace:
    """Return a connection around `rate` bytes per second that changes to another rate, 0.25 to 4 times as large, one to three times."""
    count = int(rng.integers(1, 4))
    times = np.concatenate([[0.0], np.sort(rng.uniform(0.05, 0.95, count)) * duration])
    return _normalized("step", times, 4.0 ** rng.uniform(-0.5, 0.5, count + 1), duration, rate)


def ramp_trace(rng: np.random.Generator, duration: float, rate: float) -> Trace:
    """Return a connection whose rate rises or falls linearly, up to 6 times as large at one end as at the other."""
    factor = rng.uniform(1.5, 6.0)
    times = np.arange(0.0, duration, STEP / 2.0)
    rates = 1.0 + (factor - 1.0) * times / duration
    return _normalized("ramp", times, rates[::-1] if rng.random() < 0.5 else rates, duration, rate)


def burst_trace(rng: np.random.Generator, duration: float, rate: float) -> Trace:
    """Return a connection on which others send for 0.2 to 1 s now and then: its rate falls to 10 to 50 % meanwhile."""
    times, rates, time = [0.0], [1.0], 0.0
    while True:
        time += rng.exponential(1.5) + 0.1
        length = rng.uniform(0.2, 1.0)
        if time + length >= duration:
            return _normalized("burst", np.array(times), np.array(rates), duration, rate)
        times += [time, time + length]
        rates += [rng.uniform(0.1, 0.5), 1.0]
        time += length


def cellular_trace(rng: np.random.Generator, duration: float, generation: int, rate: float) -> Trace:
    """Return a connection like that of a moving phone: a Markov-modulated rate with fades.

    The mean of the logarithm of the rate jumps between states that last seconds; around it the rate is a first-order autoregressive
    process; fades to a few percent come on average every 12 s and last 0.3 to 1.5 s. Variation is chosen after what is reported for
    commutes with HSDPA (Riiser et al., MMSys 2013) and LTE (van der Hooft et al., IEEE Communications Letters 2016): the standard deviation
    is about half the mean for 3G (`generation` 3), and 0.4 of it for 4G, which varies faster. The numbers here are ours, not fitted to
    their logs.
    """
    spread, stay, memory, noise = (0.45, 4.0, 0.90, 0.12) if generation == 3 else (0.35, 2.5, 0.80, 0.15)
    count = max(math.ceil(duration / STEP), 1)
    rates = np.empty(count)
    state, deviation, fading = rng.normal(0.0, spread), 0.0, 0
    for index in range(count):
        if rng.random() < STEP / stay:
            state = rng.normal(0.0, spread)
        deviation = memory * deviation + noise * rng.normal()
        if fading == 0 and rng.random() < STEP / 12.0:
            fading = int(rng.integers(3, 16))
        rates[index] = math.exp(state + deviation) * (rng.uniform(0.02, 0.1) if fading else 1.0)
        fading = max(fading - 1, 0)
    return _normalized(f"{generation}G", np.arange(count) * STEP, rates, count * STEP, rate)


def read_trace(path: Path) -> Trace:
    """Return the trace in a text file: lines of two numbers, seconds and bytes per second from then on; or, as Mahimahi writes them,
    lines of one number, the milliseconds at which the connection carries one packet of 1500 bytes.

    Raises:
        FileError: it cannot be read, or is not such a file.
    """
    try:
        if path.stat().st_size > MAX_TRACE_BYTES:
            raise _damage(path)
        rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip() and not line.startswith("#")]
        numbers = np.array([[float(word) for word in row] for row in rows])
    except OSError as error:
        raise FileError(f'"{path}" cannot be read ({error.strerror or error}); choose a file with a trace.') from error
    except ValueError as error:
        raise _damage(path) from error
    if numbers.ndim != 2 or numbers.shape[1] not in (1, 2) or not np.isfinite(numbers).all() or (numbers < 0.0).any():
        raise _damage(path)
    times, rates = (numbers[:, 0] / 1000.0, None) if numbers.shape[1] == 1 else (numbers[:, 0] - numbers[0, 0], numbers[:, 1])
    if (np.diff(times) < 0.0).any() or times[-1] > MAX_TRACE_SECONDS:
        raise _damage(path)
    if rates is None:
        times, rates = _count_packets(times)
    if not (rates > 0.0).any() or (np.diff(times) <= 0.0).any():
        raise _damage(path)
    last = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
    return Trace(path.stem, tuple(times.tolist()), tuple(rates.tolist()), float(times[-1]) + last)


def _count_packets(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    counts = np.bincount((times / PACKET_INTERVAL).astype(np.int64), minlength=1)
    return np.arange(len(counts)) * PACKET_INTERVAL, counts * PACKET_BYTES / PACKET_INTERVAL


def _normalized(name: str, times: np.ndarray, factors: np.ndarray, duration: float, rate: float) -> Trace:
    mean = float((np.diff([*times, duration]) * factors).sum()) / duration
    return Trace(name, tuple(times.tolist()), tuple((factors * rate / mean).tolist()), duration)


def _damage(path: Path) -> FileError:
    return FileError(
        f'"{path}" is not a trace; write one line per change with seconds and bytes per second, or one with milliseconds per packet.'
    )
