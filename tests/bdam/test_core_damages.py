"""Damaged stores of large terrain: everything damaged is named, and the rest can be used without cracks."""

import shutil
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.bdam.ground.heights import HeightQuery
from farfield.addon.core.bdam.ground.surfaces import StoreSurface
from farfield.addon.core.bdam.settings import ViewSettings
from farfield.addon.core.bdam.store.patch_links import NO_PATCH, find_limits
from farfield.addon.core.bdam.store.terrain_store import GEOMETRY_FILE, GEOMETRY_KIND, TerrainStore
from farfield.addon.core.bdam.view.cut_files import extract_mesh
from farfield.addon.core.bdam.view.engine import BdamEngine
from farfield.addon.core.bdam.view.extraction import CutSettings, extract_uniform_cut
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.backups import backup_path
from farfield.addon.core.files.blocks import HEADER_SIZE, BlockReader
from farfield.addon.core.geometry.viewers import Projection, Viewer, look_at
from farfield.addon.core.jobs.progress import run_to_end
from small_terrain_stores import CELL_SIZE, add_texture, build_store, colors, hills
from watertight import undirected_edge_counts

pytest.importorskip("PIL")
pytest.importorskip("zstandard")
SIZE = 97  # samples per side
AREA = (CELL_SIZE * (SIZE - 1)) ** 2
FINE, COARSE = CutSettings(1e-3), CutSettings(50.0)


@pytest.fixture(scope="module")
def intact(tmp_path_factory):
    """A store with texture whose field does not fill the root square."""
    return add_texture(build_store(tmp_path_factory.mktemp("stores") / "intact", hills(SIZE, SIZE)), colors(700))


@pytest.fixture(scope="module")
def folder(intact):
    """A copy of the store to damage."""
    return shutil.copytree(intact, intact.with_name("copy"))


@pytest.fixture(scope="module")
def contents(intact):
    """All numbers of the store by the names of patches and texture tiles."""
    with TerrainStore(intact) as store:
        assert store.damages == () and list(store.verify()) == []
        unreadable, contents = read_all(store)
    assert not unreadable
    return contents


@pytest.fixture(scope="module")
def viewer():
    window = (-0.5, 0.5, -0.375, 0.375)
    return Viewer(look_at(np.array([0.0, -900.0, 500.0]), np.zeros(3)), Projection("perspective", window, (800, 600), 1.0, 1e5))


@contextmanager
def damaged(path, content):
    """Give a file another content in the block."""
    before = path.read_bytes()
    path.write_bytes(content)
    try:
        yield
    finally:
        path.write_bytes(before)


def damaged_patches(folder, numbers):
    """Flip a byte of each of these patches in the block."""
    content = bytearray((folder / GEOMETRY_FILE).read_bytes())
    with BlockReader(folder / GEOMETRY_FILE, GEOMETRY_KIND) as reader:
        ends = HEADER_SIZE + np.cumsum(reader.sizes)
    for end in ends[list(numbers)]:
        content[int(end) - 1] ^= 1
    return damaged(folder / GEOMETRY_FILE, content)


