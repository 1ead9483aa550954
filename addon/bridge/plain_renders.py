"""The plainest render there is: no light, no bounce, no filter wider than a pixel, values as they are."""

import bpy

MOST_TRANSPARENT_BOUNCES = 1024


def prepare_plain_render(scene: bpy.types.Scene, width: int, height: int, seed: int) -> None:
    """Set `scene` up for orthographic Cycles renders that read materials off, see `channels`; the samples are left to set."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = width, height
    render.resolution_percentage = 100
    render.film_transparent = True
    render.use_persistent_data = True
    render.use_simplify = False
    render.use_compositing = render.use_sequencer = False
    cycles.device = "CPU"
    cycles.seed = seed
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_light_tree = False
    # The mean over each texel and nothing beyond it: bilinear look-up in the finished texture blurs enough.
    cycles.pixel_filter_type = "BOX"
    cycles.max_bounces = 0
    cycles.transparent_max_bounces = MOST_TRANSPARENT_BOUNCES
    # Else paths through transparent surfaces end at random, so that what shines and how much it covers no longer fit each other.
    cycles.min_transparent_bounces = MOST_TRANSPARENT_BOUNCES
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    scene.camera.data.type = "ORTHO"
    scene.camera.data.sensor_fit = "HORIZONTAL"
