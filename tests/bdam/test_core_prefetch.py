"""Reading ahead while a viewer moves: moves find in memory what they need, show the same, and lose nothing that they have."""

import numpy as np
import pytest

from farfield.addon.core.bdam.settings import ViewSettings
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view.caches import PatchCache, Prefetch, TextureFiles
from farfield.addon.core.bdam.view.engine import BdamEngine
from farfield.addon.core.bdam.view.extraction import extract_uniform_cut
from farfield.addon.core.errors import FileError
from farfield.addon.core.geometry.viewers import Projection, Viewer, look_at
from farfield.addon.core.jobs.progress import run_to_end
from small_terrain_stores import CELL_SIZE, add_texture, build_store, colors, hills

pytest.importorskip("PIL")
pytest.importorskip("zstandard")
SIZE = 129  # samples per side
EXTENT = 0.5 * CELL_SIZE * (SIZE - 1)
INTERVAL = 0.1  # seconds between two moves
PROJECTION = Projection("perspective", (-0.47, 0.47, -0.35, 0.35), (800, 600), 1.0, 1e5)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    plain = build_store(tmp_path_factory.mktemp("stores") / "plain", hills(SIZE, SIZE))
    return {"plain": plain, "texture": add_texture(build_store(plain.with_name("texture"), hills(SIZE, SIZE)), colors(2048))}


class Flight:
    """A flight with a constant velocity over the terrain, and what an engine has read in its moves and between them."""

    def __init__(self, folder, prefetches: bool, **values) -> None:
        self.time = 0.0
        shading = "texture" if folder.name == "texture" else "slope"
        self.engine = BdamEngine(folder, ViewSettings(tolerance=4.0, shading=shading, **values), lambda: self.time)
        self.prefetches, self.is_moving = prefetches, False
        self.in_moves, self.between = 0, 0
        self._count_reads(self.engine.store, "read_all", len)
        if self.engine.store.textures is not None:
            self._count_reads(self.engine.store.textures, "read_coded", lambda _: 1)

    def _count_reads(self, source, name, count_items) -> None:
        read = getattr(source, name)

        def count(items):
            self.in_moves += count_items(items) * self.is_moving
            self.between += count_items(items) * (not self.is_moving)
            return read(items)

        setattr(source, name, count)

    def choose_matrix(self, number: int) -> np.ndarray:
        """The matrix of the viewer."""
        position = np.array([-0.8 * EXTENT + 12.0 * number, -0.3 * EXTENT + 5.0 * number, 260.0])
        return look_at(position, position + [300.0, 100.0, -150.0])

    def step(self, number: int):
        """Fly on, and return what is shown."""
        self.time = INTERVAL * number
        self.is_moving = True
        update = run_to_end(self.engine.move(Viewer(self.choose_matrix(number), PROJECTION, True)))
        self.is_moving = False
        if self.prefetches:
            run_to_end(self.engine.prefetch())
        blocks = []
        while not self.engine.finished_blocks.empty():
            key, block = self.engine.finished_blocks.get_nowait()
            blocks.append((key, block.mesh.ids.tobytes(), block.mesh.triangles.tobytes(), block.mesh.vertices.tobytes()))
        return update.tiles, update.figures.triangles, update.figures.tolerance, update.figures.max_error, blocks


class Turn(Flight):
    """A viewer who looks around in the middle of the terrain."""

    def choose_matrix(self, number: int) -> np.ndarray:
        position, angle = np.array([0.0, 0.0, 150.0]), 0.08 * number
        return look_at(position, position + [300.0 * np.cos(angle), 300.0 * np.sin(angle), -100.0])


class Orbit(Flight):
    """A viewer who orbits around the middle of the terrain."""

    def choose_matrix(self, number: int) -> np.ndarray:
        angle = 0.08 * number
        return look_at(np.array([500.0 * np.cos(angle), 500.0 * np.sin(angle), 200.0]), np.zeros(3))


