"""Truncated files are detected at every length."""

import os
import struct
import zlib

import pytest

from farfield.addon.core.files.complete_files import is_complete_blend, is_complete_png

FRAMES = [b"\x28\xb5\x2f\xfd" + bytes([index]) * (50 + index) for index in range(4)]


def seekable_zstd(frames, table_of=None, checksums=False):
    """A file of compressed frames with a seek table, as Blender writes it (Zstandard seekable format)."""
    table_of = frames if table_of is None else table_of
    entries = b"".join(struct.pack("<II", len(frame), 1000) + bytes(4 * checksums) for frame in table_of)
    footer = struct.pack("<IBI", len(table_of), 0x80 * checksums, 0x8F92EAB1)
    return b"".join(frames) + struct.pack("<II", 0x184D2A5E, len(entries) + len(footer)) + entries + footer


def png():
    chunk = b"IHDR" + struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0)
    parts = [chunk, b"IDAT" + zlib.compress(b"\0\0"), b"IEND"]
    return b"\x89PNG\r\n\x1a\n" + b"".join(struct.pack(">I", len(part) - 4) + part + struct.pack(">I", zlib.crc32(part)) for part in parts)


BLENDS = {
    "compressed": seekable_zstd(FRAMES),
    "with checksums": seekable_zstd(FRAMES, checksums=True),
    "4.5": b"BLENDER-v405REND" + b"x" * 200 + b"ENDB" + bytes(20),
    "5.0": b"BLENDER17-01v0500REND" + b"x" * 200 + b"ENDB" + bytes(28),
}


@pytest.mark.parametrize(
    ("content", "is_complete"),
    [*((content, is_complete_blend) for content in BLENDS.values()), (png(), is_complete_png)],
    ids=[*BLENDS, "png"],
)
def test_every_truncated_length(content, is_complete, tmp_path):
    path = tmp_path / "file"
    path.write_bytes(content)
    assert is_complete(path)
    for size in reversed(range(len(content))):
        os.truncate(path, size)
        assert not is_complete(path)


@pytest.mark.parametrize(
    "content", [seekable_zstd(FRAMES[:3], FRAMES), seekable_zstd(FRAMES[:1] + [FRAMES[1][:9]] + FRAMES[2:], FRAMES), b"JSON"]
)
def test_frames_that_are_missing_before_the_end(content, tmp_path):
    (tmp_path / "a.blend").write_bytes(content)
    assert not is_complete_blend(tmp_path / "a.blend")
