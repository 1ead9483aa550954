"""The time that levels take is said before they are made."""

import bpy
import pytest

from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.operators.texmesh.estimates import Estimator, count_source_triangles, estimator
from textured_scenes import textured_ball

SETTINGS = TexmeshSettings()


def test_before_the_first_run_it_is_a_range_that_grows_with_the_triangles():
    shortest, longest = Estimator().estimate([1000], SETTINGS)
    assert 0.0 < shortest < longest
    assert Estimator().estimate([1000, 1000], SETTINGS) == pytest.approx((2.0 * shortest, 2.0 * longest))
    assert Estimator().estimate([1000], TexmeshSettings(levels="number", number=6)) == (shortest, longest)


def test_nothing_is_said_without_meshes_or_about_settings_with_other_costs():
    assert Estimator().estimate([], SETTINGS) is None
    assert Estimator().estimate([1000], TexmeshSettings(views=3)) is None


def test_a_run_tells_the_time_of_its_meshes_and_narrows_that_of_others():
    known, quick = Estimator(), TexmeshSettings(views=3)
    known.remember([500, 2000], quick, 12.0)
    assert known.estimate([2000, 500], quick) == (12.0, 12.0)
    shortest, longest = known.estimate([2000, 2000, 500, 500], quick)
    assert shortest < 24.0 < longest < 7.0 * shortest


@pytest.mark.slow
@pytest.mark.usefixtures("empty_scene", "few_samples")
def test_triangles_are_those_that_levels_are_made_of():
    ball = textured_ball(8)
    duplicate = ball.copy()
    bpy.context.scene.collection.objects.link(duplicate)
    counts = count_source_triangles([ball, duplicate], bpy.context.evaluated_depsgraph_get())
    assert len(counts) == 1, "linked duplicates share their levels"
    assert bpy.ops.farfield.texmesh_levels(levels="number", number=2, views=1, max_image=32) == {"FINISHED"}
    assert estimator.run.triangles == tuple(counts) and estimator.run.seconds > 0.0


@pytest.mark.usefixtures("empty_scene")
def test_triangles_of_modifiers_and_collections_count():
    ball = textured_ball(8)
    before = count_source_triangles([ball], bpy.context.evaluated_depsgraph_get())
    ball.modifiers.new("Subdivision", "SUBSURF").levels = 1
    bpy.context.view_layer.update()
    after = count_source_triangles([ball], bpy.context.evaluated_depsgraph_get())
    assert after[0] > 3 * before[0]
    asset, instance = bpy.data.collections.new("Asset"), bpy.data.objects.new("Instance", None)
    asset.objects.link(ball)
    instance.instance_type, instance.instance_collection = "COLLECTION", asset
    assert count_source_triangles([instance], bpy.context.evaluated_depsgraph_get()) == after
