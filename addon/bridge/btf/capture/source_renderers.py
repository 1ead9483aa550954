"""Capture of a cloud's source with Cycles: face IDs per view, radiance per view and light, or color and normal without light.

The model *emission* needs the radiance, the model *surface* the colors and normals. Face IDs are rendered from proxies whose faces emit
their own index, with holes where their materials are transparent. Open one renderer after the other, never two at once: between renders
Blender keeps the data of only one scene.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy
import numpy as np

from ....core.btf.capture.observations import ID_BUFFER_SCALE, ViewRender
from ....core.btf.estimate import image_resolution
from ....core.btf.reflectance.disc_lights import disc_radius
from ....core.btf.settings import BtfSettings
from ....core.geometry.cameras import OrthographicView
from ....core.geometry.directions import DirectionGrid
from ....core.geometry.mesh import face_areas_and_normals
from ...cameras import light_matrix, set_camera_view
from ...geometry.mesh_arrays import write_attribute
from ...geometry.meshes import Source
from ...rendering.render_scene import RenderScene, prepare_channel_render, prepare_cycles, render_scene
from ...shading.material_channels import CaptureMaterial, build_capture_material
from ...shading.node_builder import NodeBuilder, has_emission
from ...shading.surface_layers import EMISSION
from .proxies import add_channel_proxies, add_proxies, single_placement

MAX_TRANSPARENT_BOUNCES = 256
MIN_FILTER_WIDTH = 0.01  # Pixels: the narrowest filter of Cycles.
FACE_ID = "farfield_face_id"  # Face attribute (id // BASE, id % BASE, 1): single precision holds each component exactly.
BASE = 4096
MIN_OPAQUE_ALPHA = 0.5  # A face with less alpha is transparent.


class FaceIdRenderer:
    """Renders the face IDs of a source from any view."""

    def __init__(self, work: RenderScene) -> None:
        self.work = work

    def render_face_ids(self, view: OrthographicView) -> np.ndarray:
        """Return the face ID (H, W) int32 at the center of every pixel of `view`, -1 for none."""
        set_camera_view(self.work.scene, view)
        return decode_face_ids(self.work.render())


class RadianceRenderer:
    """Renders the source objects from any view, under one Sun light or uniform World lighting."""

    def __init__(self, work: RenderScene, source: Source, settings: BtfSettings) -> None:
        self.work, self._source, self._settings = work, source, settings
        light = work.own(bpy.data.lights.new("Farfield Sun", "SUN"))
        light.energy, light.angle = 1.0, 2.0 * disc_radius(settings.sun_solid_angle)
        self._sun = work.add_object(light)
        self._black_world, self._white_world = (work.add_world(radiance) for radiance in (0.0, 1.0))
        self._has_emission = has_emission(source.materials)

    def render_view(self, view: OrthographicView, face_ids: np.ndarray) -> ViewRender:
        """Render one view under every Sun direction of the light grid, and last under uniform World lighting.

        Emission is subtracted from all of them. If a material may emit light, one more render captures it.

        face_ids: of this view, as `ViewRender.face_ids`.
        """
        sun_directions = self._settings.light_grid.directions
        set_camera_view(self.work.scene, view)
        radiance = np.empty((len(sun_directions) + 1, view.resolution, view.resolution, 3), np.float32)
        coverage = np.zeros((view.resolution, view.resolution), np.float32)
        self.work.scene.world, self._sun.hide_render = self._black_world, False
        for index in range(len(sun_directions) + 1):
            if index < len(sun_directions):
                self._sun.matrix_world = light_matrix(sun_directions[index])
            else:
                self.work.scene.world, self._sun.hide_render = self._white_world, True
            render = self.work.render()
            radiance[index] = render[..., :3]
            coverage += render[..., 3] / (len(sun_directions) + 1)
        emission = None
        if self._has_emission:
            emission = self.render_emission(view)
            radiance = np.maximum(radiance - emission, 0.0)
        heights = compute_heights(self._source, view.supersample(ID_BUFFER_SCALE), face_ids)
        return ViewRender(radiance, coverage, face_ids, heights, emission)

    def render_emission(self, view: OrthographicView) -> np.ndarray:
        """Render the emitted radiance (H, W, 3) float32 of the source, premultiplied, from one view."""
        set_camera_view(self.work.scene, view)
        self.work.scene.world, self._sun.hide_render = self._black_world, True
        return self.work.render()[..., :3]


class SurfaceRenderer:
    """Renders color, coverage and normal of a source from any view."""

    def __init__(self, work: RenderScene, source: Source, materials: Sequence[CaptureMaterial], settings: BtfSettings) -> None:
        self.work, self._source, self._materials, self._settings = work, source, materials, settings

    def render_view(self, view: OrthographicView, face_ids: np.ndarray) -> ViewRender:
        """Render one view. Its images are color and world-space normal, encoded in 0..1; both are premultiplied.

        face_ids: of this view, as `ViewRender.face_ids`.
        """
        set_camera_view(self.work.scene, view)
        color = self._render_channel("color", self._settings.silhouette_samples)
        normal = self._render_channel("normal", self._settings.normal_samples)
        # Both must be premultiplied by the same coverage, but the one of fewer samples is noisier.
        normal[..., :3] *= color[..., 3:] / np.maximum(normal[..., 3:], 1e-6)
        heights = compute_heights(self._source, view.supersample(ID_BUFFER_SCALE), face_ids)
        return ViewRender(np.stack([color[..., :3], normal[..., :3]]), color[..., 3], face_ids, heights)

    def _render_channel(self, channel: str, samples: int) -> np.ndarray:
        self.work.scene.cycles.samples = samples
        for material in self._materials:
            material.emit(channel)
        return self.work.render()


def compute_heights(source: Source, view: OrthographicView, face_ids: np.ndarray) -> np.ndarray:
    """Return the height (H, W) above the view's center of the surface at every pixel center, on the plane of its face; -inf for none."""
    row, column = np.nonzero(face_ids >= 0)
    point, normal = _face_planes(source, face_ids[row, column])
    x = (column + 0.5 - 0.5 * view.resolution) * view.pixel_size
    y = (row + 0.5 - 0.5 * view.resolution) * view.pixel_size
    base = view.center + x[:, None] * view.right + y[:, None] * view.up
    cosine = normal @ view.direction
    cosine = np.where(np.abs(cosine) < 1e-3, np.copysign(1e-3, cosine), cosine)
    heights = np.full(face_ids.shape, -np.inf)
    heights[row, column] = np.einsum("ni,ni->n", point - base, normal) / cosine
    return heights


