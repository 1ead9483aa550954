"""TIFF pixels by window: every format gives the samples that were written, and only what a window touches is read."""

import io
import itertools
import tracemalloc
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from farfield.addon.core.errors import FileError
from farfield.addon.core.files import tiff_codecs, tiffs
from farfield.addon.core.files.segment_cache import SegmentCache
from farfield.addon.core.files.tiffs import open_tiff
from tiff_writer import COMPRESSIONS, COMPRESSORS, compress_lzw, compress_pack_bits, map_tags, write_tiff

pytest.importorskip("tifffile")

ROWS, COLUMNS = 75, 101
DTYPES = ["u1", "i2", "u2", "i4", "u4", "f4", "f8"]


def hills(dtype: str, channels: int = 1) -> np.ndarray:
    """An image (ROWS, COLUMNS, channels) with slopes, noise and a flat part, over the range of the type."""
    y, x, z = np.mgrid[0:ROWS, 0:COLUMNS, 0:channels]
    values = np.sin(x / 9.0 + z) * np.cos(y / 7.0) + 0.02 * np.random.default_rng(3).random(x.shape)
    values[20:40, 30:70] = 0.25
    kind = np.dtype(dtype)
    if kind.kind == "f":
        return (3000.0 * values).astype(kind)
    info = np.iinfo(kind)
    return (info.min / 2 + info.max / 2 + (info.max / 2.1 - info.min / 2.1) / 2 * values).astype(kind)


def read_all(path: Path, cache: SegmentCache | None = None) -> np.ndarray:
    image = open_tiff(path)
    image.check_complete()
    return image.read(slice(0, image.shape[0]), slice(0, image.shape[1]), cache)


def formats():
    """Combinations of a compression and a predictor that occur together; each of both, with and without tiles, in one that always runs."""
    for compression, predictor, tile in itertools.product(COMPRESSORS, (1, 2, 3), (None, (32, 16))):
        if predictor == 1 or compression in {"deflate", "lzw", "zstd"}:
            is_variant = tile is None if predictor == 1 else compression != "deflate" or (tile is None) == (predictor == 3)
            yield pytest.param(compression, predictor, tile, marks=pytest.mark.exhaustive if is_variant else ())


@pytest.mark.parametrize(("compression", "predictor", "tile"), list(formats()))
def test_every_format_gives_the_samples_that_were_written(tmp_path, compression, predictor, tile):
    for dtype, (order, big) in zip(DTYPES, itertools.cycle([("<", False), (">", True)]), strict=False):
        if predictor == 3 and dtype[0] != "f":
            continue
        values = hills(dtype)
        path = write_tiff(tmp_path / "map.tif", values, compression, predictor, tile, order=order, big=big)
        samples = read_all(path)
        assert samples.dtype == values.dtype and samples.dtype.isnative
        assert np.array_equal(samples, values), (dtype, order)


@pytest.mark.parametrize("predictor", [1, 2, 3])
def test_channels_are_not_mixed(tmp_path, predictor):
    colors = hills("f4", 3)
    for tile in (None, (16, 48)):
        assert np.array_equal(read_all(write_tiff(tmp_path / "colors.tif", colors, "deflate", predictor, tile)), colors)


