"""Stores of strangers: all checksums are right, and the content is not. They are refused when they are opened, or can be used."""

import io
import json
import shutil
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.bdam.ground.heights import HeightQuery
from farfield.addon.core.bdam.settings import ViewSettings
from farfield.addon.core.bdam.store import structure
from farfield.addon.core.bdam.store.terrain_store import GEOMETRY_FILE, TEXTURE_FOLDER, TerrainStore
from farfield.addon.core.bdam.textures import store as textures
from farfield.addon.core.bdam.textures.tile_blocks import SIZES
from farfield.addon.core.bdam.view.cut_files import extract_mesh
from farfield.addon.core.bdam.view.cut_meshes import vertex_gradients
from farfield.addon.core.bdam.view.engine import BdamEngine
from farfield.addon.core.bdam.view.extraction import CutSettings
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.backups import copy_to_backup
from farfield.addon.core.files.blocks import BlockReader, BlockWriter
from farfield.addon.core.geometry import triangle_search
from farfield.addon.core.geometry.triangle_search import TriangleSearch
from farfield.addon.core.geometry.viewers import Projection, Viewer, look_at
from farfield.addon.core.imaging.coded_images import encode
from farfield.addon.core.jobs.progress import run_to_end
from small_terrain_stores import add_texture, build_store, colors, hills

Image = pytest.importorskip("PIL.Image")
pytest.importorskip("zstandard")
SIZE = 49  # samples per side
VIEWER = Viewer(
    look_at(np.array([0.0, -900.0, 500.0]), np.zeros(3)), Projection("perspective", (-0.5, 0.5, -0.375, 0.375), (800, 600), 1.0, 1e5)
)


@pytest.fixture(scope="module")
def intact(tmp_path_factory):
    return add_texture(build_store(tmp_path_factory.mktemp("stores") / "intact", hills(SIZE, SIZE)), colors(700))


@pytest.fixture
def folder(intact, tmp_path):
    """A copy of the store to change."""
    return shutil.copytree(intact, tmp_path / "store")


def rewrite(path: Path, kind: str, change: Callable[[list[bytes]], None], backs_up: bool = True) -> int:
    """Change the blocks of a file, with right checksums. Returns the checksum of the index."""
    with BlockReader(path, kind) as reader:
        blocks = [reader.read(number, "") for number in range(len(reader))]
    change(blocks)
    with BlockWriter(path, kind) as writer:
        for block in blocks:
            writer.append(block)
        checksum = writer.finish(backs_up_index=not backs_up)
    if backs_up:
        copy_to_backup(path)
    return checksum


def change_structure(folder: Path, change: Callable[[list[bytes]], None]) -> None:
    rewrite(folder / structure.STRUCTURE_FILE, structure.KIND, change)


def change_header(folder: Path, **values: object) -> None:
    """Give fields of the header other values. Those of `json` are the whole text."""

    def change(blocks: list[bytes]) -> None:
        blocks[0] = values["json"] if "json" in values else json.dumps(json.loads(blocks[0]) | values).encode()

    change_structure(folder, change)


def change_numbers(folder: Path, block: int, dtype: str, place: int, value: float) -> None:
    """Change a number in a block of the structure."""

    def change(blocks: list[bytes]) -> None:
        columns = structure.COLUMNS[(block - 1) % structure.ARRAYS_PER_LEVEL]
        count = len(blocks[block - (block - 1) % structure.ARRAYS_PER_LEVEL]) // 8
        content = blocks[block]
        numbers = np.frombuffer(content, dtype).copy() if dtype == "<u8" else structure.decompress(content, count, columns, dtype).copy()
        numbers.reshape(-1)[place] = value
        blocks[block] = numbers.tobytes() if dtype == "<u8" else structure.compress(numbers)

    change_structure(folder, change)


def change_textures(folder: Path, change: Callable[[list[bytes]], None]) -> None:
    rewrite(folder / TEXTURE_FOLDER / textures.STRUCTURE_FILE, textures.STRUCTURE_KIND, change)


def change_tile(folder: Path, color: bytes, alpha: bytes = b"") -> None:
    """Replace the root tile by other images."""

    def change(blocks: list[bytes]) -> None:
        blocks[0] = SIZES.pack(len(color), len(alpha)) + color + alpha

    def seal(blocks: list[bytes]) -> None:
        blocks[5] = checksum.to_bytes(4, "little")

    checksum = rewrite(folder / TEXTURE_FOLDER / textures.TILES_FILE, textures.TILES_KIND, change, backs_up=False)
    change_textures(folder, seal)


