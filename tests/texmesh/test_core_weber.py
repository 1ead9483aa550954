"""Cross-sections of known shapes, Weber fractions, and the estimate of a threshold from answers."""

import json
import math

import numpy as np
import pytest

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.texmesh.perception.calibration import (
    Answer,
    answers_from_rows,
    answers_to_rows,
    estimate_threshold,
    next_trial,
    record_answer,
)
from farfield.addon.core.texmesh.perception.weber import Collapses, measure_cross_section, measure_impacts, measure_thickness
from farfield.addon.core.texmesh.settings import PERCEPTUAL_VALUES, TexmeshSettings
from shapes import box, sheet, sphere

SPHERE = sphere(30)


def test_cross_sections_of_a_ball_and_a_box():
    z = np.array([0.0, 0.0, 1.0])
    for height, expected in ((0.0, 2.0), (0.6, 1.6)):
        position = np.array([height, 0.0, 0.3])
        assert measure_cross_section(SPHERE.vertices, SPHERE.triangles, position, z) == pytest.approx(expected, abs=0.02)
    brick = box((1.0, 2.0, 3.0))
    center = brick.vertices.mean(axis=0)
    assert measure_cross_section(brick.vertices, brick.triangles, center + [0.11, 0.07, 0.0], z) == pytest.approx(3.0)
    assert measure_thickness(brick.vertices, brick.triangles, center + [0.11, 0.07, 1.5], z) == pytest.approx(3.0)


def test_a_line_that_only_touches_gives_the_extent_of_the_object():
    hill = sheet(8, lambda x, y: 0.1 * x + 0.0 * y)
    z = np.array([0.0, 0.0, 1.0])
    assert measure_cross_section(hill.vertices, hill.triangles, hill.vertices[11], z) == pytest.approx(np.ptp(hill.vertices[:, 2]))


def collapses(values: list[float], scales: list[int]) -> Collapses:
    """Vertices near the equator of the sphere onto neighbors."""
    links = np.unique(np.sort(SPHERE.triangles[:, :2], axis=1), axis=0)
    links = links[np.abs(SPHERE.vertices[links[:, 0], 2]) < 0.2][: len(values)]
    return Collapses(links[:, 0], links[:, 1], np.array(values), np.array(scales))


def test_the_largest_displacement_of_a_scale_counts_relative_to_the_diameter():
    impacts = measure_impacts(SPHERE.vertices, SPHERE.triangles, collapses([0.05, 0.1, 0.3, 0.01], [0, 0, 2, 2]), 4, TexmeshSettings())
    assert np.allclose(impacts.values, [0.1, 0.0, 0.3, 0.0]) and np.allclose(impacts.lengths[[0, 2]], 2.0, atol=0.02)
    assert np.allclose(impacts.fractions, [0.05, 0.0, 0.15, 0.0], atol=2e-3)
    assert impacts.is_noticed.tolist() == [False, False, True, False] and impacts.vertices.tolist()[1] == -1


@pytest.mark.parametrize(("perceptual_value", "factor"), [("center", 2.0), ("skeleton", 2.0)])
def test_on_a_ball_radius_and_skeleton_give_twice_the_fraction_of_the_diameter(perceptual_value, factor):
    removed = collapses([0.05, 0.1, 0.3, 0.01], [0, 0, 1, 1])
    usual = measure_impacts(SPHERE.vertices, SPHERE.triangles, removed, 2, TexmeshSettings())
    other = measure_impacts(SPHERE.vertices, SPHERE.triangles, removed, 2, TexmeshSettings(perceptual_value=perceptual_value))
    assert np.allclose(other.fractions, factor * usual.fractions, rtol=0.02)


