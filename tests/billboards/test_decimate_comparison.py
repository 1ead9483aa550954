"""The sentence that compares a cloud with decimated meshes of as many triangles, and the renders behind it."""

import bpy
import numpy as np
import pytest

pytest.importorskip("bpy")

from bridge import blender_scenes
from bridge.instance_scenes import scatter, shining
from bridge.operator_scenes import levels, select
from farfield.addon.bridge.billboards import decimate_comparison
from farfield.addon.bridge.billboards.decimate_comparison import can_compare, compare_with_decimate
from farfield.addon.bridge.billboards.scene_clouds import clouds_in
from farfield.addon.core.billboards.comparison import Difference, LevelComparison, describe_comparison, measure_difference
from farfield.addon.core.billboards.settings import BillboardSettings, BuildOptions
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.billboards.job import prepare_job
from lib.baselines import decimate

pytestmark = pytest.mark.usefixtures("empty_scene")


def level(index, triangles, cloud, decimate, gain=0.0):
    """Return a comparison of two visible differences; `gain` is the lead of the cloud in decibels of PSNR."""
    mesh = None if decimate is None else Difference(decimate, 30.0 - gain)
    return LevelComparison(index, triangles, Difference(cloud, 30.0), mesh)


class TestSentence:
    """What the panel and the report say."""

    def test_nothing_was_compared(self):
        assert describe_comparison([]) == ""

    def test_the_cloud_is_better(self):
        assert describe_comparison([level(0, 1576, 0.0366, 0.0639), level(1, 154, 0.0512, 0.0829)]) == (
            "Visible difference from the original at the switch distance: cloud 3.7, 5.1 %, "
            "decimated mesh of the same 1,576, 154 triangles 6.4, 8.3 %."
        )

    def test_decimate_is_better(self):
        assert describe_comparison([level(0, 300, 0.05, 0.03, -1.0)]).endswith("3.0 %. Decimate is the better choice.")
        text = describe_comparison([level(0, 300, 0.05, 0.03, -1.0), level(2, 80, 0.05, 0.06)])
        assert text.endswith("Decimate is the better choice at 300 triangles.")

    def test_about_equal_is_no_advice(self):
        assert "better" not in describe_comparison([level(0, 300, 0.05, 0.049, -1.0)])

    def test_measures_that_disagree_are_no_advice(self):
        assert "better" not in describe_comparison([level(0, 300, 0.05, 0.03, 1.0)])

    def test_decimate_cannot_reach_the_number(self):
        assert describe_comparison([level(0, 20, 0.05, None)]) == (
            "Visible difference from the original at the switch distance: cloud 5.0 %. Decimate cannot reach 20 triangles."
        )
        assert describe_comparison([level(0, 90, 0.05, 0.06), level(1, 20, 0.07, None)]).endswith(
            "triangles 6.0, - %. Decimate cannot reach 20 triangles."
        )


def test_difference_is_0_for_equal_and_1_for_opposite_images():
    image = np.zeros((40, 40, 4), np.float32)
    image[10:30, 10:30] = (0.0, 0.0, 0.0, 1.0)
    white = image + np.float32([1.0, 1.0, 1.0, 0.0]) * image[..., 3:]
    assert measure_difference([image], [image]) == Difference(0.0, np.inf)
    assert measure_difference([image, image], [white, white]).visible > 0.9
    assert measure_difference([np.zeros_like(image)], [np.zeros_like(image)]).visible == 0.0


def build(*objects, **settings):
    """Build one cloud of objects, and return its job."""
    select(*objects)
    options = BuildOptions(combine_selected=True, keep_original_visible=True)
    job = prepare_job(bpy.context, list(objects), BillboardSettings(**{"levels": 1, "samples": 1, "error": 0.04} | settings), options)
    run_to_end(job.scene_steps(run_to_end(job.core_steps())))
    return job


@pytest.mark.slow
def test_sphere_is_compared_with_the_mesh_that_decimate_makes():
    ball = blender_scenes.ball(material=blender_scenes.create_material("Clay"))
    before = blender_scenes.count_data()
    job = build(ball)
    (comparison,) = job.comparisons[0]
    (shown,) = levels().values()
    assert comparison.triangles == len(shown.data.loops) - 2 * len(shown.data.polygons)
    assert 0.0 < comparison.cloud.visible < 0.2 and 0.0 < comparison.decimate.visible < 0.5
    (note,) = [note for note in clouds_in(bpy.context.scene)[0].notes if "Visible difference" in note]
    assert note == describe_comparison(job.comparisons[0]) and job.built_clouds[0][1].notes[0] == note
    after = blender_scenes.count_data()
    assert {key: after[key] - before[key] for key in ("meshes", "objects", "scenes", "cameras")} == {
        "meshes": 1,
        "objects": 1,
        "scenes": 0,
        "cameras": 0,
    }
    assert bpy.context.scene.objects.get("Ball") is not None and not ball.hide_render and not ball.modifiers


