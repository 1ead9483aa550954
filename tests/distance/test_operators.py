"""Builds of small scenes: levels are shown, found again, cancelled and removed."""

import bpy
import numpy as np
import pytest

from distance_scenes import add_box, add_camera, add_scatter, describe_file, rendered, shown
from farfield.addon.bridge.distance import simplified_meshes
from farfield.addon.bridge.distance.chains import read_chains
from farfield.addon.bridge.distance.frame_renders import BLEND_FILE
from farfield.addon.bridge.distance.level_switch import MAX_ERROR, level_modifiers
from farfield.addon.bridge.distance.placing import QUADS
from farfield.addon.bridge.geometry.mesh_arrays import read_attribute, write_attribute
from farfield.addon.compat import compositor_trees, enable_nodes, read_node_input
from farfield.addon.core.distance import levels as core_levels
from farfield.addon.core.distance.settings import DistanceSettings
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.json_values import parse_json
from farfield.addon.operators.distance import build as distance_build
from farfield.addon.operators.distance.analysis import OUTCOMES, Plan, describe_weight
from farfield.addon.operators.distance.job import prepare
from farfield.addon.operators.distance.measuring import prepare as prepare_measurement
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.results import read_result
from textured_scenes import textured_ball

pytestmark = pytest.mark.usefixtures("empty_scene", "few_samples", "quick_levels")
QUICK = {"min_triangles": 10, "billboard_cloud": False}
ONLY_CLOUD = {"min_triangles": 10, "perceptual_levels": False}


@pytest.fixture
def camera():
    return add_camera()


def count_triangles(item: bpy.types.Object) -> int:
    return len(item.data.loops) - 2 * len(item.data.polygons)


def add_ball(y: float = 5.0) -> bpy.types.Object:
    ball = textured_ball(8, "Ball")
    ball.location = (0.0, y, 0.0)
    return ball


def build(**values) -> None:
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.update()
    assert bpy.ops.farfield.distance_build(**values) == {"FINISHED"}


def test_perceptual_levels_of_an_object_and_its_linked_duplicate(camera):
    ball = add_ball()
    duplicate = ball.copy()
    bpy.context.scene.collection.objects.link(duplicate)
    duplicate.location = (0.0, 5000.0, 0.0)
    before = describe_file()
    build(**QUICK, fade_range=20.0)
    (chain,) = read_chains()
    assert len(chain.collections) >= 2 and chain.triangles == sorted(chain.triangles, reverse=True)
    assert chain.triangles[0] == count_triangles(ball) and chain.pixel_sizes == sorted(chain.pixel_sizes)
    assert [len(level_modifiers(item)) for item in (ball, duplicate)] == [1, 1]
    last = len(chain.collections) - 1
    assert shown() == rendered() == [("Ball Level 0", (0, 5, 0)), (f"Ball Level {last}", (0, 5000, 0))]
    first = chain.collections[0].objects[0]
    assert first.data == ball.data and first.material_slots[0].material == ball.material_slots[0].material
    fading = chain.fading[0].objects[0]
    assert fading.data == ball.data and fading.material_slots[0].material != ball.material_slots[0].material
    assert bpy.ops.farfield.distance_remove() == {"FINISHED"}
    assert describe_file() == before
    assert read_result(bpy.context.scene, "distance") == ["Objects that no longer show levels by distance: 2."]


@pytest.mark.slow
def test_an_object_that_is_light_when_decimated_gets_neither_perceptual_levels_nor_a_cloud(camera, monkeypatch):
    ball = textured_ball(24, "Ball")
    monkeypatch.setattr(core_levels, "MANY_TRIANGLES", len(ball.data.loops))
    for name in ("_prepare_levels", "_prepare_cloud"):
        monkeypatch.setattr(distance_build, name, lambda _copies: pytest.fail("not needed"))
    build(min_triangles=10)
    (chain,) = read_chains()
    assert chain.triangles[0] == count_triangles(ball) and chain.triangles[-1] <= 0.1 * chain.triangles[0]


