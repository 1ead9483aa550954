"""Effect of the compression on the noise of a bake with few samples: captured and compressed colors relative to a bake with many."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from btf_bakes import BenchmarkCloud, BenchmarkOptions, bake, build_cloud

import btf
from farfield.addon.core.btf.compression import CompressedTextures, LevelCompressor
from farfield.addon.core.btf.settings import EMISSION, BtfSettings
from farfield.addon.core.jobs.progress import Progress, Steps, run_to_end
from lib import scene_files

REFERENCE_SAMPLE_FACTOR = 32  # with this many times the samples there is almost no noise
DIRECTIONS_PER_SIDE = 5  # So many views and lights are enough to separate noise from colors.


@dataclass(frozen=True)
class CompressedBake:
    """A finished bake and its compressed textures."""

    compressor: LevelCompressor
    textures: CompressedTextures


def measure_noise(options: BenchmarkOptions) -> Steps[dict[str, Any]]:
    """Measure the RMS error of texels under single Suns relative to their mean color, over all views, for every model."""
    figures = {}
    for index, name in enumerate(options.models):
        yield Progress(index / len(options.models), f"Baking {name} with few and with many samples")
        grid = {"views_per_side": DIRECTIONS_PER_SIDE, "lights_per_side": DIRECTIONS_PER_SIDE}
        figures[name] = _measure_model(build_cloud(name, options, options.error), replace(options, **grid))
    return figures


def _measure_model(cloud: BenchmarkCloud, options: BenchmarkOptions) -> dict[str, Any]:
    sample_counts = (options.capture_samples, _reference_samples(options))
    noisy, reference = (_bake_and_compress(cloud, replace(options, capture_samples=count)) for count in sample_counts)
    squared_errors, count, total = np.zeros(3), 0, 0.0
    for view in range(options.views_per_side**2):
        rows, captured = noisy.compressor.captured_colors(view)
        reference_rows, expected = reference.compressor.captured_colors(view)
        _, common, reference_common = np.intersect1d(rows, reference_rows, assume_unique=True, return_indices=True)
        rows, expected = rows[common], expected[reference_common, :-1]
        decoded = (item.compressor.decoded_colors(item.textures, view, rows)[:, :-1] for item in (noisy, reference))
        squared_errors += [float(((colors - expected) ** 2).sum()) for colors in (captured[common, :-1], *decoded)]
        count, total = count + expected.size, total + float(expected.sum())
    names = ("captured", "compressed", "compressed_reference")
    relative = np.sqrt(squared_errors / count) / (total / count)
    return {
        "samples": options.capture_samples,
        "reference_samples": _reference_samples(options),
        **dict(zip(names, relative.round(4).tolist(), strict=True)),
    }


def _bake_and_compress(cloud: BenchmarkCloud, options: BenchmarkOptions) -> CompressedBake:
    name = f"noise {options.capture_samples}"
    work = cloud.path.with_name(f"views of {name}")
    bake(cloud, name, work, options, "--no-refine")
    scene_files.open_scene(cloud.path)
    settings = BtfSettings(
        model=EMISSION,
        views_per_side=options.views_per_side,
        lights_per_side=options.lights_per_side,
        samples=options.capture_samples,
        upper_hemisphere=cloud.upper,
        refine=False,
    )
    [job] = btf.prepare_jobs(settings, Path(work))
    [level] = job.levels
    compressor = level.open_compressor()
    return CompressedBake(compressor, run_to_end(compressor.compress()))


def _reference_samples(options: BenchmarkOptions) -> int:
    return REFERENCE_SAMPLE_FACTOR * options.capture_samples
