"""Numbers and texts from the bytes of a file, little-endian."""

import struct


class BinaryReader:
    """Reads from `data`, beginning at byte `position`; struct.error or ValueError at its end."""

    def __init__(self, data: bytes, position: int = 0) -> None:
        """Read nothing yet."""
        self._bytes = data
        self._position = position

    def read(self, layout: str) -> tuple:
        """Read the numbers of a `layout` of the module `struct`."""
        values = struct.unpack_from("<" + layout, self._bytes, self._position)
        self._position += struct.calcsize("<" + layout)
        return values

    def read_count(self, item_bytes: int) -> int:
        """Read the number, 64 bits, of items that follow, of at least `item_bytes` bytes each. Raises ValueError if the file is shorter."""
        (count,) = self.read("Q")
        if count * item_bytes > len(self._bytes) - self._position:
            raise ValueError("more items than bytes")
        return count

    def read_text(self) -> str:
        """Read a text in UTF-8 up to its zero byte."""
        end = self._bytes.index(b"\0", self._position)
        text = self._bytes[self._position : end].decode("utf-8")
        self._position = end + 1
        return text

    def read_counted_text(self) -> str:
        """Read a text in UTF-8 after the number of its bytes."""
        count = self.read_count(1)
        text = self._bytes[self._position : self._position + count].decode("utf-8")
        self._position += count
        return text

    def skip(self, count: int) -> None:
        """Skip `count` bytes."""
        self._position += count
