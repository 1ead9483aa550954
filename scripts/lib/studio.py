"""A studio for comparison renders: one Sun light, a dim gray World and an orthographic camera, in a temporary scene of its own."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy
import mathutils
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.cameras import light_matrix
from farfield.addon.bridge.rendering.render_scene import RenderScene, prepare_cycles, render_scene
from farfield.addon.compat import enable_nodes
from lib.shader_nodes import find_node

SUN_DIRECTION = (0.45, -0.55, 0.70)  # towards the Sun light, world space
SUN_STRENGTH = 3.0  # W/m2 across the beam
SUN_ANGLE = 0.05  # radians across the disc
SKY_RADIANCE = 0.3  # the same gray from all directions
MAX_TRANSPARENT_BOUNCES = 256  # transparent surfaces that a ray may pass


class Studio:
    """Renders selected objects under one light. Created by `open_studio`. work: its scene. sun: the Sun light."""

    def __init__(self, work: RenderScene) -> None:
        self.work = work
        self.sun = _add_sun(work)

    def set_sun_direction(self, direction: np.ndarray) -> None:
        """Rotate the Sun light: `direction` (3,) points towards it."""
        self.sun.matrix_world = light_matrix(direction)

    def set_samples(self, samples: int) -> None:
        """Set the samples per pixel of later renders."""
        scene = self.work.scene
        scene.cycles.samples = scene.eevee.taa_render_samples = samples

    def set_engine(self, engine: str) -> None:
        """Set the render engine of later renders; the default is Cycles."""
        self.work.scene.render.engine = engine

    def render(
        self, visible: Sequence[bpy.types.Object], direction: np.ndarray, center: np.ndarray, pixel_size: float, size: int
    ) -> np.ndarray:
        """Render the objects `visible` from `direction` (3,) with `center` (3,) in the center of the image.

        `pixel_size` is the side of a pixel in scene units; it is constant, since the camera is orthographic.
        Returns (size, size, 4) float32, scene-linear, premultiplied, row 0 at the bottom.
        """
        self.work.show_only(visible)
        extent = pixel_size * size
        camera, render = self.work.camera, self.work.scene.render
        camera.data.ortho_scale = extent
        camera.data.clip_start, camera.data.clip_end = 0.01 * extent, 10.0 * extent
        camera.matrix_world = look_at_matrix(direction, center + 5.0 * extent * direction)
        render.resolution_x = render.resolution_y = size
        return self.work.render()


@contextmanager
def open_studio(objects: Sequence[bpy.types.Object], samples: int) -> Iterator[Studio]:
    """Yield a studio that contains `objects` and renders with `samples` Cycles samples per pixel. Removes everything that it creates.

    Objects that the user has disabled in renders can be rendered; the property is restored at the end.
    """
    with render_scene("Farfield Studio") as work, work.show(objects):
        _add_sky(work)
        prepare_cycles(work.scene, samples, MAX_TRANSPARENT_BOUNCES)
        yield Studio(work)


def bounding_sphere(objects: Sequence[bpy.types.Object]) -> tuple[np.ndarray, float]:
    """Return the center (3,) and radius of a sphere around the world-space bounding boxes of `objects`."""
    bpy.context.view_layer.update()
    corners = np.concatenate([np.array([item.matrix_world @ mathutils.Vector(corner) for corner in item.bound_box]) for item in objects])
    low, high = corners.min(axis=0), corners.max(axis=0)
    return 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))


def look_at_matrix(direction: np.ndarray, position: np.ndarray) -> mathutils.Matrix:
    """Return the world matrix of a camera at `position` (3,) that looks against the unit `direction` (3,), with world Z upwards."""
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([right, np.cross(direction, right), direction, position])
    return mathutils.Matrix(matrix.tolist())


def sun_matrix() -> mathutils.Matrix:
    """Return the world matrix of the studio's Sun light."""
    return look_at_matrix(np.array(SUN_DIRECTION) / np.linalg.norm(SUN_DIRECTION), np.zeros(3))


def set_uniform_sky(world: bpy.types.World) -> None:
    """Give `world` the studio's uniform gray background."""
    enable_nodes(world)
    background = find_node(world.node_tree, "BACKGROUND")
    background.inputs["Color"].default_value = (SKY_RADIANCE, SKY_RADIANCE, SKY_RADIANCE, 1.0)
    background.inputs["Strength"].default_value = 1.0


def _add_sun(work: RenderScene) -> bpy.types.Object:
    light = work.own(bpy.data.lights.new("Farfield Studio", "SUN"))
    light.energy, light.angle = SUN_STRENGTH, SUN_ANGLE
    sun = work.add_object(light)
    sun.matrix_world = sun_matrix()
    return sun


def _add_sky(work: RenderScene) -> None:
    work.scene.world = work.own(bpy.data.worlds.new("Farfield Studio"))
    set_uniform_sky(work.scene.world)
