"""Fit of the luminance and coverage of a cloud to its source: both are rendered under a uniform sky from some directions.

See `luminance_gains`. Gains of texels follow the noise of the renders, and scale the color, but neither gloss nor what neighbors reflect.
Both leave levels too bright, so those that were far off are rendered again, and scaled by one factor.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import bpy
import numpy as np

from ...core.arrays import TINY
from ...core.billboards.cloud import Cloud, Level
from ...core.billboards.luminance_gains import compute_gains
from ...core.geometry.cameras import OrthographicView
from ...core.geometry.directions import fibonacci_sphere
from ...core.imaging.colors import LUMINANCE
from ...core.jobs.progress import Progress, Steps, subprogress
from ..cameras import set_camera_view
from ..geometry.meshes import Source
from ..rendering.render_scene import RenderScene, prepare_cycles, render_scene
from ..shading.surface_layers import DEFAULT_LEVEL, SPECULAR
from .cloud_materials import create_texel_material
from .clouds import create_level_object, list_level_data
from .level_maps import LevelTextures, PbrMaps

VIEW_COUNT = 12
FIRST_VIEWS = 4  # So many of these views decide whether a level is fitted.
RESOLUTION = 96  # pixels along the diagonal
SAMPLES = 2
MAX_DEVIATION = 0.03  # A level whose luminance was within this is not corrected, or not rendered again.
MAX_TRANSPARENT_BOUNCES = 256
MIN_ALPHA = 0.05  # Colors of pixels with less are not compared.
MIN_OVERLAP = 0.5  # With less overlap of both silhouettes, the objects have changed since they were read.
MIN_BALANCE = 0.7
MARGIN = 1  # pixels
SPECULAR_LEVEL = "Specular IOR Level"  # Input of a Principled shader.


def fit_luminance(
    source: Source, objects: Sequence[bpy.types.Object], cloud: Cloud, textures: Sequence[LevelTextures]
) -> Steps[list[LevelTextures]]:
    """Return the `textures` of `cloud`, a cloud of a mesh, fitted to the `objects` that `source` was read from. Each step is one render.

    Raises:
        FileError: the temporary folder cannot store a render.
    """
    textures = list(textures)
    with render_scene("Farfield Luminance Fit") as work, work.show(objects):
        prepare_cycles(work.scene, SAMPLES, MAX_TRANSPARENT_BOUNCES)
        work.scene.world = work.add_world(1.0)
        work.scene.cycles.pixel_filter_type = "BOX"
        work.scene.cycles.max_bounces = 1
        center, radius = source.bounding_sphere
        pixel_size = 2.0 * radius / RESOLUTION
        views = [OrthographicView(axis, center, RESOLUTION + 2 * MARGIN, pixel_size) for axis in fibonacci_sphere(VIEW_COUNT)]
        step = VIEW_COUNT // FIRST_VIEWS
        views = [view for first in range(step) for view in views[first::step]]  # The first ones are distributed over the sphere.
        wanted = yield from subprogress(_render_views(work, objects, SAMPLES, views[:FIRST_VIEWS]), 0.0, 0.1)
        steps = _find_deviating(work, cloud, textures, source.origin, views, wanted)
        deviating = yield from subprogress(steps, 0.1, 0.3)
        if not deviating:
            return textures
        wanted += yield from subprogress(_render_views(work, objects, SAMPLES, views[FIRST_VIEWS:]), 0.3, 0.4)
        step = 0.6 / len(deviating)
        for index, shown in enumerate(deviating):
            steps = _fit_level(work, cloud.levels[shown.index], textures[shown.index], source.origin, views, wanted, shown)
            textures[shown.index] = yield from subprogress(steps, 0.4 + step * index, 0.4 + step * (index + 1))
    return textures


class ShownLevel(NamedTuple):
    """The level number `index` as users see it, and its renders (H, W, 4) from the first views."""

    index: int
    item: bpy.types.Object
    renders: list[np.ndarray]


def _find_deviating(
    work: RenderScene,
    cloud: Cloud,
    textures: Sequence[LevelTextures],
    origin: np.ndarray,
    views: Sequence[OrthographicView],
    wanted: Sequence[np.ndarray],
) -> Steps[list[ShownLevel]]:
    """Return the levels whose luminance or coverage differs from one of the renders `wanted` of the first `views`.

    There are none if these show other objects than those that the cloud was built from.
    """
    step = 1.0 / len(textures)
    deviating = []
    for index, level in enumerate(cloud.levels):
        shown = _add_level(work, level, textures[index], origin)
        renders = yield from subprogress(_render_views(work, [shown], SAMPLES, views[: len(wanted)]), step * index, step * (index + 1))
        pairs = list(zip(wanted, renders, strict=True))
        if not all(_overlap(*pair) for pair in pairs):
            return []
        if any(_deviates(*pair) for pair in pairs):
            deviating.append(ShownLevel(index, shown, renders))
    return deviating


def _overlap(source: np.ndarray, image: np.ndarray) -> bool:
    """Return whether two renders (H, W, 4) may show the same objects."""
    return np.minimum(source[..., 3], image[..., 3]).sum() >= MIN_OVERLAP * np.maximum(source[..., 3], image[..., 3]).sum()


def _deviates(source: np.ndarray, image: np.ndarray) -> bool:
    """Return whether the luminance, where both renders (H, W, 4) show something, or the coverage differs visibly."""
    is_inside = np.minimum(source[..., 3], image[..., 3]) > 1.0 - MIN_ALPHA
    luminances = [render[is_inside][:, :3].sum(axis=0) @ LUMINANCE for render in (source, image)]
    coverages = [render[..., 3].sum() for render in (source, image)]
    return any(abs(shown - wanted) > MAX_DEVIATION * wanted for wanted, shown in (luminances, coverages))


def _fit_level(
    work: RenderScene,
    level: Level,
    textures: LevelTextures,
    origin: np.ndarray,
    views: Sequence[OrthographicView],
    wanted: Sequence[np.ndarray],
    shown: ShownLevel,
) -> Steps[LevelTextures]:
    """Return `textures` with the luminance and coverage of the renders `wanted`, one per view. shown: the level with these textures."""
    quads = level.atlas.quad_map
    is_loose = ~level.joined & [chart is None for chart in level.charts]
    is_thinned = np.append(is_loose, False)[quads]  # A surface that continues must not get holes.
    ids = yield from subprogress(_render_views(work, [_add_texels(work, shown.item)], 1, views), 0.0, 0.3)
    further_views = views[len(shown.renders) :]
    renders = shown.renders + (yield from subprogress(_render_views(work, [shown.item], SAMPLES, further_views), 0.3, 0.6))
    seen = _observe(wanted, renders, ids, level)
    gain, balance = seen.compare_luminance()
    sides = []
    for maps, is_side in ((textures.front, ~seen.is_back), (textures.back, seen.is_back)):
        gains = compute_gains(seen.texel[is_side], *seen.luminances(is_side), quads)
        opacities = compute_gains(seen.texel[is_side], seen.source_alpha[is_side], seen.alpha[is_side], quads)
        sides.append(_scale(maps, gains[..., None] * balance, np.where(is_thinned, opacities, 1.0)))
    textures = _scale_specular(replace(textures, front=sides[0], back=sides[1]), gain)
    if abs(gain - 1.0) <= MAX_DEVIATION:
        return textures
    fitted = _add_level(work, level, textures, origin)
    renders = yield from subprogress(_render_views(work, [fitted], SAMPLES, views), 0.6, 1.0)
    gain, balance = _observe(wanted, renders, ids, level).compare_luminance()
    front, back = (_scale(maps, gain * balance, np.ones(1)) for maps in (textures.front, textures.back))
    return _scale_specular(replace(textures, front=front, back=back), gain)


def _add_level(work: RenderScene, level: Level, textures: LevelTextures, origin: np.ndarray) -> bpy.types.Object:
    """Add a level to the scene as users see it."""
    groups = set(bpy.data.node_groups)
    shown = create_level_object("Farfield Luminance Fit", level, textures, origin)
    for data in (*set(bpy.data.node_groups).difference(groups), *list_level_data(shown)):
        work.own(data)
    work.scene.collection.objects.link(shown)
    return shown


def _add_texels(work: RenderScene, shown: bpy.types.Object) -> bpy.types.Object:
    """Add the level `shown` once more, with the indices of its texels."""
    texels = work.add_object(shown.data)
    texels.location = shown.location
    texels.material_slots[0].link = "OBJECT"
    texels.material_slots[0].material = work.own(create_texel_material(shown.data.materials[0]))
    return texels


def _render_views(
    work: RenderScene, visible: Sequence[bpy.types.Object], samples: int, views: Sequence[OrthographicView]
) -> Steps[list[np.ndarray]]:
    """Render only the objects `visible`, which is fastest view after view."""
    work.show_only(visible)
    work.scene.cycles.samples = samples
    renders = []
    for index, view in enumerate(views):
        set_camera_view(work.scene, view)
        yield Progress(index / len(views), "Comparing with the original")
        renders.append(work.render())
    return renders


class Observations(NamedTuple):
    """What N pixels show of a level and of its source.

    Attributes:
        texel: (N,) int, row-major index of the texel of the level.
        is_back: (N,) bool, its quad is seen from the back.
        alpha, source_alpha: (N,) coverage.
        color, source_color: (N, 3) premultiplied, scene-linear Rec.709.
    """

    texel: np.ndarray
    is_back: np.ndarray
    alpha: np.ndarray
    source_alpha: np.ndarray
    color: np.ndarray
    source_color: np.ndarray

    @property
    def _weights(self) -> tuple[np.ndarray, np.ndarray]:
        """(N,) factors of both colors where both images show something; the silhouettes have no influence then."""
        alpha = np.minimum(self.alpha, self.source_alpha)
        alpha = np.where(alpha > MIN_ALPHA, alpha, 0.0)
        return alpha / np.maximum(self.alpha, MIN_ALPHA), alpha / np.maximum(self.source_alpha, MIN_ALPHA)

    def luminances(self, selected: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the luminance of source and level in the `selected` (N,) bool pixels."""
        weights = (weight[selected] for weight in self._weights)
        shown, wanted = (
            weight * (color[selected] @ LUMINANCE) for weight, color in zip(weights, (self.color, self.source_color), strict=True)
        )
        return wanted, shown

    def compare_luminance(self) -> tuple[float, np.ndarray]:
        """Return the factor that gives the level the luminance of its source, and factors (3,) of red, green and blue that then give it
        the same mean color."""
        shown, wanted = (weight @ color for weight, color in zip(self._weights, (self.color, self.source_color), strict=True))
        gain = float(wanted @ LUMINANCE / max(shown @ LUMINANCE, TINY))
        return gain, np.clip(wanted / np.maximum(shown * gain, TINY), MIN_BALANCE, 1.0 / MIN_BALANCE).astype(np.float32)


