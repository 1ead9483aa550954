"""Textures of a cloud, captured from the real materials with Cycles.

The faces that a quad shows are laid flat upon its rectangle of the atlas, those of all quads of a level at once. One orthographic camera
above sees every front at the atlas' resolution, one below every back; each renders colour, normal and surface. Six renders make a level.
"""

import math

import bpy
import numpy as np

from ..core.billboards.cloud import Cloud, Level
from ..core.billboards.settings import BillboardSettings
from ..core.progress import Progress, Steps
from .channels import CHANNELS, CaptureMaterial, capture_material
from .images import check_images
from .meshes import Source
from .outlines import Continuations
from .plain_renders import prepare_plain_render
from .slot_meshes import drawn_surfaces, places_inside, slot_mesh, slot_positions
from .slots import slots_of
from .surfaces import MaterialKey
from .temporary import TemporaryScene, temporary_scene
from .textures import LevelTextures, maps_of
from .world_nodes import asked_layers

SIDES = ("front", "back")
ORDINARY_TEXELS = (1e-3, 1e3)  # lengths that single precision and the camera's clipping take as they are


def capture(source: Source, cloud: Cloud, settings: BillboardSettings) -> Steps[list[LevelTextures]]:
    """Textures of every level of `cloud`. Runs in Blender's main thread; each step is one render.

    The user's scene, selection and mode stay untouched, and nothing that was made for the renders is left, also when the generator is
    closed between two steps. Emission of Principled shaders is not captured; an Emission shader's colour is taken for its base colour.

    Raises:
        FileError: when an image file of a material is missing, or the temporary folder cannot take a picture.
        FarfieldError: when Cycles is switched off.
    """
    check_images(source)
    continuations = Continuations(source)
    textures = []
    for number, level in enumerate(cloud.levels):
        with temporary_scene("Farfield Capture") as work:
            prepare_plain_render(work.scene, *level.atlas.size, settings.seed)
            work.camera.data.ortho_scale = level.atlas.size[0] * level.texel / _unit(level)
            materials, reach = _lay_out(work, source, level)
            renders: dict[tuple[str, str], np.ndarray] = {}
            for side in SIDES:
                _look_from(work.camera, side, reach)
                for channel in CHANNELS:
                    fraction = (number + len(renders) / 6.0) / len(cloud.levels)
                    yield Progress(fraction, f"Capturing {channel} of level {number}, {side}")
                    for material in materials:
                        material.show(channel)
                    work.scene.cycles.samples = _samples(channel, settings)
                    picture = work.render()
                    renders[side, channel] = picture if side == "front" else picture[:, ::-1]
        goes_on = continuations.texels(level, [renders[side, "colour"][..., 3] for side in SIDES])
        maps = (maps_of(*(renders[side, channel] for channel in CHANNELS), level, goes_on) for side in SIDES)
        textures.append(LevelTextures(*maps))
    return textures


def _samples(channel: str, settings: BillboardSettings) -> int:
    """Samples a texel. The edge of a leaf needs them all, since alpha is their mean; what it is made of varies less."""
    return settings.samples if channel == "colour" else max(min(settings.samples, 4), settings.samples // 4)


def _unit(level: Level) -> float:
    """Length that is one unit in the capture: a scene's own, unless it is enormous or tiny."""
    return 1.0 if ORDINARY_TEXELS[0] <= level.texel <= ORDINARY_TEXELS[1] else level.texel


def _lay_out(work: TemporaryScene, source: Source, level: Level) -> tuple[list[CaptureMaterial], float]:
    """Put what the quads show into the slots. Returns the materials, and how far from the slots the camera has to be."""
    slots, unit = slots_of(level), _unit(level)
    copies: dict[tuple[MaterialKey | None, str, bool], CaptureMaterial] = {}
    reach = 0.0
    quads = np.repeat(np.arange(len(level.quads)), np.diff(level.quads.drawn_offsets))
    for drawn in drawn_surfaces(source, level.quads.drawn, quads):
        world, moved = slot_positions(drawn, slots)
        inside = places_inside(level, slots, moved, drawn.quads)
        clip = bool(np.abs(inside).max() > 1.0)
        color_layer = drawn.surface.color if source.points is not None else ""
        keys = [(material, color_layer, clip) for material in drawn.surface.materials]
        for key in keys:
            if key not in copies:
                original = None if key[0] is None else bpy.data.materials[key[0]]
                copies[key] = capture_material(original, color_layer, level.error / unit, clip, work)
        asked = set().union(*(asked_layers(copies[key].material.node_tree) for key in keys))
        mesh = work.keep(slot_mesh("Farfield Slots", drawn, world, moved / unit, inside, slots, asked))
        for key in keys:
            mesh.materials.append(copies[key].material)
        work.add(mesh)
        reach = max(reach, float(np.abs(moved[..., 2]).max()) / unit)
    return list(copies.values()), reach + level.texel / unit


def _look_from(camera: bpy.types.Object, side: str, reach: float) -> None:
    """Set the camera above the slots, or below them; its picture from below is mirrored."""
    distance = 2.0 * reach
    camera.location = (0.0, 0.0, distance if side == "front" else -distance)
    camera.rotation_euler = (0.0, 0.0 if side == "front" else math.pi, 0.0)
    camera.data.clip_start, camera.data.clip_end = 0.5 * reach, 3.5 * reach
