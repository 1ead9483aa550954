"""Capture of a cloud's source for the model *surface*: color and normal of its materials from every view, without light."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy
import numpy as np

from ...core.btf.capture.observations import ID_BUFFER_SCALE, ViewRender
from ...core.btf.settings import BtfSettings
from ...core.geometry.cameras import OrthographicView
from ..cameras import set_camera_view
from ..geometry.meshes import Source
from ..rendering.cycles_renders import prepare_channel_render
from ..rendering.render_scene import RenderScene, render_scene
from ..shading.material_channels import CaptureMaterial, build_capture_material
from .capture import compute_heights
from .proxies import add_proxies, single_placement


class SurfaceRenderer:
    """Renders color, coverage and normal of a source from any view."""

    def __init__(self, work: RenderScene, source: Source, materials: Sequence[CaptureMaterial], settings: BtfSettings) -> None:
        self._work, self._source, self._materials, self._settings = work, source, materials, settings

    @property
    def render_seconds(self) -> float:
        """Total time of all Cycles renders so far."""
        return self._work.render_seconds

    def render_view(self, view: OrthographicView, face_ids: np.ndarray, emission: np.ndarray | None) -> ViewRender:
        """Render one view. Its images are color and world-space normal, encoded in 0..1; both are premultiplied.

        face_ids, emission: of this view, as in `ViewRender`.
        """
        set_camera_view(self._work.scene, view)
        color = self._render_channel("color", self._settings.silhouette_samples)
        normal = self._render_channel("normal", self._settings.normal_samples)
        # Both must be premultiplied by the same coverage, but the one of fewer samples is noisier.
        normal[..., :3] *= color[..., 3:] / np.maximum(normal[..., 3:], 1e-6)
        heights = compute_heights(self._source, view.supersample(ID_BUFFER_SCALE), face_ids)
        return ViewRender(np.stack([color[..., :3], normal[..., :3]]), color[..., 3], face_ids, heights, emission)

    def _render_channel(self, channel: str, samples: int) -> np.ndarray:
        self._work.scene.cycles.samples = samples
        for material in self._materials:
            material.emit(channel)
        return self._work.render()


@contextmanager
def open_surface_renderer(source: Source, settings: BtfSettings, threads: int) -> Iterator[SurfaceRenderer]:
    """Open a renderer for `source` that uses `threads` threads. It leaves nothing behind. No other renderer may be open, see `capture`."""
    materials: list[CaptureMaterial] = []
    with render_scene("Farfield Surface") as work:
        prepare_channel_render(work.scene, 1, 1, settings.seed)
        work.scene.render.threads_mode, work.scene.render.threads = "FIXED", threads

        def copy_material(original: bpy.types.Material | None, color_layer: str) -> bpy.types.Material:
            materials.append(build_capture_material(original, color_layer, 1.0, False, work))
            return materials[-1].material

        for _ in add_proxies(work, source, single_placement(np.zeros(3)), copy_material):
            pass
        yield SurfaceRenderer(work, source, materials, settings)
