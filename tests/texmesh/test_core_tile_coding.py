"""Tiles as progressive JPEG files: the coder agrees with the library's decoder, whatever the coefficients and the order of scans."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.fft import idct

from farfield.addon.core.errors import FileError
from farfield.addon.core.texmesh.streaming.textures.dct_blocks import (
    RGB_OF_YCC,
    ZIGZAG,
    quantize,
    standard_steps,
    transform_tiles,
    zigzag_order,
)
from farfield.addon.core.texmesh.streaming.textures.huffman import MAX_LENGTH, build_table, pack_bits
from farfield.addon.core.texmesh.streaming.textures.progressive_files import EOI, check_increment, decode_tile, join_scans, split_scans
from farfield.addon.core.texmesh.streaming.textures.scan_symbols import RAW, RUN_OF_ZEROS, list_ac_corrections, list_ac_symbols
from farfield.addon.core.texmesh.streaming.textures.tile_coding import (
    build_tables,
    code_scan,
    find_first_shifts,
    list_scans,
    write_header,
)


def make_tiles(seed: int, count: int, side: int, detail: float) -> np.ndarray:
    generator = np.random.default_rng(seed)
    y, x = np.mgrid[:side, :side] / side
    smooth = 128.0 + 60.0 * np.sin(3.0 * x + generator.uniform(0, 6, (count, 1, 1)))[..., None] * generator.uniform(0.2, 1.0, 3)
    smooth[:, :, : side // 2] += 20.0 * (y[:, : side // 2, None] > 0.4)
    return np.clip(smooth + detail * generator.normal(size=(count, side, side, 3)), 0, 255).astype(np.uint8)


def code_tiles(tiles: np.ndarray, quality: int, components: int = 3) -> tuple[bytes, list[list[bytes]], np.ndarray, np.ndarray]:
    steps = standard_steps(quality, components)
    quantized = quantize(transform_tiles(tiles, components), np.repeat(steps[:, None], len(tiles), axis=1))
    scans = list_scans(components)
    tables = build_tables(quantized, np.abs(quantized).max(axis=(1, 2)), scans)
    tops = find_first_shifts(quantized, scans)
    parts = [code_scan(quantized, scan, top, tables) for scan, top in zip(scans, tops, strict=True)]
    return write_header(tiles.shape[1], steps, tables), [list(row) for row in zip(*parts, strict=True)], quantized, steps


def reconstruct(quantized: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return pixels (N, S, S, 3) of complete coefficients."""
    values = np.zeros(quantized.shape, np.float64)
    values[..., ZIGZAG] = quantized * steps[:, None, None]
    components, count, blocks = values.shape[:3]
    side = round(blocks**0.5)
    pixels = idct(idct(values.reshape(components, count, side, side, 8, 8), axis=-1, norm="ortho"), axis=-2, norm="ortho")
    pixels = pixels.transpose(1, 2, 4, 3, 5, 0).reshape(count, 8 * side, 8 * side, components)
    pixels[..., 0] += 128.0
    if components == 1:
        return np.repeat(pixels, 3, axis=-1)
    return np.clip(pixels, [0, -128, -128], [255, 127, 127]) @ RGB_OF_YCC.T


@settings(deadline=None, max_examples=12)
@given(
    st.integers(0, 99), st.integers(1, 4), st.sampled_from([16, 24, 64]), st.floats(0.0, 60.0), st.integers(1, 98), st.sampled_from([1, 3])
)
def test_library_decodes_what_was_coded(seed, count, side, detail, quality, components):
    header, contents, quantized, steps = code_tiles(make_tiles(seed, count, side, detail), quality, components)
    expected = np.clip(np.rint(reconstruct(quantized, steps)), 0, 255)
    for scans, pixels in zip(contents, expected, strict=True):
        found = decode_tile(header, scans)[::-1]
        # Where a band is missing since it is zero, decoders smooth steps between blocks.
        if all(scans[index] or scans[index + 1] for index in range(1, len(scans), 2)):
            assert np.abs(found - pixels).max() <= 3.0
        assert found.shape == pixels.shape


def test_each_prefix_decodes_and_the_error_falls():
    tiles = make_tiles(4, 3, 64, 2.0)
    tiles[:, :, ::4] //= 2
    header, contents, _, _ = code_tiles(tiles, 85)
    errors = []
    for scans, pixels in zip(contents, tiles, strict=True):
        prefixes = [decode_tile(header, scans[:count])[::-1].astype(float) for count in range(1, len(scans) + 1)]
        errors.append([np.mean((image - pixels) ** 2) for image in prefixes])
    means = np.mean(errors, axis=0)
    assert (np.diff(means) < 0.05 * means[0]).all()
    assert means[-1] < 0.3 * means[0]


def test_bands_can_come_in_any_order():
    header, contents, _, _ = code_tiles(make_tiles(5, 1, 32, 20.0), 80)
    scans = contents[0]
    bands = [scans[start : start + 2] for start in range(1, len(scans), 2)]
    shuffled = [scans[0]] + [scan for index in np.random.default_rng(1).permutation(len(bands)) for scan in bands[index]]
    np.testing.assert_array_equal(decode_tile(header, shuffled), decode_tile(header, scans))


def test_flat_tiles_have_one_scan():
    _, contents, _, _ = code_tiles(np.full((2, 32, 32, 3), 77, np.uint8), 90)
    assert all(all(not scan for scan in scans[1:]) and scans[0] for scans in contents)


def test_zigzag_begins_as_in_the_standard():
    assert zigzag_order()[:10].tolist() == [0, 1, 8, 16, 9, 2, 3, 10, 17, 24]
    assert zigzag_order()[-3:].tolist() == [55, 62, 63]


