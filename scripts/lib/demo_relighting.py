"""The demo's relightable textures: bakes one level of a cloud and compares it with the source, its PBR maps and an octahedral impostor."""

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.billboards.clouds import FINGERPRINT
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud, read_cloud
from farfield.addon.bridge.source_links import store_sources
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.jobs.progress import Steps, subprogress
from farfield.addon.operators.btf.job import BakeJob, prepare_bake
from farfield.addon.operators.job_run import run_job
from lib.baselines import build_octahedral_impostor
from lib.relighting import Candidate, RelightingComparison, compare_relighting, draw_relighting_sheet, held_out_pairs

BAKE_END, IMPOSTOR_END = 0.7, 0.85  # fractions of the progress
MAX_SHEET_COLUMNS = 6
PBR_TEXEL_BYTES = 20  # The maps of both sides need this much; the impostor has them as well.


@dataclass(frozen=True)
class RelightingPreset:
    """The amount of work.

    level: index in the cloud. pairs: number of held-out pairs of view and Sun direction. samples: Cycles samples of their renders. frames:
    along each side of the impostor's grid. frame_samples: Cycles samples of these frames.
    """

    level: int
    bake: BtfSettings
    pairs: int
    samples: int
    frames: int
    frame_samples: int


@dataclass(frozen=True)
class RelitCloud:
    """A cloud with one relightable level, not linked to any Sun light, with the job that baked it and the comparison.

    level_index: of the level in the cloud that it was copied from.
    """

    cloud: SceneCloud
    level_index: int
    job: BakeJob
    comparison: RelightingComparison

    def to_report(self) -> dict[str, Any]:
        """Return the figures of the bake and the comparison for a JSON report."""
        (bake,) = self.job.figures
        settings = self.job.settings
        return {
            "level": self.level_index,
            "views": settings.view_count,
            **{name: getattr(settings, name) for name in ("upper_hemisphere", "samples")},
            **{name: bake[name] for name in ("renders", "texels", "bare_render_seconds", "raw_bytes", "compressed_bytes")},
            "pairs": len(self.comparison.views),
            "scores": self.comparison.mean_scores(),
        }

    def draw_sheet(self) -> np.ndarray:
        """Return a contact sheet (H, W, 3) of the comparison."""
        count = len(self.comparison.views)
        columns = np.unique(np.linspace(0, count - 1, MAX_SHEET_COLUMNS).round().astype(int)).tolist()
        (level,) = self.cloud.levels
        title = f"{level['farfield_quads']:,} quads under Sun directions and from views that were not baked; the error is one pixel"
        return draw_relighting_sheet(title, self.comparison, columns)


def bake_and_compare(cloud: SceneCloud, preset: RelightingPreset) -> Steps[RelitCloud]:
    """Copy one level of `cloud`, whose source is in the scene, to a new cloud, bake it and compare it.

    Where the cloud does not have the level of the preset, because it would save too little, it is the coarsest one.

    Raises:
        FarfieldError: see `prepare_bake` and its job.
    """
    index = min(preset.level, len(cloud.levels) - 1)
    pbr_level = cloud.levels[index]
    relightable = copy_level_as_cloud(cloud, index)
    job = prepare_bake(bpy.context, relightable, preset.bake, None, keep_finished_views=False)
    yield from subprogress(run_job(job), 0.0, BAKE_END)
    max_bytes = job.figures[0]["compressed_bytes"] + PBR_TEXEL_BYTES * job.figures[0]["texels"]
    upper_hemisphere = preset.bake.upper_hemisphere
    steps = build_octahedral_impostor(cloud.sources, max_bytes, preset.frame_samples, preset.frames, upper_hemisphere)
    impostor = yield from subprogress(steps, BAKE_END, IMPOSTOR_END)
    others = [Candidate("PBR maps", [pbr_level]), Candidate("octahedral impostor", impostor.objects, impostor.face_viewer)]
    pairs = held_out_pairs(preset.pairs, upper_hemisphere)
    steps = compare_relighting(cloud.sources, relightable.levels[0], others, cloud.errors[index], pairs, preset.samples)
    comparison = yield from subprogress(steps, IMPOSTOR_END, 1.0)
    impostor.remove()
    return RelitCloud(relightable, index, job, comparison)


def copy_level_as_cloud(cloud: SceneCloud, index: int) -> SceneCloud:
    """Copy one level of `cloud` to a new cloud in the scene."""
    collection = bpy.data.collections.new(f"{cloud.collection.name} Relightable")
    collection[FINGERPRINT] = cloud.collection[FINGERPRINT]
    store_sources(collection, cloud.sources)
    level = cloud.levels[index].copy()
    level.data = level.data.copy()
    level.name = level.data.name = collection.name
    level["farfield_level"] = 0
    level.hide_viewport = level.hide_render = False
    collection.objects.link(level)
    bpy.context.scene.collection.children.link(collection)
    bpy.context.view_layer.update()
    return read_cloud(collection)
