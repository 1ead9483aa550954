"""Levels of textured meshes in a scene: what is made, shown, carried and removed."""

import bpy
import numpy as np
import pytest

from bridge.solid_views import shown_image
from farfield.addon.bridge.lod_crossfade import CROSSFADE
from farfield.addon.bridge.texmesh.level_sets import ERROR, level_sets_in
from farfield.addon.bridge.texmesh.scale_attributes import SCALE_ATTRIBUTE, read_scales
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.messages import first_sentences
from farfield.addon.core.texmesh import TexmeshSettings
from farfield.addon.core.texmesh.settings import SceneSettings
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.results import read_result
from farfield.addon.operators.texmesh import preview
from farfield.addon.operators.texmesh.job import prepare_levels
from textured_scenes import textured_ball

pytestmark = pytest.mark.usefixtures("empty_scene", "few_samples")
SMALL = {"levels": "ratios", "ratios": "0.5,0.2", "views": 1, "max_image": 32, "vertices": "original"}


@pytest.fixture
def ball() -> bpy.types.Object:
    """A smooth sphere with a UV map and a checkered image."""
    return textured_ball(6, "Ball")


def make(**values) -> list[bpy.types.Object]:
    assert bpy.ops.farfield.texmesh_levels(**{**SMALL, **values}) == {"FINISHED"}
    (levels,) = level_sets_in(bpy.context.scene)
    return levels.levels


