"""The state of the paper's experiment while it runs: trials, distances and answers, without a window."""

import math
from dataclasses import replace

import bpy
import mathutils
import numpy as np

from ...bridge.objects import find_by_uid
from ...bridge.texmesh.level_sets import ERROR, FIGURES, LevelSet, read_level_set
from ...bridge.texmesh.trial_objects import create_trial_objects, remove_trial_objects
from ...core.errors import GeometryError, SettingsError
from ...core.geometry.cameras import Camera
from ...core.json_values import parse_json
from ...core.texmesh.figures import read_figures
from ...core.texmesh.perception.calibration import Answer, Trial, next_trial, record_answer
from ...core.texmesh.perception.recorded_answers import RecordedAnswer, read_answers, write_answers
from ...core.texmesh.perception.trial_view import DEPTH, TrialView

ANSWERS = "farfield_texmesh_answers"  # custom property of a scene: JSON with the answers about all objects
STEP = 1.04  # factor of the distance per step
MAX_FACTOR = 8.0  # Relative to the distance of the coarsest level.
TURN = math.radians(40.0)  # per second


class CalibrationRun:
    """One judge who looks at one set of levels. `close` removes everything temporary.

    answers: of this run. distance: of the simplified object, in object units for the display, None until it has been placed.
    """

    def __init__(self, scene: bpy.types.Scene, levels: LevelSet, pixels_per_degree: float) -> None:
        """Create the temporary objects and choose the first trial.

        Raises:
            SettingsError: there is only one level, or stored answers or figures are damaged.
        """
        if len(levels.levels) < 2:
            raise SettingsError(f'"{levels.source_name}" has only its original; make levels first.')
        self._scene_uid, self._collection_uid = scene.session_uid, levels.collection.session_uid
        self._pixels_per_degree = pixels_per_degree
        self._name = levels.source_name
        figures = read_figures(levels.collection.get(FIGURES))
        self._stimuli = figures.stimuli
        if len(self._stimuli) != len(levels.levels) - 1:
            raise SettingsError(f'The levels of "{self._name}" are not those that were made; make them again.')
        self._seed = len(read_answers(scene.get(ANSWERS)))
        pixel = math.tan(math.radians(1.0 / pixels_per_degree))
        self._farthest = float(levels.levels[-1][ERROR]) / pixel
        self._expected = [float(level[ERROR]) / pixel / figures.distance_factor for level in levels.levels[1:]]
        corners = np.array(levels.levels[0].bound_box, np.float64)
        self._center = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        self._radius = 0.5 * float(np.linalg.norm(np.ptp(corners, axis=0)))
        self.answers: list[Answer] = []
        self.distance: float | None = None
        self.trial = self._next_trial()
        self._objects = create_trial_objects(scene, levels.levels[0], levels.levels[self.trial.level])

    def place(self, view: mathutils.Matrix, camera: Camera, size: tuple[int, int], near: float, seconds: float) -> None:
        """Place the objects in front of a viewer.

        Args:
            view: of the viewer in world space. size: width and height of the image in pixels. near: distance of the near clipping plane.
            seconds: since the run started.

        Raises:
            GeometryError: something that is needed was removed.
            SettingsError: the viewer is orthographic.
        """
        trial_view = TrialView(camera, size[0] / max(size[1], 1), near, self._center, self._radius, self._pixels_per_degree)
        nearest = trial_view.nearest if camera.field_of_view else 0.0
        if self.distance is None:
            self.trial = replace(self.trial, start_distance=max(self.trial.start_distance, nearest))
            self.distance = self.trial.start_distance
        self.distance = min(max(self.distance, nearest), max(MAX_FACTOR * self._farthest, nearest))
        matrices = [trial_view.object_matrix(self.distance, TURN * seconds, side) for side in (-1, 1)]
        width = camera.pixels * camera.pixel_size(1.0)
        if not self._objects.place(view, *matrices, DEPTH * near, width):
            raise GeometryError("The objects of the calibration were removed; start it again.")

    def move(self, steps: int) -> None:
        """Move the objects by a number of steps, nearer if it is negative."""
        if self.distance is not None:
            self.distance *= STEP**steps

    def accept(self) -> None:
        """Record the distance as the answer, and go on to the next trial.

        Raises:
            GeometryError: the levels or the scene were removed.
        """
        if self.distance is None:
            return
        scene = find_by_uid(bpy.data.scenes, self._scene_uid)
        collection = find_by_uid(bpy.data.collections, self._collection_uid)
        levels = None if collection is None else read_level_set(collection)
        if scene is None or levels is None or len(levels.levels) != len(self._stimuli) + 1:
            raise GeometryError("The levels were removed; make them again.")
        answer = record_answer(self.trial, self.distance)
        index = answer.level - 1
        record = RecordedAnswer(self._name, float(self._stimuli[index]), answer, self._expected[index] or None)
        scene[ANSWERS] = write_answers([*read_answers(scene.get(ANSWERS)), record])
        self.answers.append(answer)
        self.trial, self.distance = self._next_trial(), None
        if not self._objects.show_level(levels.levels[self.trial.level].data):
            raise GeometryError("The objects of the calibration were removed; start it again.")

    def close(self) -> None:
        """Remove everything temporary."""
        remove_trial_objects()

    def _next_trial(self) -> Trial:
        return next_trial(self.answers, len(self._stimuli), self._farthest, self._seed)


def stored_answers(scene: bpy.types.Scene) -> list[RecordedAnswer]:
    """Return the answers that are stored in a scene.

    Raises:
        SettingsError: they are damaged.
    """
    return read_answers(scene.get(ANSWERS))


def clear_answers(scene: bpy.types.Scene) -> int:
    """Remove the answers from a scene, damaged ones, too; return how many there were."""
    text = scene.get(ANSWERS)
    if text is None:
        return 0
    del scene[ANSWERS]
    try:
        return len(parse_json(text))
    except (TypeError, ValueError):
        return 0
