"""What changes in a large terrain when its viewer moves: only changed tiles, few of them, welded exactly, within a triangle budget."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from farfield.addon.core.bdam.settings import ViewSettings
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.textures.tile_blocks import CodedTile
from farfield.addon.core.bdam.view.caches import encode_targa, to_image_files
from farfield.addon.core.bdam.view.engine import BdamEngine, Update
from farfield.addon.core.bdam.view.extraction import CutSettings
from farfield.addon.core.bdam.view.texture_cuts import square_boxes
from farfield.addon.core.bdam.view.tiles import MAX_TILES, TileMesh, locate_tile
from farfield.addon.core.files.blocks import INDEX_ENTRY_SIZE
from farfield.addon.core.geometry.viewers import Projection, Viewer
from farfield.addon.core.imaging.coded_images import encode
from farfield.addon.core.jobs.progress import run_to_end
from small_terrain_stores import CELL_SIZE, add_texture, build_store, colors, hills

pytest.importorskip("PIL")
pytest.importorskip("zstandard")
SIZE = 145  # samples per side
EXTENT = CELL_SIZE * (SIZE - 1)
HOLE = 93, 23  # the sample at its center, x and y
SHADING = {"texture": "texture", "plain": "slope"}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two stores of the same hills, with and without texture. The field does not fill the root square."""
    heights = hills(SIZE, SIZE)
    heights[HOLE[1] - 3 : HOLE[1] + 3, HOLE[0] - 3 : HOLE[0] + 3] = np.nan
    plain = build_store(tmp_path_factory.mktemp("stores") / "plain", heights)
    return {"plain": plain, "texture": add_texture(build_store(plain.with_name("texture"), heights), colors(1024))}


def look_at(eye, target, is_interactive=False, size=(800, 600)) -> Viewer:
    """A viewer of 50 degrees at `eye` that looks at `target`, neither straight down nor up."""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(right, forward), -forward, eye], axis=1)
    half = math.tan(math.radians(25.0))
    window = (-half, half, -half * size[1] / size[0], half * size[1] / size[0])
    return Viewer(matrix, Projection("perspective", window, size, 1.0, 1e5), is_interactive)


def viewers(seed: int, count: int) -> list[Viewer]:
    random = np.random.default_rng(seed)
    eyes = random.uniform([-EXTENT, -EXTENT, 150.0], [EXTENT, EXTENT, 1500.0], (count, 3))
    return [look_at(eye, [*random.uniform(-300.0, 300.0, 2), 0.0], bool(random.integers(2))) for eye in eyes]


class Scene:
    """What a user would see of an engine: the tiles after every update."""

    def __init__(self, engine: BdamEngine) -> None:
        self.engine = engine
        self.tiles: dict[tuple[int, int, int], TileMesh] = {}
        self.textures: dict[tuple[int, int, int], int | None] = {}
        self.filled = 0

    def move(self, viewer: Viewer) -> Update:
        update = run_to_end(self.engine.move(viewer))
        if update.is_complete:
            self.tiles, self.textures = {}, {}
        self.filled = 0
        while not self.engine.finished_blocks.empty():
            key, block = self.engine.finished_blocks.get_nowait()
            self.tiles[key], self.textures[key] = block.mesh, block.maps and block.maps[0]
            self.filled += 1
        self.tiles = {key: self.tiles[key] for key in update.tiles}
        self.textures = {key: self.textures[key] for key in update.tiles}
        assert self.textures == update.tiles
        return update

    def triangles(self) -> int:
        return sum(len(tile.triangles) for tile in self.tiles.values())


def engine_of(folder, kind="plain", **values) -> BdamEngine:
    return BdamEngine(folder[kind], ViewSettings(**{"shading": SHADING[kind], "tolerance": 8.0, **values}))


