"""What a cloud's texels see of the original: one Cycles render for every view and light, and one of face numbers for every view."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import bpy
import mathutils
import numpy as np

from ..core.btf.broad_suns import disc_radius
from ..core.btf.estimate import side_of
from ..core.btf.settings import BtfSettings
from ..core.btf.texels import FINER, Picture, View
from ..core.direction_grids import DirectionGrid
from .cameras import look
from .cycles_renders import prepare_cycles
from .emission import may_shine
from .identity import add_stand_in, faces_in
from .meshes import Source
from .temporary import TemporaryScene, temporary_scene

MOST_TRANSPARENT_BOUNCES = 256
POINT_FILTER = 0.01  # pixels: the narrowest filter that Cycles has


class NumberBooth:
    """A scene with the face numbers of a source, to be photographed from everywhere."""

    def __init__(self, work: TemporaryScene) -> None:
        self._work = work

    @property
    def render_seconds(self) -> float:
        """What Cycles took so far."""
        return self._work.render_seconds

    def faces(self, view: View) -> np.ndarray:
        """The face (H, W) int32 in the middle of every pixel of `view`, -1 for none."""
        look(self._work.scene, view)
        return faces_in(self._work.render())


class LitBooth:
    """A scene with the originals, one sun and one dome, to be photographed from everywhere."""

    def __init__(self, work: TemporaryScene, source: Source, settings: BtfSettings) -> None:
        self._work, self._source, self._settings = work, source, settings
        light = work.keep(bpy.data.lights.new("Farfield Sun", "SUN"))
        light.energy, light.angle = 1.0, sun_angle(settings)
        self._sun = work.add(light)
        self._dark, self._even = (_world(work, strength) for strength in (0.0, 1.0))
        self._shines = may_shine(source.materials)

    @property
    def render_seconds(self) -> float:
        """What Cycles took so far."""
        return self._work.render_seconds

    def picture(self, view: View, faces: np.ndarray) -> Picture:
        """All renders from one view, where `faces` are seen: under every sun of the settings' grid, and last under the dome; without what
        shines by itself, for which there is one more render where something may."""
        suns = self._settings.light_grid.directions
        look(self._work.scene, view)
        radiance = np.empty((len(suns) + 1, view.side, view.side, 3), np.float32)
        coverage = np.zeros((view.side, view.side), np.float32)
        self._work.scene.world, self._sun.hide_render = self._dark, False
        for number in range(len(suns) + 1):
            if number < len(suns):
                self._sun.matrix_world = mathutils.Vector(suns[number]).to_track_quat("Z", "Y").to_matrix().to_4x4()
            else:
                self._work.scene.world, self._sun.hide_render = self._even, True
            picture = self._work.render()
            radiance[number] = picture[..., :3]
            coverage += picture[..., 3] / (len(suns) + 1)
        glow = None
        if self._shines:
            self._work.scene.world, self._sun.hide_render = self._dark, True
            glow = self._work.render()[..., :3]
            radiance = np.maximum(radiance - glow, 0.0)
        return Picture(radiance, coverage, faces, heights_of(self._source, view.finer(FINER), faces), glow)


def heights_of(source: Source, view: View, faces: np.ndarray) -> np.ndarray:
    """Heights (H, W) above the view's centre of the places seen in the middle of each pixel, on the planes of their faces."""
    row, column = np.nonzero(faces >= 0)
    first, normal = _planes(source, faces[row, column])
    x = (column + 0.5 - 0.5 * view.side) * view.pixel
    y = (row + 0.5 - 0.5 * view.side) * view.pixel
    base = view.center + x[:, None] * view.right + y[:, None] * view.up
    facing = normal @ view.direction
    facing = np.where(np.abs(facing) < 1e-3, np.copysign(1e-3, facing), facing)
    heights = np.full(faces.shape, -np.inf)
    heights[row, column] = np.einsum("ni,ni->n", first - base, normal) / facing
    return heights


# One booth after the other, never both at once: Blender keeps the data of one scene between renders, not of two.


@contextmanager
def number_booth(source: Source, settings: BtfSettings, threads: int) -> Iterator[NumberBooth]:
    """A booth for the face numbers of `source`, rendered by so many `threads`. Leaves nothing behind."""
    with temporary_scene("Farfield Numbers") as work:
        add_stand_in(work, source)
        _set_up(work, settings, threads)
        cycles = work.scene.cycles
        cycles.samples, cycles.max_bounces = 1, 0
        cycles.pixel_filter_type = "BLACKMAN_HARRIS"  # the one whose width can be set
        cycles.filter_width = POINT_FILTER
        yield NumberBooth(work)


@contextmanager
def lit_booth(objects: Sequence[bpy.types.Object], source: Source, settings: BtfSettings, threads: int) -> Iterator[LitBooth]:
    """A booth for the `objects` that `source` was taken from, rendered by so many `threads`. Leaves nothing behind; whether they are
    disabled in renders is as before."""
    hidden = [item.hide_render for item in objects]
    with temporary_scene("Farfield Lit") as work:
        for item in objects:
            work.scene.collection.objects.link(item)
            item.hide_render = False
        _set_up(work, settings, threads)
        try:
            yield LitBooth(work, source, settings)
        finally:
            for item, was_hidden in zip(objects, hidden, strict=True):
                item.hide_render = was_hidden


def sun_angle(settings: BtfSettings) -> float:
    """Width of the disc, in radians, of a sun of the bake; see `BtfSettings.sun_size`."""
    return 2.0 * disc_radius(settings.sun_size)


def views_of(source: Source, grid: DirectionGrid, pixel: float) -> list[View]:
    """One view for each direction of `grid`, with the whole source in it, `pixel` (a length) a pixel."""
    points = source.mesh.vertices if source.mesh is not None else source.points.points
    low, high = points.min(axis=0), points.max(axis=0)
    center = 0.5 * (low + high)
    reach = float(np.linalg.norm(points - center, axis=1).max())
    return [View(direction, center, side_of(reach, pixel), pixel) for direction in grid.directions]


def _planes(source: Source, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A point (N, 3) and a unit normal (N, 3) of each of `faces`."""
    if source.mesh is None:
        return source.points.points[faces], source.points.normals[faces]
    corners = source.mesh.vertices[source.mesh.triangles[faces]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return corners[:, 0], normals / np.where(lengths > 0.0, lengths, 1.0)


def _world(work: TemporaryScene, strength: float) -> bpy.types.World:
    world = work.keep(bpy.data.worlds.new("Farfield"))
    if world.node_tree is None:
        world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    background.inputs["Strength"].default_value = strength
    return world


def _set_up(work: TemporaryScene, settings: BtfSettings, threads: int) -> None:
    scene = work.scene
    prepare_cycles(scene, settings.samples, MOST_TRANSPARENT_BOUNCES)
    scene.render.threads_mode, scene.render.threads = "FIXED", threads
    scene.cycles.seed = settings.seed
    scene.cycles.pixel_filter_type = "BOX"