def area_of(mesh) -> float:
    """The horizontal area of a mesh, and that it has no crack: the boundary of the union is that of the square."""
    unique, counts = undirected_edge_counts(mesh.triangles)
    assert counts.max() == 2
    ends = np.stack([mesh.ids % SIZE, mesh.ids // SIZE], axis=1)[unique[counts == 1]]
    assert (((ends[:, 0] == ends[:, 1]) & np.isin(ends[:, 0], [0, SIZE - 1])).any(axis=1)).all()
    corners = mesh.positions[mesh.triangles][..., :2]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * float((first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).sum())


@pytest.mark.slow
@settings(max_examples=25)
@given(data=st.data())
def test_a_flipped_byte_anywhere_is_named_and_the_rest_is_usable(intact, contents, folder, viewer, data):
    files = sorted(path.relative_to(intact) for path in intact.rglob("*") if path.is_file())
    name = data.draw(st.sampled_from(files))
    content = bytearray((intact / name).read_bytes())
    place = data.draw(st.integers(0, len(content) - 1) | st.integers(0, min(63, len(content) - 1)))
    content[place] ^= data.draw(st.integers(1, 255))
    with damaged(folder / name, content):
        with TerrainStore(folder) as store:
            (named,) = store.verify()
            unreadable, read = read_all(store)
            assert all(np.array_equal(read[label], contents[label]) for label in read)
            if named in contents:
                assert [named] == list(unreadable) == list(contents.keys() - read.keys()) and named in unreadable[named]
            else:
                assert not unreadable and named in (f'file "{name.name}"', f'index of "{name.name}"')
                assert len(store.damages) == 1 and f'{name.name}" is damaged' in store.damages[0]
        with TerrainStore(folder) as store:
            fine, coarse = (run_to_end(extract_mesh(store, viewer, tolerance)) for tolerance in (FINE, COARSE))
            assert np.isclose(area_of(fine.mesh), AREA) and np.isclose(area_of(coarse.mesh), AREA)
            assert fine.patches > coarse.patches and set(fine.warnings) <= set(coarse.warnings)


def read_all(store: TerrainStore) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """Return the sentences about patches and texture tiles that cannot be read, and the numbers of all others, by name."""
    unreadable, read = {}, {"bounds": store.bounds}
    readers = [
        (store.label(level, row), partial(read_patch, store, level, row))
        for level, patches in enumerate(store.levels)
        for row in range(len(patches.indices))
    ]
    readers += [(store.textures.label(number), partial(read_tile, store, number)) for number in range(len(store.textures))]
    for label, reader in readers:
        try:
            read[label] = reader()
        except FileError as error:
            unreadable[label] = str(error)
    return unreadable, read


def read_patch(store: TerrainStore, level: int, row: int) -> np.ndarray:
    patch = store.read(level, row)
    return np.concatenate([patch.x, patch.y, patch.z, patch.triangles.ravel(), patch.gradients.ravel()])


def read_tile(store: TerrainStore, number: int) -> np.ndarray:
    return np.frombuffer(store.textures.read_coded(number).color, np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["structure.bdam", "structure-backup.bdam", "textures/textures.structure", "textures/textures-backup.tiles"]
)
def test_a_missing_file_that_exists_twice_is_reported_and_costs_nothing(folder, contents, viewer, name):
    path = folder / name
    with moved_away(path):
        with TerrainStore(folder) as store:
            (damage,) = store.file_damages
            assert damage.path == path and list(store.verify()) == [damage.name] and "or missing; nothing is lost" in damage.sentence
            unreadable, read = read_all(store)
            assert not unreadable and all(np.array_equal(read[label], contents[label]) for label in contents)
        assert move(BdamEngine(folder, ViewSettings()), viewer)[0].warnings == (damage.sentence,)


@pytest.mark.slow
def test_without_structure_and_backup_a_folder_is_no_terrain(folder):
    path = folder / "structure.bdam"
    with moved_away(path), moved_away(backup_path(path)), pytest.raises(FileError, match="is no terrain built by Farfield"):
        TerrainStore(folder)


@contextmanager
def moved_away(path):
    """Give a file another name in the block."""
    path.rename(path.with_suffix(".away"))
    try:
        yield
    finally:
        path.with_suffix(".away").rename(path)


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """The store of another terrain with as many patches."""
    return build_store(tmp_path_factory.mktemp("stores") / "other", hills(SIZE, SIZE, seed=2))


@pytest.mark.parametrize("names", [(GEOMETRY_FILE,), (GEOMETRY_FILE, backup_path(Path(GEOMETRY_FILE)).name)])
def test_the_geometry_of_another_terrain_with_as_many_patches_is_refused(folder, other, names):
    with ExitStack() as stack:
        for name in names:
            stack.enter_context(damaged(folder / name, (other / name).read_bytes()))
        with pytest.raises(FileError, match="belong to different terrains; build the terrain again"):
            TerrainStore(folder)
    TerrainStore(folder).close()


@pytest.mark.slow
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12))
def test_cuts_avoid_any_damaged_patches_without_cracks(folder, viewer, seed, count):
    random = np.random.default_rng(seed)
    with TerrainStore(folder) as store:
        numbers = random.choice(np.arange(2, len(store.links.parents)), count, replace=False)
    with damaged_patches(folder, numbers), TerrainStore(folder) as store:
        labels = set(store.verify())
        assert len(labels) == count
        for tolerance in random.permutation([0.01, 1.0, 5.0, 20.0, 100.0]).tolist():
            extracted = run_to_end(extract_mesh(store, viewer, CutSettings(tolerance)))
            assert np.isclose(area_of(extracted.mesh), AREA), "patches replace all damaged ones, as the roots are intact"
            assert all(any(f"{label} " in sentence for label in labels) for sentence in extracted.warnings)


