"""Cycles settings of Farfield's own renders."""

import bpy

MAX_TRANSPARENT_BOUNCES = 1024


def prepare_cycles(scene: bpy.types.Scene, samples: int, max_transparent_bounces: int) -> None:
    """Set up `scene` for orthographic Cycles renders on the CPU, with transparent film, all samples and `max_transparent_bounces`."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.film_transparent = True
    render.use_persistent_data = True
    render.resolution_percentage = 100
    render.use_compositing = render.use_sequencer = False
    cycles.device = "CPU"
    cycles.samples = samples
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.transparent_max_bounces = max_transparent_bounces
    # The minimum too: otherwise paths through stacks end at random, and color and coverage no longer match.
    cycles.min_transparent_bounces = max_transparent_bounces
    scene.camera.data.type = "ORTHO"


def prepare_channel_render(scene: bpy.types.Scene, width: int, height: int, seed: int) -> None:
    """Set up `scene` for Cycles renders of material channels, see `material_channels`: emission only, one sample per pixel, no bounces.

    Callers may raise the number of samples.
    """
    prepare_cycles(scene, 1, MAX_TRANSPARENT_BOUNCES)
    render, cycles = scene.render, scene.cycles
    render.resolution_x, render.resolution_y = width, height
    render.use_simplify = False
    cycles.seed = seed
    cycles.use_light_tree = False
    # The mean over each texel and nothing outside: the bilinear lookup in the finished texture blurs enough.
    cycles.pixel_filter_type = "BOX"
    cycles.max_bounces = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    scene.camera.data.sensor_fit = "HORIZONTAL"
