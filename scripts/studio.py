"""A studio for comparing: one sun, a dim grey sky and an orthographic camera, in a scene of its own that leaves the user's scene alone."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy
import mathutils
import numpy as np

import environment

environment.import_farfield()

from farfield.addon.bridge.cycles_renders import prepare_cycles
from farfield.addon.bridge.temporary import TemporaryScene, temporary_scene

SUN_DIRECTION = (0.45, -0.55, 0.70)  # towards the sun, world space
SUN_STRENGTH = 3.0  # W/m2 across the beam
SUN_ANGLE = 0.05  # radians across the disc
SKY_RADIANCE = 0.3  # the same grey from everywhere
STACKED_QUADS = 256  # transparent surfaces that a ray may pass


class Studio:
    """Takes pictures of chosen objects under one light; made by `studio`. sun: its lamp."""

    def __init__(self, work: TemporaryScene, objects: Sequence[bpy.types.Object]) -> None:
        self._work = work
        self._objects = list(objects)
        self.sun = _add_sun(work)

    def shine_from(self, direction: np.ndarray) -> None:
        """Turn the sun: `direction` (3,) points towards it."""
        self.sun.matrix_world = mathutils.Vector(direction).to_track_quat("Z", "Y").to_matrix().to_4x4()

    def take_samples(self, samples: int) -> None:
        """From now on take so many samples a pixel."""
        scene = self._work.scene
        scene.cycles.samples = scene.eevee.taa_render_samples = samples

    def render_with(self, engine: str) -> None:
        """From now on render with another engine than Cycles."""
        self._work.scene.render.engine = engine

    def picture(
        self, shown: Sequence[bpy.types.Object], direction: np.ndarray, center: np.ndarray, pixel_size: float, size: int
    ) -> np.ndarray:
        """The objects `shown`, seen from `direction` (3,) with `center` (3,) in the middle.

        `pixel_size` is the side of a pixel in scene units, anywhere in the picture, since the camera is orthographic.
        Returns (size, size, 4) float32, scene-linear, premultiplied, row 0 at the bottom.
        """
        for item in self._objects:
            item.hide_render = item not in shown
        extent = pixel_size * size
        camera, render = self._work.camera, self._work.scene.render
        camera.data.ortho_scale = extent
        camera.data.clip_start, camera.data.clip_end = 0.01 * extent, 10.0 * extent
        camera.matrix_world = looking_along(direction, center + 5.0 * extent * direction)
        render.resolution_x = render.resolution_y = size
        return self._work.render()


@contextmanager
def studio(objects: Sequence[bpy.types.Object], samples: int) -> Iterator[Studio]:
    """A studio with `objects` in it, as bright as its lamps make them, `samples` Cycles samples a pixel. Leaves nothing behind.

    Whether the user has disabled an object in renders does not matter here, and is as before at the end.
    """
    hidden = [item.hide_render for item in objects]
    with temporary_scene("Farfield Studio") as work:
        for item in objects:
            work.scene.collection.objects.link(item)
        _add_sky(work)
        prepare_cycles(work.scene, samples, STACKED_QUADS)
        try:
            yield Studio(work, objects)
        finally:
            for item, was_hidden in zip(objects, hidden, strict=True):
                item.hide_render = was_hidden


def bounds(objects: Sequence[bpy.types.Object]) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius of a sphere around the world-space bounding boxes of `objects`."""
    bpy.context.view_layer.update()
    corners = np.concatenate([np.array([item.matrix_world @ mathutils.Vector(corner) for corner in item.bound_box]) for item in objects])
    low, high = corners.min(axis=0), corners.max(axis=0)
    return 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))


def looking_along(direction: np.ndarray, place: np.ndarray) -> mathutils.Matrix:
    """World matrix of a camera at `place` (3,) that looks against the unit `direction` (3,), world Z upwards in the picture."""
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([right, np.cross(direction, right), direction, place])
    return mathutils.Matrix(matrix.tolist())


def sun_matrix() -> mathutils.Matrix:
    """World matrix of the studio's sun lamp."""
    return looking_along(np.array(SUN_DIRECTION) / np.linalg.norm(SUN_DIRECTION), np.zeros(3))


def paint_sky(world: bpy.types.World) -> None:
    """Give `world` the studio's even grey."""
    if world.node_tree is None:
        world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (SKY_RADIANCE, SKY_RADIANCE, SKY_RADIANCE, 1.0)
    background.inputs["Strength"].default_value = 1.0


def _add_sun(work: TemporaryScene) -> bpy.types.Object:
    light = work.keep(bpy.data.lights.new("Farfield Studio", "SUN"))
    light.energy, light.angle = SUN_STRENGTH, SUN_ANGLE
    sun = work.add(light)
    sun.matrix_world = sun_matrix()
    return sun


def _add_sky(work: TemporaryScene) -> None:
    work.scene.world = work.keep(bpy.data.worlds.new("Farfield Studio"))
    paint_sky(work.scene.world)