@contextmanager
def open_face_id_renderer(source: Source, settings: BtfSettings, threads: int) -> Iterator[FaceIdRenderer]:
    """Open a renderer for the face IDs of `source` that uses `threads` threads. It leaves nothing behind."""
    with render_scene("Farfield Face IDs") as work:
        add_face_id_proxies(work, source)
        _prepare_scene(work, settings, threads)
        cycles = work.scene.cycles
        cycles.samples, cycles.max_bounces = 1, 0
        cycles.pixel_filter_type = "BLACKMAN_HARRIS"  # Its width can be set.
        cycles.filter_width = MIN_FILTER_WIDTH
        yield FaceIdRenderer(work)


def add_face_id_proxies(work: RenderScene, source: Source) -> None:
    """Add proxies of all faces of `source`, at their world-space positions, to the scene of `work`; see `decode_face_ids`."""
    placement = single_placement(np.zeros(3))
    for mesh, drawn in add_proxies(work, source, placement, lambda original, color_layer: _face_id_material(original, color_layer, work)):
        digits = np.stack([drawn.primitives // BASE, drawn.primitives % BASE, np.ones(len(drawn.primitives))], axis=1)
        write_attribute(mesh, FACE_ID, "FACE", digits)


def decode_face_ids(render: np.ndarray) -> np.ndarray:
    """Return the face ID (H, W) int32 in every pixel of a render (H, W, 4) of the proxies, -1 for none."""
    high, low, mask = np.moveaxis(render[..., :3], -1, 0)
    return np.where(mask > 0.5, np.rint(high).astype(np.int64) * BASE + np.rint(low).astype(np.int64), -1).astype(np.int32)


def _face_id_material(original: bpy.types.Material | None, color_layer: str, work: RenderScene) -> bpy.types.Material:
    """Return a copy of a material that emits the face ID where it is opaque and is transparent elsewhere."""
    capture = build_capture_material(original, color_layer, 1.0, False, work)
    builder = NodeBuilder(capture.material.node_tree)
    is_opaque = builder.math("GREATER_THAN", capture.channels.alpha, MIN_OPAQUE_ALPHA)
    builder.connect(builder.vector("SCALE", builder.attribute(FACE_ID), is_opaque), capture.emission.inputs["Color"])
    builder.connect(builder.math("SUBTRACT", 1.0, is_opaque), capture.transparent.inputs["Color"])
    return capture.material


@contextmanager
def open_radiance_renderer(
    objects: Sequence[bpy.types.Object], source: Source, settings: BtfSettings, threads: int
) -> Iterator[RadianceRenderer]:
    """Open a renderer for the `objects` that `source` was read from. It uses `threads` threads and leaves nothing behind.

    Objects that are disabled in renders are enabled meanwhile.
    """
    with render_scene("Farfield Radiance") as work, work.show(objects):
        _prepare_scene(work, settings, threads)
        yield RadianceRenderer(work, source, settings)


@contextmanager
def open_surface_renderer(source: Source, settings: BtfSettings, threads: int) -> Iterator[SurfaceRenderer]:
    """Open a renderer for `source` that uses `threads` threads. It leaves nothing behind."""
    with render_scene("Farfield Surface") as work:
        prepare_channel_render(work.scene, 1, 1, settings.seed)
        work.scene.render.threads_mode, work.scene.render.threads = "FIXED", threads
        layers = (EMISSION,) if has_emission(source.materials) else ()  # Emitted light is no part of the color.
        materials = add_channel_proxies(work, source, single_placement(np.zeros(3)), 1.0, layers)
        yield SurfaceRenderer(work, source, materials, settings)


def build_views(source: Source, grid: DirectionGrid, pixel_size: float) -> list[OrthographicView]:
    """Return one view per direction of `grid` that contains the whole source. pixel_size: a length."""
    center, radius = source.bounding_sphere
    return [OrthographicView(direction, center, image_resolution(radius, pixel_size), pixel_size) for direction in grid.directions]


def _face_planes(source: Source, face_ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a point (N, 3) and the unit normal (N, 3) of each face."""
    if source.mesh is None:
        return source.points.points[face_ids], source.points.normals[face_ids]
    corners = source.mesh.vertices[source.mesh.triangles[face_ids]]
    return corners[:, 0], face_areas_and_normals(corners)[1]


def _prepare_scene(work: RenderScene, settings: BtfSettings, threads: int) -> None:
    scene = work.scene
    prepare_cycles(scene, settings.samples, MAX_TRANSPARENT_BOUNCES)
    scene.render.threads_mode, scene.render.threads = "FIXED", threads
    scene.cycles.seed = settings.seed
    scene.cycles.pixel_filter_type = "BOX"
