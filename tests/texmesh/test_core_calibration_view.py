"""What a judge sees, what is recorded, and the figures that are stored with levels."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.bridge.texmesh.ring_overlay import ring_around_box
from farfield.addon.bridge.texmesh.scale_attributes import color_scales
from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.geometry.cameras import Camera, distance_to_box
from farfield.addon.core.texmesh.figures import read_figures, step_function
from farfield.addon.core.texmesh.perception.answer_settings import estimate_settings
from farfield.addon.core.texmesh.perception.calibration import Answer, estimate_threshold
from farfield.addon.core.texmesh.perception.recorded_answers import (
    RecordedAnswer,
    decode_answers,
    estimate_distance_factor,
    estimate_recorded,
    merge_answers,
    read_answers,
    write_answers,
)
from farfield.addon.core.texmesh.perception.trial_view import TrialView

FIGURES = {
    "levels": [{"triangles": 1000}, {"triangles": 250}, {"triangles": 31}],
    "candidates": [{"triangles": 1000 >> step, "pixel_size": 0.01 * step} for step in range(6)],
    "weber_fractions": [0.01, 0.05, 0.02, 0.1, 0.3],
    "features": [500, 100, 10],
    "ranges": [1.0, 0.5, 0.2],
}


def view(pixels: int = 1200, aspect: float = 1.5) -> TrialView:
    return TrialView(Camera(np.zeros(3), pixels, 0.8), aspect, 0.1, np.array([1.0, -2.0, 0.5]), 3.0, 67.0)


def project(trial: TrialView, points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Pixels from the center of the image, and depths."""
    placed = points @ matrix[:3, :3].T + matrix[:3, 3]
    return np.column_stack([placed[:, :2] / -placed[:, 2:] / trial.camera.pixel_size(1.0), -placed[:, 2]])


@given(st.floats(1.0, 50.0), st.floats(0.0, 7.0), st.sampled_from([-1, 1]), st.floats(0.5, 3.0))
def test_objects_fit_beside_each_other_beyond_the_near_plane(factor, angle, side, aspect):
    trial = view(aspect=aspect)
    random = np.random.default_rng(0).normal(size=(200, 3))
    points = trial.center + trial.radius * random / np.linalg.norm(random, axis=1, keepdims=True)
    pixels = project(trial, points, trial.object_matrix(factor * trial.nearest, angle, side))
    assert pixels[:, 2].min() > 4.0 * trial.near
    tolerance = 1.2  # perspective enlarges what is near
    assert np.abs(pixels[:, 0] - 150.0 * side).max() < 150.0 * tolerance and np.abs(pixels[:, 1]).max() < 600.0 / aspect * tolerance


def test_an_object_covers_the_pixels_of_the_display():
    trial = view()
    distance = 4.0 * trial.nearest
    pixels = project(trial, trial.center + np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), trial.object_matrix(distance, 0.0, -1))
    np.testing.assert_allclose(pixels[0, :2], [-150.0, 0.0], atol=1e-9)
    assert pixels[1, 0] - pixels[0, 0] == pytest.approx(1.0 / (distance * math.tan(math.radians(1.0 / 67.0))), rel=1e-6)


def test_objects_stand_upright_and_turn():
    trial = view()
    up = trial.center + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for angle in (0.0, 1.0):
        matrix = trial.object_matrix(100.0, angle, 1)
        pixels = project(trial, up, matrix)
        assert abs(pixels[1, 0] - pixels[0, 0]) < 0.1 * (pixels[1, 1] - pixels[0, 1]) and np.linalg.det(matrix[:3, :3]) > 0.0
        assert pixels[1, 2] < pixels[0, 2], "the top is tilted towards the viewer"


def test_an_orthographic_view_is_refused():
    trial = TrialView(Camera(np.zeros(3), 100, 0.0, 5.0), 1.0, 0.1, np.zeros(3), 1.0, 67.0)
    with pytest.raises(SettingsError, match="perspective"):
        trial.object_matrix(1.0, 0.0, 1)


def test_figures_tell_the_factor_of_distances():
    assert read_figures(json.dumps(FIGURES)).distance_factor == 1.0  # Figures of earlier versions.
    assert read_figures(json.dumps(FIGURES | {"distance_factor": 1.5})).distance_factor == 1.5
    for value in (0.0, -1.0, None, "1"):
        with pytest.raises(SettingsError, match="damaged"):
            read_figures(json.dumps(FIGURES | {"distance_factor": value}))


def answers_of_a_judge(seed: int, factor: float = 1.0, count: int = 60) -> list[RecordedAnswer]:
    """Answers of a judge with a threshold of 0.1 who needs `factor` times the distances of FLIP."""
    random = np.random.default_rng(seed)
    records = []
    for stimulus in np.resize(np.linspace(0.02, 0.2, 10), count):
        expected = random.uniform(5.0, 50.0)
        accepted = factor * expected * random.lognormal(0.0, 0.2)
        is_noticed = random.random() < 1.0 / (1.0 + np.exp(-60.0 * (stimulus - 0.1)))
        start = accepted * (0.5 if is_noticed else 2.0)
        records.append(RecordedAnswer("statue", float(stimulus), Answer(1, float(start), float(accepted)), float(expected)))
    return records


