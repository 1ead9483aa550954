"""How long *Make Levels* takes: a range, and for objects of which levels were made in this session with the same settings, one time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...bridge.geometry.mesh_arrays import count_triangles
from ...bridge.geometry.meshes import is_collection_instance
from ...core.texmesh.level_chain import estimate_costs
from ...core.texmesh.settings import TexmeshSettings

SECONDS = 0.7, 5.0  # Per unit of `estimate_costs`: of textured animals and of parts of machines, which take longest.
UNCERTAINTY = 2.5  # Times of objects per unit differ by up to this factor from the pace of another run.
CHOICES = ("levels", "number", "max_triangles", "max_size", "max_pixels", "ratios")  # Settings that hardly change the time.


@dataclass(frozen=True)
class LevelsRun:
    """A run that has ended. triangles: numbers of triangles of its meshes. seconds: that it took."""

    triangles: tuple[int, ...]
    settings: TexmeshSettings
    seconds: float


class Estimator:
    """Estimates from the latest run of this session. run: None before there was one."""

    def __init__(self) -> None:
        self.run: LevelsRun | None = None

    def remember(self, triangles: Sequence[int], settings: TexmeshSettings, seconds: float) -> None:
        """Use the time that levels of meshes with these numbers of `triangles` took."""
        self.run = LevelsRun(tuple(sorted(triangles)), settings, seconds)

    def estimate(self, triangles: Sequence[int], settings: TexmeshSettings) -> tuple[float, float] | None:
        """Return the shortest and the longest time in seconds, which are equal for the meshes of the latest run; None without meshes, and
        where nothing is known about the settings."""
        cost = _find_cost(triangles, settings)
        if self.run is not None and settings == self.run.settings and cost:
            if tuple(sorted(triangles)) == self.run.triangles:
                return self.run.seconds, self.run.seconds
            likely = self.run.seconds * cost / _find_cost(self.run.triangles, settings)
            return likely / UNCERTAINTY, likely * UNCERTAINTY
        default = TexmeshSettings()
        has_usual_cost = replace(settings, **{name: getattr(default, name) for name in CHOICES}) == default
        return (SECONDS[0] * cost, SECONDS[1] * cost) if cost and has_usual_cost else None


estimator = Estimator()


def _find_cost(triangles: Sequence[int], settings: TexmeshSettings) -> float:
    return float(estimate_costs(np.array(triangles), settings).sum()) if triangles else 0.0


def count_source_triangles(objects: Sequence[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> list[int]:
    """Return the number of triangles of each mesh that `objects` show, as evaluated. Cheap enough for every redraw."""
    shown = [item for owner in objects for item in (owner.instance_collection.objects if is_collection_instance(owner) else [owner])]
    meshes = {item if item.modifiers else item.data: item for item in shown if item.type == "MESH"}
    return [count_triangles(item.evaluated_get(depsgraph).data) for item in meshes.values()]