@pytest.mark.slow
def test_a_billboard_cloud_of_a_scatter(camera):
    scatter = add_scatter([(0.0, 5.0, 0.0), (0.0, 3000.0, 0.0)], [add_box("Box", linked=False), add_box("Cube", size=0.3, linked=False)])
    before = describe_file()
    build(**ONLY_CLOUD, fade_range=0.0)
    assert not level_modifiers(scatter), "quads of a box are no lighter"
    assert describe_file() == before
    kind = bpy.data.objects["Box"]
    kind.modifiers.new("Subdivision", "SUBSURF").levels = 2
    build(**ONLY_CLOUD, fade_range=0.0)
    (chain,) = read_chains()
    assert chain.name == "Box" and chain.triangles[0] == 12 * 4**2
    last = chain.collections[-1].objects[0]
    assert last.data.materials[0].node_tree.nodes and not last.users_scene
    assert ("Box Level 0", (0, 5, 0)) in shown()
    bpy.ops.farfield.distance_remove()
    kind.modifiers.clear()
    assert describe_file() == before


def test_hair_particles_that_are_objects_show_levels(camera):
    stone = add_ball()
    stone.data.materials.clear()
    stone.rotation_euler, stone.scale = (0.3, 0.2, 0.9), (0.5, 1.0, 0.7)
    bpy.context.scene.collection.objects.unlink(stone)
    ground = add_box("Ground", (0.0, 300.0, 0.0), size=20.0)
    settings = ground.modifiers.new("Stones", "PARTICLE_SYSTEM").particle_system.settings
    settings.type, settings.count, settings.render_type, settings.instance_object = "HAIR", 12, "OBJECT", stone
    settings.use_rotation_instance = settings.use_scale_instance = True
    bpy.context.view_layer.update()
    before, particles = describe_file(), read_instances()
    assert len(particles) == 12
    settings.display_percentage = 25
    build(**QUICK)
    (chain,) = read_chains()
    levels = read_instances()
    assert len(levels) == 12 and chain.name == "Ball"
    assert all(min(np.abs(matrix - other).max() for other in levels) < 1e-4 for matrix in particles)
    assert {name for name, _ in rendered()} == {f"Ball Level {len(chain.collections) - 1}"}
    build(**QUICK)
    assert len(read_instances()) == 12 and settings.display_percentage == 25
    bpy.ops.farfield.distance_remove()
    settings.display_percentage = 100
    assert describe_file() == before and len(read_instances()) == 12


def test_hair_particles_stay_if_nothing_heavy_is_found(camera):
    stone = add_box("Stone", linked=False)
    ground = add_box("Ground", (0.0, 300.0, 0.0), size=20.0)
    settings = ground.modifiers.new("Stones", "PARTICLE_SYSTEM").particle_system.settings
    settings.type, settings.count, settings.render_type, settings.instance_object = "HAIR", 12, "OBJECT", stone
    bpy.context.view_layer.update()
    before = describe_file()
    with pytest.raises(RuntimeError, match="Nothing to make ready"):
        build(min_triangles=100, billboard_cloud=False)
    assert describe_file() == before and len(read_instances()) == 12