@pytest.mark.slow
@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12))
def test_the_ground_over_damaged_leaves_is_that_of_the_coarser_patches_that_replace_them(folder, seed, count):
    random = np.random.default_rng(seed)
    with TerrainStore(folder) as store:
        points = np.stack(store.frame.to_local(*random.integers(0, SIZE, (2, 400))), axis=1)  # at samples, where errors are measured
        numbers = random.choice(np.arange(*store.links.starts[-2:]), count, replace=False)
        intact_heights, _ = HeightQuery(store).find(points)
    with damaged_patches(folder, numbers), TerrainStore(folder) as store:
        labels = set(store.verify())
        surface = StoreSurface(store, 2.0)
        heights, normals = surface.find(points)
        assert np.isfinite(heights).all() and np.allclose(np.linalg.norm(normals, axis=1), 1.0)
        assert len(surface.damages) == store.damage_count
        assert all(any(f"{label} " in sentence for label in labels) for sentence in surface.damages)
        cut = extract_uniform_cut(store, 0.0)
        assert np.allclose(heights, 2.0 * HeightQuery(store, cut).find(points)[0])
        allowed = cut.max_error + 1e-5 * np.abs(intact_heights).max()
        assert (np.abs(heights / 2.0 - intact_heights) <= allowed).all()
        again, _ = surface.find(points)
        assert np.array_equal(again, heights)


@settings(max_examples=100)
@given(seed=st.integers(0, 2**32 - 1), fraction=st.sampled_from([0.01, 0.1, 0.5, 0.9]))
def test_limits_are_consistent(intact, seed, fraction):
    with TerrainStore(intact) as store:
        links = store.links
    is_damaged = np.random.default_rng(seed).random(len(links.parents)) < fraction
    limits = find_limits(links, is_damaged)
    is_leaf = (links.children == NO_PATCH).all(axis=1)
    is_final = limits.is_blocked | is_leaf
    assert not (limits.is_required & (is_final | ~is_damaged)).any() and not (limits.is_blocked & is_leaf).any()
    assert np.array_equal(is_final[links.partners], is_final)
    below = np.flatnonzero(links.parents != NO_PATCH)
    assert is_final[below[limits.is_blocked[links.parents[below]]]].all()
    shown = below[is_final[below] & ~is_final[links.parents[below]]]
    assert not is_damaged[shown].any(), "the finest patches that can be shown are intact, except for roots"


@pytest.mark.parametrize(("tolerance", "level"), [(0.1, 6), (12.0, 4), (100.0, 1)])
def test_the_engine_replaces_damaged_patches_and_names_them(folder, viewer, tolerance, level):
    with TerrainStore(folder) as store:
        numbers = np.arange(*store.links.starts[level : level + 2])[::2]
    with damaged_patches(folder, numbers):
        with TerrainStore(folder) as store:
            labels = list(store.verify())
        engine = BdamEngine(folder, ViewSettings(tolerance=tolerance, exaggeration=10.0 if level == 6 else 1.0))
        update, meshes = move(engine, viewer)
        assert np.isclose(sum(horizontal_area(mesh) for mesh in meshes), AREA, rtol=1e-5)
        assert all(mesh.uvs.min() >= 0.0 and mesh.uvs.max() <= 1.0 for mesh in meshes), "each patch lies within one texture"
        assert update.warnings and all(any(f"{label} " in sentence for label in labels) for sentence in update.warnings)
        again, none = move(engine, viewer)
        assert not none and again.tiles == update.tiles and again.warnings == update.warnings


def move(engine, viewer):
    """Return the update of a move, and the meshes of the tiles that were filled."""
    update, blocks = run_to_end(engine.move(viewer)), {}
    while not engine.finished_blocks.empty():
        key, block = engine.finished_blocks.get_nowait()
        blocks[key] = block.mesh
    return update, [blocks[key] for key in update.tiles if key in blocks]


def horizontal_area(mesh) -> float:
    """The area in square meters that a mesh covers seen from above."""
    corners = mesh.vertices[mesh.triangles][..., :2].astype(np.float64)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * float((first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).sum())


def test_a_terrain_of_damaged_patches_only_shows_nothing(folder, viewer):
    with TerrainStore(folder) as store:
        numbers = range(len(store.links.parents))
    with damaged_patches(folder, numbers):
        with TerrainStore(folder) as store, pytest.raises(FileError, match="No patch of"):
            run_to_end(extract_mesh(store, viewer, FINE))
        update, meshes = move(BdamEngine(folder, ViewSettings()), viewer)
        assert update.warnings and not any(len(mesh.triangles) for mesh in meshes)
