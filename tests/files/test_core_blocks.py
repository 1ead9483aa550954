"""Files of blocks: what was written comes back, and a changed byte anywhere is found."""

import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.errors import FileError
from farfield.addon.core.files.blocks import CHECKSUM, HEADER, HEADER_SIZE, BlockReader, BlockWriter

BLOCKS = [b"first", b"", bytes(range(200)), b"\0" * 17]


def write(path, blocks, kind="TEST"):
    with BlockWriter(path, kind) as writer:
        assert [writer.append(block) for block in blocks] == list(range(len(blocks)))
        writer.finish()


@pytest.fixture
def path(tmp_path):
    write(tmp_path / "data.blocks", BLOCKS)
    return tmp_path / "data.blocks"


def test_blocks_come_back(path):
    with BlockReader(path, "TEST") as reader:
        assert len(reader) == len(BLOCKS)
        assert [reader.read(number, "block") for number in range(len(reader))] == BLOCKS
        assert reader.sizes.tolist() == [len(block) for block in BLOCKS]
        assert list(reader.verify()) == []


@given(blocks=st.lists(st.binary(max_size=50), max_size=20))
def test_any_blocks_come_back(tmp_path_factory, blocks):
    path = tmp_path_factory.mktemp("blocks") / "data.blocks"
    write(path, blocks)
    with BlockReader(path, "TEST") as reader:
        assert [reader.read(number, "block") for number in range(len(reader))] == blocks


def test_a_flipped_bit_of_any_byte_is_found(path):
    content = path.read_bytes()
    ends = [HEADER_SIZE]
    for block in BLOCKS:
        ends.append(ends[-1] + len(block))
    for place in range(len(content)):
        changed = bytearray(content)
        changed[place] ^= 1 << place % 8
        path.write_bytes(changed)
        if not ends[0] <= place < ends[-1]:
            with pytest.raises(FileError, match=r"data\.blocks"):
                BlockReader(path, "TEST")
            continue
        damaged = next(number for number in range(len(BLOCKS)) if place < ends[number + 1])
        with BlockReader(path, "TEST") as reader:
            assert list(reader.verify()) == [damaged]
            with pytest.raises(FileError, match=r"The patch 7 in .*data\.blocks"):
                reader.read(damaged, "patch 7")
            assert [reader.read(number, "") for number in range(len(BLOCKS)) if number != damaged] == [
                block for number, block in enumerate(BLOCKS) if number != damaged
            ]


def test_a_flipped_bit_anywhere_costs_one_block_at_most_with_a_backup_of_the_index(tmp_path):
    path, backup = tmp_path / "data.blocks", tmp_path / "data-backup.blocks"
    with BlockWriter(path, "TEST") as writer:
        for block in BLOCKS:
            writer.append(block)
        writer.finish(backs_up_index=True)
    for file in (path, backup):
        content = file.read_bytes()
        for place in range(len(content)):
            file.write_bytes(content[:place] + bytes([content[place] ^ 1 << place % 8]) + content[place + 1 :])
            with BlockReader(path, "TEST", has_backup=True) as reader:
                damaged = list(reader.verify())
                assert [damage.path for damage in reader.damages] + damaged in ([path], [backup], *([n] for n in range(len(BLOCKS))))
                for number in set(range(len(BLOCKS))) - set(damaged):
                    assert reader.read(number, "") == BLOCKS[number]
        file.write_bytes(content)
    path.write_bytes(content[:HEADER_SIZE] + BLOCKS[0])  # truncated within the blocks
    with BlockReader(path, "TEST", has_backup=True) as reader:
        assert list(reader.verify()) == [2, 3] and reader.read(0, "") == BLOCKS[0]
    path.write_bytes(b"")
    with pytest.raises(FileError, match="empty"):
        BlockReader(path, "TEST", has_backup=True)


def test_a_file_of_any_other_length_is_refused(path):
    content = path.read_bytes()
    for size in range(len(content)):
        path.write_bytes(content[:size])
        with pytest.raises(FileError, match=r"data\.blocks"):
            BlockReader(path, "TEST")
    path.write_bytes(content + b"\0")
    with pytest.raises(FileError, match="truncated or damaged"):
        BlockReader(path, "TEST")


def test_an_unfinished_file_is_refused(tmp_path):
    with BlockWriter(tmp_path / "data.blocks", "TEST") as writer:
        writer.append(b"block")
    with pytest.raises(FileError, match="not written to its end"):
        BlockReader(tmp_path / "data.blocks", "TEST")


def test_a_newer_version_is_refused(path):
    content = bytearray(path.read_bytes())
    content[8] = 2
    content[HEADER.size : HEADER_SIZE] = CHECKSUM.pack(zlib.crc32(content[: HEADER.size]))
    path.write_bytes(content)
    with pytest.raises(FileError, match="newer Farfield"):
        BlockReader(path, "TEST")


def test_blocks_of_another_kind_are_refused(path):
    with pytest.raises(FileError, match='holds "TEST" instead of "PATCHES"'):
        BlockReader(path, "PATCHES")


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(FileError):
            BlockReader(path, "TEST")
    with pytest.raises(FileError, match="Cannot write"):
        BlockWriter(tmp_path, "TEST")
