"""A cache of decoded parts of files that is limited in bytes."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Protocol, TypeVar

DEFAULT_CACHE_BYTES = 64 << 20


class HasBytes(Protocol):
    """An array, or an object of several arrays. nbytes: of all of them."""

    @property
    def nbytes(self) -> int: ...


Segment = TypeVar("Segment", bound=HasBytes)


class SegmentCache:
    """Keeps the arrays that were used last, `max_bytes` of them at most. Several files and threads can share one."""

    def __init__(self, max_bytes: int = DEFAULT_CACHE_BYTES) -> None:
        self.max_bytes, self._lock = max_bytes, Lock()
        self._arrays: OrderedDict[Hashable, HasBytes] = OrderedDict()
        self.byte_count = 0

    def get(self, key: Hashable, create: Callable[[], Segment]) -> Segment:
        """Return the array of a key, which `create` returns if it is not kept. It must not be changed.

        Two threads that need the same array at the same time both create it. An array of more than `max_bytes` is not kept.
        """
        with self._lock:
            if key in self._arrays:
                self._arrays.move_to_end(key)
                return self._arrays[key]
        array = create()
        with self._lock:
            if key not in self._arrays and array.nbytes <= self.max_bytes:
                self._arrays[key] = array
                self.byte_count += array.nbytes
                while self.byte_count > self.max_bytes:
                    self.byte_count -= self._arrays.popitem(last=False)[1].nbytes
        return array

    def touch(self, key: Hashable) -> int | None:
        """Keep an array as if it had just been used. Returns its bytes, None if it is not kept."""
        with self._lock:
            if key not in self._arrays:
                return None
            self._arrays.move_to_end(key)
            return self._arrays[key].nbytes
