"""What compression does to the noise of a bake with few samples: captured and compressed colours against a bake with many."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from btf_bakes import Cloud, Effort, baked, built_cloud

import btf
import scene_files
from farfield.addon.core.btf.compression import Compressed, Compression
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.progress import Progress, Steps, finish

TIMES = 32  # as many samples have hardly noise
SIDE = 5  # views and lights along a side: enough to tell noise from colours


@dataclass(frozen=True)
class Standing:
    """A bake whose views stand, compressed."""

    compression: Compression
    textures: Compressed


def noise(effort: Effort) -> Steps[dict[str, Any]]:
    """Of every model the errors of single texels under single suns, over the mean colour under these, all views together."""
    figures = {}
    for number, name in enumerate(effort.models):
        yield Progress(number / len(effort.models), f"Baking {name} with few samples and with many")
        figures[name] = _of_model(built_cloud(name, effort, effort.error), replace(effort, views=SIDE**2, lights=SIDE**2))
    return figures


def _of_model(cloud: Cloud, effort: Effort) -> dict[str, Any]:
    few, many = (_standing(cloud, replace(effort, capture_samples=samples)) for samples in (effort.capture_samples, _many(effort)))
    squares, size, total = np.zeros(3), 0, 0.0
    for view in range(effort.views):
        rows, right = few.compression.captured(view)
        again, truth = many.compression.captured(view)
        _, own, others = np.intersect1d(rows, again, assume_unique=True, return_indices=True)
        rows, truth = rows[own], truth[others, :-1]
        shown = (each.compression.shown(each.textures, view, rows)[:, :-1] for each in (few, many))
        squares += [float(((each - truth) ** 2).sum()) for each in (right[own, :-1], *shown)]
        size, total = size + truth.size, total + float(truth.sum())
    names = ("captured", "compressed", "compressed_from_many")
    relative = np.sqrt(squares / size) / (total / size)
    return {"samples": effort.capture_samples, "truth_samples": _many(effort), **dict(zip(names, relative.round(4).tolist(), strict=True))}


def _standing(cloud: Cloud, effort: Effort) -> Standing:
    name = f"noise {effort.capture_samples}"
    work = cloud.path.with_name(f"views of {name}")
    baked(cloud, name, work, effort, "--no-refine")
    scene_files.open_scene(cloud.path)
    settings = BtfSettings(
        views=effort.views, lights=effort.lights, samples=effort.capture_samples, upper_hemisphere=cloud.upper, refine=False
    )
    [job] = btf.jobs_of(settings, Path(work))
    [level] = job.levels
    compression = Compression(level.store, level.order.texels, level.plain, level.surface, settings)
    return Standing(compression, finish(compression.compress()))


def _many(effort: Effort) -> int:
    return TIMES * effort.capture_samples
