"""The operators: what they create, how terrains follow a viewer, and undo, files and renders."""

import gc
import subprocess
import sys
import time
import weakref

import bpy
import mathutils
import numpy as np
import pytest

from farfield.addon.bridge.clipbox import objects as terrain_objects
from farfield.addon.bridge.geometry.mesh_pool import spare_meshes
from farfield.addon.core.clipbox import engine as engine_module
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.generators import Sampler
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators import following
from farfield.addon.operators.clipbox import job as clipbox_job
from farfield.addon.operators.engine_cache import cache
from farfield.addon.operators.following import Following, recenter
from farfield.addon.operators.job_run import run_job
from lib import command_line, environment
from scene_terrain import SMALL, camera_at, create, geometry_bytes

pytestmark = pytest.mark.usefixtures("empty_scene")


def follow(terrain, position):
    """Let the terrain follow to `position`, in ticks."""
    run = Following(terrain)
    while not run.tick(np.array(position, np.float64)):
        time.sleep(0.001)
    run.close()
    return run


def create_at(position):
    bpy.context.scene.camera.location = position
    bpy.context.view_layer.update()
    return create()


def ground_group(terrain):
    """The group node of the terrain material."""
    return next(node for node in terrain.material.node_tree.nodes if node.type == "GROUP")


def test_undo_before_meshes_are_shown_leaves_nothing_behind():
    job = clipbox_job.prepare(ClipboxSettings(**SMALL), np.array([0.0, 0.0, 10.0]))
    steps = job.scene_steps(run_to_end(job.core_steps()))
    next(step for step in steps if step.label == "Showing meshes")
    bpy.data.batch_remove(spare_meshes(terrain_objects.POOL))  # as before undo
    before = set(bpy.data.objects)
    with pytest.raises(GeometryError, match="Undo has removed"):
        next(steps)
    assert set(bpy.data.objects) == before and job.terrain is None


def test_terrain_is_created_around_the_camera_from_regular_meshes():
    camera_at(3.0, 4.0, 20.0)
    terrain = create()
    assert terrain.viewer.tolist() == [3.0, 4.0, 20.0]
    for block in terrain.blocks().values():
        assert block.parent == terrain.root and block.type == "MESH" and not block.modifiers
        assert not block.data.validate() and block.data.has_custom_normals
        assert block.data.materials[0] == terrain.material


def test_the_numbers_of_the_material_are_inputs_with_defaults():
    camera_at(3.0, 4.0, 20.0)
    group = ground_group(create())
    sockets = {item.name: item for item in group.node_tree.interface.items_tree if item.in_out == "INPUT"}
    assert {"Rock", "Grass", "Snow Height", "Rock Slope", "Slope Noise", "Water Height", "Roughness"} <= set(sockets)
    assert sockets["Slope Noise"].default_value == pytest.approx(0.35) == group.inputs["Slope Noise"].default_value
    assert all(group.node_tree.nodes["Group Input"].outputs[name].is_linked for name in sockets)


def test_water_is_at_its_level_and_goes_with_update():
    camera_at(3.0, 4.0, 20.0)
    terrain = create(water=True, water_level=5.0)
    heights = [vertex.co.z + terrain.origin[2] for vertex in terrain.water.data.vertices]
    assert heights == [5.0] * 4
    assert ground_group(terrain).inputs["Water Height"].default_value == pytest.approx(5.0 - terrain.origin[2])
    bpy.ops.farfield.clipbox_update("EXEC_DEFAULT", **SMALL, water=False)
    assert terrain.water is None
    assert ground_group(terrain).inputs["Water Height"].default_value < -1e5


def test_blocky_terrain_is_flat_shaded():
    camera_at(0.0, 0.0, 20.0)
    for block in create(surface="blocky").blocks().values():
        assert not block.data.has_custom_normals and block.data.polygons[0].use_smooth is False


