"""The cut of a camera path satisfies the tolerance in every frame, and meshes of cuts have no cracks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.bdam.settings import ViewSettings
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view import freezing
from farfield.addon.core.bdam.view.extraction import Cut, CutSettings, ProjectedErrors, extract_cut, extract_union_cut
from farfield.addon.core.bdam.view.freezing import FrozenMesh, choose_path_cut, describe_limit, freeze_cut, join
from farfield.addon.core.bdam.view.texture_cuts import TextureSelector
from farfield.addon.core.bdam.view.tile_maps import StoreMaps
from farfield.addon.core.geometry.viewers import Projection, Viewer
from farfield.addon.core.jobs.progress import run_to_end
from small_terrain_stores import CELL_SIZE, add_texture, build_cut_mesh, build_store, colors, hills
from watertight import open_edges

pytest.importorskip("PIL")
pytest.importorskip("zstandard")
SIZE = 129
EXTENT = 0.5 * CELL_SIZE * (SIZE - 1)


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    """Stores of the same hills, "plain" and with "texture"."""
    folder = tmp_path_factory.mktemp("stores")
    build_store(folder / "plain", hills(SIZE, SIZE))
    add_texture(build_store(folder / "texture", hills(SIZE, SIZE)), colors(2048))
    opened = {name: TerrainStore(folder / name) for name in ("plain", "texture")}
    yield opened
    for store in opened.values():
        store.close()


def path(seed: int, count: int) -> list[Viewer]:
    """Viewers along a line over the terrain, which look forward and down."""
    random = np.random.default_rng(seed)
    ends = random.uniform([-EXTENT, -EXTENT, 150.0], [EXTENT, EXTENT, 800.0], (2, 3))
    half = math.tan(math.radians(25.0))
    projection = Projection("perspective", (-half, half, -0.75 * half, 0.75 * half), (800, 600), 1.0, 1e5)
    tilt = random.uniform(0.0, 1.2)
    viewers = []
    for fraction in np.linspace(0.0, 1.0, count):
        matrix = np.eye(4)
        matrix[1:3, 1:3] = [[math.cos(tilt), -math.sin(tilt)], [math.sin(tilt), math.cos(tilt)]]
        matrix[:3, 3] = ends[0] + fraction * (ends[1] - ends[0])
        viewers.append(Viewer(matrix, projection))
    return viewers


def patches(cut: Cut) -> list[tuple[int, int]]:
    return sorted(zip(cut.levels.tolist(), cut.rows.tolist(), strict=True))


def are_open_edges_on_border(x: np.ndarray, y: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether edges with one triangle are on the border of the field. x, y: (V,) from -1 to 1."""
    edges = open_edges(triangles)
    on_border = [(np.abs(np.abs(axis[edges]) - 1.0) < 1e-6).all(axis=1) & (np.abs(np.ptp(axis[edges], axis=1)) < 1e-6) for axis in (x, y)]
    return bool(len(edges)) and bool((on_border[0] | on_border[1]).all())


@pytest.mark.slow
@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 6), tolerance=st.floats(0.3, 30.0), exaggeration=st.floats(0.2, 5.0))
def test_the_union_cut_satisfies_every_frame_without_cracks(stores, seed, count, tolerance, exaggeration):
    store, viewers, cut_settings = stores["plain"], path(seed, count), CutSettings(tolerance, exaggeration)
    cut = run_to_end(extract_union_cut(store, viewers, cut_settings))
    numbers = cut.rows + store.links.starts[cut.levels]
    errors = [ProjectedErrors(store, viewer, cut_settings)(numbers).max() for viewer in viewers]
    assert max(errors) == cut.max_error <= tolerance
    mesh = build_cut_mesh(store, cut)
    assert are_open_edges_on_border(*(mesh.positions[:, :2].T / EXTENT), mesh.triangles)


@pytest.mark.slow
@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_union_cut_of_one_frame_is_its_cut(stores, seed):
    (viewer,) = path(seed, 1)
    cut_settings = CutSettings(2.0)
    expected, found = (
        extract_cut(stores["plain"], viewer, cut_settings),
        run_to_end(extract_union_cut(stores["plain"], [viewer], cut_settings)),
    )
    assert patches(found) == patches(expected)
    assert found.max_error == pytest.approx(expected.max_error, rel=1e-12)  # matrix products of other lengths round differently


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_union_cut_refines_only_what_a_frame_refines(stores, seed):
    store, viewers, cut_settings = stores["plain"], path(seed, 4), CutSettings(4.0)

    def ancestors(cut: Cut) -> set[tuple[int, int]]:
        found = set()
        for level, row in patches(cut):
            index = int(store.levels[level].indices[row])
            found |= {(level - step, index >> step) for step in range(1, level + 1)}
        return found

    of_frames = set().union(*(ancestors(extract_cut(store, viewer, cut_settings)) for viewer in viewers))
    assert ancestors(run_to_end(extract_union_cut(store, viewers, cut_settings))) == of_frames


def freeze(store: TerrainStore, viewers: list[Viewer], **values) -> tuple[Cut, list[FrozenMesh]]:
    view_settings = ViewSettings(**{"tolerance": 4.0, **values})
    textures, cut = run_to_end(choose_path_cut(store, viewers, view_settings))
    meshes, damages = run_to_end(freeze_cut(store, textures, cut, view_settings.exaggeration))
    assert not damages
    return cut, meshes


@pytest.mark.parametrize("name", [pytest.param("plain", marks=pytest.mark.exhaustive), "texture"])
def test_joined_meshes_have_the_vertices_of_the_cut_and_no_cracks(stores, name):
    store = stores[name]
    cut, meshes = freeze(store, path(3, 5), exaggeration=2.0)
    expected_mesh = build_cut_mesh(store, cut)
    joined = join(meshes)
    positions = joined.vertices.astype(np.float64) + joined.location
    assert len(positions) == len(expected_mesh.positions) and len(joined.triangles) == len(expected_mesh.triangles)
    order, expected = np.lexsort(positions.T[:2]), expected_mesh.positions[np.lexsort(expected_mesh.positions.T[:2])] * [1.0, 1.0, 2.0]
    assert np.allclose(positions[order], expected, atol=0.01)
    assert are_open_edges_on_border(*(positions[:, :2].T / EXTENT), joined.triangles)
    assert np.array_equal(np.sort(joined.levels), np.sort(expected_mesh.levels))
    assert len(joined.slots) == len(joined.triangles) and joined.slots.max() == len(joined.materials) - 1


def test_textures_of_a_path_are_as_fine_as_those_of_every_frame(stores):
    store, viewers = stores["texture"], path(11, 5)
    view_settings = ViewSettings(tolerance=1.0)
    levels = {}
    for index, part in enumerate([viewers, *([viewer] for viewer in viewers)]):
        textures, _ = run_to_end(choose_path_cut(store, part, view_settings))
        finest = max(level for level, _, _ in textures.numbers)
        size = 1 << finest
        grid = np.zeros((size, size), int)
        for level, i, j in textures.numbers:
            step = size >> level
            grid[i * step : (i + 1) * step, j * step : (j + 1) * step] = level
        levels[index] = np.kron(grid, np.ones((64 // size, 64 // size), int))
    assert all((levels[0] >= levels[index]).all() for index in range(1, 6)) and levels[0].max() > 0
    _, meshes = freeze(store, viewers, tolerance=1.0)
    assert all(mesh.uvs is not None and mesh.uvs.min() >= 0.0 and mesh.uvs.max() <= 1.0 for mesh in meshes)
    assert {mesh.materials[0] for mesh in meshes} == set(run_to_end(choose_path_cut(store, viewers, view_settings))[0].numbers.values())


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.integers(1, 5), st.sampled_from([1, 4, 7, 16, 64]), st.floats(0.1, 20.0))
def test_a_path_has_a_limited_number_of_textures_that_keep_their_stated_tolerance(stores, seed, count, max_count, tolerance):
    store, viewers = stores["texture"], path(seed, count)
    selector = TextureSelector(store, StoreMaps(store, has_color=True))
    chosen = run_to_end(selector.choose_for_path(viewers, CutSettings(tolerance), max_count))
    assert 1 <= len(chosen.numbers) <= max_count and chosen.tolerance >= tolerance
    refined = [{tuple(square) for square in squares.tolist()} for squares in chosen.refined]
    for viewer in viewers:
        single = selector.choose(viewer, CutSettings(chosen.tolerance), 10**6)
        assert single.tolerance == chosen.tolerance
        assert all({tuple(square) for square in squares.tolist()} <= other for squares, other in zip(single.refined, refined, strict=True))
    if count == 1:
        assert chosen.numbers == selector.choose(viewers[0], CutSettings(tolerance), max_count).numbers


def test_too_few_textures_for_a_path_are_reported(stores, monkeypatch):
    store, viewers, view_settings = stores["texture"], path(11, 5), ViewSettings(tolerance=1.0)
    textures, _ = run_to_end(choose_path_cut(store, viewers, view_settings))
    assert textures.tolerance == 1.0 and describe_limit(textures, view_settings) == ""
    monkeypatch.setattr(freezing, "MAX_TILES", 4)
    textures, cut = run_to_end(choose_path_cut(store, viewers, view_settings))
    assert len(textures.numbers) <= 4 and textures.tolerance > 1.0
    assert f"limited to 4 tiles, so that texels cover up to {textures.tolerance:.3g} pixels" in describe_limit(textures, view_settings)
    meshes, _ = run_to_end(freeze_cut(store, textures, cut, 1.0))
    assert {mesh.materials[0] for mesh in meshes} == set(textures.numbers.values()) and len(meshes) <= 64
    untextured, _ = run_to_end(choose_path_cut(stores["plain"], viewers, view_settings))
    assert describe_limit(untextured, view_settings) == ""


def test_joining_keeps_the_slots_of_materials(stores):
    _, meshes = freeze(stores["plain"], path(5, 1), shading="slope")
    meshes = [replace(mesh, materials=(f"M{index % 2}",)) for index, mesh in enumerate(meshes)]
    joined = join([*meshes, *meshes])
    counts = [sum(len(mesh.triangles) for mesh in meshes[start::2]) for start in range(2)]
    assert np.bincount(joined.slots, minlength=2).tolist() == [2 * count for count in counts]
    assert len(joined.vertices) == len(join(meshes).vertices)
