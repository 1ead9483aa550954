"""The job of the operator and the script: unwraps meshes and writes their UV maps."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial

import bpy
import numpy as np

from ...bridge.cameras import read_camera_projection
from ...bridge.geometry.mesh_arrays import read_positions
from ...bridge.geometry.meshes import SourceInstance, concatenate_in_world_space, read_instances
from ...bridge.unwrap import uv_maps
from ...core.errors import GeometryError, SettingsError
from ...core.geometry.cameras import CameraProjection
from ...core.geometry.local_origin import describe_coarseness
from ...core.geometry.mesh import TriangleMesh, concatenate, face_areas_and_normals
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.messages import format_count, format_number, join_sentences
from ...core.settings import describe
from ...core.unwrap.importance import compute_importance, from_direction
from ...core.unwrap.settings import UnwrapSettings
from ...core.unwrap.unwrapping import UnwrapInput, UnwrapResult, check_surface, unwrap_together

COMBINE_LABEL = next(item.panel_label for item in describe(UnwrapSettings) if item.name == "combine_selected")
MIN_DENSITY_FRACTION = 0.99  # Of the wanted texel density, below which it counts as lowered.


@dataclass
class UnwrapJob:
    """Unwraps every target.

    Attributes:
        targets: Meshes to unwrap.
        cameras: Cameras that determine importance.
        occluders: Surfaces that may hide a target.
        settings: Settings of the unwrap.
        unit_length: Of a Blender unit, in meters.
        skipped: Names of other objects with the reason.
        remarks: Sentences about the targets.
        results: Targets and UV maps, once the job is done.
    """

    core_fraction = 0.98

    targets: list[uv_maps.UvTarget]
    cameras: list[CameraProjection]
    occluders: list[SourceInstance]
    settings: UnwrapSettings
    unit_length: float
    skipped: list[str]
    remarks: list[str] = field(default_factory=list)
    results: list[tuple[uv_maps.UvTarget, UnwrapResult]] = field(default_factory=list)

    def core_steps(self) -> Steps[list[UnwrapResult]]:
        """Unwrap every mesh, or all together."""
        total, done, results = sum(len(target.mesh.triangles) for target in self.targets), 0.0, []
        for group in [self.targets] if self.settings.combine_selected else [[target] for target in self.targets]:
            fraction = sum(len(target.mesh.triangles) for target in group) / total
            yield Progress(done, "Computing importance")
            weights = self._compute_importance(group)
            inputs = [
                UnwrapInput(target.mesh, target.polygon_ids, target.seams, importance, target.object_name)
                for target, importance in zip(group, weights, strict=True)
            ]
            steps = unwrap_together(inputs, self.settings, self.unit_length)
            results += yield from subprogress(steps, done, done + fraction)
            done += fraction
        return results

    def scene_steps(self, core_result: list[UnwrapResult]) -> Steps[str]:
        """Write all UV maps at once.

        Raises:
            GeometryError: a mesh was removed or edited in the meantime; no UV map was written.
        """
        yield Progress(0.0, "Writing UV maps")
        is_editing = bpy.context.mode == "EDIT_MESH"
        if is_editing:
            bpy.ops.object.mode_set(mode="OBJECT")  # Mesh data can only be written outside of Edit Mode.
        try:
            for target in self.targets:
                uv_maps.find_mesh(target, self.settings.uv_map)
            for target, result in zip(self.targets, core_result, strict=True):
                texture, metrics = self.settings.texture, asdict(result.metrics) | result.counts
                stretches, name = result.stretches.dominant, self.settings.uv_map
                uv_maps.write_uv_map(target, result.corner_uvs, stretches, name, metrics, texture, self.unit_length)
                self.results.append((target, result))
        finally:
            if is_editing:
                bpy.ops.object.mode_set(mode="EDIT")
        return self._summarize()

    def _compute_importance(self, group: Sequence[uv_maps.UvTarget]) -> list[np.ndarray]:
        """Return the importance (T,) of the triangles of each mesh in a group, for one texture: what is less important in all of them
        gets less of it."""
        counts = [len(target.mesh.triangles) for target in group]
        signs = np.repeat([target.normal_sign for target in group], counts)
        weights = np.concatenate([target.group_weights for target in group])
        mesh, occluders = concatenate([target.mesh for target in group]), partial(self._occluders, group)
        importance = compute_importance(mesh, self.settings, self.cameras, occluders, signs, weights)
        return np.split(importance, np.cumsum(counts)[:-1])

    def _occluders(self, group: Sequence[uv_maps.UvTarget]) -> Iterator[TriangleMesh]:
        """Yield the meshes that may hide those of a group: their polygons that are not unwrapped, and all other visible objects."""
        for target in group:
            yield TriangleMesh(target.mesh.vertices, target.other_triangles)
        names = {target.object_name for target in group}
        for instance in self.occluders:
            if instance.name not in names:
                yield concatenate_in_world_space([instance])

    @property
    def _is_combined(self) -> bool:
        """Whether several meshes share a texture."""
        return self.settings.combine_selected and len(self.targets) > 1

    def _summarize(self) -> str:
        results, textures = [result for _, result in self.results], ""
        skipped = f"Skipped: {'; '.join(self.skipped)}." if self.skipped else ""
        notes = [*self._lowered_densities(), *self.remarks, skipped]
        if len(results) == 1:
            name = self.results[0][0].object_name
            return join_sentences([f'Unwrapped "{name}" ({_describe(results, has_packing=True)}).', *notes])
        place = " into one texture" if self._is_combined else ""
        summary = f"Unwrapped {format_count(len(results), 'mesh')}{place}: {_describe(results, has_packing=self._is_combined)}."
        if not self._is_combined:
            textures = f"Each mesh has its own texture; {COMBINE_LABEL} packs them into one."
        details = [f'"{target.object_name}": {_describe([result], has_packing=not self._is_combined)}.' for target, result in self.results]
        return " ".join([join_sentences([summary, textures, *notes]), *details])

    def _lowered_densities(self) -> list[str]:
        """Return a sentence about each texture whose texel density was lowered."""
        densities = {f' of "{target.object_name}"': result.metrics.texel_density for target, result in self.results}
        if self._is_combined:
            areas = [face_areas_and_normals(target.mesh.corners)[0].sum() for target, _ in self.results]
            densities = {"": float(np.sqrt(np.average(np.square(list(densities.values())), weights=areas)))}
        return [
            f"The texel density{of_mesh} was lowered to {format_number(density)} px/m: "
            f"{format_number(self.settings.texel_density)} px/m do not fit into {_describe_tiles(self.settings)}."
            for of_mesh, density in densities.items()
            if density < MIN_DENSITY_FRACTION * self.settings.texel_density
        ]


def _describe(results: Sequence[UnwrapResult], *, has_packing: bool) -> str:
    """Return the most important figures of UV maps, in one texture or in several ones. has_packing: with those of the texture."""
    first, stacked = results[0], sum(result.stacked_count for result in results)
    islands = format_count(sum(result.chart_count for result in results), "UV island")
    figures = [f"stretch {_format_range([f'{result.metrics.l2:.3f}' for result in sorted(results, key=lambda each: each.metrics.l2)])}"]
    figures.append(f"{islands} of which {stacked:,} stacked" if stacked else islands)
    if has_packing and first.tile_count > 1:
        figures.append(format_count(first.tile_count, "UDIM tile"))
    if has_packing and first.is_upright:
        figures.append("upright")
    densities = sorted(result.metrics.texel_density for result in results)
    figures.append(f"{_format_range([format_number(density) for density in densities])} px/m")
    return ", ".join([*figures, *([f"{first.metrics.fill:.0%} filled"] if has_packing else [])])


def _format_range(numbers: Sequence[str]) -> str:
    """Return the first and the last of sorted numbers, or one where they are equal."""
    return numbers[0] if numbers[0] == numbers[-1] else f"{numbers[0]} to {numbers[-1]}"


def _describe_tiles(settings: UnwrapSettings) -> str:
    tiles = "a texture" if settings.max_tiles == 1 else f"{settings.max_tiles} UDIM tiles"
    return f"{tiles} of {settings.texture_size[0]} x {settings.texture_size[1]} pixels"


def prepare(context: bpy.types.Context, objects: Sequence[bpy.types.Object], settings: UnwrapSettings) -> UnwrapJob:
    """Return the job that unwraps the meshes of `objects`, each mesh once.

    Raises:
        GeometryError: none of them can be unwrapped; the message names each with the reason.
        SettingsError: importance needs a camera and there is none, or the direction has no length.
    """
    cameras = _read_cameras(context, settings)
    if settings.importance in ("direction", "gradual"):
        from_direction(np.zeros((0, 3)), np.array(settings.direction))  # Reports an invalid direction early.
    targets, skipped, meshes, errors, remarks = [], [], set(), [], []
    for item in objects:
        reason = uv_maps.skip_reason(item, settings.uv_map)
        if reason:
            skipped.append(f"{item.name} ({reason})")
        elif item.data not in meshes:
            meshes.add(item.data)
            try:
                target = uv_maps.read_uv_target(item, settings.vertex_group if settings.importance == "vertex_group" else None)
                check_surface(target.mesh, item.name)
                targets.append(target)
                remarks.append(describe_coarseness(read_positions(item.data), f'"{item.name}"', "it"))
            except GeometryError as error:
                errors.append(error)
    if not targets:
        if len(errors) == 1 and not skipped:
            raise errors[0]
        reasons = "; ".join([*skipped, *_reasons(errors)])
        raise GeometryError(f"Nothing to unwrap: {reasons or 'no object is selected'}. Select a local mesh object.")
    skipped += _reasons(errors)
    unit_length = uv_maps.read_unit_length(context.scene)
    return UnwrapJob(targets, cameras, _read_occluders(context) if cameras else [], settings, unit_length, skipped, remarks)


def _read_cameras(context: bpy.types.Context, settings: UnwrapSettings) -> list[CameraProjection]:
    """Return the cameras that determine importance; none for other settings."""
    if settings.importance not in ("camera", "cameras"):
        return []
    scene = context.scene
    candidates = [scene.camera] if settings.importance == "camera" else scene.objects
    cameras = [item for item in candidates if item is not None and item.type == "CAMERA"]
    if not cameras:
        raise SettingsError("The scene has no camera; add one, or choose another Importance.", settings=("importance",))
    depsgraph = context.evaluated_depsgraph_get()
    return [read_camera_projection(scene, item.evaluated_get(depsgraph), depsgraph) for item in cameras]


def _read_occluders(context: bpy.types.Context) -> list[SourceInstance]:
    """Return all surfaces that are visible in renders."""
    visible = [item for item in context.view_layer.objects if item.visible_get() and not item.hide_render]
    return read_instances(visible, context.evaluated_depsgraph_get())


def _reasons(errors: list[GeometryError]) -> list[str]:
    return [str(error).removesuffix(".") for error in errors]
