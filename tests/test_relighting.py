"""Pictures under held-out suns: what is equal scores as equal, only the original is spared its noise, and the scene stays as it was."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import peers  # noqa: E402 - only where bpy is
from bridge import blender_scenes  # noqa: E402
from bridge.bakes import cloud_of, job_of  # noqa: E402
from farfield.addon.bridge.btf_clouds import light_with  # noqa: E402
from farfield.addon.bridge.btf_materials import light_property  # noqa: E402
from farfield.addon.core.progress import finish  # noqa: E402
from farfield.addon.operators.long_work import whole  # noqa: E402
from flip import mean_flip  # noqa: E402
from relighting import Contestant, encoded, held_out_pairs, plain_twin, relight, score  # noqa: E402


@pytest.fixture(scope="module")
def relit(extension, tmp_path_factory):
    """A ball and the finest level of its cloud, in a file: relightable, and lit by nothing."""
    blender_scenes.fresh()
    cloud = cloud_of(blender_scenes.ball(made=blender_scenes.material("Red", (0.8, 0.2, 0.1), 1.0)))
    finish(whole(job_of(cloud, None)))
    path = tmp_path_factory.mktemp("relit") / "ball.blend"
    names = cloud.sources[0].name, cloud.levels[0].name
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
    return path, *names


@pytest.fixture
def ball_and_level(relit):
    bpy.ops.wm.open_mainfile(filepath=str(relit[0]))
    return [bpy.data.objects[name] for name in relit[1:]]


@pytest.mark.parametrize("upper", [False, True])
def test_pairs_are_unit_directions_and_above_the_horizon_where_they_should(upper):
    views, suns = held_out_pairs(24, upper)
    for directions in (views, suns):
        assert directions.shape == (24, 3)
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
        assert (directions[:, 2].min() > 0.0) == upper
    assert len({tuple(pair) for pair in np.column_stack([views, suns]).round(6)}) == 24
    np.testing.assert_array_equal(held_out_pairs(24, upper)[1], suns)


def test_a_copy_of_the_original_is_as_good_as_it_gets(ball_and_level):
    ball, level = ball_and_level
    copy = ball.copy()
    bpy.context.scene.collection.objects.link(copy)
    before = blender_scenes.counts()
    rivals = [Contestant("copy", [copy])]
    compared = finish(relight([ball], level, rivals, 0.1, held_out_pairs(3, False), 64))
    assert blender_scenes.counts() == before
    assert compared.names == ["original", "relightable", "copy"]
    figures = compared.figures()
    assert figures["copy"]["psnr"] > 35.0 and figures["copy"]["psnr"] > figures["relightable"]["psnr"] + 3.0
    assert figures["copy"]["alpha_iou"] > 0.99
    assert 0.5 < figures["relightable"]["alpha_iou"] < 1.0
    assert level.animation_data is None or not level.animation_data.drivers
    assert list(level[light_property(0)]) == [0.0, 0.0, 0.0]


def test_every_relightable_contestant_is_lit(ball_and_level):
    ball, level = ball_and_level
    second = level.copy()
    second.animation_data_clear()
    bpy.context.scene.collection.objects.link(second)
    light_with(level, [], [0.0] * 3)
    rivals = [Contestant("second", [second], relightable=True), Contestant("plain", [plain_twin(level)])]
    compared = finish(relight([ball], level, rivals, 0.1, held_out_pairs(2, False), 4))
    first, same, plain = (pictures[..., :3] for pictures in compared.pictures[1:])
    np.testing.assert_allclose(same, first, atol=1e-5)
    assert first.max() > 0.1 and np.abs(plain - first).max() > 0.01


def test_only_the_original_takes_the_samples_of_the_reference(ball_and_level):
    ball, level = ball_and_level
    copy = ball.copy()
    bpy.context.scene.collection.objects.link(copy)
    pairs = held_out_pairs(1, False)
    rivals = [Contestant("copy", [copy])]
    clean = finish(relight([ball], level, rivals, 0.1, pairs, 256)).pictures[0]
    noisy = finish(relight([ball], level, rivals, 0.1, pairs, 1, 256)).pictures
    original, rival = (np.sqrt(np.mean((pictures - clean) ** 2)) for pictures in (noisy[0], noisy[2]))
    assert original < 0.3 * rival


def test_scores_do_not_depend_on_the_room_around():
    random = np.random.default_rng(0)
    pair = random.uniform(0.2, 0.8, (2, 20, 24, 4)).astype(np.float32)
    small, large = (np.pad(pair, ((0, 0), (room, room), (room, room), (0, 0))) for room in (8, 30))
    assert score(*small) == pytest.approx(score(*large))
    assert encoded(*large)[0].shape == (30, 34, 3)


@pytest.mark.skipif(peers.python() is None, reason="flip-evaluator is not there to compare pictures: run python3 scripts/peers.py")
def test_flip_is_nothing_for_equals_and_grows_with_the_difference():
    random = np.random.default_rng(1)
    picture = random.random((32, 40, 3))
    black, white = np.zeros((16, 48, 3)), np.ones((16, 48, 3))
    equal, near, far, opposite = mean_flip([(picture, picture), (picture, 0.95 * picture), (picture, 0.5 * picture), (black, white)])
    assert equal == 0.0
    assert 0.0 < near < far < opposite <= 1.0
    assert opposite > 0.9


def test_without_the_peers_there_is_no_flip(monkeypatch):
    monkeypatch.setattr(peers, "python", lambda: None)
    assert mean_flip([(np.zeros((16, 16, 3)),) * 2]) is None
