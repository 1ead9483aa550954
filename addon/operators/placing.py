"""What *Drop to Ground* has in common for all terrains."""

from collections import Counter
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import ClassVar

import bpy
import numpy as np

from ..bridge import placing
from ..bridge.placing import TerrainSpace
from ..bridge.terrain_roots import TerrainRoot
from ..core.errors import FileError, GeometryError
from ..core.geometry.surfaces import Surface, find_ground
from ..core.geometry.transforms import is_invertible
from ..core.jobs.progress import Progress, Steps
from ..core.messages import format_count, join_sentences
from ..core.placing import PlacingSettings
from . import start_job
from .following import disabled_reason

OUTSIDE = "outside of the terrain or over holes"
LOCKED = "kept in place by constraints or animation"


@dataclass
class DropJob:
    """Puts objects, or their points, on a terrain.

    Attributes:
        surface: the ground.
        space: the space of the terrain.
        settings: how objects are placed.
        names: names of the objects.
        starts: (N + 1,) int64, where the points of each object begin in `points`; objects have one point each.
        points: (P, 3) float64, terrain space.
        skipped: number of objects by reason.
        opened: what is closed at the end, None without.
    """

    core_fraction = 0.8

    surface: Surface
    space: TerrainSpace
    settings: PlacingSettings
    names: list[str]
    starts: np.ndarray
    points: np.ndarray
    skipped: Counter = field(default_factory=Counter)
    opened: AbstractContextManager | None = None

    def core_steps(self) -> Steps[tuple[np.ndarray, np.ndarray]]:
        """Find heights and normals."""
        with self.opened or nullcontext():
            return (yield from find_ground(self.surface, self.points))

    def scene_steps(self, core_result: tuple[np.ndarray, np.ndarray]) -> Steps[str]:
        """Move objects or points. Returns the message for the user.

        Raises:
            FileError: nothing could be moved because the store is damaged.
            GeometryError: nothing is above or below the terrain.
        """
        yield Progress(0.0, "Moving objects")
        heights, normals = core_result
        if np.isnan(heights).all():
            if self.surface.damages:
                raise FileError(self.surface.damages[0])
            raise GeometryError("Nothing that is selected is above or below the terrain; move it there.")
        targets = self.points.copy()
        targets[:, 2] = heights + self.settings.offset / self.space.height_scale
        moved = self._move_points(targets) if self.settings.target == "points" else self._move_objects(targets, normals)
        sentences = [f"Put {moved} on the ground."]
        return join_sentences([*sentences, *describe_skipped(self.skipped), *describe_damages(self.surface.damages)])

    def _move_objects(self, targets: np.ndarray, normals: np.ndarray) -> str:
        """Move objects, parents first, and return how many in words."""
        view_layer, up, uses_bottom = bpy.context.view_layer, self.space.up, self.settings.target == "bottoms"
        places, axes = self.space.to_world(targets), self.space.normals_to_world(normals)
        starts = self.space.to_world(self.points)
        placed, depth = [], 0
        for name, start, place, axis in zip(self.names, starts, places, axes, strict=True):
            item = bpy.data.objects.get((name, None))
            if item is None:
                continue  # deleted meanwhile
            if np.isnan(place).any():
                self.skipped[OUTSIDE] += 1
                continue
            parents = placing.count_parents(item)
            if parents > depth:
                depth = parents
                view_layer.update()  # parents have moved
            normal = axis if self.settings.align_to_normal else None
            placing.place(item, place, up, normal, uses_bottom)
            placed.append((name, place, axis if self.settings.align_to_normal else up, float(np.linalg.norm(place - start))))
        view_layer.update()
        objects = bpy.data.objects
        locked = sum(not placing.is_at(objects[name, None], place, axis, uses_bottom, step) for name, place, axis, step in placed)
        self.skipped[LOCKED] += locked
        return format_count(len(placed) - locked, "object")

    def _move_points(self, targets: np.ndarray) -> str:
        """Move the points of all objects and return how many in words."""
        is_moved = np.isfinite(targets[:, 2])
        places = self.space.to_world(targets)
        count = 0
        for name, start, stop in zip(self.names, self.starts[:-1].tolist(), self.starts[1:].tolist(), strict=True):
            item, part = bpy.data.objects.get((name, None)), slice(start, stop)
            if item is None or placing.count_points(item) != stop - start:
                continue  # deleted or changed meanwhile
            placing.write_points(item, places[part], is_moved[part])
            count += int(is_moved[part].sum())
        left = int((~is_moved).sum())
        return format_count(count, "point") + (f", and left {left:,} outside of the terrain or over holes," if left else "")


