"""Calibration of how much light the loose quads of a surface material block, by renders compared with the source.

A quad shows all leaves within one error of its plane, so they no longer shade each other, and a crown would get too bright. How much
depends on the model: in some crowns the silhouettes block as much light as the leaves did, in others it takes all that the PBR maps cover.
So the factor with the least error is chosen, from views and under Suns that the bake has not seen.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import bpy
import numpy as np

from ....core.geometry.cameras import OrthographicView
from ....core.imaging.metrics import composite_over_gray
from ....core.jobs.progress import Progress, Steps
from ...billboards.cloud_materials import JOINED_ATTRIBUTE
from ...billboards.level_objects import read_quad_flags
from ...cameras import light_matrix, set_camera_view
from ...geometry.mesh_arrays import read_positions
from ...lod_crossfade import CROSSFADE, MAX_PIXEL, MIN_PIXEL, MIN_RANGE, PIXEL_SIZE
from ...rendering.render_scene import MAX_TRANSPARENT_BOUNCES, RenderScene, prepare_cycles, render_scene
from ..materials.surface_material import DEFAULT_LIGHT_COVERAGE, set_light_coverage

CANDIDATES = (0.0, 0.5, 1.0)
PAIR_COUNT = 3  # Number of pairs of view and Sun.
SOURCE_SAMPLES, SAMPLES = 32, 16
SHOW_ALWAYS = [MIN_PIXEL, MAX_PIXEL, MIN_RANGE], [0.0, 1.0, 0.0]  # For a material with a cross-fade.
SUN_STRENGTH, SUN_ANGLE, SKY_RADIANCE = 3.0, 0.05, 0.3


def has_loose_quads(level_object: bpy.types.Object) -> bool:
    """Whether any quad of a level is loose: not joined with others to a surface, so that its light coverage matters."""
    return not read_quad_flags(level_object, JOINED_ATTRIBUTE).all()


def calibrate_light_coverage(
    level_object: bpy.types.Object, sources: Sequence[bpy.types.Object], center: np.ndarray, view: OrthographicView, seed: int
) -> Steps[float]:
    """Set the light coverage of the surface material of a level to the best of CANDIDATES, and return it. Each step is one render.

    If the generator is closed before, it is DEFAULT_LIGHT_COVERAGE.

    sources: the source objects, unchanged since the cloud was built. center (3,): the mean of the level's vertices in world space then.
    view: any view that shows all of the source at the size of the level's texels.

    Raises:
        FileError: the temporary folder cannot store a render.
    """
    material, best = level_object.data.materials[0], DEFAULT_LIGHT_COVERAGE
    random = np.random.default_rng([seed, PAIR_COUNT])
    directions = random.standard_normal((2, PAIR_COUNT, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    errors = np.zeros(len(CANDIDATES))
    try:
        with _open_scene(level_object, sources, center) as (work, level_copy, sun):
            for index, (direction, sun_direction) in enumerate(zip(*directions, strict=True)):
                set_camera_view(work.scene, replace(view, direction=direction))
                sun.matrix_world = light_matrix(sun_direction)
                yield Progress(index / PAIR_COUNT, "Calibrating light")
                reference = _render(work, sources, [level_copy], SOURCE_SAMPLES)
                for candidate, light_coverage in enumerate(CANDIDATES):
                    yield Progress((index + (candidate + 1) / (len(CANDIDATES) + 1)) / PAIR_COUNT, "Calibrating light")
                    set_light_coverage(material, light_coverage)
                    image = _render(work, [level_copy], sources, SAMPLES)
                    errors[candidate] += float(((image - reference) ** 2).sum())
        best = CANDIDATES[int(np.argmin(errors))]
    finally:
        set_light_coverage(material, best)
    return best


def _render(work: RenderScene, visible: Sequence[bpy.types.Object], others: Sequence[bpy.types.Object], samples: int) -> np.ndarray:
    """Render the `visible` objects; return display values (H, W, 3) over gray."""
    for items, is_hidden in ((visible, False), (others, True)):
        for item in items:
            item.hide_render = is_hidden
    work.scene.cycles.samples = samples
    return composite_over_gray(work.render())


@contextmanager
def _open_scene(
    level_object: bpy.types.Object, sources: Sequence[bpy.types.Object], center: np.ndarray
) -> Iterator[tuple[RenderScene, bpy.types.Object, bpy.types.Object]]:
    """Open a scene with the sources, a copy of the level where it was built, a Sun light and a gray World. Yield scene, copy and Sun."""
    with render_scene("Farfield Calibration") as work, work.show(sources):
        copy = work.own(bpy.data.objects.new("Farfield Calibration", level_object.data))
        work.scene.collection.objects.link(copy)
        copy[CROSSFADE], copy[PIXEL_SIZE] = SHOW_ALWAYS
        copy.location = center - read_positions(level_object.data).mean(axis=0)
        light = work.own(bpy.data.lights.new("Farfield Calibration", "SUN"))
        light.energy, light.angle = SUN_STRENGTH, SUN_ANGLE
        work.scene.world = work.add_world(SKY_RADIANCE)
        prepare_cycles(work.scene, SAMPLES, MAX_TRANSPARENT_BOUNCES)
        yield work, copy, work.add_object(light)