def read_instances() -> list[np.ndarray]:
    """Return the matrices of all instances of objects in the viewport."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return [np.array(instance.matrix_world) for instance in depsgraph.object_instances if instance.is_instance]


def add_bush() -> bpy.types.Object:
    """Add 500 leaves of six triangles with a color attribute, distributed in a ball with a radius of 1, and a stem."""
    random = np.random.default_rng(0)
    angles = np.arange(6) * np.pi / 3.0
    leaf = 0.05 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(6)])
    turns = np.linalg.qr(random.normal(size=(500, 3, 3)))[0]
    places = random.normal(size=(500, 1, 3))
    places *= random.uniform(size=(500, 1, 1)) ** (1 / 3) / np.linalg.norm(places, axis=2, keepdims=True)
    vertices = np.concatenate([(leaf @ turns + places).reshape(-1, 3), [(-0.1, 0.0, -1.0), (0.1, 0.0, -1.0), (0.0, 0.0, 1.0)]])
    mesh = bpy.data.meshes.new("Bush")
    mesh.from_pydata(vertices, [], [*np.arange(3000).reshape(-1, 6).tolist(), (3000, 3001, 3002)])
    write_attribute(mesh, "Tint", "POINT", np.full((len(vertices), 4), 0.25))
    for name in ("Leaf", "Bark"):
        mesh.materials.append(bpy.data.materials.new(name))
        enable_nodes(mesh.materials[-1])
    mesh.polygons[500].material_index = 1
    color_node = mesh.materials[0].node_tree.nodes.new("ShaderNodeVertexColor")
    color_node.layer_name = "Tint"
    bush = bpy.data.objects.new("Bush", mesh)
    bpy.context.scene.collection.objects.link(bush)
    bush.location, bush.scale = (0.0, 5.0, 0.0), (2.0, 2.0, 2.0)
    return bush


def test_foliage_gets_fewer_and_larger_leaves_instead_of_a_cloud(camera):
    bush = add_bush()
    before = describe_file()
    build(min_triangles=10)
    (chain,) = read_chains()
    assert chain.triangles[0] == 2001 and chain.triangles[1] <= 0.5 * 2001 and len(chain.collections) >= 3
    total = sum(polygon.area for polygon in bush.data.polygons)
    for collection, triangles in zip(chain.collections[1:], chain.triangles[1:], strict=True):
        (level,) = collection.objects
        assert count_triangles(level) == triangles and "farfield_quads" not in level
        assert sum(polygon.area for polygon in level.data.polygons) == pytest.approx(total, rel=0.1)
        assert [material.name for material in level.data.materials] == ["Leaf", "Bark"]
        assert {polygon.material_index for polygon in level.data.polygons} == {0, 1}, "the stem stays"
        assert level.data.texspace_size == bush.data.texspace_size, "patterns by Generated coordinates stay where they are"
        assert np.allclose(read_attribute(level.data.attributes["Tint"]), 0.25) and level.data.attributes["Tint"].domain == "POINT"
    bpy.ops.farfield.distance_remove()
    assert describe_file() == before


@pytest.mark.parametrize("is_textured", [True, False])
def test_heavy_objects_and_those_without_a_texture_are_decimated(camera, monkeypatch, is_textured):
    monkeypatch.setattr(distance_build, "MAX_PERCEPTUAL_TRIANGLES", 100)
    monkeypatch.setattr(simplified_meshes, "LIGHT_TRIANGLES", 100)
    ball = textured_ball(16, "Ball")
    if not is_textured:
        bpy.data.batch_remove([image for image in bpy.data.images if image.users])
    total = count_triangles(ball)
    before = describe_file()
    build(**QUICK)
    (chain,) = read_chains()
    assert chain.triangles[0] == total and abs(chain.triangles[1] - total / 4) < 0.05 * total
    assert 50 <= chain.triangles[-1] < 250 and chain.pixel_sizes == sorted(chain.pixel_sizes)
    first = chain.collections[1].objects[0]
    assert len(first.data.uv_layers) == 1 and first.data.materials[0] == ball.data.materials[0]
    bpy.ops.farfield.distance_remove()
    assert describe_file() == before


def test_show_originals_and_back(camera):
    add_ball(5000.0)
    build(**QUICK)
    levels = shown()
    bpy.ops.farfield.distance_show_original()
    assert shown() == rendered() == []
    bpy.ops.farfield.distance_show_original()
    assert shown() == rendered() == levels != []


@pytest.mark.slow
def test_a_second_build_uses_the_levels_of_the_first(camera):
    add_ball()
    build(**QUICK)
    first = [collection.session_uid for chain in read_chains() for collection in chain.collections]
    build(**QUICK)
    assert [collection.session_uid for chain in read_chains() for collection in chain.collections] == first
    build(**QUICK, max_error=4.0)
    assert [collection.session_uid for chain in read_chains() for collection in chain.collections] == first, "only their distances differ"
    build(**QUICK, fade_range=0.5)
    (chain,) = read_chains()
    assert [collection.session_uid for collection in chain.collections] != first
    assert len(level_modifiers(bpy.data.objects["Ball"])) == 1


@pytest.mark.slow
def test_an_edited_material_or_mesh_makes_new_levels(camera):
    ball = add_ball()
    build(**QUICK)
    found = [read_chains()[0].fingerprint]
    ball.data.vertices[0].co.x += 0.1
    build(**QUICK)
    found.append(read_chains()[0].fingerprint)
    next(node for node in ball.data.materials[0].node_tree.nodes if "Roughness" in node.inputs).inputs["Roughness"].default_value = 0.123
    build(**QUICK)
    found.append(read_chains()[0].fingerprint)
    assert len(set(found)) == 3 and len(read_chains()) == 1


def test_a_cancelled_build_leaves_the_scene_and_the_next_one_continues(camera):
    first, second = add_ball(), add_ball(9.0)
    second.data = second.data.copy()
    second.data.vertices[0].co.x += 0.2
    second.name = "Second"
    bpy.context.view_layer.update()
    before = describe_file()
    settings = DistanceSettings(**QUICK)
    steps = run_job(prepare(bpy.context.scene, [first, second], settings))
    for step in steps:
        if step.label.startswith("Second"):
            break
    steps.close()
    (chain,) = read_chains()
    finished = [collection.session_uid for collection in chain.collections]
    assert chain.name == "Ball" and not level_modifiers(first) and [scene.name for scene in bpy.data.scenes] == ["Scene"]
    after = describe_file()
    assert all(after[key] == before[key] for key in ("Ball", "Second", "scene", "scenes"))
    job = prepare(bpy.context.scene, [first, second], settings)
    run_to_end(run_job(job))
    assert [is_reused for _, _, is_reused in job.chains] == [True, False]
    assert [collection.session_uid for collection in job.chains[0][0].collections] == finished
    bpy.ops.object.select_all(action="DESELECT")
    bpy.ops.farfield.distance_remove()
    assert describe_file() == before


def test_collection_instances_show_levels_and_stay_movable(camera):
    ball = add_ball(0.0)
    collection = bpy.data.collections.new("Balls")
    collection.objects.link(ball)
    bpy.context.scene.collection.objects.unlink(ball)
    empties = []
    for y in (5.0, 5000.0):
        empty = bpy.data.objects.new("Place", None)
        empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", collection, (0.0, y, 0.0)
        bpy.context.scene.collection.objects.link(empty)
        empties.append(empty)
    before = describe_file()
    build(**QUICK)
    last = len(read_chains()[0].collections) - 1
    assert shown() == rendered() == [("Balls Level 0", (0, 5, 0)), (f"Balls Level {last}", (0, 5000, 0))]
    empties[0].location.y = 4000.0
    assert shown() == [(f"Balls Level {last}", (0, 4000, 0)), (f"Balls Level {last}", (0, 5000, 0))]
    empties[0].location.y = 5.0
    bpy.ops.farfield.distance_show_original()
    assert shown() == rendered() == [("Ball", (0, 5, 0)), ("Ball", (0, 5000, 0))]
    bpy.ops.farfield.distance_show_original()
    build(**QUICK)
    assert len(shown()) == 2
    bpy.ops.farfield.distance_remove()
    assert describe_file() == before


def test_the_analysis_lists_the_heaviest_first(camera):
    ball = add_ball()
    add_box("Box", (0.0, 3.0, 0.0))
    group = bpy.context.scene.farfield_distance
    group.min_triangles = 100
    bpy.ops.object.select_all(action="DESELECT")
    assert bpy.ops.farfield.distance_analyze() == {"FINISHED"}
    plans = group.plans
    assert [(plan.name, plan.source, plan.places, plan.triangles, plan.outcome) for plan in plans] == [
        ("Ball", ball, 1, count_triangles(ball), "build"),
        ("Box", bpy.data.objects["Box"], 1, 12, "stays"),
    ]
    assert [plan.nearest for plan in plans] == pytest.approx([4.0, 2.75], abs=1e-3)
    diagonal = 0.5 * 3.0**0.5
    assert plans[1].pixels == pytest.approx(1000.0 * diagonal / 3.0, rel=1e-3), "1,000 pixels are 1 long at a distance of 1"
    plans[0].method, plans[1].error_factor = "original", 2.0
    reasons = [OUTCOMES[plan.current_outcome] for plan in plans]
    assert reasons[0].endswith("method is Original") and reasons[1].endswith("than Min Triangles")
    ball.hide_render = True
    bpy.ops.farfield.distance_analyze()
    assert [(plan.name, plan.error_factor) for plan in plans] == [("Box", 2.0)], "choices stay"


def test_the_analysis_says_what_levels_can_save():
    def plan(places: int, triangles: int) -> Plan:
        return Plan(None, "Tree", places, triangles, 0, 0.0, 0.0, "build")

    assert "light" in describe_weight([plan(1000, 1000)])
    assert "Cycles keeps repeated meshes once" in describe_weight([plan(1000, 10_000)])
    assert describe_weight([plan(10, 400_000), plan(1, 200_000)]) == ""


def test_the_analysis_looks_at_several_frames_and_ends_at_the_current_one(camera):
    add_box("Box", (0.0, 500.0, 0.0))
    camera.location = (0.0, 0.0, 0.0)
    camera.keyframe_insert("location", frame=1)
    camera.location = (0.0, 490.0, 0.0)
    camera.keyframe_insert("location", frame=250)
    scene = bpy.context.scene
    scene.frame_set(1)
    bpy.ops.farfield.distance_analyze()
    (plan,) = scene.farfield_distance.plans
    assert plan.nearest == pytest.approx(9.75, abs=0.01) and scene.frame_current == 1


@pytest.mark.slow
def test_the_method_of_an_object_and_its_error_factor(camera):
    first, second = add_ball(), add_ball(9.0)
    second.data = second.data.copy()
    second.data.vertices[0].co.x += 0.2
    rows = bpy.context.scene.farfield_distance.plans
    for item, method, factor in ((first, "original", 1.0), (second, "levels", 2.5)):
        row = rows.add()
        row.source, row.method, row.error_factor = item, method, factor
    build(min_triangles=10, perceptual_levels=False)
    assert not level_modifiers(first)
    (modifier,) = level_modifiers(second)
    assert read_node_input(modifier, MAX_ERROR) == pytest.approx(2.5)
    assert not any(QUADS in item for item in read_chains()[0].objects), "no cloud"


@pytest.mark.slow
@pytest.mark.parametrize("budget", [{"triangle_budget": 60}, {"texture_budget": 1e-3}])
def test_a_budget_raises_the_error_until_levels_fit(camera, budget):
    ball = add_ball(20.0)
    build(**QUICK)
    chain = read_chains()[0]
    ball.location.y = 900.0 * chain.pixel_sizes[1]
    assert shown()[0][0] == "Ball Level 0" and chain.triangles[-1] < 60 < chain.triangles[0]
    assert chain.pixel_sizes[-1] < 10.0 * chain.pixel_sizes[1]
    job = prepare(bpy.context.scene, [ball], DistanceSettings(**QUICK, **budget))
    message = run_to_end(run_job(job))
    if "triangle_budget" in budget:
        assert "Max Error was raised to" in message and f"instead of {chain.triangles[0]:,}" in message
        assert chain.triangles[int(shown()[0][0][-1])] <= 60
    else:
        assert "The budget is too small" in message, "all levels have the image of the ball"


@pytest.mark.slow
def test_drivers_run_without_permission_for_python(camera):
    add_ball(300.0)
    build(**QUICK)
    drivers = [curve.driver for group in bpy.data.node_groups if group.animation_data for curve in group.animation_data.drivers]
    assert len(drivers) == 3 and all(driver.is_valid and driver.is_simple_expression for driver in drivers)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [1e-3, 1e4])
def test_a_budget_of_seconds_is_tried_with_renders(camera, seconds):
    ball = add_ball(300.0)
    ball.scale = (30.0, 30.0, 30.0)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.render.resolution_percentage = "CYCLES", 2, 5
    message = run_to_end(run_job(prepare(scene, [ball], DistanceSettings(**QUICK, seconds_budget=seconds))))
    (modifier,) = level_modifiers(ball)
    assert read_node_input(modifier, MAX_ERROR) == 1.0
    if seconds < 1.0:
        assert "The budget is too small: a frame takes about " in message and " with a Max Error of " in message
    else:
        assert "A frame takes about " in message and "to the originals." in message
    assert scene.cycles.samples == 2


@pytest.mark.slow
def test_a_budget_of_seconds_needs_cycles(camera):
    bpy.context.scene.render.engine = "BLENDER_WORKBENCH"
    message = run_to_end(run_job(prepare(bpy.context.scene, [add_ball()], DistanceSettings(**QUICK, seconds_budget=1.0))))
    assert "A budget of seconds needs a camera, levels, and Cycles" in message


def test_a_measurement_renders_both_and_changes_nothing(camera):
    ball = add_ball(300.0)
    ball.scale = (30.0, 30.0, 30.0)
    build(**QUICK)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.render.resolution_percentage = "CYCLES", 1, 10
    levels, before = shown(), describe_file()
    assert bpy.ops.farfield.distance_measure() == {"FINISHED"}
    figures = parse_json(scene.farfield_distance.figures)
    assert figures["frames"] == 1 and 0.0 <= figures["flip"] < 0.2
    assert all(figures[name]["seconds"] > 0.0 and figures[name]["memory"] > 0 for name in ("originals", "levels"))
    assert shown() == levels and describe_file() == before
    bpy.ops.farfield.distance_remove()
    assert not scene.farfield_distance.figures


@pytest.mark.slow
def test_unsaved_images_do_not_hinder_a_measurement(camera):
    ball = add_ball(300.0)
    build(**QUICK)
    for name, is_tiled in (("painted", False), ("unused", False), ("tiles", True)):
        image = bpy.data.images.new(name, 8, 8, tiled=is_tiled)
        image.pixels[0] = 0.5
        image.update()
        assert image.is_dirty
        if name == "painted":
            node = ball.data.materials[0].node_tree.nodes.new("ShaderNodeTexImage")
            node.image = image
    bpy.context.scene.render.resolution_percentage, bpy.context.scene.render.engine = 5, "CYCLES"
    bpy.context.scene.cycles.samples = 1
    assert bpy.ops.farfield.distance_measure() == {"FINISHED"}


@pytest.mark.slow
def test_a_measurement_that_is_cancelled_ends_its_process_and_deletes_its_copy_of_the_scene(camera):
    add_ball(300.0)
    build(**QUICK)
    before = describe_file()
    job = prepare_measurement(bpy.context.scene)
    assert (job.folder / BLEND_FILE).exists()
    steps = run_job(job)
    assert next(steps).label == "Starting to render"
    steps.close()
    assert not job.folder.exists() and describe_file() == before


@pytest.mark.slow
def test_a_measurement_writes_no_file_of_the_compositor(camera, tmp_path):
    add_ball(300.0)
    build(**QUICK)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.render.resolution_percentage = "CYCLES", 1, 5
    if hasattr(scene, "compositing_node_group"):
        scene.compositing_node_group = bpy.data.node_groups.new("Compositor", "CompositorNodeTree")
    else:
        scene.use_nodes = True
    (tree,) = dict.fromkeys(compositor_trees(scene))
    node, layers = tree.nodes.new("CompositorNodeOutputFile"), tree.nodes.new("CompositorNodeRLayers")
    if hasattr(node, "directory"):
        node.directory = str(tmp_path)
        node.file_output_items.new("RGBA", "Image")
    else:
        node.base_path = str(tmp_path)
    tree.links.new(layers.outputs["Image"], node.inputs[0])
    bpy.ops.farfield.distance_measure()
    assert scene.farfield_distance.figures and list(tmp_path.iterdir()) == [] and not node.mute


def test_a_scene_without_anything_heavy_is_refused(camera):
    add_box("Box", (0.0, 3.0, 0.0))
    before = describe_file()
    with pytest.raises(RuntimeError, match="Nothing to make ready: 1 object with too few triangles"):
        bpy.ops.farfield.distance_build(min_triangles=100)
    assert describe_file() == before


@pytest.mark.slow
def test_only_selected_objects_are_made_ready_and_removed(camera):
    first, second = add_ball(), add_ball(9.0)
    for selected in (first, second):
        bpy.ops.object.select_all(action="DESELECT")
        selected.select_set(True)
        bpy.ops.farfield.distance_build(**QUICK)
    assert level_modifiers(first) and level_modifiers(second)
    bpy.ops.farfield.distance_remove()
    assert level_modifiers(first) and not level_modifiers(second)
    bpy.ops.farfield.distance_remove()
    assert not level_modifiers(first) and not read_chains()


@pytest.mark.slow
def test_a_small_part_of_a_collection_vanishes_before_the_rest(camera):
    large, small = add_ball(0.0), add_ball(0.0)
    for item in (large, small):
        item.data = item.data.copy()
        item.data.materials.clear()
    small.scale, small.location = (0.02, 0.02, 0.02), (0.0, 0.0, 1.5)
    collection = bpy.data.collections.new("Planet")
    for item in (large, small):
        bpy.context.scene.collection.objects.unlink(item)
        collection.objects.link(item)
    empty = bpy.data.objects.new("Planet", None)
    empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", collection, (0.0, 50.0, 0.0)
    bpy.context.scene.collection.objects.link(empty)
    build(**QUICK)
    (chain,) = read_chains()
    numbers = [len(level.objects) for level in chain.collections]
    assert numbers[0] == 2 and numbers[-1] == 1
    vanished = numbers.index(1)
    assert chain.pixel_sizes[vanished] > 0.0692 > chain.pixel_sizes[vanished - 1]
