"""Comparisons under held-out Sun directions: equal objects get equal scores, only the source takes the reference samples, and the scene
is unchanged."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import reference_tools  # noqa: E402 - only if bpy is available
from bridge import blender_scenes  # noqa: E402
from bridge.bakes import bake_finished_views, build_small_cloud, finished_views_of_small_cloud  # noqa: E402
from farfield.addon.bridge.btf.levels.emission_levels import link_suns  # noqa: E402
from farfield.addon.bridge.btf.materials.emission_material import sun_color_property  # noqa: E402
from farfield.addon.core.jobs.progress import run_to_end  # noqa: E402
from lib.flip_metric import mean_flip  # noqa: E402
from lib.relighting import Candidate, compare_relighting, copy_with_pbr_material, crop_and_encode, held_out_pairs, score_renders  # noqa: E402


@pytest.fixture(scope="module")
def relit(extension, tmp_path_factory):
    """A file with a ball and the finest level of its cloud, which is relightable and linked to no light."""
    finished_views_of_small_cloud()
    cloud = build_small_cloud()
    bake_finished_views(cloud)
    path = tmp_path_factory.mktemp("relit") / "ball.blend"
    names = cloud.sources[0].name, cloud.levels[0].name
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
    return path, *names


@pytest.fixture
def ball_and_level(relit):
    bpy.ops.wm.open_mainfile(filepath=str(relit[0]))
    return [bpy.data.objects[name] for name in relit[1:]]


@pytest.mark.slow
@pytest.mark.parametrize("upper", [False, True])
def test_pairs_are_unit_directions_above_the_horizon_if_requested(upper):
    views, suns = held_out_pairs(24, upper)
    for directions in (views, suns):
        assert directions.shape == (24, 3)
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
        assert (directions[:, 2].min() > 0.0) == upper
    assert len({tuple(pair) for pair in np.column_stack([views, suns]).round(6)}) == 24
    np.testing.assert_array_equal(held_out_pairs(24, upper)[1], suns)


@pytest.mark.slow
def test_a_copy_of_the_source_gets_the_best_score(ball_and_level):
    ball, level = ball_and_level
    copy = ball.copy()
    bpy.context.scene.collection.objects.link(copy)
    counts = blender_scenes.count_data()
    candidates = [Candidate("copy", [copy])]
    comparison = run_to_end(compare_relighting([ball], level, candidates, 0.1, held_out_pairs(1, False), 64))
    assert blender_scenes.count_data() == counts
    assert comparison.names == ["source", "relightable", "copy"]
    scores = comparison.mean_scores()
    assert scores["copy"]["psnr"] > 35.0 and scores["copy"]["psnr"] > scores["relightable"]["psnr"] + 3.0
    assert scores["copy"]["alpha_iou"] > 0.99
    assert 0.5 < scores["relightable"]["alpha_iou"] < 1.0
    assert level.animation_data is None or not level.animation_data.drivers
    assert list(level[sun_color_property(0)]) == [0.0, 0.0, 0.0]


@pytest.mark.slow
def test_every_relightable_candidate_is_lit(ball_and_level):
    ball, level = ball_and_level
    second = level.copy()
    second.animation_data_clear()
    bpy.context.scene.collection.objects.link(second)
    link_suns(level, [], [0.0] * 3)
    candidates = [Candidate("second", [second], relightable=True), Candidate("PBR", [copy_with_pbr_material(level)])]
    comparison = run_to_end(compare_relighting([ball], level, candidates, 0.1, held_out_pairs(2, False), 4))
    first, second_render, pbr = (renders[..., :3] for renders in comparison.renders[1:])
    np.testing.assert_allclose(second_render, first, atol=1e-5)
    assert first.max() > 0.1 and np.abs(pbr - first).max() > 0.01


@pytest.mark.exhaustive
def test_only_the_source_takes_the_reference_samples(ball_and_level):
    ball, level = ball_and_level
    copy = ball.copy()
    bpy.context.scene.collection.objects.link(copy)
    pairs = held_out_pairs(1, False)
    candidates = [Candidate("copy", [copy])]
    clean = run_to_end(compare_relighting([ball], level, candidates, 0.1, pairs, 256)).renders[0]
    noisy = run_to_end(compare_relighting([ball], level, candidates, 0.1, pairs, 1, 256)).renders
    source_noise, candidate_noise = (np.sqrt(np.mean((renders - clean) ** 2)) for renders in (noisy[0], noisy[2]))
    assert source_noise < 0.3 * candidate_noise


@pytest.mark.slow
def test_scores_do_not_depend_on_the_margin():
    random = np.random.default_rng(0)
    pair = random.uniform(0.2, 0.8, (2, 20, 24, 4)).astype(np.float32)
    small, large = (np.pad(pair, ((0, 0), (margin, margin), (margin, margin), (0, 0))) for margin in (8, 30))
    assert score_renders(*small) == pytest.approx(score_renders(*large))
    assert crop_and_encode(*large)[0].shape == (30, 34, 3)


@pytest.mark.slow
@pytest.mark.skipif(reference_tools.find_python() is None, reason="flip-evaluator is not installed: run python3 scripts/reference_tools.py")
def test_flip_is_zero_for_equal_images_and_grows_with_the_difference():
    random = np.random.default_rng(1)
    image = random.random((32, 40, 3))
    black, white = np.zeros((16, 48, 3)), np.ones((16, 48, 3))
    equal, near, far, opposite = mean_flip([(image, image), (image, 0.95 * image), (image, 0.5 * image), (black, white)])
    assert equal == 0.0
    assert 0.0 < near < far < opposite <= 1.0
    assert opposite > 0.9


@pytest.mark.slow
def test_without_the_reference_tools_there_is_no_flip(monkeypatch):
    monkeypatch.setattr(reference_tools, "find_python", lambda: None)
    assert mean_flip([(np.zeros((16, 16, 3)),) * 2]) is None
