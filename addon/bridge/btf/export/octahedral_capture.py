"""The frames of an octahedral impostor, captured from the original materials with Cycles: color and alpha, normal, height, roughness.

Proxies of all faces, translated so that the center of the object is the origin, emit one channel at a time; see `material_channels`. An
orthographic camera renders one image per frame and channel.
"""

from collections.abc import Sequence
from dataclasses import replace

import bpy
import numpy as np

from ....core.btf.octahedral import MIN_FRAME_RESOLUTION, FrameGrid, OctahedralAtlas
from ....core.errors import SettingsError
from ....core.imaging.images import MIN_ALPHA, mean_over_coverage
from ....core.jobs.progress import Progress, Steps
from ...cameras import set_camera_view
from ...geometry.meshes import Source
from ...imaging.images import check_images
from ...rendering.render_scene import prepare_channel_render, render_scene
from ...shading.material_channels import CHANNELS, CaptureMaterial
from ...shading.node_builder import NodeBuilder
from ..capture.proxies import add_channel_proxies, single_placement

MIN_UNSCALED_LENGTH, MAX_UNSCALED_LENGTH = 1e-3, 1e3  # Half sides that single precision and camera clipping handle without scaling.
POSITION = "position"
ATLAS_CHANNELS = (*CHANNELS, POSITION)
MAX_MATERIAL_SAMPLES = 4  # Material parameters vary less within a pixel than coverage at edges.
MARGIN_PIXELS = 1.0  # Between the object and the border of a frame.


def capture_atlas(
    source: Source, grid: FrameGrid, frame_resolution: int, samples: int, channels: Sequence[str] = ATLAS_CHANNELS
) -> Steps[OctahedralAtlas]:
    """Render the frames of `source`, each `frame_resolution` pixels wide and high. Runs in Blender's main thread; each step is one render.

    The user's scene is unchanged, and nothing remains of the renders, even if the generator is closed between two steps.

    samples: Cycles samples per pixel for color and alpha; other channels use fewer. channels: those to render; the maps of others stay 0.

    Raises:
        FileError: if an image file of a material is missing, or the temporary folder cannot store a render.
        SettingsError: if a frame has too few pixels.
        FarfieldError: if Cycles is disabled.
    """
    if frame_resolution < MIN_FRAME_RESOLUTION:
        raise SettingsError(
            f"The frames of an octahedral atlas need at least {MIN_FRAME_RESOLUTION} pixels per side, not {frame_resolution}."
        )
    center, half_side = frame_bounds(source, frame_resolution)
    side = grid.frames_per_side * frame_resolution
    empty_maps = (np.zeros((side, side, *width), np.float32) for width in ((4,), (3,), (), (2,)))
    atlas = OctahedralAtlas(grid, center, half_side, frame_resolution, *empty_maps)
    check_images(source)
    unit = 1.0 if MIN_UNSCALED_LENGTH <= half_side <= MAX_UNSCALED_LENGTH else half_side
    scaled_half_side = half_side / unit
    pixel_size = 2.0 * scaled_half_side / frame_resolution
    with render_scene("Farfield Octahedral") as work:
        prepare_channel_render(work.scene, frame_resolution, frame_resolution, seed=0)
        captures = add_channel_proxies(work, source, single_placement(center, 1.0 / unit), scaled_half_side)
        positions = [_encode_position(capture, scaled_half_side) for capture in captures]
        for i, channel in enumerate(channels):
            work.scene.cycles.samples = samples if channel == "color" else min(samples, MAX_MATERIAL_SAMPLES)
            for capture, position in zip(captures, positions, strict=True):
                if channel == POSITION:
                    NodeBuilder(capture.material.node_tree).connect(position, capture.emission.inputs["Color"])
                else:
                    capture.emit(channel)
            for index in range(len(grid)):
                label = f"Capturing {channel.replace('_', ', ')}, frame {index + 1} of {len(grid)}"
                yield Progress((i + index / len(grid)) / len(channels), label)
                set_camera_view(work.scene, replace(atlas.view(index), center=np.zeros(3), pixel_size=pixel_size))
                _write_frame(atlas, index, channel, work.render())
    return atlas


def frame_bounds(source: Source, frame_resolution: int) -> tuple[np.ndarray, float]:
    """Return the center (3,) of all frames of `source`, and half the side length of a frame that contains it from every direction."""
    points = source.mesh.corners.reshape(-1, 3) if source.mesh is not None else source.points.points
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.linalg.norm(points - center, axis=1).max())
    if source.points is not None:
        radius += float(source.points.radii.max())
    return center, radius * frame_resolution / (frame_resolution - 2.0 * MARGIN_PIXELS)


def _encode_position(capture: CaptureMaterial, half_side: float) -> bpy.types.NodeSocket:
    """Return a socket with the premultiplied position, scaled and offset to 0..1."""
    builder = NodeBuilder(capture.material.node_tree)
    position = builder.node("ShaderNodeNewGeometry").outputs["Position"]
    encoded = builder.vector("ADD", builder.vector("SCALE", position, 0.5 / half_side), (0.5, 0.5, 0.5))
    return builder.vector("SCALE", encoded, capture.channels.alpha)


def _write_frame(atlas: OctahedralAtlas, index: int, channel: str, render: np.ndarray) -> None:
    """Write the `render` (P, P, 4) of a channel of a frame to its map in `atlas`."""
    tile = atlas.tile(index)
    if channel == "color":
        alpha = np.clip(render[..., 3:], 0.0, 1.0)
        atlas.color[tile] = np.concatenate([mean_over_coverage(render, maximum=np.inf), alpha], axis=2)
    elif channel == "normal":
        atlas.normal[tile] = mean_over_coverage(render) * 2.0 - 1.0
    elif channel == "roughness_metallic_depth":
        atlas.roughness_metallic[tile] = mean_over_coverage(render)[..., :2]
    elif (render[..., 3] > MIN_ALPHA).any():
        positions = mean_over_coverage(render) * 2.0 - 1.0
        atlas.height[tile] = np.clip(positions @ atlas.grid.directions[index], -1.0, 1.0)
    else:
        atlas.height[tile] = 0.0  # An empty frame, such as of a card seen edge-on, gets the height of the center.
