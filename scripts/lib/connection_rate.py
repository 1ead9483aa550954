"""A connection of limited rate, to see how a package loads over a network: its bytes per second, constant or by a trace, and its
latency."""

import asyncio
import re
from dataclasses import dataclass

from lib import environment

environment.import_farfield()

from farfield.addon.core.errors import SettingsError

UNITS = {"bit": 0.125, "kbit": 125.0, "mbit": 125e3, "gbit": 125e6, "b": 1.0, "kb": 1e3, "mb": 1e6, "gb": 1e9}  # bytes per second
RATE = re.compile(r"(\d+(?:\.\d+)?) ?([kmg]?(?:bit|b))(?:/s)?", re.IGNORECASE | re.ASCII)
PART_SECONDS = 0.02  # that a part of a response takes on the connection, so that bytes trickle as in a network
MIN_PART_BYTES, MAX_PART_BYTES = 512, 2**16


def parse_rate(text: str) -> float:
    """Return the bytes per second of a rate such as "2Mbit", "350 kbit/s" or "1.5MB".

    Raises:
        SettingsError: the text is no rate.
    """
    match = RATE.fullmatch(text.strip())
    if match is None or float(match[1]) <= 0.0:
        raise SettingsError(f'The rate is "{text}"; write a number above 0 and kbit, Mbit, kB or MB, such as 2Mbit.')
    return float(match[1]) * UNITS[match[2].lower()]


@dataclass(frozen=True)
class ConnectionRate:
    """A connection. steps: seconds and bytes per second, one after the other, from the first byte on; the last rate stays. latency: seconds
    before each response."""

    steps: tuple[tuple[float, float], ...]
    latency: float = 0.0

    def __post_init__(self) -> None:
        if not self.steps or self.steps[-1][1] <= 0.0 or any(seconds < 0.0 or rate < 0.0 for seconds, rate in self.steps):
            raise SettingsError("The rates of the connection must be at least 0 bytes per second, and the last one above 0.")

    def arrival(self, start: float, size: int) -> float:
        """Return when `size` bytes that the connection begins to carry at `start` have arrived, in seconds after the first byte."""
        left, position, end = float(size), start, 0.0
        for seconds, rate in self.steps[:-1]:
            end += seconds
            if position < end:
                carried = (end - position) * rate
                if carried >= left:
                    return position + left / rate if left > 0.0 else position
                left -= carried
                position = end
        return position + left / self.steps[-1][1]

    def rate_at(self, position: float) -> float:
        """Return the bytes per second at `position`, in seconds after the first byte."""
        for seconds, rate in self.steps[:-1]:
            if position < seconds:
                return rate
            position -= seconds
        return self.steps[-1][1]


class Throttle:
    """Shares a connection between all responses of a server, in the order in which they ask for it."""

    def __init__(self, connection: ConnectionRate | None) -> None:
        self._connection = connection
        self._first = self._free = -1.0

    async def begin(self) -> None:
        """Wait for the latency of the connection."""
        if self._connection is not None and self._connection.latency > 0.0:
            await asyncio.sleep(self._connection.latency)

    def part_size(self) -> int:
        """Return the bytes to send at once."""
        if self._connection is None:
            return MAX_PART_BYTES
        return int(min(max(self._connection.rate_at(max(self._free, 0.0)) * PART_SECONDS, MIN_PART_BYTES), MAX_PART_BYTES))

    async def carry(self, size: int) -> None:
        """Wait until the connection has carried `size` more bytes."""
        if self._connection is None:
            return
        now = asyncio.get_running_loop().time()
        if self._first < 0.0:
            self._first = now
        self._free = self._connection.arrival(max(now - self._first, self._free), size)
        await asyncio.sleep(max(self._first + self._free - now, 0.0))
