"""Rice codes alone: integers come back, and their bytes are those that are documented."""

from itertools import chain

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.bdam.store.rice_codes import CHUNK, RiceReader, encode_integers, to_signed, to_unsigned
from farfield.addon.core.errors import FileError

VALUES = st.lists(st.integers(0, 2**33) | st.integers(0, 9) | st.just(0), max_size=3 * CHUNK)


@given(groups=st.lists(st.lists(VALUES, min_size=3, max_size=3), min_size=1, max_size=4), start=st.integers(0, 3))
def test_integers_of_several_blocks_come_back(groups, start):
    streams = [np.array(list(chain(*streams)), np.int64) for streams in zip(*groups, strict=True)]
    counts = np.array([[len(stream) for stream in streams] for streams in groups])
    blocks = [bytes(start) + group for group in encode_integers(streams, counts)]
    reader = RiceReader([block + b"\xff" for block in blocks], start)
    decoded = reader.read(counts)
    assert [values.tolist() for values in decoded] == [stream.tolist() for stream in streams]
    assert reader.find_bytes() == [len(block) for block in blocks]
    for size in range(start, len(blocks[0])):
        with pytest.raises(FileError, match="shorter"):
            RiceReader([blocks[0][:size], *blocks[1:]], start).read(counts)


def test_known_integers_have_the_documented_bits():
    (block,) = encode_integers([np.array([0, 0, 0]), np.array([4, 5, 7, 6, 9])], np.array([[3, 5]]))
    assert block[:2] == bytes([0b01011111, 0b0]), "k is 31 for zeros, and 2"
    assert block[2:4] == bytes([0b10101010, 0b100]), "quotients 1, 1, 1, 1, 2"
    assert block[4:] == bytes([0b10010110, 0b1]), "lowest bits 0, 1, 1, 0, 1, then the second ones 0, 0, 1, 1, 0"


def encode(values) -> bytes:
    """The group of one stream of one block."""
    (group,) = encode_integers([values], np.array([[len(values)]]))
    return group


def test_flat_ground_takes_nothing_but_its_keys_and_a_step_in_it_little():
    flat = np.zeros(50 * CHUNK, np.int64)
    assert len(encode(flat)) == 32
    flat[CHUNK] = 4000
    assert len(encode(flat)) < 100


@given(values=st.lists(st.integers(-(2**32), 2**32 - 1)))
def test_signed_integers_come_back(values):
    unsigned = to_unsigned(np.array(values, np.int64))
    assert (unsigned >= 0).all() and (unsigned >> 1 <= np.abs(np.array(values, np.int64))).all()
    assert to_signed(unsigned).tolist() == values