@pytest.mark.parametrize("perceptual_value", PERCEPTUAL_VALUES)
def test_fractions_do_not_depend_on_the_size_of_the_object(perceptual_value):
    settings = TexmeshSettings(perceptual_value=perceptual_value)
    small = measure_impacts(SPHERE.vertices, SPHERE.triangles, collapses([0.05, 0.1], [0, 1]), 2, settings)
    large = measure_impacts(100.0 * SPHERE.vertices, SPHERE.triangles, collapses([5.0, 10.0], [0, 1]), 2, settings)
    assert np.allclose(small.fractions, large.fractions) and (small.fractions > 0.0).all()


def test_removing_vertices_of_a_plane_has_no_quadric_error():
    flat = sheet(6)
    links = flat.triangles[:4, :2]
    removed = Collapses(links[:, 0], links[:, 1], np.ones(4), np.zeros(4, int))
    assert measure_impacts(flat.vertices, flat.triangles, removed, 1, TexmeshSettings(perceptual_value="quadric")).fractions[0] < 1e-9


def simulate(count: int, threshold: float, steepness: float, seed: int, stimuli: np.ndarray) -> list[Answer]:
    """Answers of judges whose psychometric function is known."""
    random = np.random.default_rng(seed)
    answers: list[Answer] = []
    for _ in range(count):
        trial = next_trial(answers, len(stimuli), 100.0, seed)
        probability = 1.0 / (1.0 + math.exp(-steepness * (stimuli[trial.level - 1] - threshold)))
        answers.append(record_answer(trial, trial.start_distance * (1.3 if random.random() < probability else 0.7)))
    return answers


def test_the_threshold_of_simulated_judges_is_found_within_its_interval():
    stimuli = np.linspace(0.01, 0.2, 12)
    inside = 0
    for seed in range(20):
        threshold = estimate_threshold(simulate(361, 0.096, 60.0, seed, stimuli), stimuli)  # as many evaluations as in the paper
        inside += threshold.low <= 0.096 <= threshold.high
        assert abs(threshold.value - 0.096) < 0.02 and threshold.correlation > 0.9 and 30.0 < threshold.steepness < 120.0
    assert inside >= 16


def test_answers_that_separate_perfectly_give_a_finite_threshold():
    stimuli = np.array([0.02, 0.08, 0.11, 0.2])
    answers = [Answer(level, 1.0, 2.0 if level > 2 else 0.5) for level in (1, 2, 3, 4) for _ in range(5)]
    threshold = estimate_threshold(answers, stimuli)
    assert 0.08 < threshold.value < 0.11 and threshold.low < threshold.value < threshold.high


def test_trials_repeat_with_the_seed_and_show_every_level_in_turn():
    answers: list[Answer] = []
    for turn in range(3):
        levels = []
        for _ in range(5):
            trial = next_trial(answers, 5, 50.0, 7)
            assert trial == next_trial(list(answers), 5, 50.0, 7)
            assert 0.8 * 10.0 * trial.level <= trial.start_distance <= 1.2 * 10.0 * trial.level
            levels.append(trial.level)
            answers.append(record_answer(trial, 3.0))
        assert sorted(levels) == [1, 2, 3, 4, 5], turn
    assert answers_from_rows(json.loads(json.dumps(answers_to_rows(answers))), 5) == answers


def test_unusable_answers_are_refused():
    with pytest.raises(SettingsError, match="too few"):
        estimate_threshold([Answer(1, 1.0, 2.0)], np.array([0.1]))
    with pytest.raises(SettingsError, match="agree"):
        estimate_threshold([Answer(1, 1.0, 2.0)] * 10, np.array([0.1]))
    with pytest.raises(SettingsError, match="more often"):
        estimate_threshold([Answer(1, 1.0, 2.0)] * 9 + [Answer(2, 1.0, 0.5)] * 9, np.array([0.1, 0.3]))
    with pytest.raises(SettingsError, match="make levels"):
        next_trial([], 0, 1.0, 0)
    for rows in (None, [{}], [{"level": 9, "start_distance": 1, "accepted_distance": 1}], [{"level": 1, "start_distance": "x"}], [[1]]):
        with pytest.raises(SettingsError, match="Row 1"):
            answers_from_rows(rows, 3)
