"""The job behind the button and the script: meshes in, their UV maps out."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field

import bpy
import numpy as np

from ..bridge import cameras, uv_maps
from ..bridge.meshes import SourcePart, parts_of, world_mesh
from ..core.errors import GeometryError, SettingsError
from ..core.mesh import TriangleMesh, face_areas_and_normals
from ..core.progress import Progress, Steps, scaled
from ..core.unwrap import importance
from ..core.unwrap.settings import UnwrapSettings
from ..core.unwrap.unwrapping import Unwrapped, unwrap
from ..core.unwrap.visibility import Shot, shown_pixels


@dataclass
class UnwrapJob:
    """Unwraps every target; `made` holds what came of them once the job is done."""

    core_share = 0.98

    targets: list[uv_maps.UvTarget]
    shots: list[Shot]
    surroundings: list[SourcePart]
    settings: UnwrapSettings
    skipped: list[str]
    made: list[tuple[uv_maps.UvTarget, Unwrapped]] = field(default_factory=list)

    def core_steps(self) -> Steps[list[Unwrapped]]:
        """Unwrap every mesh."""
        total, done, made = sum(len(target.mesh.triangles) for target in self.targets), 0.0, []
        for target in self.targets:
            share = len(target.mesh.triangles) / total
            yield Progress(done, "Looking for what matters")
            steps = unwrap(target.mesh, target.polygons, target.seams, self._importance(target), self.settings, target.name)
            made.append((yield from scaled(steps, done, done + share)))
            done += share
        return made

    def scene_steps(self, core_result: list[Unwrapped]) -> Steps[str]:
        """Write all UV maps at once.

        Raises:
            GeometryError: when a mesh has gone or was edited since.
        """
        yield Progress(0.0, "Writing UV maps")
        editing = bpy.context.mode == "EDIT_MESH"
        if editing:
            bpy.ops.object.mode_set(mode="OBJECT")  # meshes are written to outside of Edit Mode
        try:
            for target, unwrapped in zip(self.targets, core_result, strict=True):
                uv_maps.write(target, unwrapped.corners, unwrapped.stretches.largest, self.settings.uv_map, asdict(unwrapped.measures))
                self.made.append((target, unwrapped))
        finally:
            if editing:
                bpy.ops.object.mode_set(mode="EDIT")
        return self._sentence()

    def _importance(self, target: uv_maps.UvTarget) -> np.ndarray:
        """How much each triangle matters, (T,), 0 to 1."""
        settings, mesh = self.settings, target.mesh
        areas, normals = face_areas_and_normals(mesh.corners)
        if settings.importance == "direction":
            return importance.from_direction(target.outwards * normals, np.array(settings.direction))
        if settings.importance == "look":
            return importance.from_look(target.outwards * normals, np.array(settings.direction), settings.density_ratio)
        if settings.importance in ("camera", "cameras"):
            pixels = np.max([shown_pixels(mesh, shot, self._others(target)) for shot in self.shots], axis=0)
            return importance.from_pixels(pixels, areas, settings.density_ratio)
        if settings.importance == "group":
            return target.painted[mesh.triangles].mean(axis=1)
        return np.zeros(len(mesh.triangles))

    def _others(self, target: uv_maps.UvTarget) -> Iterator[TriangleMesh]:
        """What may hide a target: its faces that were not chosen, and all other surfaces, one after the other."""
        yield TriangleMesh(target.mesh.vertices, target.rest)
        for part in self.surroundings:
            if part.name != target.name:
                yield world_mesh([part])

    def _sentence(self) -> str:
        told = [f'"{target.name}" (stretch {made.measures.l2:.3f}, {_charts(made.charts)})' for target, made in self.made]
        skipped = f" Skipped: {'; '.join(self.skipped)}." if self.skipped else ""
        return f"Unwrapped {', '.join(told)}.{skipped}"


def prepare(context: bpy.types.Context, objects: Sequence[bpy.types.Object], settings: UnwrapSettings) -> UnwrapJob:
    """The job that unwraps the meshes of `objects`, each mesh once.

    Raises:
        GeometryError: when none of them can be unwrapped; its sentence names each and why.
        SettingsError: when there is no camera for importance to come from, or the direction has no length.
    """
    shots = _shots(context, settings)
    if settings.importance in ("direction", "look"):
        importance.from_direction(np.zeros((0, 3)), np.array(settings.direction))
    targets, skipped, taken, empty = [], [], set(), []
    for item in objects:
        reason = uv_maps.refusal(item, settings.uv_map)
        if reason:
            skipped.append(f"{item.name} ({reason})")
        elif item.data not in taken:
            taken.add(item.data)
            try:
                targets.append(uv_maps.take(item, settings.group if settings.importance == "group" else None))
            except GeometryError as error:
                empty.append(error)
    if not targets:
        if empty:
            raise empty[0]
        raise GeometryError(f"Nothing to unwrap: {'; '.join(skipped) or 'no object is selected'}. Select a mesh of this file.")
    return UnwrapJob(targets, shots, _surroundings(context) if shots else [], settings, skipped)


def _shots(context: bpy.types.Context, settings: UnwrapSettings) -> list[Shot]:
    if settings.importance not in ("camera", "cameras"):
        return []
    scene = context.scene
    found = [scene.camera] if settings.importance == "camera" else [item for item in scene.objects if item.type == "CAMERA"]
    found = [item for item in found if item is not None and item.type == "CAMERA"]
    if not found:
        raise SettingsError("The scene has no camera from which importance could come; add one, or choose another kind of importance.")
    depsgraph = context.evaluated_depsgraph_get()
    return [cameras.shot(scene, item.evaluated_get(depsgraph), depsgraph) for item in found]


def _surroundings(context: bpy.types.Context) -> list[SourcePart]:
    """All surfaces that cameras see."""
    seen = [item for item in context.view_layer.objects if item.visible_get() and not item.hide_render]
    return parts_of(seen, context.evaluated_depsgraph_get())


def _charts(count: int) -> str:
    return "1 chart" if count == 1 else f"{count} charts"