def test_unset_properties_come_from_the_panel():
    camera_at(0.0, 0.0, 20.0)
    panel = bpy.context.scene.farfield_clipbox
    panel.terrain, panel.resolution, panel.boxes, panel.seed = "islands", 32, 2, 9
    assert bpy.ops.farfield.clipbox_create() == {"FINISHED"}
    [terrain] = terrain_objects.SceneTerrain.in_scene(bpy.context.scene)
    assert (terrain.settings.terrain, terrain.settings.boxes, terrain.settings.seed) == ("islands", 2, 9)


def test_solid_view_shows_the_color_of_the_ground():
    terrain = create()
    shown, grass = terrain.material.diffuse_color, ground_group(terrain).inputs["Grass"].default_value
    assert shown[1] > 1.2 * shown[0] > 2.0 * shown[2], "grass is green"
    assert [shown[i] / grass[i] for i in range(3)] == pytest.approx([shown[0] / grass[0]] * 3), "it has the hue that renders have"


def test_update_rebuilds_the_terrain_and_keeps_its_material():
    camera_at(0.0, 0.0, 20.0)
    terrain = create()
    material = bpy.data.materials.new("Mine")
    for block in terrain.blocks().values():
        block.data.materials[0] = material
    before = geometry_bytes(terrain)
    bpy.context.view_layer.objects.active = terrain.root
    assert bpy.ops.farfield.clipbox_update(**(SMALL | {"seed": 5})) == {"FINISHED"}
    after = geometry_bytes(terrain)
    assert before != after and terrain.settings.seed == 5 and len(terrain_objects.SceneTerrain.in_scene(bpy.context.scene)) == 1
    assert all(block.data.materials[0] == material for block in terrain.blocks().values())


@pytest.mark.slow
def test_ticks_show_the_same_as_a_build_from_scratch():
    camera_at(0.0, 0.0, 20.0)
    terrain = create()
    mesh_count = len(bpy.data.meshes)
    for position in ((1.0, 0.0, 20.0), (4.0, -7.0, 22.0), (60.0, 0.0, 10.0), (0.0, 0.0, 20.0)):
        assert follow(terrain, position).moves == 1
        fresh = create_at(position)
        assert geometry_bytes(terrain) == geometry_bytes(fresh)
        bpy.data.objects.remove(fresh.root)
    assert terrain.viewer.tolist() == [0.0, 0.0, 20.0] and mesh_count > 0


@pytest.mark.slow
def test_meshes_are_reused():
    camera_at(0.0, 0.0, 20.0)
    terrain = create()
    for step in range(1, 5):
        follow(terrain, (float(step), 0.0, 20.0))
    mesh_count = len(bpy.data.meshes)
    for step in range(5, 25):
        follow(terrain, (float(step), 0.0, 20.0))
    assert len(bpy.data.meshes) <= mesh_count + 12


@pytest.mark.slow
def test_terrains_are_independent():
    camera_at(0.0, 0.0, 20.0)
    first, second = create(), create(terrain="islands")
    before = geometry_bytes(first)
    second.root.location.x = 500.0
    bpy.context.view_layer.update()
    follow(second, (9.0, 0.0, 20.0))
    assert geometry_bytes(first) == before and first.settings.terrain == "cascades"
    follow(first, (9.0, 0.0, 20.0))
    assert geometry_bytes(first) != before


def test_the_viewer_position_is_relative_to_the_root():
    camera_at(0.0, 0.0, 20.0)
    terrain = create()
    terrain.root.matrix_world = mathutils.Matrix.LocRotScale((10.0, 0.0, 0.0), mathutils.Euler((0.0, 0.0, np.pi / 2)), (2.0, 2.0, 2.0))
    bpy.context.view_layer.update()
    assert np.allclose(terrain.viewer_position(mathutils.Matrix.Translation((10.0, 6.0, 8.0))), [3.0, 0.0, 4.0], atol=1e-5)