def _observe(sources: Sequence[np.ndarray], images: Sequence[np.ndarray], texels: Sequence[np.ndarray], level: Level) -> Observations:
    """Return what the renders (H, W, 4) of the source, of the level and of its texels show."""
    source, image, texel = (np.concatenate(renders) for renders in (sources, images, texels))
    is_seen, size = texel[..., 2] > 0.5, level.atlas.size
    coordinates = texel[is_seen]
    column, row = (np.clip((coordinates[:, axis] * size[axis]).astype(np.int64), 0, size[axis] - 1) for axis in (0, 1))
    colors = image[is_seen], source[is_seen]
    alphas = (color[:, 3] for color in colors)
    return Observations(row * size[0] + column, coordinates[:, 2] > 1.5, *alphas, *(color[:, :3] for color in colors))


def _scale(maps: PbrMaps, gains: np.ndarray, opacities: np.ndarray) -> PbrMaps:
    """Return `maps` with straight colors times `gains` (H, W, 3) or (3,), and alpha times `opacities` (H, W) or (1,), both at most 1.

    Their product over all rounds is the near visibility.
    """
    alpha = np.clip(maps.color[..., 3:], 0.0, 1.0)
    color = np.minimum(maps.color[..., :3] * gains, alpha)  # No surface reflects more light than it receives.
    opacities = np.minimum(opacities[..., None], 1.0 / np.maximum(alpha, MIN_ALPHA))
    near_visibility = (1.0 if maps.near_visibility is None else maps.near_visibility) * (gains @ LUMINANCE)
    return replace(maps, color=np.concatenate([color, alpha], axis=2) * opacities, near_visibility=near_visibility)


def _scale_specular(textures: LevelTextures, gain: float) -> LevelTextures:
    """Return `textures` with highlights that are darker by the mean `gain` of a level: nothing shades them, either."""
    if gain > 1.0 - MAX_DEVIATION:
        return textures
    if SPECULAR in textures.layers:
        layer = textures.layers[SPECULAR]
        return replace(textures, layers={**textures.layers, SPECULAR: replace(layer, scale=gain * layer.scale)})
    level = textures.parameters.get(SPECULAR_LEVEL, DEFAULT_LEVEL)
    return replace(textures, parameters={**textures.parameters, SPECULAR_LEVEL: gain * level})