def open_edges(scene: Scene) -> np.ndarray:
    """The directed edges (E, 2), as pairs of ids, that have no edge of the opposite direction, over all tiles."""
    corners = np.concatenate([tile.ids[tile.triangles] for tile in scene.tiles.values()])
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    keys, opposite = edges[:, 0] << 32 | edges[:, 1], edges[:, 1] << 32 | edges[:, 0]
    assert len(np.unique(keys)) == len(keys), "two triangles have the same side on one edge"
    return edges[~np.isin(keys, opposite)]


def welded(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ids (V,) of all vertices of all tiles, ascending, their positions (V, 3) float64 and normals (V, 3)."""
    tiles = list(scene.tiles.values())
    ids = np.concatenate([tile.ids for tile in tiles])
    order = np.argsort(ids, kind="stable")
    positions = np.concatenate([tile.location + tile.vertices.astype(np.float64) for tile in tiles])
    return ids[order], positions[order], np.concatenate([tile.normals for tile in tiles])[order]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "exaggeration"), [("plain", 1.0), ("texture", 3.0)])
def test_incremental_updates_show_the_same_as_a_new_engine(folders, kind, exaggeration):
    scene = Scene(engine_of(folders, kind, exaggeration=exaggeration))
    for viewer in viewers(1, 5):
        scene.move(viewer)
        fresh = Scene(engine_of(folders, kind, exaggeration=exaggeration))
        fresh.move(viewer)
        shown, expected = ([np.unique(array, axis=0) for array in welded(item)[:2]] for item in (scene, fresh))
        assert scene.triangles() == fresh.triangles()
        assert all(np.array_equal(first, second) for first, second in zip(shown, expected, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plain", "texture"])
def test_tiles_weld_without_cracks_by_id_position_and_normal(folders, kind):
    scene = Scene(engine_of(folders, kind, exaggeration=1.7))
    levels = set()
    for viewer in viewers(2, 8):
        scene.move(viewer)
        levels |= set(np.concatenate([tile.levels for tile in scene.tiles.values()]).tolist())
        ids, positions, normals = welded(scene)
        is_same = ids[1:] == ids[:-1]
        assert is_same.any() and (positions[1:] == positions[:-1])[is_same].all(), "positions are exact in single precision"
        assert np.allclose(normals[1:][is_same], normals[:-1][is_same], atol=1e-6)
        edges = open_edges(scene)
        x, y = edges % SIZE, edges // SIZE
        is_outer = (np.isin(x, [0, SIZE - 1]) & (x[:, :1] == x)).all(axis=1) | (np.isin(y, [0, SIZE - 1]) & (y[:, :1] == y)).all(axis=1)
        is_near_hole = ((np.abs(x - HOLE[0]) <= 24) & (np.abs(y - HOLE[1]) <= 24)).all(axis=1)
        assert (is_outer | is_near_hole).all()
    assert len(levels) > 2, "the tolerance gives patches of several levels"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plain", "texture"])
def test_there_are_at_most_64_tiles_each_within_its_texture_tile(folders, kind):
    scene = Scene(engine_of(folders, kind, tolerance=0.1))
    for viewer in viewers(3, 6):
        update = scene.move(viewer)
        assert 1 <= len(update.tiles) == update.figures.tiles <= MAX_TILES
        for key, tile in scene.tiles.items():
            if scene.textures[key] is None:
                assert tile.uvs is None
                continue
            index = scene.engine.store.textures.index
            level, position = index.levels[scene.textures[key]], index.tiles[scene.textures[key]]
            assert (np.array(key[1:]) >> (key[0] - level)).tolist() == position.tolist()
            assert (tile.uvs >= 4 / 512 - 1e-6).all() and (tile.uvs <= 508 / 512 + 1e-6).all()


def test_texture_tiles_are_fine_near_the_viewer_and_balanced(folders):
    engine = engine_of(folders, "texture")
    selector, index = engine._select()[1], engine.store.textures.index
    for max_count in (1, 4, 16, MAX_TILES):
        cut = selector.choose(look_at((0.0, -200.0, 250.0), (0.0, 0.0, 0.0)), CutSettings(), max_count)
        assert 1 <= len(cut.numbers) <= max_count
    levels = {key: key[0] for key in cut.numbers}
    assert max(levels.values()) == index.level_count - 1, "the finest level is below the viewer"
    for (level, i, j), (other, k, m) in ((a, b) for a in levels for b in levels):
        side, step = 2.0**-level, 2.0**-other
        touch_x = i * side == (k + 1) * step and max(j * side, m * step) < min((j + 1) * side, (m + 1) * step)
        touch_y = j * side == (m + 1) * step and max(i * side, k * step) < min((i + 1) * side, (k + 1) * step)
        assert not (touch_x or touch_y) or abs(level - other) <= 1


@pytest.mark.parametrize("kind", ["plain", "texture"])
def test_only_changed_tiles_are_filled_again(folders, kind):
    scene = Scene(engine_of(folders, kind))
    first = scene.move(look_at((-600.0, -900.0, 300.0), (0.0, 0.0, 0.0)))
    assert first.is_complete and scene.filled == len(first.tiles)
    again = scene.move(look_at((-600.0, -900.0, 300.0), (0.0, 0.0, 0.0)))
    assert not again.is_complete and scene.filled == 0 and again.tiles == first.tiles
    scene.move(look_at((-598.0, -897.0, 300.0), (0.0, 0.0, 0.0)))
    assert scene.filled <= 2
    scene.engine.invalidate()
    complete = scene.move(look_at((-598.0, -897.0, 300.0), (0.0, 0.0, 0.0)))
    assert complete.is_complete and scene.filled == len(complete.tiles)


def test_a_viewer_that_stays_is_settled_and_one_that_moves_is_not(folders):
    engine = engine_of(folders)
    viewer = look_at((-600.0, -900.0, 800.0), (0.0, 0.0, 0.0), is_interactive=True)
    assert not engine.is_settled_at(viewer)
    run_to_end(engine.move(viewer))
    assert engine.is_settled_at(viewer)
    near = replace(viewer, matrix=viewer.matrix.copy())
    near.matrix[:3, 3] += 0.5
    assert engine.is_settled_at(near)
    far = replace(viewer, matrix=viewer.matrix.copy())
    far.matrix[:3, 3] += 100.0
    assert not engine.is_settled_at(far)
    assert not engine.is_settled_at(look_at((-600.0, -900.0, 800.0), (400.0, 0.0, 0.0), is_interactive=True))
    assert not engine.is_settled_at(replace(viewer, is_interactive=False)), "a render needs what the viewport culls"
    zoomed = replace(viewer.projection, window=tuple(0.5 * side for side in viewer.projection.window))
    assert not engine.is_settled_at(replace(viewer, projection=zoomed))
    engine.invalidate()
    assert not engine.is_settled_at(viewer)


@given(seed=st.integers(0, 10_000), budget=st.integers(3_000, 40_000))
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_budget_is_respected_and_does_not_depend_on_the_past(folders, seed, budget):
    engine = engine_of(folders, "plain", triangle_budget=budget, tolerance=0.2)
    first, second = viewers(seed, 2)
    for viewer in (first, second):
        update = run_to_end(engine.move(viewer))
        assert update.figures.triangles <= budget
        assert update.figures.max_error <= update.figures.tolerance
    fresh = run_to_end(engine_of(folders, "plain", triangle_budget=budget, tolerance=0.2).move(second))
    assert fresh.figures.tolerance == update.figures.tolerance and fresh.figures.triangles == update.figures.triangles


def test_the_default_budget_changes_nothing_below_it(folders):
    viewer = look_at((0.0, 0.0, 200.0), (500.0, 0.0, 100.0))
    for kind in ("plain", "texture"):
        updates = [run_to_end(engine_of(folders, kind, tolerance=0.5, **values).move(viewer)) for values in ({}, {"triangle_budget": 0})]
        assert updates[0].figures == updates[1].figures and updates[0].tiles == updates[1].tiles
        assert updates[0].figures.describe_budget() == ""


def test_what_a_viewport_does_not_show_is_coarse_and_a_render_has_all(folders):
    viewer = look_at((0.0, 0.0, 200.0), (500.0, 0.0, 100.0))
    figures = {}
    for culling in (True, False):
        for is_interactive in (True, False):
            update = run_to_end(engine_of(folders, tolerance=2.0, culling=culling).move(replace(viewer, is_interactive=is_interactive)))
            figures[culling, is_interactive] = update.figures.triangles
    assert figures[True, True] < 0.8 * figures[True, False]
    assert figures[True, False] == figures[False, False] <= figures[False, True]


def test_a_cancelled_move_leaves_a_valid_engine(folders):
    scene = Scene(engine_of(folders))
    scene.move(look_at((-600.0, -900.0, 300.0), (0.0, 0.0, 0.0)))
    steps = scene.engine.move(look_at((500.0, 600.0, 200.0), (0.0, 0.0, 0.0)))
    next(steps), next(steps)
    steps.close()
    scene.engine.invalidate()
    update = scene.move(look_at((500.0, 600.0, 200.0), (0.0, 0.0, 0.0)))
    assert update.is_complete and scene.filled == len(update.tiles)


def test_a_damaged_patch_is_named_and_the_rest_is_shown(folders, tmp_path):
    viewer = look_at((0.0, -100.0, 150.0), (0.0, 0.0, 0.0))
    intact = run_to_end(engine_of(folders).move(viewer))
    for path in folders["plain"].iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    content = bytearray((tmp_path / "geometry.bdam").read_bytes())
    with TerrainStore(tmp_path) as store:
        index_size = INDEX_ENTRY_SIZE * len(store.links.parents)
    for position in range(len(content) // 2, len(content) - index_size, len(content) // 20):
        content[position] ^= 255
    (tmp_path / "geometry.bdam").write_bytes(content)
    with TerrainStore(tmp_path) as store:
        damaged = list(store.verify())
    scene = Scene(engine_of({"plain": tmp_path}))
    update = scene.move(viewer)
    areas = [sum(0.25**level for level, *_ in shown.tiles) for shown in (update, intact)]
    assert damaged and update.warnings and areas[0] == areas[1], "damaged tiles are shown, or finer ones instead"
    assert all(any(f"{name} " in sentence for name in damaged) for sentence in update.warnings)
    assert scene.triangles() > 0


def test_boxes_of_squares_contain_their_patches(folders):
    store = TerrainStore(folders["plain"])
    squares = store.leaf_squares
    for level in range(store.tree.depth + 1):
        every = np.unique(squares[2 * level] >> (store.tree.depth - level), axis=0)
        low, high = square_boxes(store, level, np.concatenate([every, [[99, 99]]]))
        assert np.isinf(low[-1]).all() and (low[:-1] <= high[:-1]).all()
        corners = store.tree.triangle_corners(2 * level, store.levels[2 * level].indices)
        cells = (corners.min(axis=1) * (1 << level)) // store.tree.side
        assert (cells == squares[2 * level] >> (store.tree.depth - level)).all(), "a patch of level 2 s lies in one square of level s"


def test_origins_of_tiles_are_exact_in_single_precision(folders):
    store = TerrainStore(folders["plain"])
    for key in [(0, 0, 0), (2, 1, 3), (store.tree.depth, 4, 2)]:
        location = locate_tile(store, key)
        assert (location == location.astype(np.float32)).all()


def test_raw_tiles_become_targa_files_and_others_stay():
    pixels = np.random.default_rng(1).integers(0, 256, (4, 5, 4), np.uint8)
    file = to_image_files(CodedTile(encode(pixels, "raw"), None)).color
    assert file == encode_targa(pixels) and file[2] == 2 and file[12:18] == bytes([5, 0, 4, 0, 32, 8])
    assert np.frombuffer(file[18:], np.uint8).reshape(4, 5, 4)[..., [2, 1, 0, 3]].tolist() == pixels.tolist()
    coded = CodedTile(encode(pixels[..., :3], "jpeg"), b"alpha")
    assert to_image_files(coded) is coded