def change_patch(folder: Path, number: int, block: bytes) -> None:
    """Replace the block of a patch."""

    def change(blocks: list[bytes]) -> None:
        blocks[number] = block

    change_header(folder, geometry_checksum=rewrite(folder / GEOMETRY_FILE, "bdamgeom", change, backs_up=False))


HEADERS = [
    *({"json": text} for text in (b"null", b'"abc"', b"[" * 100_000, b"{}", b"\xff", b"[1]")),
    *({"frame": value} for value in ("zz", [1], None, {})),
    *({"first": value} for value in (5, None, ["a", 1], [1], [1, 2, 3], [float("nan"), 0], [0, 1e300], "ab")),
    *({"step": value} for value in ([0, 0], [1, -1], [1, float("inf")], None)),
    *({"origin": value} for value in ("ab", [None, 0], [float("inf"), 0])),
    *({name: value} for name in ("height_step", "gradient_step", "cell_size") for value in ("x", None, 0, -1, 1e308, float("nan"), True)),
    *({"leaf_cells": value} for value in (0, -2, 3, 32768, 2**40, 16.0, True, None)),
    *({name: value} for name in ("rows", "columns") for value in (1, 0, -5, 2**40, 10**400, 33.0, "33")),
    *({"crs": value} for value in (5, "x" * 2000, "\ud800", None)),
    *({"has_texture": value} for value in (1, "yes", None)),
    *({"geometry_checksum": value} for value in (-1, 2**32, "1")),
    *({"version": value} for value in (None, "3", 3.0)),
    {"another": 1},
]


@pytest.mark.slow
@pytest.mark.parametrize("values", HEADERS, ids=lambda values: str(values)[:40])
def test_a_header_with_a_wrong_type_or_range_is_damaged(folder, values):
    change_header(folder, **values)
    with pytest.raises(FileError, match="is damaged or no structure of a terrain") as caught:
        TerrainStore(folder)
    assert len(str(caught.value)) < 400 and str(caught.value).isprintable()


NUMBERS = [
    *((1, "<u8", 0, value) for value in (1, 2**63, 10**9)),
    *((6, "<u8", 1, value) for value in (0, 2**63, 2**64 - 1, 10**9)),
    *((2, "<f4", 0, value) for value in (np.nan, np.inf, -1.0, 1e30)),
    (3, "<i4", 0, 2**31 - 1),
    *((4, "<u4", place, value) for place in (0, 1, 2) for value in (30_000_000, 2**31 - 1, 2**32 - 1)),
    *((4, "<u4", place, 0) for place in (0, 1)),
    *((5, "<f4", place, value) for place, value in ((0, np.nan), (0, 1e30), (0, np.inf), (4, -np.inf), (3, -1e6))),
]


@pytest.mark.parametrize(("block", "dtype", "place", "value"), NUMBERS)
def test_numbers_of_patches_out_of_range_are_damaged(folder, block, dtype, place, value):
    change_numbers(folder, block, dtype, place, value)
    with pytest.raises(FileError, match="is damaged or no structure of a terrain"):
        TerrainStore(folder)


def test_blocks_that_are_missing_or_too_many_are_damaged(folder, tmp_path):
    for number, change in enumerate(
        (lambda blocks: blocks.pop(), lambda blocks: blocks.append(b""), lambda blocks: blocks.__setitem__(1, b""))
    ):
        copy = shutil.copytree(folder, tmp_path / str(number))
        change_structure(copy, change)
        with pytest.raises(FileError, match="is damaged or no structure of a terrain"):
            TerrainStore(copy)


PLANS = [
    *({"json": text} for text in (b"null", b"[" * 100_000, b"{}", b"3")),
    *({"image_format": value} for value in ("gif", [1], None, {})),
    *({"quality": value} for value in ("9", 0, 101, 1e9, float("nan"))),
    *({"error": value} for value in (5, None, [], "x")),
    *({"grid": value} for value in (None, 3, [], {})),
    *({name: value} for name in ("columns", "rows", "size") for value in (0, -1, 2**40, 10**400, 3.0, None, True)),
    *({"level_count": value} for value in (0, 21, 2**40, 1.0, None)),
    *({"spacing": value} for value in ("ab", [1], [0, 1], [float("nan"), 1], [1e300, 1], 5, None)),
]


@pytest.mark.parametrize("values", PLANS, ids=lambda values: str(values)[:40])
def test_a_plan_of_textures_with_a_wrong_type_or_range_is_damaged(folder, values):
    def change(blocks: list[bytes]) -> None:
        plan = json.loads(blocks[0])
        (plan["grid"] if values.keys() <= plan["grid"].keys() else plan).update(values)
        blocks[0] = values.get("json") or json.dumps(plan).encode()

    change_textures(folder, change)
    with pytest.raises(FileError, match=r'textures\.structure" is damaged; build it again'):
        TerrainStore(folder)


@pytest.mark.parametrize(
    ("block", "dtype", "value"), [(1, "<i4", -1), (1, "<i4", 30), (2, "<i4", -1), (2, "<i4", 2**30), (3, "<f4", np.nan), (4, "<f4", np.inf)]
)
def test_numbers_of_tiles_out_of_range_are_damaged(folder, block, dtype, value):
    def change(blocks: list[bytes]) -> None:
        numbers = np.frombuffer(blocks[block], dtype).copy()
        numbers[0] = value
        blocks[block] = numbers.tobytes()

    change_textures(folder, change)
    with pytest.raises(FileError, match=r'textures\.structure" is damaged; build it again'):
        TerrainStore(folder)


def test_textures_of_another_grid_are_refused(folder):
    def change(blocks: list[bytes]) -> None:
        plan = json.loads(blocks[0])
        plan["grid"]["columns"] -= 1
        blocks[0] = json.dumps(plan).encode()

    change_textures(folder, change)
    with pytest.raises(FileError, match="are those of another terrain"):
        TerrainStore(folder)


def large_header(image_format: str) -> bytes:
    """A small image whose header says that it is much larger."""
    file = io.BytesIO()
    Image.new("L", (16, 16)).save(file, image_format)
    content = bytearray(file.getvalue())
    if image_format == "PNG":
        content[16:24] = (30_000).to_bytes(4, "big") * 2
        content[29:33] = int.to_bytes(zlib.crc32(content[12:29]), 4, "big")
    else:
        place = content.index(b"\xff\xc0") + 5
        content[place : place + 4] = (65_500).to_bytes(2, "big") * 2
    return bytes(content)


def coded(image_format: str, side: int) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (side, side)).save(file, image_format)
    return file.getvalue()


TILES = {
    "larger PNG": lambda: coded("PNG", 513),
    "larger WebP": lambda: coded("WEBP", 600),
    "larger JPEG": lambda: coded("JPEG", 4096),
    "PNG that says it is larger": lambda: large_header("PNG"),
    "JPEG that says it is larger": lambda: large_header("JPEG"),
    "TIFF": lambda: coded("TIFF", 16),
    "no image": lambda: b"no image at all",
    "raw pixels that are missing": lambda: encode(np.zeros((4, 4, 3), np.uint8), "raw")[:-1],
}


@pytest.mark.parametrize("name", TILES)
@pytest.mark.parametrize("is_alpha", [False, True])
def test_a_tile_that_is_no_image_or_too_large_is_named_and_not_shown(folder, name, is_alpha):
    content = TILES[name]()
    change_tile(folder, *((coded("JPEG", 512), content) if is_alpha else (content,)))
    with TerrainStore(folder) as store:
        assert list(store.verify()) == ["texture tile 0/0/0"]
        with pytest.raises(FileError, match=r"The texture tile 0/0/0 in .* is damaged"):
            store.textures.read_coded(0)
    engine = BdamEngine(folder, ViewSettings(tolerance=100.0))
    update = run_to_end(engine.move(VIEWER))
    _, block = engine.finished_blocks.get_nowait()
    assert block.maps[1].color is None and "texture tile 0/0/0" in " ".join(update.warnings)
    engine.store.close()


