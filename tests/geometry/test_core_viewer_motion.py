"""A viewer who moves steadily is expected to go on; others are not."""

import numpy as np
import pytest

from farfield.addon.core.geometry.viewer_motion import MAX_PAUSE, ViewerMotion
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
