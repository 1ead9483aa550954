"""The demo's relightable textures: one level of a cloud baked, and held against the original, its plain maps and an octahedral impostor."""

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

import environment

environment.import_farfield()

from baselines import octahedral_impostor
from farfield.addon.bridge.clouds import FINGERPRINT
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.progress import Steps, scaled
from farfield.addon.operators.billboards_clouds import StandingCloud, cloud_of, remember_sources
from farfield.addon.operators.btf_job import BtfJob, prepare
from farfield.addon.operators.long_work import whole
from relighting import Contestant, Relighting, held_out_pairs, relight, relighting_sheet

BAKED, IMPOSTOR_MADE = 0.7, 0.85  # of the bar
MOST_COLUMNS = 6


@dataclass(frozen=True)
class RelightingEffort:
    """How much is baked and compared.

    level: of the cloud. pairs: held-out views and suns. samples: Cycles samples of their pictures. frames: along a side of the impostor's
    grid of pictures. frame_samples: of each of these.
    """

    level: int
    bake: BtfSettings
    pairs: int
    samples: int
    frames: int
    frame_samples: int


@dataclass(frozen=True)
class Relit:
    """A cloud of one relightable level, which no lamp lights yet, with the job that baked it and its comparison with others.

    number: of the level in the cloud that it was taken from.
    """

    cloud: StandingCloud
    number: int
    job: BtfJob
    comparison: Relighting

    def figures(self) -> dict[str, Any]:
        """Those of bake and comparison, for a report."""
        (baked,) = self.job.figures
        settings = self.job.settings
        return {
            "level": self.number,
            **{name: getattr(settings, name) for name in ("views", "lights", "upper_hemisphere", "samples")},
            **{name: baked[name] for name in ("renders", "texels", "bare_render_seconds", "raw_bytes", "compressed_bytes")},
            "fit": baked["fits"][-1],
            "pairs": len(self.comparison.views),
            "scores": self.comparison.figures(),
        }

    def sheet(self) -> np.ndarray:
        """A contact sheet (H, W, 3) of the comparison."""
        count = len(self.comparison.views)
        columns = np.unique(np.linspace(0, count - 1, MOST_COLUMNS).round().astype(int)).tolist()
        (level,) = self.cloud.levels
        title = f"{level['farfield_quads']:,} quads under suns and from views that were not baked, where their error is one pixel"
        return relighting_sheet(title, self.comparison, columns)


def bake_and_compare(cloud: StandingCloud, effort: RelightingEffort) -> Steps[Relit]:
    """Bake one level of `cloud`, whose original stands in the scene, as a new cloud of its own, and compare it.

    Raises:
        FarfieldError: what `prepare` and the job that it makes raise.
    """
    plain = cloud.levels[effort.level]
    relightable = cloud_of_level(cloud, effort.level)
    job = prepare(bpy.context, relightable, effort.bake, None, keeps_work=False)
    yield from scaled(whole(job), 0.0, BAKED)
    most_bytes = job.figures[0]["compressed_bytes"]
    upper = effort.bake.upper_hemisphere
    steps = octahedral_impostor(cloud.sources, most_bytes, effort.frame_samples, effort.frames, upper)
    impostor = yield from scaled(steps, BAKED, IMPOSTOR_MADE)
    others = [Contestant("plain maps", [plain]), Contestant("impostor", impostor.objects, impostor.face)]
    pairs = held_out_pairs(effort.pairs, upper)
    steps = relight(cloud.sources, relightable.levels[0], others, cloud.errors[effort.level], pairs, effort.samples)
    comparison = yield from scaled(steps, IMPOSTOR_MADE, 1.0)
    impostor.remove()
    return Relit(relightable, effort.level, job, comparison)


def cloud_of_level(cloud: StandingCloud, number: int) -> StandingCloud:
    """A copy of one level of `cloud` as a cloud of its own, beside it in the scene."""
    collection = bpy.data.collections.new(f"{cloud.collection.name} Relightable")
    collection[FINGERPRINT] = cloud.collection[FINGERPRINT]
    remember_sources(collection, cloud.source_names)
    level = cloud.levels[number].copy()
    level.data = level.data.copy()
    level.name = level.data.name = collection.name
    level["farfield_level"] = 0
    level.hide_viewport = level.hide_render = False
    collection.objects.link(level)
    bpy.context.scene.collection.children.link(collection)
    bpy.context.view_layer.update()
    return cloud_of(collection)
