"""The operators: what they make, how terrains follow, and what undo, files and renders leave of them."""

import subprocess
import sys
import time

import bpy
import mathutils
import numpy as np
import pytest

import environment
from farfield.addon.bridge import terrain_objects
from farfield.addon.core.clipbox import terrains
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.progress import finish
from farfield.addon.operators import clipbox_job
from farfield.addon.operators.clipbox_following import Following, follow_at_once
from farfield.addon.operators.long_work import whole
from standing_terrain import SMALL, camera_at, create, shape_of

pytestmark = pytest.mark.usefixtures("empty_scene")


def followed(standing, place):
    """The terrain after it has followed to `place`, in ticks."""
    following = Following(standing)
    while not following.tick(np.array(place, np.float64)):
        time.sleep(0.001)
    following.close()
    return following


def test_it_is_made_about_the_camera_of_blocks_that_need_no_farfield():
    camera_at(3.0, 4.0, 20.0)
    standing = create()
    assert standing.viewer.tolist() == [3.0, 4.0, 20.0]
    for block in standing.blocks().values():
        assert block.parent == standing.root and block.type == "MESH" and not block.modifiers
        assert not block.data.validate() and block.data.has_custom_normals
        assert block.data.materials[0] == standing.material
    groups = [node.node_tree for node in standing.material.node_tree.nodes if node.type == "GROUP"]
    assert len(groups) == 1 and {"Rock", "Grass", "Snow Height", "Steep"} <= {item.name for item in groups[0].interface.items_tree}


def test_blocky_terrain_is_flat_shaded():
    camera_at(0.0, 0.0, 20.0)
    for block in create(surface="blocky").blocks().values():
        assert not block.data.has_custom_normals and block.data.polygons[0].use_smooth is False


def test_settings_come_from_the_panel():
    camera_at(0.0, 0.0, 20.0)
    panel = bpy.context.scene.farfield_clipbox
    panel.terrain, panel.resolution, panel.boxes, panel.seed = "islands", 32, 2, 9
    assert bpy.ops.farfield.clipbox_create() == {"FINISHED"}
    [standing] = terrain_objects.standing_terrains(bpy.context.scene)
    assert (standing.settings.terrain, standing.settings.boxes, standing.settings.seed) == ("islands", 2, 9)


def test_an_update_changes_it_where_it_is():
    camera_at(0.0, 0.0, 20.0)
    standing = create()
    mine = bpy.data.materials.new("Mine")
    for block in standing.blocks().values():
        block.data.materials[0] = mine
    before = shape_of(standing)
    bpy.context.view_layer.objects.active = standing.root
    assert bpy.ops.farfield.clipbox_update(**(SMALL | {"seed": 5})) == {"FINISHED"}
    after = shape_of(standing)
    assert before != after and standing.settings.seed == 5 and len(terrain_objects.standing_terrains(bpy.context.scene)) == 1
    assert all(block.data.materials[0] == mine for block in standing.blocks().values())


def test_ticks_show_what_a_build_from_scratch_does():
    camera_at(0.0, 0.0, 20.0)
    standing = create()
    spare_before = len(bpy.data.meshes)
    for place in ((1.0, 0.0, 20.0), (4.0, -7.0, 22.0), (60.0, 0.0, 10.0), (0.0, 0.0, 20.0)):
        assert followed(standing, place).moves == 1
        fresh = create_at(place)
        assert shape_of(standing) == shape_of(fresh)
        bpy.data.objects.remove(fresh.root)
    assert standing.viewer.tolist() == [0.0, 0.0, 20.0] and spare_before > 0


def create_at(place):
    bpy.context.scene.camera.location = place
    bpy.context.view_layer.update()
    return create()


def test_meshes_are_used_again():
    camera_at(0.0, 0.0, 20.0)
    standing = create()
    for step in range(1, 5):
        followed(standing, (float(step), 0.0, 20.0))
    most = len(bpy.data.meshes)
    for step in range(5, 25):
        followed(standing, (float(step), 0.0, 20.0))
    assert len(bpy.data.meshes) <= most + 12


def test_two_terrains_do_not_meddle_with_each_other():
    camera_at(0.0, 0.0, 20.0)
    one, other = create(), create(terrain="islands")
    before = shape_of(one)
    other.root.location.x = 500.0
    bpy.context.view_layer.update()
    followed(other, (9.0, 0.0, 20.0))
    assert shape_of(one) == before and one.settings.terrain == "cascades"
    followed(one, (9.0, 0.0, 20.0))
    assert shape_of(one) != before


def test_a_viewer_is_seen_in_the_frame_of_the_root():
    camera_at(0.0, 0.0, 20.0)
    standing = create()
    standing.root.matrix_world = mathutils.Matrix.LocRotScale((10.0, 0.0, 0.0), mathutils.Euler((0.0, 0.0, np.pi / 2)), (2.0, 2.0, 2.0))
    bpy.context.view_layer.update()
    assert np.allclose(standing.seen_from(mathutils.Matrix.Translation((10.0, 6.0, 8.0))), [3.0, 0.0, 4.0], atol=1e-5)


def test_far_away_the_root_is_near_the_viewer():
    camera_at(0.0, 0.0, 20.0)
    standing = create(formula="-z", terrain="formula")
    assert standing.origin.tolist() == [0.0, 0.0, 0.0]
    bpy.context.scene.camera.location = (1.0e7, 3.0, 20.0)
    bpy.context.view_layer.update()
    far = create(formula="-z", terrain="formula")
    assert far.origin.tolist() == [1.0e7, 0.0, 0.0]
    assert np.abs([vertex.co for block in far.blocks().values() for vertex in block.data.vertices]).max() < 200.0