def test_tifffile_reads_what_the_tests_write_and_the_same_samples(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    for compression, predictor, big in itertools.product(("none", "deflate", "packbits"), (1, 2), (False, True)):
        path = write_tiff(tmp_path / "map.tif", hills("i2"), compression, predictor if compression == "deflate" else 1, (32, 16), big=big)
        assert np.array_equal(tifffile.imread(path), hills("i2")[:, :, 0])


@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_what_tifffile_writes(tmp_path, planar):
    tifffile = pytest.importorskip("tifffile")
    colors = hills("u2", 3)
    stored = colors if planar == "contig" else np.moveaxis(colors, 2, 0)
    for compression, tile in itertools.product((None, "zlib"), (None, (16, 32))):
        tifffile.imwrite(tmp_path / "colors.tif", stored, photometric="rgb", planarconfig=planar, compression=compression, tile=tile)
        assert np.array_equal(read_all(tmp_path / "colors.tif"), colors)
    bits = colors[:, :, 0] > 30000
    tifffile.imwrite(tmp_path / "bits.tif", bits, metadata=None)
    assert np.array_equal(read_all(tmp_path / "bits.tif")[:, :, 0], bits)


@pytest.fixture(scope="module")
def windowed(tmp_path_factory):
    """Open images in several formats with the same pixels, and the pixels."""
    folder = tmp_path_factory.mktemp("windows")
    kinds = [
        ("none", 1, None),
        ("none", 1, (16, 16)),
        ("deflate", 2, None),
        ("deflate", 3, (32, 16)),
        ("lzw", 1, (16, 48)),
        ("packbits", 1, None),
    ]
    values = hills("f4")
    return values, [open_tiff(write_tiff(folder / f"{index}.tif", values, *kind)) for index, kind in enumerate(kinds)]


@settings(max_examples=30)
@given(
    st.tuples(st.integers(0, ROWS), st.integers(0, ROWS)).map(sorted),
    st.tuples(st.integers(0, COLUMNS), st.integers(0, COLUMNS)).map(sorted),
    st.booleans(),
)
def test_a_window_is_a_part_of_the_image(windowed, rows, columns, is_cached):
    values, images = windowed
    for image in images:
        window = image.read(slice(*rows), slice(*columns), SegmentCache(5000) if is_cached else None)
        assert np.array_equal(window, values[slice(*rows), slice(*columns)])


@given(st.binary(max_size=3000).map(lambda data: data * 3), st.integers(300, 4094))
@settings(max_examples=60)
def test_lzw_and_pack_bits_round_trip(data, max_entries):
    assert tiff_codecs.decompress_lzw(compress_lzw(data, max_entries), len(data)) == data
    assert tiff_codecs.decompress_pack_bits(compress_pack_bits(data), len(data)) == data


def test_long_lzw_data_fills_the_table_again_and_again():
    generator = np.random.default_rng(5)
    for levels in (1, 2, 16, 256):
        data = generator.integers(0, levels, 30_000).astype(np.uint8).tobytes()
        assert tiff_codecs.decompress_lzw(compress_lzw(data), len(data)) == data
        assert tiff_codecs.decompress_lzw(compress_lzw(data), 777) == data[:777]
        assert tiff_codecs.decompress_lzw(compress_lzw(data, 5000), len(data)) == data, "a full table is not always cleared"


def test_examples_of_the_specification():
    # TIFF 6.0, section 9: a run of AA, the literals 80 00 2A, ...
    packed = bytes.fromhex("FE AA 02 80 00 2A FD AA 03 80 00 2A 22 F7 AA")
    expected = bytes.fromhex("AA AA AA 80 00 2A AA AA AA AA 80 00 2A 22 AA AA AA AA AA AA AA AA AA AA")
    assert tiff_codecs.decompress_pack_bits(packed, 24) == expected
    # TIFF 6.0, section 13: 7 7 7 8 8 7 7 6 6 becomes Clear 7 258 8 8 258 6 6 End
    codes = [256, 7, 258, 8, 8, 258, 6, 6, 257]
    bits = "".join(format(code, "09b") for code in codes).ljust(88, "0")
    assert tiff_codecs.decompress_lzw(int(bits, 2).to_bytes(11, "big"), 9) == bytes([7, 7, 7, 8, 8, 7, 7, 6, 6])


@given(st.binary(min_size=1, max_size=200))
def test_damaged_segments_raise_known_errors_only(data):
    for compression in tiff_codecs.MAX_RATIOS:
        for size in (1, 100, 10**9):
            try:
                decoded = tiff_codecs.decompress(data, compression, size)
                assert len(decoded) == size
            except tiffs.TIFFFILE_ERRORS:
                pass


class CountedFile(io.FileIO):
    """A file that counts the bytes that are read from it."""

    bytes_read = 0

    def read(self, size: int = -1) -> bytes:
        data = super().read(size)
        CountedFile.bytes_read += len(data)
        return data

    def readinto(self, buffer) -> int:
        count = super().readinto(buffer)
        CountedFile.bytes_read += count
        return count


@pytest.mark.slow
@pytest.mark.parametrize(("compression", "tile"), [("none", None), ("none", (64, 64)), ("deflate", (64, 64)), ("deflate", None)])
def test_only_the_window_is_read_and_decoded(tmp_path, monkeypatch, compression, tile):
    values = np.random.default_rng(1).integers(0, 1000, (1536, 2048)).astype(np.int16)
    path = write_tiff(tmp_path / "map.tif", values, compression, 1, tile, rows_per_strip=1536 if compression == "none" else 4)
    monkeypatch.setattr(Path, "open", lambda path, *_, **__: CountedFile(path, "rb"))
    CountedFile.bytes_read = 0
    tracemalloc.start()
    image = open_tiff(path)
    window = image.read(slice(1000, 1064), slice(700, 764))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.array_equal(window[:, :, 0], values[1000:1064, 700:764])
    touched = 64 * 64 * 2 * 4 if tile or compression == "none" else 72 * 2048 * 2  # at most four tiles, or whole rows
    assert CountedFile.bytes_read <= touched
    assert peak < 2**20, "the image has 6 MB"


def test_the_cache_keeps_what_was_used_last_within_its_limit(tmp_path, monkeypatch):
    path = write_tiff(tmp_path / "map.tif", hills("i2"), "deflate", 2, (16, 16))
    decoded = []
    original = tiffs.decode_segment

    def count(*arguments):
        decoded.append(1)
        return original(*arguments)

    monkeypatch.setattr(tiffs, "decode_segment", count)
    image, cache = open_tiff(path), SegmentCache(4 * 512)
    for _ in range(3):
        image.read(slice(0, 32), slice(0, 32), cache)
    assert len(decoded) == 4 and cache.byte_count == 4 * 512
    image.read(slice(64, 75), slice(0, 16), cache)
    assert len(decoded) == 5 and cache.byte_count == 4 * 512
    image.read(slice(0, 16), slice(0, 16), cache)
    assert len(decoded) == 6, "what was used longest ago has left"


def test_segments_that_are_not_stored_hold_no_data(tmp_path):
    values = hills("i2")[:, :, 0]
    for tags, expected in (({}, 0), ({42113: (2, "-9999")}, -9999), ({42113: (2, "nan")}, 0), ({42113: (2, "99999")}, 0)):
        path = write_tiff(tmp_path / "sparse.tif", values, "deflate", 2, (32, 32), tags=tags, empty=(1,))
        samples = read_all(path)[:, :, 0]
        assert (samples[:32, 32:64] == expected).all()
        assert np.array_equal(samples[32:], values[32:])


def encode_picture(pixels: np.ndarray, image_format: str = "JPEG", **options) -> bytes:
    """Return pixels (h, w, C) as a picture."""
    file = io.BytesIO()
    values = ~pixels if pixels.shape[2] == 4 else pixels  # Pillow inverts inks.
    picture = Image.frombytes({1: "L", 3: "RGB", 4: "CMYK"}[pixels.shape[2]], pixels.shape[1::-1], np.ascontiguousarray(values))
    picture.save(file, image_format, **options)
    return file.getvalue()


JPEG_KINDS = {  # channels, photometric interpretation, options of Pillow
    "gray": (1, 1, {}),
    "YCbCr": (3, 6, {"subsampling": 0}),
    "subsampled": (3, 6, {"subsampling": 2}),
    "RGB": (3, 2, {"keep_rgb": True}),
    "RGB and alpha": (4, 2, {}),
}


@pytest.mark.parametrize("kind", JPEG_KINDS)
@pytest.mark.parametrize("tile", [None, (32, 48)])
def test_pictures_in_jpeg(tmp_path, kind, tile):
    channels, photometric, options = JPEG_KINDS[kind]
    y, x, z = np.mgrid[0:ROWS, 0:COLUMNS, 0:channels]
    values = (127.0 + 100.0 * np.sin(x / 15.0 + z) * np.cos(y / 12.0)).astype(np.uint8)
    for has_tables in (False, True):
        tags = {258: (3, (8,) * channels), 259: (3, (7,)), 262: (3, (photometric,))}
        if has_tables:
            tags[347] = (7, tuple(encode_picture(values[:16, :16], quality=95, streamtype=1, **options)))
        if channels == 4:
            tags[338] = (3, (2,))
        code = partial(encode_picture, quality=95, streamtype=2 if has_tables else 0, **options)
        path = write_tiff(tmp_path / "ground.tif", values, tile=tile, rows_per_strip=32, tags=tags, encode=code)
        samples = read_all(path)
        assert samples.shape == values.shape and samples.dtype == np.uint8
        assert np.abs(samples.astype(int) - values).max() <= (12 if kind == "subsampled" else 4)
        assert np.array_equal(open_tiff(path).read(slice(20, 60), slice(30, 90)), samples[20:60, 30:90])
        content = path.read_bytes()
        path.write_bytes(content[:40] + bytes(200) + content[240:])
        with pytest.raises(FileError, match="is damaged"):
            read_all(path)


def test_pictures_in_webp(tmp_path):
    values = hills("u1", 3)
    tags = {259: (3, (50001,)), 262: (3, (2,))}
    path = write_tiff(
        tmp_path / "ground.tif", values, tile=(32, 48), tags=tags, encode=partial(encode_picture, image_format="WEBP", lossless=True)
    )
    assert np.array_equal(read_all(path), values)


class TestErrors:
    """Sentences about files that cannot be read."""

    def test_truncated_and_damaged_files(self, tmp_path):
        path = write_tiff(tmp_path / "map.tif", hills("i2"), "deflate", 1, (16, 16))
        content = bytearray(path.read_bytes())
        content[8:400] = b"\x07" * 392
        path.write_bytes(content)
        with pytest.raises(FileError, match="is damaged or has another format"):
            read_all(path)
        path.write_bytes(bytes(content[:40]))
        with pytest.raises(FileError, match="is damaged or has another format"):
            open_tiff(path)
        pytest.importorskip("tifffile").imwrite(path, hills("i2")[:, :, 0], metadata=None)
        path.write_bytes(path.read_bytes()[:-10])
        with pytest.raises(FileError, match="is truncated; copy the file again"):
            read_all(path)

    @pytest.mark.parametrize("compression", COMPRESSORS)
    def test_segments_that_end_early(self, compression):
        data = hills("i2").tobytes()
        packed = COMPRESSORS[compression](data)
        with pytest.raises(ValueError, match=r"ends before|too short"):
            tiff_codecs.decompress(packed[: len(packed) // 2], COMPRESSIONS[compression], len(data))

    def test_a_size_that_the_file_cannot_hold_reserves_no_memory(self, tmp_path):
        tags = dict.fromkeys((256, 257, 322, 323), (4, (2**14,)))  # 512 MB in one tile
        path = write_tiff(tmp_path / "huge.tif", hills("i2"), "deflate", 1, (128, 128), tags=tags)
        image = open_tiff(path)
        tracemalloc.start()
        with pytest.raises(FileError, match="is truncated"):
            image.check_complete()
        with pytest.raises(FileError, match="damaged"):
            image.read(slice(0, 8), slice(0, 8))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 2**20

    def test_a_compression_that_cannot_be_read_is_named(self, tmp_path):
        for number, name in ((34887, "the unsupported compression LERC"), (34712, "the unsupported compression JPEG2000")):
            path = write_tiff(tmp_path / "map.tif", hills("f4"), tags={259: (3, (number,))})
            with pytest.raises(FileError, match=f"has {name}; save it with deflate"):
                open_tiff(path).check_complete()

    def test_an_image_of_which_nothing_is_stored(self, tmp_path):
        path = write_tiff(tmp_path / "empty.tif", hills("i2"), "deflate", 1, (80, 112), empty=(0,))
        with pytest.raises(FileError, match="contains no pixels: none of its parts is stored"):
            read_all(path)

    def test_a_byte_anywhere_in_a_file(self, tmp_path):
        content = write_tiff(tmp_path / "map.tif", hills("f4"), "lzw", 3, (32, 32), tags=map_tags((30.0, 30.0), (0.0, 0.0))).read_bytes()
        generator = np.random.default_rng(2)
        path = tmp_path / "flipped.tif"
        for position in generator.integers(0, len(content), 60).tolist() + list(range(len(content) - 300, len(content), 2)):
            flipped = bytearray(content)
            flipped[position] ^= int(generator.integers(1, 256))
            path.write_bytes(flipped)
            try:
                image = open_tiff(path)
                image.check_complete()
                image.read(slice(0, min(8, image.shape[0])), slice(0, min(8, image.shape[1])))
            except FileError as error:
                assert str(error).endswith(".")
