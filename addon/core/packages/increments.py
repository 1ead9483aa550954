"""The table of increments of a package's textures.

An increment is a tile of the pyramid of a texture: the payload of an AVIF file, whose header tiles share, see `textures.avif_files`. It
shows its part of the texture by itself, and replaces earlier increments there. Each is in a few successive states of all textures, of
which later ones are better, see `textures.tile_states`. Increments stand in textures.bin one after the other, by the first of their states.

The table is raw DEFLATE of byte planes: for each of FIELDS the lowest byte of all increments, then the next one.
The checksums are the CRC-32 of each increment, uint32 little-endian, not compressed.
"""

import zlib
from dataclasses import dataclass

import numpy as np

from ..errors import FileError
from .manifest import TEXTURES, Manifest

FIELDS = {"textures": 1, "tiles": 2, "headers": 1, "sizes": 4, "firsts": 1, "lasts": 1}  # bytes of each, in the order of the file
ROW_BYTES = sum(FIELDS.values())


@dataclass(frozen=True, eq=False)
class Increments:
    """N increments in the order of the file.

    Attributes:
        textures: (N,) int64.
        tiles: (N,) int64, numbers in the pyramid of the texture, see `TilePyramid`.
        headers: (N,) int64, the header of the tile, of those of its texture.
        sizes: (N,) int64, bytes.
        firsts, lasts: (N,) int64, the first and the last state that have it.
    """

    textures: np.ndarray
    tiles: np.ndarray
    headers: np.ndarray
    sizes: np.ndarray
    firsts: np.ndarray
    lasts: np.ndarray

    @property
    def state_count(self) -> int:
        """The number of states, 0 without increments."""
        return int(self.lasts.max(initial=-1)) + 1

    def are_in(self, state: int) -> np.ndarray:
        """Return which increments a state consists of, (N,) bool."""
        return (self.firsts <= state) & (state <= self.lasts)

    def measure_states(self, count: int) -> list[int]:
        """Return the bytes of each of `count` states."""
        return [int(self.sizes[self.are_in(state)].sum()) for state in range(count)]

    def split(self, content: bytes | memoryview) -> list[memoryview]:
        """Return the bytes of each increment. content: those of all, one after the other."""
        view, ends = memoryview(content), np.cumsum(self.sizes).tolist()
        return [view[end - size : end] for end, size in zip(ends, self.sizes.tolist(), strict=True)]

    def compute_checksums(self, content: bytes | memoryview) -> np.ndarray:
        """Return the CRC-32 (N,) uint32, little-endian, of each increment. content: see `split`."""
        return np.array([zlib.crc32(part) for part in self.split(content)], "<u4")


def encode_increments(increments: Increments) -> bytes:
    """Return the table, compressed."""
    planes = []
    for name, width in FIELDS.items():
        planes.append(np.ascontiguousarray(getattr(increments, name).astype("<u8")[:, None].view(np.uint8)[:, :width].T).tobytes())
    coder = zlib.compressobj(9, zlib.DEFLATED, -15)
    return coder.compress(b"".join(planes)) + coder.flush()


def decode_increments(content: bytes | memoryview, manifest: Manifest) -> Increments:
    """Return the table in the section `manifest.increments` whose bytes are `content`.

    Raises:
        FileError: it is damaged, has another length than the manifest says, or refers to textures, tiles, states or bytes that do not
            exist.
    """
    count = manifest.increment_count
    try:
        decoder = zlib.decompressobj(-15)
        table = decoder.decompress(content, ROW_BYTES * count + 1)
    except zlib.error as error:
        raise _damage() from error
    if len(table) != ROW_BYTES * count or decoder.unconsumed_tail:
        raise _damage()
    fields, offset = {}, 0
    for name, width in FIELDS.items():
        planes = np.frombuffer(table, np.uint8, width * count, offset).reshape(width, count)
        padded = np.zeros((count, 8), np.uint8)
        padded[:, :width] = planes.T
        fields[name] = padded.view("<u8")[:, 0].astype(np.int64)
        offset += width * count
    increments = Increments(**fields)
    _check(increments, manifest)
    return increments


def _check(increments: Increments, manifest: Manifest) -> None:
    tile_counts = np.array([texture.tile_count for texture in manifest.textures], np.int64)
    header_counts = np.array([len(texture.headers) for texture in manifest.textures], np.int64)
    if len(increments.tiles) and (len(tile_counts) == 0 or increments.textures.max() >= len(tile_counts)):
        raise _damage()
    if (increments.tiles >= tile_counts[increments.textures]).any() or (increments.headers >= header_counts[increments.textures]).any():
        raise _damage()
    if (np.diff(increments.firsts) < 0).any() or (increments.firsts > increments.lasts).any() or (increments.sizes < 1).any():
        raise _damage()
    if len(increments.tiles) and set(increments.firsts.tolist()) != set(range(max(manifest.state_count, increments.state_count))):
        raise _damage()  # each state adds some
    if manifest.first_increment + int(increments.sizes.sum()) != manifest.files[TEXTURES][0]:
        raise _damage()


def _damage() -> FileError:
    return FileError("The table of increments of the package is damaged; export the package again, or copy it again.")
