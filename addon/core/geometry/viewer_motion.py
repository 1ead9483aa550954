"""Where a viewer will be soon."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from .viewers import Viewer

MAX_PAUSE = 1.0  # seconds between two views; after a longer one, a viewer is not expected to go on
MAX_TURN = 0.5 * np.pi  # between two views, and ahead of the last one; who turns farther hardly goes on turning
MAX_SHEAR = 1e-4  # Two views differ by a rigid motion unless the space of the terrain changes as well.


@dataclass(frozen=True)
class _Velocity:
    """Constant velocities along and around the axes of the camera: (3,) in the unit of the space, and (3,) radians, per second."""

    linear: np.ndarray
    angular: np.ndarray


class ViewerMotion:
    """The last two views of a viewer, and where it will be if it goes on like that: straight ahead, or along a circle if it turns.

    Both velocities are constant as seen from the camera. That is so when a viewer orbits around a point, steers while it flies, or looks
    around.
    """

    def __init__(self) -> None:
        self._last: tuple[Viewer, float] | None = None
        self._velocity: _Velocity | None = None

    def record(self, viewer: Viewer, time: float) -> None:
        """Take note of a view at a time in seconds."""
        last, self._last, self._velocity = self._last, (viewer, time), None
        if last is not None and 0.0 < time - last[1] <= MAX_PAUSE and viewer.projection.kind == last[0].projection.kind:
            self._velocity = _measure_velocity(last[0].matrix, viewer.matrix, time - last[1])

    def predict(self, seconds: float) -> Viewer | None:
        """Return the viewer `seconds` after the last view, None unless it moves or turns."""
        if self._last is None or self._velocity is None:
            return None
        viewer, velocity = self._last[0], self._velocity
        turn = float(np.linalg.norm(velocity.angular))
        seconds = min(seconds, MAX_TURN / turn) if turn else seconds
        matrix, step = viewer.matrix.copy(), seconds * velocity.angular
        matrix[:3, 3] += matrix[:3, :3] @ _integrate_rotation(step) @ (seconds * velocity.linear)
        if turn:
            matrix[:3, :3] = matrix[:3, :3] @ Rotation.from_rotvec(step).as_matrix()
        return replace(viewer, matrix=matrix)


def _measure_velocity(before: np.ndarray, after: np.ndarray, seconds: float) -> _Velocity | None:
    """Return the constant velocities that lead from one matrix (4, 4) of a camera to the next one; None without, or if it jumped."""
    if np.array_equal(before, after) or not np.isfinite(before).all() or not np.isfinite(after).all():
        return None
    try:
        change = np.linalg.solve(before[:3, :3], after[:3, :3])
        offset = np.linalg.solve(before[:3, :3], after[:3, 3] - before[:3, 3])
    except np.linalg.LinAlgError:
        return None
    if np.array_equal(before[:3, :3], after[:3, :3]):
        return _Velocity(offset / seconds, np.zeros(3))
    if np.abs(change.T @ change - np.eye(3)).max() > MAX_SHEAR or np.linalg.det(change) < 0.0:
        return None
    turn = Rotation.from_matrix(change).as_rotvec()
    if np.linalg.norm(turn) > MAX_TURN:
        return None
    return _Velocity(np.linalg.solve(_integrate_rotation(turn), offset) / seconds, turn / seconds)


def _integrate_rotation(turn: np.ndarray) -> np.ndarray:
    """Return the mean (3, 3) of the rotations by fractions 0 to 1 of a rotation vector (3,): who turns by it while moving by a constant
    velocity along its own axes arrives at this matrix times the velocity (the exponential map of rigid motions)."""
    angle, x, y, z = float(np.linalg.norm(turn)), *turn.tolist()
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    first = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2  # (1 - cos angle) / angle^2
    second = (angle - np.sin(angle)) / angle**3 if angle > 1e-2 else (1.0 - angle**2 / 20.0) / 6.0
    return np.eye(3) + first * cross + second * (cross @ cross)
