"""A viewer who moves steadily is expected to go on; others are not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from farfield.addon.core.geometry.viewer_motion import MAX_PAUSE, MAX_TURN, ViewerMotion
from farfield.addon.core.geometry.viewers import Projection, Viewer, look_at

PERSPECTIVE = Projection("perspective", (-0.5, 0.5, -0.4, 0.4), (500, 400), 0.1, 1e4)


def viewer_at(*position, projection=PERSPECTIVE) -> Viewer:
    return Viewer(look_at(np.array(position, float), np.add(position, (1.0, 2.0, -1.0))), projection, True)


def test_the_velocity_and_the_direction_of_view_are_kept():
    motion = ViewerMotion()
    assert motion.predict(1.0) is None
    motion.record(viewer_at(0.0, 0.0, 50.0), 10.0)
    assert motion.predict(1.0) is None, "one view has no velocity"
    last = viewer_at(3.0, -1.0, 50.5)
    motion.record(last, 10.25)
    for seconds in (0.0, 0.1, 2.0):
        predicted = motion.predict(seconds)
        assert predicted.position == pytest.approx([3.0 + 12.0 * seconds, -1.0 - 4.0 * seconds, 50.5 + 2.0 * seconds])
        assert np.array_equal(predicted.matrix[:3, :3], last.matrix[:3, :3]) and predicted.is_interactive
        assert predicted.projection == last.projection
    assert last.position.tolist() == [3.0, -1.0, 50.5], "the recorded view is unchanged"


def test_viewers_who_stay_pause_or_change_their_camera_are_not_predicted():
    orthographic = Projection("orthographic", (-5.0, 5.0, -4.0, 4.0), (500, 400), 0.1, 1e4)
    first = viewer_at(0.0, 0.0, 50.0)
    for second, time in (
        (first, 0.1),
        (viewer_at(1.0, 0.0, 50.0), 0.0),
        (viewer_at(1.0, 0.0, 50.0), 1.01 * MAX_PAUSE),
        (viewer_at(1.0, 0.0, 50.0, projection=orthographic), 0.1),
    ):
        motion = ViewerMotion()
        motion.record(first, 0.0)
        motion.record(second, time)
        assert motion.predict(0.5) is None


def rigid(rotation: Rotation, translation) -> np.ndarray:
    """The matrix (4, 4) of a rotation followed by a translation."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), translation
    return matrix


def orbit(start: np.ndarray, pivot, axis, angle: float) -> Viewer:
    """A viewer with a matrix (4, 4) after a turn around an axis through a pivot."""
    turn = Rotation.from_rotvec(angle * np.array(axis))
    return Viewer(rigid(turn, pivot - turn.apply(pivot)) @ start, PERSPECTIVE, True)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    turn=st.floats(-1.2, 1.2).filter(lambda angle: abs(angle) > 1e-5),
    seconds=st.floats(0.0, 0.3),
    is_scaled=st.booleans(),
)
def test_orbits_and_turns_go_on_exactly_in_terrains_of_any_scale(seed, turn, seconds, is_scaled):
    random = np.random.default_rng(seed)
    axis = random.normal(size=3)
    axis, pivot = axis / np.linalg.norm(axis), random.normal(size=3) * random.choice([0.0, 100.0])
    start = look_at(random.normal(size=3) * 50.0, np.zeros(3))
    space = np.eye(4)
    if is_scaled:
        space[:3, :3] += np.diag([1.0, 0.0, -0.7]) + np.triu(random.uniform(-0.3, 0.3, (3, 3)), 1)
    motion, rate = ViewerMotion(), turn / 0.25
    for time in (0.0, 0.25):
        motion.record(orbit(start, pivot, axis, rate * time).transform(space), 5.0 + time)
    expected = orbit(start, pivot, axis, rate * 0.25 + np.clip(rate * seconds, -MAX_TURN, MAX_TURN)).transform(space)
    predicted = motion.predict(seconds)
    np.testing.assert_allclose(predicted.matrix, expected.matrix, atol=1e-6)
    assert predicted.projection == PERSPECTIVE and predicted.is_interactive


def test_a_viewer_who_steers_flies_along_a_circle():
    motion = ViewerMotion()
    for step in (0, 1):  # 10 m a second forward, a turn to the left of 0.2 radians a second
        heading = Rotation.from_rotvec([0.0, 0.0, 0.2 * step])
        position = 50.0 * np.array([np.sin(0.2 * step), 1.0 - np.cos(0.2 * step), 0.0])
        motion.record(Viewer(look_at(position, position + heading.apply([1.0, 0.0, 0.0])), PERSPECTIVE), float(step))
    predicted = motion.predict(2.0)
    assert predicted.position == pytest.approx(50.0 * np.array([np.sin(0.6), 1.0 - np.cos(0.6), 0.0]))
    assert predicted.matrix[:3, 2] == pytest.approx([-np.cos(0.6), -np.sin(0.6), 0.0]), "it looks along its path"


def test_jumps_and_changes_of_the_space_are_not_predicted():
    first = viewer_at(0.0, 0.0, 50.0)
    stretched = first.transform(np.diag([1.0, 1.0, 2.0, 1.0]))
    mirrored = first.transform(np.diag([-1.0, 1.0, 1.0, 1.0]))
    flat, unknown = first.transform(np.diag([1.0, 1.0, 0.0, 1.0])), first.transform(np.full((4, 4), np.nan))
    turned = orbit(first.matrix, np.zeros(3), (0.0, 0.0, 1.0), 1.01 * MAX_TURN)
    for second in (stretched, mirrored, turned, unknown):
        motion = ViewerMotion()
        motion.record(first, 0.0)
        motion.record(second, 0.1)
        assert motion.predict(0.5) is None
    motion = ViewerMotion()
    motion.record(flat, 0.0)
    motion.record(first, 0.1)
    assert motion.predict(0.5) is None