def test_streams_without_bytes_cannot_claim_more_vertices_than_a_patch_has(folder):
    """Zeros have no bytes, however many of them there are."""
    block = bytes([1, 0, 0, 0, 0, 0]) + b"\xff" * 1000
    change_patch(folder, 0, block)
    for count in (30_000_000, 2**31 - 1):
        change_numbers(folder, 4, "<u4", 0, count)
        with pytest.raises(FileError, match="impossible number of triangles"):
            TerrainStore(folder)
    change_numbers(folder, 4, "<u4", 0, 1000)
    with TerrainStore(folder) as store, pytest.raises(FileError, match="Patch 0/0 of"):
        store.read(0, 0)


def test_normals_of_triangles_without_area_are_numbers():
    positions = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1e9], [2.0, 2.0, -1e9]])
    assert (np.abs(vertex_gradients(positions, np.array([[0, 1, 2]]))) < 1e100).all()


@pytest.mark.slow
def test_thin_triangles_that_overlap_need_little_memory(monkeypatch):
    """Each of them is in nearly all buckets, and each point is in nearly all of them."""
    count = 3000
    positions = np.concatenate(
        [[[0.0, 0.0], [1000.0, 1000.0]], np.stack([np.linspace(1.0, 999.0, count), np.linspace(0.0, 998.0, count)], axis=1)]
    )
    triangles = np.stack([np.zeros(count, int), np.arange(2, count + 2), np.ones(count, int)], axis=1)
    points = np.random.default_rng(0).uniform(0.0, 1000.0, (5000, 2))
    expected = TriangleSearch(positions, triangles[:40]).find(points) >= 0
    monkeypatch.setattr(triangle_search, "MAX_CANDIDATES", 1 << 16)
    monkeypatch.setattr(triangle_search, "MAX_MEMBERS", 1 << 16)
    search = TriangleSearch(positions, triangles)
    tracemalloc.start()
    found = search.find(points)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert search.nbytes < 2_000_000 and peak < 30_000_000
    assert (found[expected] >= 0).all() and not (found[points[:, 0] < points[:, 1]] >= 0).any()


VALUES = st.sampled_from([0, 1, -1, 2, 3, 16, 64, 2**31, 2**63, 1e18, 1e-15, 1e9, 1e300, float("inf"), float("nan")])
JUNK = VALUES | st.floats() | st.integers() | st.none() | st.booleans() | st.text(max_size=3) | st.lists(VALUES, min_size=2, max_size=2)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@settings(max_examples=60)
@given(data=st.data())
def test_any_content_is_refused_or_can_be_used(intact, tmp_path_factory, data):
    """Nothing but FileError, no warning of NumPy, and only finite numbers, whatever fields, arrays and patches contain."""
    folder = shutil.copytree(intact, tmp_path_factory.mktemp("stores") / "store")
    names = ["rows", "columns", "leaf_cells", "height_step", "gradient_step", "cell_size", "crs", "frame", "first", "step", "origin"]
    change_header(folder, **data.draw(st.dictionaries(st.sampled_from(names), JUNK | st.just("geographic"), max_size=2)))
    if data.draw(st.booleans()):
        block, dtype = data.draw(st.sampled_from([(1, "<u8"), (2, "<f4"), (3, "<i4"), (4, "<u4"), (5, "<f4"), (11, "<u8"), (12, "<f4")]))
        kind = np.dtype(dtype).kind
        value = data.draw(st.floats(width=32) if kind == "f" else st.integers(0, 100) | st.just(2**31 - 1))
        change_numbers(folder, block, dtype, data.draw(st.integers(0, 1)), value)
    if data.draw(st.booleans()):
        content = data.draw(st.binary(max_size=200) | st.binary(max_size=30).map(lambda part: bytes(10) + part))
        change_patch(folder, data.draw(st.integers(0, 30)), content)
    try:
        with TerrainStore(folder) as store:
            list(store.verify())
            extracted = run_to_end(extract_mesh(store, VIEWER, CutSettings(0.1)))
            heights, normals = HeightQuery(store).find(np.random.default_rng(0).uniform(-40.0, 40.0, (50, 2)))
        engine = BdamEngine(folder, ViewSettings())
        run_to_end(engine.move(VIEWER))
        engine.store.close()
    except FileError as error:
        assert str(error).endswith(".")
        return
    assert np.isfinite(extracted.mesh.positions).all() and np.isfinite(extracted.mesh.normals).all() and np.isfinite(extracted.max_error)
    assert (np.isnan(heights) == np.isnan(normals).any(axis=1)).all()
