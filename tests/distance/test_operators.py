"""Builds of small scenes: levels are shown, found again, cancelled and removed."""

from functools import partial

import bpy
import pytest

from distance_scenes import add_box, add_camera, add_scatter, describe_file, rendered, shown
from farfield.addon.bridge.distance.chains import read_chains
from farfield.addon.bridge.distance.level_switch import level_modifiers
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.distance.settings import DistanceSettings
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.json_values import parse_json
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.operators.distance import build as distance_build
from farfield.addon.operators.distance.job import prepare
from farfield.addon.operators.job_run import run_job
from textured_scenes import textured_ball

pytestmark = pytest.mark.usefixtures("empty_scene")
QUICK = {"min_triangles": 10, "billboard_cloud": False}
ONLY_CLOUD = {"min_triangles": 10, "perceptual_levels": False}


@pytest.fixture(autouse=True)
def quick_levels(monkeypatch):
    """Make levels and clouds in a fraction of a second; which ones is not tested here."""
    level_settings = {"levels": "ratios", "ratios": "0.5,0.2", "views": 1, "max_image": 32, "vertices": "original"}
    monkeypatch.setattr(distance_build, "TexmeshSettings", partial(TexmeshSettings, **level_settings))
    monkeypatch.setattr(distance_build, "BillboardSettings", partial(BillboardSettings, samples=1, error=0.05))


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
    build(**QUICK)
    (chain,) = read_chains()
    assert len(chain.collections) >= 2 and chain.triangles == sorted(chain.triangles, reverse=True)
    assert chain.triangles[0] == count_triangles(ball) and chain.pixel_sizes == sorted(chain.pixel_sizes)
    assert [len(level_modifiers(item)) for item in (ball, duplicate)] == [1, 1]
    last = len(chain.collections) - 1
    assert shown() == rendered() == [("Ball Level 0", (0, 5, 0)), (f"Ball Level {last}", (0, 5000, 0))]
    first = chain.collections[0].objects[0]
    assert first.data == ball.data and first.material_slots[0].material != ball.material_slots[0].material
    assert bpy.ops.farfield.distance_remove() == {"FINISHED"}
    assert describe_file() == before


def test_a_billboard_cloud_of_a_scatter(camera):
    scatter = add_scatter([(0.0, 5.0, 0.0), (0.0, 3000.0, 0.0)], [add_box("Box", linked=False), add_box("Cube", size=0.3, linked=False)])
    before = describe_file()
    build(**ONLY_CLOUD, fade_range=0.0)
    assert not level_modifiers(scatter), "quads of a box are no lighter"
    assert describe_file() == before
    kind = bpy.data.objects["Box"]
    kind.modifiers.new("Subdivision", "SUBSURF").levels = 3
    build(**ONLY_CLOUD, fade_range=0.0)
    (chain,) = read_chains()
    assert chain.name == "Box" and chain.triangles[0] == 12 * 4**3
    last = chain.collections[-1].objects[0]
    assert last.data.materials[0].node_tree.nodes and not last.users_scene
    assert ("Box Level 0", (0, 5, 0)) in shown()
    bpy.ops.farfield.distance_remove()
    kind.modifiers.clear()
    assert describe_file() == before


def test_show_originals_and_back(camera):
    add_ball(5000.0)
    build(**QUICK)
    levels = shown()
    bpy.ops.farfield.distance_show_original()
    assert shown() == rendered() == []
    bpy.ops.farfield.distance_show_original()
    assert shown() == rendered() == levels != []


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
    plans = parse_json(group.analysis)
    assert [(plan["name"], plan["places"], plan["triangles"], plan["outcome"]) for plan in plans] == [
        ("Ball", 1, count_triangles(ball), "build"),
        ("Box", 1, 12, "stays"),
    ]
    assert [plan["nearest"] for plan in plans] == pytest.approx([5.0, 3.0], abs=1e-3)


def test_a_scene_without_anything_heavy_is_refused(camera):
    add_box("Box", (0.0, 3.0, 0.0))
    before = describe_file()
    with pytest.raises(RuntimeError, match="Nothing to make ready: 1 object with too few triangles"):
        bpy.ops.farfield.distance_build(min_triangles=100)
    assert describe_file() == before


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