def test_mesh_is_that_of_the_modifier(monkeypatch):
    """The mesh joined from arrays is decimated to the same shape and normals as the object itself."""
    ball = blender_scenes.ball()
    ball.scale = (1.0, 0.6, 1.4)
    bpy.context.view_layer.update()
    expected = decimate([ball], 100)
    source = blender_scenes.read_objects(ball)
    with decimate_comparison.render_scene("Test") as work:
        reached = decimate_comparison._decimate(work, decimate_comparison._add_joined_mesh(work, source, [ball]), 100)
        positions = [np.array([item.matrix_world @ vertex.co for vertex in item.data.vertices]) for item in (expected, reached)]
        assert abs(len(reached.data.polygons) - len(expected.data.polygons)) <= 2
        assert np.ptp(positions[0], axis=0) == pytest.approx(np.ptp(positions[1], axis=0), rel=0.05)
        monkeypatch.setattr(decimate_comparison, "MAX_EXCESS", 0.0)
        joined = decimate_comparison._add_joined_mesh(work, source, [ball])
        assert decimate_comparison._decimate(work, joined, 100) is None and not joined.modifiers


def test_original_at_full_detail_would_not_differ():
    """With as many triangles as the original, the mesh is the original."""
    ball = blender_scenes.ball(material=blender_scenes.create_material("Clay", (0.7, 0.3, 0.1)))
    other = blender_scenes.box("Box", blender_scenes.create_material("Paint", (0.1, 0.3, 0.7)))
    other.location, other.scale = (3.0, 0.0, 0.0), (-1.0, 0.5, 0.2)
    bpy.context.view_layer.update()
    source = blender_scenes.read_objects(ball, other)
    with decimate_comparison.render_scene("Test") as work:
        joined = decimate_comparison._add_joined_mesh(work, source, [ball, other])
        sun = decimate_comparison._prepare_scene(work)
        with work.show([ball, other]):
            renders = decimate_comparison._render(work, sun, [[ball, other], [joined]], source, 0.06, 130)
    assert measure_difference(*renders).visible < 2e-3


class TestNotCompared:
    """Cases without a sentence, because it would be wrong or take too long."""

    def test_materials_that_one_mesh_cannot_have(self):
        row = scatter("Row", blender_scenes.card(material=shining()))
        bpy.context.view_layer.update()
        assert not can_compare(blender_scenes.read_objects(row), [row])

    def test_random_colors(self):
        material = blender_scenes.create_material("Random")
        info = material.node_tree.nodes.new("ShaderNodeObjectInfo")
        blender_scenes.link(material, info.outputs["Random"], blender_scenes.shader_of(material).inputs["Base Color"])
        box = blender_scenes.box(material=material)
        assert not can_compare(blender_scenes.read_objects(box), [box])

    def test_generated_coordinates_of_several_objects(self):
        material = blender_scenes.create_material("Noise")
        noise = material.node_tree.nodes.new("ShaderNodeTexNoise")
        blender_scenes.link(material, noise.outputs[0], blender_scenes.shader_of(material).inputs["Base Color"])
        one, two = blender_scenes.box("One", material), blender_scenes.box("Two", material)
        assert can_compare(blender_scenes.read_objects(one), [one])
        assert not can_compare(blender_scenes.read_objects(one, two), [one, two])

    def test_lights_in_an_instanced_collection(self):
        collection = bpy.data.collections.new("House")
        box = blender_scenes.box()
        bpy.ops.object.light_add()
        for item in (box, bpy.context.object):
            bpy.context.scene.collection.objects.unlink(item)
            collection.objects.link(item)
        owner = bpy.data.objects.new("Instance", None)
        owner.instance_type, owner.instance_collection = "COLLECTION", collection
        bpy.context.scene.collection.objects.link(owner)
        bpy.context.view_layer.update()
        assert not can_compare(blender_scenes.read_objects(owner), [owner])

    def test_large_sources(self, monkeypatch):
        monkeypatch.setattr(decimate_comparison, "MAX_TRIANGLES", 11)
        box = blender_scenes.box()
        assert not can_compare(blender_scenes.read_objects(box), [box])

    @pytest.mark.slow
    def test_levels_that_are_too_fine_or_heavy(self, monkeypatch):
        ball = blender_scenes.ball()
        job = build(ball)
        source, shown = job.sources[0], list(levels().values())
        monkeypatch.setattr(decimate_comparison, "MAX_PIXELS", 20)
        assert run_to_end(compare_with_decimate(source, [ball], shown)) == []

    @pytest.mark.slow
    def test_clouds_without_textures(self):
        assert build(blender_scenes.ball(), textures=False).comparisons == [[]]


@pytest.mark.slow
@pytest.mark.parametrize("is_removed", [pytest.param(False, marks=pytest.mark.exhaustive), True])
def test_nothing_is_left_when_the_build_ends_during_the_comparison(is_removed):
    ball = blender_scenes.ball(material=blender_scenes.create_material("Clay"))
    select(ball)
    job = prepare_job(bpy.context, [ball], BillboardSettings(levels=1, samples=1, error=0.04), BuildOptions())
    quads = run_to_end(job.core_steps())
    before = blender_scenes.count_data()
    steps = job.scene_steps(quads)
    while "Comparing" not in next(steps).label:
        pass
    assert not clouds_in(bpy.context.scene)
    if is_removed:
        bpy.data.objects.remove(ball)
        with pytest.raises(GeometryError, match="were removed while"):
            run_to_end(steps)
    else:
        steps.close()
        assert not ball.hide_render
    assert blender_scenes.count_data() == before | {"objects": before["objects"] - is_removed} and not levels()