def test_answers_of_several_judges_and_files_count_together_and_once():
    first, second = answers_of_a_judge(1, 1.5), answers_of_a_judge(2, 1.5)
    files = [write_answers(first).encode(), write_answers(second + first[:7]).encode()]
    merged = merge_answers(decode_answers(content, "answers.json") for content in files)
    assert merged == first + second
    values, message = estimate_settings(merged)
    assert values["weber_threshold"] == estimate_recorded(first + second).value == pytest.approx(0.1, abs=0.02)
    assert values["distance_factor"] == pytest.approx(1.5, rel=0.1) and "from 120 answers" in message
    for content in (b"", b"[]", b"{}", b"\xff", b'[{"object": 1}]'):
        with pytest.raises(FileError, match="has no answers"):
            decode_answers(content, "answers.json")


def test_answers_of_earlier_versions_give_no_distances():
    records = [dataclasses.replace(record, expected_distance=None) for record in answers_of_a_judge(1)]
    assert read_answers(write_answers(records)) == records
    assert set(estimate_settings(records)[0]) == {"weber_threshold"}
    with pytest.raises(SettingsError, match="too few"):
        estimate_distance_factor(answers_of_a_judge(1)[:7])


def test_answers_survive_and_those_about_several_objects_count_together():
    random = np.random.default_rng(1)
    stimuli = np.concatenate([np.linspace(0.02, 0.2, 10)] * 6)
    noticed = random.random(60) < 1.0 / (1.0 + np.exp(-60.0 * (stimuli - 0.1)))
    records = [
        RecordedAnswer("AB"[row % 2], float(stimulus), Answer(1 + row % 3, 2.0, 3.0 if is_noticed else 1.0))
        for row, (stimulus, is_noticed) in enumerate(zip(stimuli, noticed, strict=True))
    ]
    again = read_answers(write_answers(records))
    assert again == records
    together = [Answer(number, 2.0, record.answer.accepted_distance) for number, record in enumerate(records, 1)]
    threshold = estimate_recorded(again)
    assert threshold == estimate_threshold(together, stimuli) and threshold.value == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize("text", ["{", "7", '[{"level": 1}]', 5, '[{"level": 1, "start_distance": 1, "accepted_distance": 1}]', "[null]"])
def test_damaged_answers_are_refused_in_one_sentence(text):
    with pytest.raises(SettingsError):
        read_answers(text)


def test_no_answers():
    assert read_answers(None) == read_answers("") == read_answers("[]") == []


def test_the_stimulus_of_a_level_is_the_largest_refinement_up_to_it():
    np.testing.assert_allclose(read_figures(json.dumps(FIGURES)).stimuli, [0.05, 0.3])


@pytest.mark.parametrize("change", [{"features": []}, {"levels": [1]}, {"ranges": ["a"]}, {"candidates": None}, {"ranges": [float("inf")]}])
def test_damaged_figures_are_refused(change):
    with pytest.raises(SettingsError, match="make the levels again"):
        read_figures(json.dumps({**FIGURES, **change}))
    for text in (None, 3, "{", "[]"):
        with pytest.raises(SettingsError, match="make the levels again"):
            read_figures(text)


@given(st.lists(st.floats(0.001, 10.0), min_size=1, max_size=12))
def test_the_step_function_gives_the_coarsest_level_that_is_right(sizes):
    corners = step_function([0.0, *sizes])
    x, y = np.array(corners).T
    assert (np.diff(x) >= 0.0).all() and (np.diff(y) >= 0.0).all() and y[-1] == len(sizes)
    for pixel in (0.5, 5.0, 11.0):
        expected = max([0, *(index for index, size in enumerate(sizes, 1) if size <= pixel)])
        assert (y[x <= pixel][-1] if (x <= pixel).any() else 0) == expected


def test_colors_hide_scales_below_the_lowest():
    colors = color_scales(np.arange(21), 5)
    assert (colors[:5, 3] == 0.0).all() and (colors[5:, 3] > 0.5).all() and colors.dtype == np.float32
    assert len(np.unique(colors[:, :3], axis=0)) == 21 and colors.min() >= 0.0 and colors.max() <= 1.0


@given(st.floats(0.01, 100.0))
def test_a_ring_has_one_distance_from_the_box(distance):
    low, high = np.array([-1.0, 0.0, 2.0]), np.array([3.0, 1.0, 4.0])
    ring = ring_around_box(low, high, distance)
    np.testing.assert_allclose([distance_to_box(point, low, high) for point in ring], distance, rtol=1e-9)
    x, y = (ring[:, :2] - [1.0, 0.5]).T
    turns = np.unwrap(np.arctan2(y, x))
    assert (np.diff(turns) > 0.0).all() and turns[-1] - turns[0] < 2.0 * math.pi