@pytest.mark.slow
@pytest.mark.parametrize("path", [Turn, pytest.param(Orbit, marks=pytest.mark.exhaustive)])
def test_turning_viewers_find_what_they_need(folders, path):
    ahead, without = (path(folders["texture"], prefetches) for prefetches in (True, False))
    for number in range(20):
        if number == 2:
            ahead.in_moves = without.in_moves = 0
        assert ahead.step(number) == without.step(number)
    assert without.in_moves > 15
    assert ahead.in_moves < 0.15 * without.in_moves


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "values"), [pytest.param("plain", {}, marks=pytest.mark.exhaustive), ("texture", {}), ("plain", {"triangle_budget": 6000})]
)
def test_moves_read_much_less_and_show_the_same(folders, kind, values):
    ahead, without = Flight(folders[kind], True, **values), Flight(folders[kind], False, **values)
    for number in range(24):
        if number == 2:  # from then on there is a velocity
            ahead.in_moves = without.in_moves = 0
        assert ahead.step(number) == without.step(number)
    assert without.in_moves > 15 and without.between == 0
    assert ahead.in_moves < 0.2 * without.in_moves
    assert ahead.between < 4 * without.in_moves


@pytest.mark.slow
def test_nothing_is_read_ahead_of_viewers_who_stay(folders):
    flight = Flight(folders["plain"], True)
    run_to_end(flight.engine.prefetch())
    flight.step(0)
    assert flight.between == 0, "one move has no velocity"
    flight.step(1)
    assert flight.between > 0
    paused = Flight(folders["plain"], True)
    paused.step(0), paused.step(100)
    assert paused.between == 0


def test_a_cancelled_prefetch_leaves_a_valid_engine(folders):
    ahead, without = Flight(folders["texture"], False), Flight(folders["texture"], False)
    for number in range(6):
        assert ahead.step(number) == without.step(number)
        steps = ahead.engine.prefetch()
        for _ in range(number):
            next(steps, None)
        steps.close()


@pytest.mark.parametrize("max_bytes", [0, 60_000, 200_000, 8 << 20])
def test_reading_ahead_evicts_nothing_that_is_needed_now(folders, max_bytes):
    with TerrainStore(folders["plain"]) as store:
        cache = PatchCache(store, max_bytes)
        present, other, next_cut = (extract_uniform_cut(store, error).list_patches() for error in (20.0, 60.0, 0.5))
        for key in present + other:
            cache.read(key)
        before = {key for key in present if cache.touch(key) is not None}
        run_to_end(Prefetch(cache, present).read(next_cut))
        assert cache.byte_count <= max_bytes
        assert all(cache.touch(key) is not None for key in before)
        read = [cache.touch(key) is not None for key in next_cut if key not in before]
        assert read == sorted(read, reverse=True), "what is needed first comes first"
        assert max_bytes < 8 << 20 or all(read)


def test_bounds_of_bytes_hold(folders):
    with TerrainStore(folders["texture"]) as store:
        cache, files = PatchCache(store), TextureFiles(store.textures)
        for level in range(len(store.levels)):
            for row in range(0, len(store.levels[level].indices), 5):
                for is_outline in (False, True):
                    key = level, row, is_outline
                    assert cache.bound_bytes(key) >= cache.read(key).nbytes
        for number in range(len(store.textures.index)):
            assert files.touch(number) is None
            files.read(number)
            assert 0 < files.touch(number) <= files.bound_bytes(number)
        assert files.byte_count == sum(files.touch(number) for number in range(len(store.textures.index)))


def test_textures_used_last_are_kept(folders):
    with TerrainStore(folders["texture"]) as store:
        one = len(TextureFiles(store.textures).read(0).color)
        files = TextureFiles(store.textures, max_bytes=3 * one)
        for number in (0, 1, 0, 2, 0, 3, 0, 4):
            files.read(number)
        assert files.touch(0) is not None and files.touch(4) is not None and files.touch(1) is None and files.byte_count <= 3 * one


def test_damaged_patches_are_left_out(folders):
    with TerrainStore(folders["plain"]) as store:
        cache = PatchCache(store)
        keys = extract_uniform_cut(store, 5.0).list_patches()
        read_all = store.read_all

        def fail(places):
            return [FileError("damaged.") if place == keys[1][:2] else patch for place, patch in zip(places, read_all(places), strict=True)]

        store.read_all = fail
        run_to_end(Prefetch(cache, []).read(keys))
        assert [cache.touch(key) is None for key in keys] == [key == keys[1] for key in keys]
