"""Normal maps of large terrain: what they hold, where tiles find them, and that coarse triangles are shaded like the finest ones."""

from contextlib import contextmanager

import bpy
import numpy as np
import pytest

from farfield.addon.bridge.bdam import materials
from farfield.addon.bridge.bdam import objects as terrain_objects
from farfield.addon.bridge.bdam.materials import find_surface
from farfield.addon.bridge.bdam.objects import TerrainChange
from farfield.addon.bridge.rendering.render_scene import prepare_cycles, render_scene
from farfield.addon.core.bdam.building import texture_stage
from farfield.addon.core.bdam.building.height_grid import HeightGrid, encode_heights
from farfield.addon.core.bdam.building.sample_normals import SampleNormals
from farfield.addon.core.bdam.building.terrain_build import build_terrain
from farfield.addon.core.bdam.settings import BdamSettings, ViewSettings
from farfield.addon.core.bdam.store import curvature
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.textures.grid import BORDER, STEP, TILE_SIZE
from farfield.addon.core.bdam.view.engine import BdamEngine
from farfield.addon.core.bdam.view.tile_maps import StoreMaps
from farfield.addon.core.geometry.placements import GeographicFrame
from farfield.addon.core.geometry.viewers import Projection, Viewer
from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from farfield.addon.core.jobs.progress import run_to_end
from small_terrain_stores import CELL_SIZE, ArrayField, add_texture, colors, hills

pytest.importorskip("PIL")
PRECISION = 0.013  # Of a component of a normal, from one byte to the next.


def build(folder, heights):
    """Build the store of heights (rows, columns) in meters, with normal maps."""
    settings = BdamSettings(patch_size="16", height_step=0.01, executor="serial")
    run_to_end(build_terrain(ArrayField(heights), [], folder, settings))
    return folder


def read_normals(store, number):
    """The components (512, 512, 2) along x and y in a tile."""
    return 2.0 * LINEAR_OF_BYTE.take(store.normals.read(number)[..., :2]) - 1.0


@pytest.mark.slow
def test_a_plane_has_its_normal_at_all_levels(tmp_path):
    y, x = np.mgrid[0:33, 0:600] * CELL_SIZE
    with TerrainStore(build(tmp_path / "store", 0.6 * x - 0.3 * y)) as store:
        assert store.normals.grid.level_count > 1
        expected = np.array([-0.6, 0.3]) / np.sqrt(1.0 + 0.6**2 + 0.3**2)
        for number in range(len(store.normals)):
            assert np.abs(read_normals(store, number) - expected).max() < PRECISION


def test_coarse_levels_have_the_mean_of_the_finest(tmp_path):
    """Ridges of the same height and direction everywhere keep their mean normal where texels are wider than they are."""
    rise = np.resize([0.0, 9.0, 6.0, 3.0], 600)
    heights = np.tile(rise, (33, 1))
    with TerrainStore(build(tmp_path / "store", heights)) as store:
        gradient = np.gradient(rise, CELL_SIZE)[4:8]
        mean = (-gradient / np.sqrt(1.0 + gradient**2)).mean()
        own = read_normals(store, 0)[BORDER + 2 : BORDER + 14, BORDER + 8 : BORDER + 280]
        assert abs(own[..., 0].mean() - mean) < 0.5 * PRECISION and np.abs(own[..., 1]).max() < PRECISION


def test_normals_of_a_grid_of_degrees_are_those_in_meters(tmp_path):
    frame = GeographicFrame((9.0, 69.0), (3e-4, 1e-4), (9.01, 69.005))
    rows, columns = 40, 60
    y, x = np.mgrid[0:rows, 0:columns]
    east, north = frame.to_local(x, y)
    heights = 0.5 * east + 0.25 * north
    grid = HeightGrid(tmp_path / "heights", rows, columns)
    encode_heights(np.rint(heights / 1e-3), np.ones(heights.shape, bool)).tofile(grid.path)
    source = SampleNormals(grid, frame, 1e-3)
    found = 2.0 * source.read(slice(3, 30), slice(0, columns))[..., :2] - 1.0
    assert np.abs(found - np.array([-0.5, -0.25]) / np.sqrt(1.0 + 0.5**2 + 0.25**2)).max() < 2e-3
    assert np.array_equal(source.read(slice(9, 12), slice(20, 30)), source.read(slice(3, 30), slice(0, columns))[6:9, 20:30])


@pytest.mark.slow
@pytest.mark.parametrize(("pixels", "color_levels"), [(256, 1), pytest.param(2400, 5, marks=pytest.mark.slow)])
def test_a_square_shows_the_part_of_each_map_that_covers_it(tmp_path, pixels, color_levels):
    """A coarse image and finer normal maps, and the other way round, meet in one quadtree."""
    folder = add_texture(build(tmp_path / "store", hills(33, 600)), colors(pixels)[: pixels // 18])
    with TerrainStore(folder) as store:
        assert (store.textures.grid.level_count, store.normals.grid.level_count) == (color_levels, 2)
        maps = StoreMaps(store, has_color=True)
        assert set(StoreMaps(store, has_color=False).stores) == {"normal"}
        for number in range(len(maps.index)):
            level, position = int(maps.index.levels[number]), maps.index.tiles[number]
            cells = (position + [[0.0, 0.0], [0.25, 0.5], [1.0, 1.0]]) * store.tree.side / 2.0**level
            own = (BORDER + STEP * (cells * 2.0**level / store.tree.side - position)) / TILE_SIZE
            for kind, tiles in maps.stores.items():
                found = maps.find(kind, number)
                shown = maps.place(number, found, None)
                tile_level, tile = int(tiles.index.levels[shown.number]), tiles.index.tiles[shown.number]
                expected = (BORDER + STEP * (cells * 2.0**tile_level / store.tree.side - tile)) / TILE_SIZE
                assert np.allclose(shown.scale * own + shown.offset, expected) and level - tile_level == found[1]


@contextmanager
def open_light_table():
    """Yield a scene with a camera above and a Sun, and remove it."""
    with render_scene("Normal Maps") as work:
        prepare_cycles(work.scene, 4, 1)
        work.scene.render.use_persistent_data = False  # The images of one terrain are removed before those of the next one are loaded.
        work.scene.render.resolution_x, work.scene.render.resolution_y = 64, 48
        work.camera.data.type, work.camera.data.ortho_scale, work.camera.data.clip_end = "ORTHO", 600.0, 1e4
        work.camera.location.z = 1000.0
        light = work.own(bpy.data.lights.new("Sun", "SUN"))
        light.energy = 3.0
        work.add_object(light).rotation_euler = (0.6, 0.4, 0.0)
        yield work


def render(work, folder, tolerance, shading="height", has_maps=True, curvature=False):
    """Render a terrain from above as the extension shows it at a tolerance, (48, 64) luminance."""
    settings = ViewSettings(tolerance=tolerance, shading=shading, culling=False, exaggeration=2.0, curvature=curvature)
    engine = BdamEngine(folder, settings)
    if not has_maps:
        engine.store.normals = None
    from_the_side = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, -1000.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    viewer = Viewer(from_the_side, Projection("orthographic", (-300.0, 300.0, -225.0, 225.0), (64, 48), 1.0, 1e4))
    terrain = terrain_objects.create_root(work.scene, str(folder), engine)
    change, update = TerrainChange(terrain, engine), run_to_end(engine.move(viewer))
    while not engine.finished_blocks.empty():
        for _ in change.fill(*engine.finished_blocks.get_nowait()):
            pass
    for _ in change.show(update):
        pass
    for node in (node for group in bpy.data.node_groups for node in group.nodes if node.type == "VALTORGB"):
        for element in node.color_ramp.elements:
            element.color = (0.5, 0.5, 0.5, 1.0)  # Otherwise colors differ with heights.
    picture = work.render()[..., 1]
    materials = {tile.data.materials[0] for tile in terrain.tiles().values()}
    assert all(find_surface(material) is not None for material in materials) or shading == "texture"
    triangles = update.figures.triangles
    terrain_objects.remove(terrain)
    assert not any("farfield_bdam_texture" in image for image in bpy.data.images)
    return picture, triangles


@pytest.mark.usefixtures("empty_scene")
@pytest.mark.parametrize("kind", ["plain", pytest.param("image", marks=pytest.mark.slow)])
def test_coarse_triangles_are_shaded_like_the_finest_ones(tmp_path, kind):
    y, x = np.mgrid[0:129, 0:129]
    folder = build(tmp_path / "store", 10.0 * np.sin(x / 2.5) * np.sin(y / 3.5))
    shading = "height" if kind == "plain" else "texture"
    if kind == "image":
        add_texture(folder, np.full((64, 64, 3), 180, np.uint8))
    with open_light_table() as work:
        full, most = render(work, folder, 0.1, shading, has_maps=False)
        mapped, few = render(work, folder, 30.0, shading)
        plain, _ = render(work, folder, 30.0, shading, has_maps=False)
    assert few < 0.2 * most
    assert full.std() > 0.05 and np.abs(mapped - full).mean() < 0.35 * np.abs(plain - full).mean()


@pytest.mark.slow
@pytest.mark.usefixtures("empty_scene")
def test_curved_ground_is_shaded_as_curved_with_normal_maps_and_without(tmp_path, monkeypatch):
    for module in (curvature, materials):
        monkeypatch.setattr(module, "EARTH_RADIUS", 1500.0)
    folder = build(tmp_path / "store", np.zeros((129, 129)))
    with open_light_table() as work:
        flat, _ = render(work, folder, 1.0)
        mapped, _ = render(work, folder, 1.0, curvature=True)
        plain, _ = render(work, folder, 1.0, has_maps=False, curvature=True)
    assert flat.std() < 0.01 and plain.std() > 0.05
    assert np.abs(mapped - plain).mean() < 0.1 * np.abs(plain - flat).mean()


def test_without_pillow_a_terrain_is_built_without_normal_maps(tmp_path, monkeypatch):
    monkeypatch.setattr(texture_stage, "find_spec", lambda _: None)
    with TerrainStore(build(tmp_path / "store", hills(33, 33))) as store:
        assert store.normals is None
