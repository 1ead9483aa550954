"""The plainest render there is: no light, no bounce, no filter wider than a pixel, values as they are."""

import bpy

from .cycles_renders import prepare_cycles

MOST_TRANSPARENT_BOUNCES = 1024


def prepare_plain_render(scene: bpy.types.Scene, width: int, height: int, seed: int) -> None:
    """Set `scene` up for Cycles renders that read materials off, see `channels`: one sample a pixel; more are left to set."""
    prepare_cycles(scene, 1, MOST_TRANSPARENT_BOUNCES)
    render, cycles = scene.render, scene.cycles
    render.resolution_x, render.resolution_y = width, height
    render.use_simplify = False
    cycles.seed = seed
    cycles.use_light_tree = False
    # The mean over each texel and nothing beyond it: bilinear look-up in the finished texture blurs enough.
    cycles.pixel_filter_type = "BOX"
    cycles.max_bounces = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    scene.camera.data.sensor_fit = "HORIZONTAL"
