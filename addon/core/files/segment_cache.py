"""A cache of decoded parts of files that is limited in bytes."""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from threading import Lock
from typing import Protocol, TypeVar

from ..errors import FarfieldError

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
        array = self._find(key)
        if array is None:
            array = create()
            self._keep(key, array)
        return array

    def get_all(
        self, keys: Sequence[Hashable], create: Callable[[list[Hashable]], Sequence[Segment | FarfieldError]]
    ) -> list[Segment | FarfieldError]:
        """Return the arrays of keys, of which `create` returns those that are not kept, or errors instead."""
        found = {key: self._find(key) for key in keys}
        missing = [key for key, array in found.items() if array is None]
        if missing:
            created = dict(zip(missing, create(missing), strict=True))
            for key, array in created.items():
                if not isinstance(array, FarfieldError):
                    self._keep(key, array)
            found.update(created)
        return [found[key] for key in keys]

    def _find(self, key: Hashable) -> HasBytes | None:
        with self._lock:
            if key not in self._arrays:
                return None
            self._arrays.move_to_end(key)
            return self._arrays[key]

    def _keep(self, key: Hashable, array: HasBytes) -> None:
        with self._lock:
            if key not in self._arrays and array.nbytes <= self.max_bytes:
                self._arrays[key] = array
                self.byte_count += array.nbytes
                while self.byte_count > self.max_bytes:
                    self.byte_count -= self._arrays.popitem(last=False)[1].nbytes

    def touch(self, key: Hashable) -> int | None:
        """Keep an array as if it had just been used. Returns its bytes, None if it is not kept."""
        array = self._find(key)
        return None if array is None else array.nbytes
