"""PBR maps of a cloud, captured from the real materials with Cycles.

The faces that the quads of a level show are laid flat on their rectangles of the atlas, all quads at once. One orthographic camera above
renders every front at the atlas resolution, one below renders every back, each with three channels: color, normal, and roughness, metallic
and depth. A level takes six renders, and one or two for each layer that the materials may have, see `surface_layers`.
"""

import math
from collections.abc import Sequence
from functools import partial

import bpy
import numpy as np

from ...core.billboards.cloud import Cloud, Level
from ...core.billboards.settings import BillboardSettings
from ...core.jobs.progress import Progress, Steps
from ..geometry.meshes import Source
from ..imaging.images import check_images
from ..rendering.render_scene import RenderScene, prepare_channel_render, render_scene
from ..shading.material_channels import CHANNELS, SEEN_THROUGH_GLASS, CaptureMaterial, build_capture_material
from ..shading.surface_layers import SUMMED_LAYERS, TRANSLUCENCY, TRANSMISSION, find_layers
from .atlas_meshes import (
    add_atlas_mesh,
    compute_atlas_positions,
    compute_cell_coordinates,
    compute_placement,
    copy_materials,
    find_drawn_triangles,
    separate_heights,
)
from .layer_maps import LayerMaps, compute_layer, separate_glass, shade_translucency
from .level_maps import LevelTextures, compute_maps
from .silhouettes import SurfaceContinuation

Renders = dict[tuple[str, str], np.ndarray]  # premultiplied images (H, W, 4) by side and channel
SIDES = ("front", "back")
MIN_SAMPLES = 4  # Minimum samples of the channels other than color.
MIN_UNSCALED_TEXEL, MAX_UNSCALED_TEXEL = 1e-3, 1e3  # Texel sizes that single precision and the camera's clipping handle without scaling.


def capture_textures(source: Source, cloud: Cloud, settings: BillboardSettings) -> Steps[list[LevelTextures]]:
    """Capture the maps of every level of `cloud`. Runs in Blender's main thread; each step is one render.

    The user's scene, selection and mode stay unchanged. All temporary data is removed, also when the generator is closed early.

    Raises:
        FileError: an image file of a material is missing, or the temporary folder cannot hold a render.
        FarfieldError: Cycles is disabled.
    """
    check_images(source)
    surface_continuation = SurfaceContinuation(source)
    layers, parameters = find_layers(source.materials)
    textures = []
    for index, level in enumerate(cloud.levels):
        passes = _list_passes(level, layers)
        with render_scene("Farfield Capture") as work:
            prepare_channel_render(work.scene, *level.atlas.size, settings.seed)
            work.camera.data.ortho_scale = level.atlas.size[0] * level.texel_size / _unit(level)
            materials, max_height = _add_meshes(work, source, level, layers)
            renders: Renders = {}
            for side, channel in passes:
                _place_camera(work.camera, side, max_height)
                fraction = (index + len(renders) / len(passes)) / len(cloud.levels)
                yield Progress(fraction, f"Capturing {channel.replace('_', ' ')} of level {index}, {side}")
                for material in materials:
                    material.emit(channel)
                work.scene.cycles.samples = _samples(channel, settings)
                image = work.render()
                renders[side, channel] = image if side == "front" else image[:, ::-1]
        found = _compute_layers(renders, layers, level)
        alphas = [renders[side, "color"][..., 3] for side in SIDES]
        masks = surface_continuation.find_texels(level, alphas), surface_continuation.find_uncovered(level, alphas)
        maps = (compute_maps(*(renders[side, channel] for channel in CHANNELS), level, *masks) for side in SIDES)
        textures.append(LevelTextures(*maps, found, parameters))
    return textures