def describe_skipped(skipped: Counter) -> list[str]:
    """Return one sentence per reason, for numbers of objects by reason."""
    return [f"Skipped {format_count(count, 'object')}: {reason}." for reason, count in skipped.items() if count]


def describe_damages(damages: list[str]) -> list[str]:
    """Return sentences about patches that were replaced by coarser ones, given the sentences about their damage."""
    return [f"Used coarser patches in {format_count(len(damages), 'damaged place')}.", damages[0]] if damages else []


class DropOperator(start_job.StartJob):
    """Mixin of the operators. terrain_type: of the terrains."""

    bl_options: ClassVar = {"REGISTER", "UNDO"}
    terrain_type: type[TerrainRoot]

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why nothing can be put on the ground now, or an empty string."""
        if not cls.terrain_type.in_scene(context.scene):
            return f"Add a {cls.terrain_type.label} first"
        return disabled_reason(context) or ("" if context.selected_objects else "Select the objects to put on the ground")

    def prepare(self, context: bpy.types.Context) -> DropJob:
        """Read the positions of the selected objects or points, and the ground.

        Raises:
            FileError: the ground is missing or damaged.
            GeometryError: nothing that can be moved is selected, or the terrain has no area or shows nothing.
            SettingsError: the settings of the terrain cannot be read.
        """
        terrain, settings = find_terrain(context, self.terrain_type), self.read_settings(context)[self.settings_types[0]]
        context.view_layer.update()
        space = TerrainSpace.of(terrain)
        if not is_invertible(space.matrix):
            raise GeometryError(
                f'The terrain "{terrain.name}" has a scale of zero, or a transform that is not finite; clear its transform.'
            )
        uses_points = settings.target == "points"
        skipped: Counter = Counter()
        names, groups = [], []
        for item in placing.selected_objects(context, terrain):
            reason = placing.refusal_of_points(item) if uses_points else placing.refusal_of_object(item)
            if reason:
                skipped[reason] += 1
                continue
            matrix = np.array(item.matrix_world, np.float64)
            base = None if uses_points else placing.find_base(item, matrix, space.up, settings.target == "bottoms")[None]
            names.append(item.name)
            groups.append(placing.read_points(item) if base is None else base)
        if not sum(len(group) for group in groups):
            wanted = "meshes or point clouds" if uses_points else "objects"
            sentences = " ".join(describe_skipped(skipped)) or "Nothing else than the terrain is selected."
            raise GeometryError(f"{sentences} Select {wanted} to put on the ground.")
        starts = np.cumsum([0] + [len(group) for group in groups])
        points = space.to_terrain(np.concatenate(groups))
        surface, opened = self.open_surface(terrain, settings, points)
        return DropJob(surface, space, settings, names, starts, points, skipped, opened)

    @staticmethod
    def open_surface(terrain: TerrainRoot, settings: PlacingSettings, points: np.ndarray) -> tuple[Surface, AbstractContextManager | None]:
        """Return the ground of a terrain for `points` (N, 3), and what is closed at the end.

        Raises:
            FarfieldError: it cannot be read, or nothing is shown.
        """
        raise NotImplementedError


def find_terrain(context: bpy.types.Context, terrain_type: type[TerrainRoot]) -> TerrainRoot:
    """Return the terrain that objects are put on: the one that is selected, or the only one of the scene.

    Raises:
        GeometryError: none or several are selected, and there are several.
    """
    terrains = terrain_type.in_scene(context.scene)
    selected = {item.name for item in context.selected_objects if item.library is None}
    chosen = [
        terrain for terrain in terrains if len(terrains) == 1 or selected & {terrain.name, *(item.name for item in terrain.shown_objects())}
    ]
    if len(chosen) != 1:
        raise GeometryError(f"The scene has {len(terrains)} terrains; select the one to use together with the objects.")
    return chosen[0]