@pytest.mark.parametrize(("vertices", "number"), [("original", 3), pytest.param("optimized", 2, marks=pytest.mark.slow)])
def test_levels_have_fewer_triangles_and_larger_errors(vertices, number):
    ball = textured_ball(6)
    ball.location, ball.scale = (3.0, -2.0, 1.0), (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()
    levels = make(levels="number", number=number, vertices=vertices)
    counts, errors = [len(level.data.polygons) for level in levels], [level[ERROR] for level in levels]
    assert len(levels) == number and counts == sorted(counts, reverse=True) and counts[0] == 120
    assert errors[0] == 0.0 and errors == sorted(errors) and errors[1] > 0.0
    assert all(level.matrix_world == ball.matrix_world and not level.data.validate() for level in levels)
    assert all(level.data.uv_layers.active.name == ball.data.uv_layers.active.name for level in levels)
    assert all(CROSSFADE in level for level in levels) and ball.hide_render


def test_materials_of_the_original_stay(ball):
    material = ball.data.materials[0]
    nodes = len(material.node_tree.nodes)
    levels = make()
    assert ball.data.materials[0] == material and len(material.node_tree.nodes) == nodes
    copies = {level.data.materials[0] for level in levels}
    assert len(copies) == 1 and material not in copies


def test_solid_views_show_the_color_of_levels_whichever_node_of_the_original_is_active(ball):
    tree = ball.data.materials[0].node_tree
    data = tree.nodes.active = tree.nodes.new("ShaderNodeTexImage")
    data.image = bpy.data.images.new("Data", 8, 8, is_data=True)
    assert all(shown_image(level.data.materials[0]).name == "Checker" for level in make())
    assert shown_image(ball.data.materials[0]) == data.image


def test_levels_render_with_the_settings_of_their_object(ball):
    lights = bpy.data.collections.new("Lights")
    ball.light_linking.receiver_collection = lights
    ball.shadow_terminator_geometry_offset, ball.shadow_terminator_shading_offset = 0.3, 0.4
    ball.visible_glossy, ball.is_holdout, ball.pass_index, ball.lightgroup = False, True, 5, "Key"
    ball.color, ball.cycles.is_caustics_caster = (0.25, 0.5, 0.75, 1.0), True
    ball["wetness"] = 0.5
    for level in make():
        assert level.light_linking.receiver_collection == lights
        assert level.shadow_terminator_geometry_offset == pytest.approx(0.3)
        assert level.shadow_terminator_shading_offset == pytest.approx(0.4)
        assert (level.visible_camera, level.visible_glossy, level.is_holdout) == (True, False, True)
        assert (level.pass_index, level.lightgroup, level["wetness"]) == (5, "Key", 0.5)
        assert tuple(level.color) == (0.25, 0.5, 0.75, 1.0) and level.cycles.is_caustics_caster


def test_one_level_is_shown_and_the_original_again(ball):
    levels = make(cross_fade=False)
    assert [level.hide_render for level in levels] == [False, True, True]
    assert bpy.ops.farfield.texmesh_show(level=2) == {"FINISHED"}
    assert [level.hide_viewport for level in levels] == [True, True, False]
    assert bpy.context.view_layer.objects.active == levels[2]
    assert bpy.ops.farfield.texmesh_show(level=-1) == {"FINISHED"}
    assert all(level.hide_render for level in levels) and not ball.hide_render
    assert bpy.ops.farfield.texmesh_crossfade() == {"FINISHED"}
    assert not any(level.hide_render for level in levels) and ball.hide_render


@pytest.mark.slow
def test_several_objects_stay_selected_and_the_active_one_stays_active(ball):
    other = textured_ball(8, "Other")
    ball.select_set(True)
    bpy.context.view_layer.objects.active = ball
    assert bpy.ops.farfield.texmesh_levels(**SMALL) == {"FINISHED"}
    sets = {levels.source: levels.levels for levels in level_sets_in(bpy.context.scene)}
    assert sets.keys() == {ball, other} and bpy.context.view_layer.objects.active == sets[ball][0]
    for level in (2, 1):
        assert bpy.ops.farfield.texmesh_show(level=level) == {"FINISHED"}
        shown = {levels[level] for levels in sets.values()}
        assert {*bpy.context.selected_objects} == shown and not any(item.hide_render for item in shown)
    assert bpy.context.view_layer.objects.active == sets[ball][1]
    assert bpy.ops.farfield.texmesh_levels(**SMALL) == {"FINISHED"}
    again = {levels.source: levels.levels for levels in level_sets_in(bpy.context.scene)}
    assert again.keys() == {ball, other} and bpy.context.view_layer.objects.active == again[ball][0]


def test_cross_fade_is_switched_per_object_and_for_all(ball):
    textured_ball(8, "Other")
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.farfield.texmesh_levels(**SMALL)
    bpy.ops.object.camera_add(location=(0.0, -1e5, 0.0))
    bpy.context.scene.camera = bpy.context.object
    bpy.ops.object.select_all(action="DESELECT")
    first, second = level_sets_in(bpy.context.scene)
    bpy.context.view_layer.objects.active = first.levels[0]
    first.levels[0].select_set(True)
    bpy.ops.farfield.texmesh_crossfade(enable=False)
    assert (first.has_crossfade, second.has_crossfade) == (False, True)
    assert [level.hide_render for level in first.levels] == [True, True, False] and first.source.hide_render
    bpy.ops.farfield.texmesh_crossfade(all_objects=True)
    assert first.has_crossfade and second.has_crossfade
    bpy.ops.farfield.texmesh_crossfade(enable=False, all_objects=True)
    assert not first.has_crossfade and not second.has_crossfade


def test_no_preview_starts_in_scripts(ball):
    make()
    assert bpy.ops.farfield.texmesh_crossfade() == {"FINISHED"}
    assert not preview.current.is_running


@pytest.mark.slow
def test_the_progress_names_the_object_and_never_decreases(ball):
    settings = TexmeshSettings(levels="ratios", ratios="0.3", views=1, max_image=16)
    steps = []
    run_to_end(prepare_levels(bpy.context, [ball], TexmeshSettings(**SMALL), SceneSettings()).core_steps(), steps.append)
    assert not any("Ball" in step.label for step in steps)
    steps.clear()
    other = textured_ball(7, "Other")
    run_to_end(prepare_levels(bpy.context, [ball, other], settings, SceneSettings()).core_steps(), steps.append)
    fractions = [step.fraction for step in steps]
    assert fractions == sorted(fractions) and fractions[0] == 0.0 and fractions[-1] > 0.9
    first, second = ([step.label.startswith(name) for step in steps] for name in ("Ball (1 of 2): ", "Other (2 of 2): "))
    assert all(a != b for a, b in zip(first, second, strict=True)) and first == sorted(first, reverse=True)
    assert 0.1 < steps[second.index(True)].fraction < 0.5


@pytest.mark.slow
def test_the_result_of_several_objects_begins_with_their_number(ball):
    textured_ball(8, "Other").scale.x = 2.0
    for name, rings in (("Third", 7), ("Fourth", 6)):
        textured_ball(rings, name)
    bpy.ops.mesh.primitive_plane_add()
    bpy.ops.object.select_all(action="SELECT")
    job = prepare_levels(bpy.context, bpy.context.selected_objects, TexmeshSettings(**SMALL), SceneSettings())
    message = run_to_end(run_job(job))
    assert message.startswith("5 objects have levels, ") and len(first_sentences(message, 120)) < 120
    assert "Too few triangles to simplify: 1 object." in message


def test_levels_are_removed_with_their_data(ball):
    before = {kind: len(getattr(bpy.data, kind)) for kind in ("objects", "meshes", "materials", "collections")}
    make()
    assert bpy.ops.farfield.texmesh_remove() == {"FINISHED"}
    assert {kind: len(getattr(bpy.data, kind)) for kind in before} == before
    assert not ball.hide_render and bpy.context.view_layer.objects.active == ball
    assert read_result(bpy.context.scene, "texmesh") == ["Removed the levels of 1 object."]


def test_levels_are_made_again_in_place_of_earlier_ones(ball):
    make()
    levels = make(ratios="0.5")
    assert len(levels) == 2


def test_features_become_an_attribute(ball):
    assert bpy.ops.farfield.texmesh_analyze() == {"FINISHED"}
    attribute = ball.data.attributes[SCALE_ATTRIBUTE]
    scales = np.array([item.value for item in attribute.data])
    assert attribute.domain == "POINT" and scales.min() >= 0 and 0 < scales.max() <= 20


@pytest.mark.slow
def test_levels_have_the_scales_of_their_own_analysis(ball):
    stale = np.full(len(ball.data.vertices), 99, np.int32)
    ball.data.attributes.new(SCALE_ATTRIBUTE, "INT", "POINT").data.foreach_set("value", stale)
    levels = make(vertices="original")
    assert np.array_equal(read_scales(ball.data), stale), "only Analyze changes the original"
    assert bpy.ops.farfield.texmesh_analyze() == {"FINISHED"}
    of_position = {tuple(vertex.co): scale for vertex, scale in zip(ball.data.vertices, read_scales(ball.data).tolist(), strict=True)}
    for level in levels:
        assert read_scales(level.data).tolist() == [of_position[tuple(vertex.co)] for vertex in level.data.vertices]


def test_other_attributes_are_carried(ball):
    mesh = ball.data
    values = np.random.default_rng(0).random(len(mesh.vertices)).astype(np.float32)
    mesh.attributes.new("weight", "FLOAT", "POINT").data.foreach_set("value", values)
    mesh.color_attributes.new("Paint", "FLOAT_COLOR", "CORNER")
    levels = make(vertices="original")
    of_position = {tuple(vertex.co): value for vertex, value in zip(mesh.vertices, values.tolist(), strict=True)}
    for level in levels:
        carried = [item.value for item in level.data.attributes["weight"].data]
        assert carried == [of_position[tuple(vertex.co)] for vertex in level.data.vertices], "vertices are a subset"
        assert level.data.color_attributes["Paint"].domain == "CORNER"


@pytest.mark.parametrize("prepare", ["no_uv", pytest.param("no_image", marks=pytest.mark.exhaustive)])
def test_meshes_without_texture_have_levels_by_shape(ball, prepare, capsys):
    if prepare == "no_uv":
        ball.data.uv_layers.remove(ball.data.uv_layers[0])
    else:
        ball.data.materials.clear()
    assert len(make()) >= 2
    expected = "has no UV map" if prepare == "no_uv" else "has no image texture"
    assert expected in capsys.readouterr().out


def test_small_objects_stay_as_they_are(capsys):
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.farfield.texmesh_levels(**SMALL | {"vertices": "optimized"})
    (levels,) = level_sets_in(bpy.context.scene)
    assert len(levels.levels) == 1 and len(levels.levels[0].data.polygons) == 12
    assert '"Cube" has only 12 triangles and stays as it is.' in capsys.readouterr().out


def test_a_small_object_stays_as_it_is_beside_the_levels_of_others(ball, capsys):
    bpy.ops.mesh.primitive_plane_add()
    bpy.ops.object.select_all(action="SELECT")
    assert bpy.ops.farfield.texmesh_levels(**SMALL) == {"FINISHED"}
    levels = {found.source_name: found.levels for found in level_sets_in(bpy.context.scene)}
    assert len(levels["Ball"]) > 1
    (plane,) = levels["Plane"]
    assert plane.dimensions == bpy.data.objects["Plane"].dimensions and len(plane.data.polygons) == 2
    assert not plane.hide_render
    assert '"Plane" has only 2 triangles and stays as it is.' in capsys.readouterr().out


@pytest.mark.slow
def test_levels_of_a_mesh_far_from_its_origin_are_at_its_place(ball, capsys):
    offset = np.array([500_000.0, 4_500_000.0, 0.0])
    positions = np.array([tuple(vertex.co) for vertex in ball.data.vertices]) * 15.0 + offset
    ball.data.vertices.foreach_set("co", positions.astype(np.float32).ravel())
    ball.data.update()
    stored = {tuple(vertex.co) for vertex in ball.data.vertices}
    levels = make()
    assert all(tuple(vertex.co) in stored for level in levels for vertex in level.data.vertices)
    expected = '"Ball" is so far from the origin that Blender has rounded its coordinates to multiples of 0.5;'
    assert expected in capsys.readouterr().out