def test_standard_steps_are_those_of_the_library():
    assert standard_steps(50, 3)[0, :3].tolist() == [16, 11, 12]
    assert standard_steps(50, 3)[1, :3].tolist() == [17, 18, 18]
    assert standard_steps(100, 1).max() == 1


def refine(blocks: np.ndarray, shift: int) -> list[tuple[int, int, int]]:
    """Return the symbols of a refinement of one tile (B, K), one coefficient after the other, as the standard describes it."""
    symbols, run_of_ends, end_bits = [], 0, []

    def finish_run():
        nonlocal run_of_ends, end_bits
        if run_of_ends:
            size = run_of_ends.bit_length() - 1
            symbols.append((size << 4, run_of_ends - (1 << size), size))
            symbols.extend((RAW, bit, 1) for bit in end_bits)
        run_of_ends, end_bits = 0, []

    for block in blocks.tolist():
        magnitudes = [abs(value) >> shift for value in block]
        last = max((place for place, value in enumerate(magnitudes) if value == 1), default=-1)
        zeros, bits = 0, []
        for place, value in enumerate(magnitudes):
            if not value:
                zeros += 1
                continue
            while zeros > 15 and place <= last:
                finish_run()
                symbols.append((RUN_OF_ZEROS, 0, 0))
                symbols.extend((RAW, bit, 1) for bit in bits)
                zeros, bits = zeros - 16, []
            if value > 1:
                bits.append(value & 1)
                continue
            finish_run()
            symbols.append((zeros << 4 | 1, int(block[place] > 0), 1))
            symbols.extend((RAW, bit, 1) for bit in bits)
            zeros, bits = 0, []
        if zeros or bits:
            run_of_ends, end_bits = run_of_ends + 1, end_bits + bits
    finish_run()
    return symbols


@settings(deadline=None, max_examples=30)
@given(
    st.integers(0, 10**6), st.integers(1, 3), st.integers(1, 40), st.integers(1, 63), st.sampled_from([0.4, 1.0, 3.0]), st.integers(0, 2)
)
def test_refinements_follow_the_standard(seed, tiles, blocks, width, size, shift):
    generator = np.random.default_rng(seed)
    values = generator.normal(scale=size * 2**shift, size=(tiles, blocks, width)) * (generator.random((tiles, blocks, 1)) < 0.6)
    found = list_ac_corrections(values.astype(np.int16), shift)
    for tile in range(tiles):
        rows = found.tiles == tile
        symbols = list(zip(found.symbols[rows].tolist(), found.values[rows].tolist(), found.lengths[rows].tolist(), strict=True))
        assert symbols == refine(values[tile].astype(np.int16), shift)


def test_blocks_without_coefficients_become_one_run():
    values = np.zeros((1, 300, 5), np.int16)
    values[0, 299, 4] = -1
    found = list_ac_symbols(values, 0)
    assert found.symbols.tolist() == [8 << 4, 4 << 4 | 1]
    assert found.values.tolist() == [299 - 256, 0]


@settings(deadline=None, max_examples=30)
@given(st.lists(st.integers(0, 10**6), min_size=256, max_size=256).filter(any))
def test_huffman_codes_are_prefix_free_and_not_all_ones(counts):
    table = build_table(np.array(counts))
    codes = sorted(format(code, f"0{length}b") for code, length in zip(table.codes.tolist(), table.lengths.tolist(), strict=True) if length)
    assert len(codes) == np.count_nonzero(counts) and max(map(len, codes)) <= MAX_LENGTH
    assert not any(second.startswith(first) for first, second in pairwise(codes))
    assert all("0" in code for code in codes)


@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 32), st.integers(0, 2)), max_size=60))
def test_bits_are_packed_in_order(entries):
    entries.sort(key=lambda entry: entry[2])
    values = np.array([value & ((1 << length) - 1) for value, length, _ in entries], np.int64)
    lengths, owners = (np.array([entry[index] for entry in entries], np.int64) for index in (1, 2))
    for owner, found in enumerate(pack_bits(values, lengths, owners, 3)):
        rows = [(int(v), int(n)) for v, n, o in zip(values, lengths, owners, strict=True) if o == owner and n]
        bits = "".join(format(value, f"0{length}b") for value, length in rows)
        bits += "1" * (-len(bits) % 8)
        expected = int(bits, 2).to_bytes(len(bits) // 8, "big") if bits else b""
        assert found == expected.replace(b"\xff", b"\xff\x00")


def test_files_are_split_and_joined():
    header, contents, _, _ = code_tiles(make_tiles(6, 1, 32, 10.0), 80)
    scans = [scan for scan in contents[0] if scan]
    start, parts = split_scans(join_scans(header, scans))
    assert join_scans(start, parts) == join_scans(header, scans)
    assert len(parts) == len(scans) and parts[1:] == scans[1:]
    check_increment(b"".join(scans), len(scans))


@pytest.mark.parametrize("change", ["truncated", "other", "marker", "count"])
def test_damaged_increments_are_refused(change):
    _, contents, _, _ = code_tiles(make_tiles(7, 1, 32, 10.0), 80)
    scans = [scan for scan in contents[0] if scan]
    content, count = b"".join(scans), len(scans)
    if change == "truncated":
        content = content[: len(scans[0]) + 5]
    elif change == "other":
        content = b"\x00" + content
    elif change == "marker":
        content += EOI
    else:
        count += 1
    with pytest.raises(FileError):
        check_increment(content, count)


@given(st.binary(max_size=200))
def test_random_files_are_refused(content):
    with pytest.raises(FileError):
        split_scans(b"\xff\xd8" + content)
    with pytest.raises(FileError):
        decode_tile(b"\xff\xd8\xff" + content[:20], [])
