"""The frames of an octahedral impostor, captured from the original materials with Cycles: color and alpha, normal, height, roughness.

Proxies of all faces, translated so that the center of the object is the origin, emit one channel at a time; see `material_channels`. An
orthographic camera renders one image per frame and channel.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ....core.btf.octahedral import MIN_FRAME_RESOLUTION, FrameGrid, OctahedralAtlas
from ....core.errors import SettingsError
from ....core.geometry.cameras import OrthographicView
from ....core.imaging.images import MIN_ALPHA, mean_over_coverage
from ....core.jobs.progress import Progress, Steps
from ...cameras import set_camera_view
from ...geometry.meshes import Source
from ...imaging.images import check_images
from ...rendering.render_scene import RenderScene, prepare_channel_render, render_scene
from ...shading.material_channels import CHANNELS, CaptureMaterial
from ...shading.node_builder import NodeBuilder
from ..capture.proxies import add_channel_proxies, single_placement

MIN_UNSCALED_LENGTH, MAX_UNSCALED_LENGTH = 1e-3, 1e3  # Half sides that single precision and camera clipping handle without scaling.
POSITION = "position"
ATLAS_CHANNELS = (*CHANNELS, POSITION)
MAX_MATERIAL_SAMPLES = 4  # Material parameters vary less within a pixel than coverage at edges.
MARGIN_PIXELS = 1.0  # Between the object and the border of a frame.


@dataclass(frozen=True)
class _FrameRenderer:
    """A scene with proxies in which the frames `views` are rendered."""

    work: RenderScene
    materials: list["_ProxyMaterial"]
    views: list[OrthographicView]

    def show_channel(self, channel: str, samples: int) -> None:
        """Emit `channel` from now on, rendered with `samples` samples."""
        self.work.scene.cycles.samples = samples
        for material in self.materials:
            material.show_channel(channel)

    def render_frame(self, index: int) -> np.ndarray:
        """Return the render (P, P, 4) of frame `index`."""
        set_camera_view(self.work.scene, self.views[index])
        return self.work.render()


@dataclass(frozen=True)
class _ProxyMaterial:
    """A material of the proxies. position: premultiplied position, scaled and offset to 0..1."""

    capture: CaptureMaterial
    position: bpy.types.NodeSocket

    def show_channel(self, channel: str) -> None:
        if channel == POSITION:
            NodeBuilder(self.capture.material.node_tree).connect(self.position, self.capture.emission.inputs["Color"])
        else:
            self.capture.emit(channel)


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
    size = (side, side)
    empty_maps = (
        np.zeros((*size, 4), np.float32),
        np.zeros((*size, 3), np.float32),
        np.zeros(size, np.float32),
        np.zeros((*size, 2), np.float32),
    )
    atlas = OctahedralAtlas(grid, center, half_side, frame_resolution, *empty_maps)
    with _open_frame_renderer(source, atlas) as renderer:
        for i, channel in enumerate(channels):
            renderer.show_channel(channel, samples if channel == "color" else min(samples, MAX_MATERIAL_SAMPLES))
            for index in range(len(grid)):
                label = f"Capturing {channel.replace('_', ', ')}, frame {index + 1} of {len(grid)}"
                yield Progress((i + index / len(grid)) / len(channels), label)
                _WRITERS[channel](atlas, index, renderer.render_frame(index))
    return atlas


def frame_bounds(source: Source, frame_resolution: int) -> tuple[np.ndarray, float]:
    """Return the center (3,) of all frames of `source`, and half the side length of a frame that contains it from every direction."""
    points = source.mesh.vertices if source.mesh is not None else source.points.points
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.linalg.norm(points - center, axis=1).max())
    if source.points is not None:
        radius += float(source.points.radii.max())
    return center, radius * frame_resolution / (frame_resolution - 2.0 * MARGIN_PIXELS)


@contextmanager
def _open_frame_renderer(source: Source, atlas: OctahedralAtlas) -> Iterator[_FrameRenderer]:
    """Open a renderer for the frames of `atlas`, whose maps are not used. It leaves nothing behind."""
    check_images(source)
    unit = 1.0 if MIN_UNSCALED_LENGTH <= atlas.half_side <= MAX_UNSCALED_LENGTH else atlas.half_side
    half_side = atlas.half_side / unit
    pixel_size = 2.0 * half_side / atlas.frame_resolution
    views = [replace(atlas.view(index), center=np.zeros(3), pixel_size=pixel_size) for index in range(len(atlas.grid))]
    with render_scene("Farfield Octahedral") as work:
        prepare_channel_render(work.scene, atlas.frame_resolution, atlas.frame_resolution, seed=0)
        captures = add_channel_proxies(work, source, single_placement(atlas.center, 1.0 / unit), half_side)
        yield _FrameRenderer(work, [_proxy_material(capture, half_side) for capture in captures], views)


def _proxy_material(capture: CaptureMaterial, half_side: float) -> _ProxyMaterial:
    builder = NodeBuilder(capture.material.node_tree)
    position = builder.node("ShaderNodeNewGeometry").outputs["Position"]
    encoded = builder.vector("ADD", builder.vector("SCALE", position, 0.5 / half_side), (0.5, 0.5, 0.5))
    return _ProxyMaterial(capture, builder.vector("SCALE", encoded, capture.channels.alpha))


def _write_color(atlas: OctahedralAtlas, index: int, render: np.ndarray) -> None:
    alpha = np.clip(render[..., 3:], 0.0, 1.0)
    atlas.color[atlas.tile(index)] = np.concatenate([mean_over_coverage(render, maximum=np.inf), alpha], axis=2)


def _write_normal(atlas: OctahedralAtlas, index: int, render: np.ndarray) -> None:
    atlas.normal[atlas.tile(index)] = mean_over_coverage(render) * 2.0 - 1.0


def _write_roughness_metallic(atlas: OctahedralAtlas, index: int, render: np.ndarray) -> None:
    atlas.roughness_metallic[atlas.tile(index)] = mean_over_coverage(render)[..., :2]


def _write_height(atlas: OctahedralAtlas, index: int, render: np.ndarray) -> None:
    # An empty frame, such as of a card seen edge-on, gets the height of the center.
    positions = mean_over_coverage(render) * 2.0 - 1.0 if (render[..., 3] > MIN_ALPHA).any() else np.zeros_like(render[..., :3])
    atlas.height[atlas.tile(index)] = np.clip(positions @ atlas.grid.directions[index], -1.0, 1.0)


_WRITERS: dict[str, Callable[[OctahedralAtlas, int, np.ndarray], None]] = {
    "color": _write_color,
    "normal": _write_normal,
    "roughness_metallic_depth": _write_roughness_metallic,
    POSITION: _write_height,
}
