"""Cycles as every picture of ours has it: on the processor, with all of its samples, through stacks of transparent surfaces."""

import bpy


def prepare_cycles(scene: bpy.types.Scene, samples: int, most_transparent: int) -> None:
    """Set `scene` up for orthographic renders with transparent film; rays pass so many transparent surfaces."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.film_transparent = True
    render.use_persistent_data = True
    render.resolution_percentage = 100
    render.use_compositing = render.use_sequencer = False
    cycles.device = "CPU"
    cycles.samples = samples
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.transparent_max_bounces = most_transparent
    # The least as well: else paths through stacks end at random, and what surfaces show and how much they cover no longer fit each other.
    cycles.min_transparent_bounces = most_transparent
    scene.camera.data.type = "ORTHO"