def _list_passes(level: Level, layers: Sequence[str]) -> list[tuple[str, str]]:
    """Return the renders of a level as side and channel. Backs that nobody sees have no layers but the one that the coverage needs."""
    back_layers = [layer for layer in layers if layer == TRANSMISSION or not level.solid.all()]
    return [(side, channel) for side in SIDES for channel in (*CHANNELS, *(layers if side == "front" else back_layers))]


def _compute_layers(renders: Renders, layers: Sequence[str], level: Level) -> dict[str, LayerMaps]:
    """Compute the layers of a level, and correct the coverage of its `renders` where they show glass."""
    for side in SIDES if TRANSMISSION in layers else ():
        separated = separate_glass(renders[side, "color"], renders[side, TRANSMISSION], level)
        renders[side, "color"], renders[side, TRANSMISSION], through = separated
        for channel in SEEN_THROUGH_GLASS - {"color"}:
            if (side, channel) in renders:
                renders[side, channel][..., 3] += through
    if TRANSLUCENCY in layers:
        depths = [renders[side, "roughness_metallic_depth"] for side in SIDES]
        for side in SIDES:
            if (side, TRANSLUCENCY) in renders:
                renders[side, TRANSLUCENCY] = shade_translucency(renders[side, TRANSLUCENCY], *depths, level)
    found = {}
    for layer in layers:
        maps = compute_layer(layer, {side: renders[side, layer] for side in SIDES if (side, layer) in renders}, level)
        if maps is not None:
            found[layer] = maps
    return found


def _samples(channel: str, settings: BillboardSettings) -> int:
    """Samples per texel. Alpha along the edge of a leaf, or light along that of a window, is a mean over all samples; other channels vary
    less and need fewer."""
    if channel == "color" or channel in SUMMED_LAYERS:
        return settings.samples
    return max(min(settings.samples, MIN_SAMPLES), settings.samples // 4)


def _unit(level: Level) -> float:
    """The length of one unit in the capture scene: a scene unit, or the texel size if that is extremely large or small."""
    return 1.0 if MIN_UNSCALED_TEXEL <= level.texel_size <= MAX_UNSCALED_TEXEL else level.texel_size


def _add_meshes(work: RenderScene, source: Source, level: Level, layers: Sequence[str]) -> tuple[list[CaptureMaterial], float]:
    """Add the faces that the quads show to the capture scene.

    Returns their materials, and the largest height above or below the atlas plane plus one texel, in capture units.
    """
    placement, unit = compute_placement(level), _unit(level)
    copies: dict[tuple, CaptureMaterial] = {}
    max_height = 0.0
    quads = np.repeat(np.arange(len(level.quads)), np.diff(level.quads.drawn_offsets))
    for drawn in find_drawn_triangles(source, level.quads.drawn, quads):
        world, flat = compute_atlas_positions(drawn, placement)
        flat[..., 2] += separate_heights(drawn.quads, level.error)[:, None]
        cell_coordinates = compute_cell_coordinates(level, placement, flat, drawn.quads)
        clip = bool(np.abs(cell_coordinates).max() > 1.0)
        copy_material = partial(build_capture_material, error=level.error / unit, clip=clip, work=work, layers=layers)
        captures = copy_materials(source, drawn, copies, copy_material, clip)
        materials = [capture.material for capture in captures]
        add_atlas_mesh(work, drawn, world, flat / unit, cell_coordinates, placement, materials)
        max_height = max(max_height, float(np.abs(flat[..., 2]).max()) / unit)
    return list(copies.values()), max_height + level.texel_size / unit


def _place_camera(camera: bpy.types.Object, side: str, max_height: float) -> None:
    """Place the camera above the atlas plane for the fronts, below it for the backs; the render from below is mirrored."""
    distance = 2.0 * max_height
    camera.location = (0.0, 0.0, distance if side == "front" else -distance)
    camera.rotation_euler = (0.0, 0.0 if side == "front" else math.pi, 0.0)
    camera.data.clip_start, camera.data.clip_end = 0.5 * max_height, 3.5 * max_height