def test_saved_and_opened_again_it_goes_on(tmp_path):
    camera_at(0.0, 0.0, 20.0)
    name = create().name
    path = str(tmp_path / "würfel.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=path)
    standing = terrain_objects.StandingTerrain(name)
    follow_at_once(standing, np.array([30.0, 0.0, 20.0]))
    fresh = create_at((30.0, 0.0, 20.0))
    assert shape_of(standing) == shape_of(fresh)


def test_after_undo_everything_is_shown_anew():
    bpy.context.preferences.edit.use_global_undo = True
    camera_at(0.0, 0.0, 20.0)
    standing = create()
    bpy.ops.ed.undo_push(message="before")
    followed(standing, (8.0, 0.0, 20.0))
    moved = shape_of(standing)
    bpy.ops.ed.undo_push(message="followed")
    if bpy.ops.ed.undo.poll():
        bpy.ops.ed.undo()
    followed(standing, (16.0, 0.0, 20.0))
    followed(standing, (8.0, 0.0, 20.0))
    assert shape_of(standing) == moved


def test_a_height_map_is_covered_with_its_picture(tmp_path):
    camera_at(0.0, 0.0, 20.0)
    np.save(tmp_path / "höhe.npy", np.fromfunction(lambda y, x: 0.1 * x + 0.0 * y, (32, 64)))
    image = bpy.data.images.new("Ground", 8, 4)
    image.filepath_raw, image.file_format = str(tmp_path / "grün.png"), "PNG"
    image.save()
    files = {"source": str(tmp_path / "höhe.npy"), "source_color": str(tmp_path / "grün.png"), "source_size": 64.0}
    standing = create(terrain="heights", **files)
    nodes = standing.material.node_tree.nodes
    cover = next(node for node in nodes if node.label == "Cover")
    group = next(node for node in nodes if node.type == "GROUP")
    assert cover.image.filepath.endswith("grün.png")
    assert {link.to_socket.name for link in cover.outputs["Color"].links} == {"Rock", "Grass", "Sand", "Snow"}
    scale = next(node for node in nodes if node.type == "VECT_MATH" and node.operation == "MULTIPLY")
    assert np.allclose(scale.inputs[1].default_value, [1.0 / 64.0, 1.0 / 32.0, 0.0]) and group.outputs["Color"].is_linked
    with pytest.raises(RuntimeError, match="no picture"):
        create(terrain="heights", **(files | {"source_color": str(tmp_path / "nowhere.png")}))


def test_a_forest_is_green_where_it_is_steep(tmp_path):
    camera_at(0.0, 0.0, 30.0)
    solid = np.zeros((12, 12, 20), bool)
    solid[4:8, 4:8], solid[:, :, 12:] = True, True
    np.save(tmp_path / "baum.npy", solid)
    forest = create(terrain="forest", source=str(tmp_path / "baum.npy"), source_size=20.0)
    plain = create(terrain="sine")

    def rock(standing):
        group = next(node for node in standing.material.node_tree.nodes if node.type == "GROUP")
        return group.inputs["Rock"].default_value

    red, green, blue, _ = rock(forest)
    assert green > 1.3 * max(red, blue) and tuple(rock(plain)) != tuple(rock(forest))
    bpy.data.objects["Camera"].location = (400.0, 0.0, 30.0)
    bpy.context.view_layer.update()
    followed(forest, (400.0, 0.0, 30.0))
    assert forest.blocks()


class TestFails:
    """Terrains that do not work."""

    @pytest.fixture
    def broken(self):
        state = {"fails": False}

        def densities(grid):
            if state["fails"]:
                raise ValueError("no more")
            return 3.0 * np.sin(grid.axes()[0] / 9.0) - grid.axes()[2] + 0.0 * grid.axes()[1]

        terrains.register("broken", "Works until it does not", lambda _settings: densities)
        yield state
        terrains.NAMES.pop("broken")

    def test_what_is_shown_stays(self, broken):
        camera_at(0.0, 0.0, 2.0)
        job = clipbox_job.prepare(ClipboxSettings(**(SMALL | {"terrain": "broken"})), np.zeros(3))
        finish(whole(job))
        before = shape_of(job.standing)
        broken["fails"] = True
        with pytest.raises(GeometryError, match="no more"):
            followed(job.standing, (9.0, 0.0, 0.0))
        assert shape_of(job.standing) == before
        broken["fails"] = False
        followed(job.standing, (9.0, 0.0, 0.0))
        assert shape_of(job.standing) != before

    def test_no_ground_is_an_error_and_leaves_nothing(self):
        camera_at(0.0, 0.0, 2.0)
        with pytest.raises(RuntimeError, match="no surface"):
            bpy.ops.farfield.clipbox_create(**(SMALL | {"terrain": "formula", "formula": "-1"}))
        assert not terrain_objects.standing_terrains(bpy.context.scene) and not bpy.data.meshes

    def test_a_bad_formula_is_an_error(self):
        with pytest.raises(RuntimeError, match="may not hold"):
            bpy.ops.farfield.clipbox_create(terrain="formula", formula="__import__('os')")

    def test_polls_say_why(self):
        assert not bpy.ops.farfield.clipbox_update.poll() and not bpy.ops.farfield.clipbox_follow.poll()


@pytest.mark.slow
def test_frames_of_an_animation_are_those_rendered_one_by_one(tmp_path):
    """Twenty frames of a flight, in one run and each in a process of its own: the very same pictures."""
    camera = camera_at(0.0, 0.0, 90.0)
    camera.rotation_euler = (0.9, 0.0, 0.0)
    for frame in (1, 20):
        camera.location = (4.0 * frame, 6.0 * frame, 90.0)
        camera.keyframe_insert("location", frame=frame)
    bpy.context.scene.frame_set(1)
    standing = create(boxes=6)
    standing.root.farfield_clipbox_follow = True
    scene = bpy.context.scene
    scene.frame_end = 20
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
import environment
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

    render(1, 20, tmp_path / "all")
    for frame in (1, 2, 11, 20):
        render(frame, frame, tmp_path / "single")
    pictures = {frame: pixels(tmp_path / "all" / f"{frame:04}.png") for frame in range(1, 21)}
    for frame in (1, 2, 11, 20):
        assert np.array_equal(pictures[frame], pixels(tmp_path / "single" / f"{frame:04}.png"))
    assert all(not np.array_equal(pictures[frame], pictures[frame + 1]) for frame in range(1, 20))


def pixels(path):
    image = bpy.data.images.load(str(path))
    values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    bpy.data.images.remove(image)
    return values