def test_far_from_the_origin_the_root_is_near_the_viewer():
    camera_at(0.0, 0.0, 20.0)
    terrain = create(formula="-z", terrain="formula")
    assert terrain.origin.tolist() == [0.0, 0.0, 0.0]
    bpy.context.scene.camera.location = (1.0e7, 3.0, 20.0)
    bpy.context.view_layer.update()
    far = create(formula="-z", terrain="formula")
    assert far.origin.tolist() == [1.0e7, 0.0, 0.0]
    assert np.abs([vertex.co for block in far.blocks().values() for vertex in block.data.vertices]).max() < 200.0


def test_a_terrain_follows_after_saving_and_loading(tmp_path):
    camera_at(0.0, 0.0, 20.0)
    name = create().name
    path = str(tmp_path / "würfel.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert len(cache) == 0
    bpy.ops.wm.open_mainfile(filepath=path)
    terrain = terrain_objects.SceneTerrain(name)
    recenter(terrain, np.array([30.0, 0.0, 20.0]))
    fresh = create_at((30.0, 0.0, 20.0))
    assert geometry_bytes(terrain) == geometry_bytes(fresh)


def test_all_blocks_are_shown_again_after_undo():
    bpy.context.preferences.edit.use_global_undo = True
    camera_at(0.0, 0.0, 20.0)
    terrain = create()
    bpy.ops.ed.undo_push(message="before")
    follow(terrain, (8.0, 0.0, 20.0))
    moved = geometry_bytes(terrain)
    bpy.ops.ed.undo_push(message="followed")
    if bpy.ops.ed.undo.poll():
        bpy.ops.ed.undo()
    follow(terrain, (16.0, 0.0, 20.0))
    follow(terrain, (8.0, 0.0, 20.0))
    assert geometry_bytes(terrain) == moved


def test_a_height_map_is_colored_by_its_ground_image(tmp_path):
    camera_at(0.0, 0.0, 20.0)
    np.save(tmp_path / "höhe.npy", np.fromfunction(lambda y, x: 0.1 * x + 0.0 * y, (32, 64)))
    image = bpy.data.images.new("Ground", 8, 4)
    image.filepath_raw, image.file_format = str(tmp_path / "grün.png"), "PNG"
    image.save()
    files = {"source": str(tmp_path / "höhe.npy"), "source_color": str(tmp_path / "grün.png"), "source_size": 64.0}
    terrain = create(terrain="heights", **files)
    nodes = terrain.material.node_tree.nodes
    ground_image = next(node for node in nodes if node.label == "Ground Image")
    assert ground_image.image.filepath.endswith("grün.png")
    assert {link.to_socket.name for link in ground_image.outputs["Color"].links} == {
        "Rock",
        "Strata",
        "Scree",
        "Grass",
        "Undergrowth",
        "Dry Grass",
        "Sand",
        "Snow",
    }
    scale = next(node for node in nodes if node.type == "VECT_MATH" and node.operation == "MULTIPLY")
    assert np.allclose(scale.inputs[1].default_value, [1.0 / 64.0, 1.0 / 32.0, 0.0])
    assert ground_group(terrain).outputs["Shader"].is_linked
    with pytest.raises(RuntimeError, match="does not exist; check the path"):
        create(terrain="heights", **(files | {"source_color": str(tmp_path / "nowhere.png")}))


@pytest.mark.slow
def test_relative_paths_are_stored_so_that_they_stay_valid(tmp_path, monkeypatch):
    camera_at(0.0, 0.0, 20.0)
    monkeypatch.chdir(tmp_path)
    np.save("map.npy", np.fromfunction(lambda y, x: 0.1 * x + 0.0 * y, (32, 64)))
    assert create(terrain="heights", source="map.npy").settings.source == str(tmp_path / "map.npy")
    with pytest.raises(RuntimeError, match=f'The file "{tmp_path / "nowhere.npy"}" does not exist'):
        create(terrain="heights", source="nowhere.npy")
    with pytest.raises(RuntimeError, match=r'"//map\.npy" is relative to the \.blend file, which was never saved'):
        create(terrain="heights", source="//map.npy")
    with pytest.raises(RuntimeError, match=r'"//map\.png" is relative to the \.blend file'):
        create(terrain="heights", source="map.npy", source_color="//map.png")
    assert create(terrain="cascades", source="//unused.npy").settings.source == "//unused.npy"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    terrain = create(terrain="heights", source="//map.npy")
    assert terrain.settings.source == "//map.npy"
    recenter(terrain, np.array([30.0, 0.0, 20.0]))


def test_a_ground_image_that_cannot_be_looked_up_is_a_sentence(tmp_path):
    camera_at(0.0, 0.0, 20.0)
    np.save(tmp_path / "map.npy", np.eye(32))
    with pytest.raises(RuntimeError, match="File name too long; choose a shorter name"):
        create(terrain="heights", source=str(tmp_path / "map.npy"), source_color=str(tmp_path / ("a" * 300 + ".png")))


def test_steep_ground_of_a_forest_is_green(tmp_path):
    camera_at(0.0, 0.0, 30.0)
    solid = np.zeros((12, 12, 20), bool)
    solid[4:8, 4:8], solid[:, :, 12:] = True, True
    np.save(tmp_path / "baum.npy", solid)
    forest = create(terrain="forest", source=str(tmp_path / "baum.npy"))
    sine = create(terrain="sine")
    red, green, blue, _ = rock = ground_group(forest).inputs["Rock"].default_value
    assert green > 1.3 * max(red, blue) and tuple(ground_group(sine).inputs["Rock"].default_value) != tuple(rock)
    bpy.data.objects["Camera"].location = (400.0, 0.0, 30.0)
    bpy.context.view_layer.update()
    follow(forest, (400.0, 0.0, 30.0))
    assert forest.blocks()


class TestEngineCache:
    """The cache of engines, which hold the voxels."""

    def test_a_renamed_terrain_keeps_its_engine(self):
        camera_at(0.0, 0.0, 20.0)
        terrain = create()
        engine = cache.get(terrain)
        terrain.root.name = "Hills"
        bpy.context.view_layer.update()
        renamed = terrain_objects.SceneTerrain("Hills")
        assert terrain.root is None and cache.get(renamed) is engine and len(cache) == 1
        assert follow(renamed, (9.0, 0.0, 20.0)).moves == 1

    @pytest.mark.slow
    @pytest.mark.parametrize("operator", ["remove", "delete", "convert"])
    def test_the_engine_of_a_removed_terrain_is_evicted(self, operator):
        camera_at(0.0, 0.0, 20.0)
        terrain = create()
        engine = weakref.ref(cache.get(terrain))
        if operator == "remove":
            terrain_objects.remove(terrain)
        elif operator == "delete":
            for item in [terrain.root, *terrain.blocks().values()]:
                item.select_set(True)
            bpy.ops.object.delete()
        else:
            assert bpy.ops.farfield.clipbox_convert_to_mesh(collider=False) == {"FINISHED"}
        bpy.context.view_layer.update()
        gc.collect()
        assert len(cache) == 0 and engine() is None

    @pytest.mark.slow
    def test_many_terrains_leave_no_memory_or_followings(self):
        camera_at(0.0, 0.0, 20.0)
        data = (bpy.data.objects, bpy.data.collections, bpy.data.meshes)
        counts = [len(collection) for collection in data]
        for index in range(12):
            terrain = create(boxes=2, resolution=32, seed=index)
            assert len(cache) == 1
            follow(terrain, (20.0, 0.0, 20.0))
            terrain_objects.remove(terrain)
            bpy.context.view_layer.update()
            assert len(cache) == 0 and not following.running()
            bpy.data.batch_remove([mesh for mesh in bpy.data.meshes if mesh.users == 0])
            if index == 5:
                peak = command_line.peak_memory_mb()
        assert [len(collection) for collection in data] == counts
        assert command_line.peak_memory_mb() < peak + 20.0


class TestErrors:
    """Terrains that cannot be built."""

    @pytest.fixture
    def failing_terrain(self, monkeypatch):
        state = {"fails": False}

        def densities(grid):
            if state["fails"]:
                raise ValueError("no more")
            x, y, z = grid.coordinates()
            return 3.0 * np.sin(x / 9.0) - z + 0.0 * y

        monkeypatch.setattr(engine_module, "build_sampler", lambda *_: Sampler("failing", densities))
        return state

    def test_a_failed_move_changes_nothing(self, failing_terrain):
        camera_at(0.0, 0.0, 2.0)
        job = clipbox_job.prepare(ClipboxSettings(**SMALL), np.zeros(3))
        run_to_end(run_job(job))
        before = geometry_bytes(job.terrain)
        failing_terrain["fails"] = True
        with pytest.raises(GeometryError, match="no more"):
            follow(job.terrain, (9.0, 0.0, 0.0))
        assert geometry_bytes(job.terrain) == before
        failing_terrain["fails"] = False
        follow(job.terrain, (9.0, 0.0, 0.0))
        assert geometry_bytes(job.terrain) != before

    def test_boxes_without_surface_are_an_error_and_create_nothing(self):
        camera_at(0.0, 0.0, 2.0)
        with pytest.raises(RuntimeError, match="no surface"):
            bpy.ops.farfield.clipbox_create(**(SMALL | {"terrain": "formula", "formula": "-1"}))
        assert not terrain_objects.SceneTerrain.in_scene(bpy.context.scene) and not bpy.data.meshes

    def test_an_invalid_formula_is_an_error(self):
        with pytest.raises(RuntimeError, match="not allowed"):
            bpy.ops.farfield.clipbox_create(terrain="formula", formula="__import__('os')")

    def test_operators_are_disabled_without_a_terrain(self):
        assert not bpy.ops.farfield.clipbox_update.poll() and not bpy.ops.farfield.clipbox_follow_view.poll()


@pytest.mark.slow
def test_frames_of_an_animation_equal_single_renders(tmp_path):
    """Four frames of a flight, in one run and one of them in another process: the images are identical."""
    camera = camera_at(0.0, 0.0, 90.0)
    camera.rotation_euler = (0.9, 0.0, 0.0)
    for frame in (1, 10):
        camera.location = (8.0 * frame, 12.0 * frame, 90.0)
        camera.keyframe_insert("location", frame=frame)
    bpy.context.scene.frame_set(1)
    terrain = create(boxes=5)
    terrain.root.farfield_clipbox_follow_camera = True
    scene = bpy.context.scene
    scene.frame_end = 4
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.device = 1, "CPU"
    scene.cycles.use_denoising = False
    scene.render.resolution_x, scene.render.resolution_y = 48, 32
    bpy.context.collection.objects.link(bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN")))
    path = tmp_path / "flight.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    code = """
import sys
sys.path.insert(0, sys.argv[1])
from lib import environment
package = environment.import_farfield()
import bpy
package.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[2])
scene = bpy.context.scene
scene.frame_start, scene.frame_end = int(sys.argv[4]), int(sys.argv[5])
scene.render.filepath = sys.argv[3]
bpy.ops.render.render(animation=True)
package.unregister()
"""

    def render(first, last, folder):
        arguments = [sys.executable, "-c", code, str(environment.ROOT / "scripts"), str(path), f"{folder}/", str(first), str(last)]
        outcome = subprocess.run(arguments, capture_output=True, text=True, check=False)
        assert outcome.returncode == 0, outcome.stderr

    render(1, 4, tmp_path / "all")
    scene.frame_start = scene.frame_end = 3
    scene.render.filepath = f"{tmp_path / 'single'}/"
    bpy.ops.render.render(animation=True)
    images = {frame: read_pixels(tmp_path / "all" / f"{frame:04}.png") for frame in range(1, 5)}
    assert np.array_equal(images[3], read_pixels(tmp_path / "single" / "0003.png"))
    assert all(not np.array_equal(images[frame], images[frame + 1]) for frame in range(1, 4))


def read_pixels(path):
    image = bpy.data.images.load(str(path))
    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels
