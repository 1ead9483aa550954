"""Worker process of a bake: opens the snapshot, captures its views, and writes each as soon as it is finished."""

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.btf.capture.capture_spec import LevelCaptureSpec
from ...core.btf.capture.dispatch import EXIT_ERROR, Shard, encode_error
from ...core.btf.capture.observations import ID_BUFFER_SCALE, observe, visible_subsamples
from ...core.btf.capture.reference_images import compute_reference_image, low_order_lights
from ...core.btf.capture.shards import ShardStore
from ...core.btf.capture.visibility_codec import encode_visibility
from ...core.errors import FarfieldError
from ...core.geometry.cameras import OrthographicView
from ..meshes import Source
from ..worker_processes import exit_when_run_ends, worker_command
from . import capture
from .snapshot import Snapshot, open_snapshot, store_folder


def shard_command(folder: Path, snapshot_folder: Path, shard: Shard, *, run_drivers: bool) -> list[str]:
    """Return the command line that captures a shard of the bake in `folder`.

    run_drivers: whether drivers in the snapshot may run any Python.
    """
    arguments = ["--folder", str(folder), "--snapshot", str(snapshot_folder), "--heartbeat", str(shard.heartbeat_file)]
    if run_drivers:
        arguments.append("--run-drivers")
    arguments += ["--workers-per-machine", str(shard.workers_per_machine), "--views", *map(str, shard.views)]
    return worker_command("addon.bridge.btf.worker", arguments)


def main(arguments: list[str]) -> int:
    """Capture the views given by the arguments; return the exit code."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--snapshot", type=Path, required=True)
    parser.add_argument("--run-drivers", action="store_true")
    parser.add_argument("--heartbeat", type=Path, required=True)
    parser.add_argument("--workers-per-machine", type=int, required=True)
    parser.add_argument("--views", type=int, nargs="+", required=True)
    options = parser.parse_args(arguments)
    exit_when_run_ends(options.heartbeat)
    try:
        snapshot = open_snapshot(options.snapshot, run_drivers=options.run_drivers)
        capture_views(snapshot, options.folder, options.views, threads=max(1, (os.cpu_count() or 1) // options.workers_per_machine))
    except FarfieldError as error:
        print(encode_error(error), file=sys.stderr, flush=True)
        return EXIT_ERROR
    return 0


def capture_views(snapshot: Snapshot, folder: Path, views: list[int], threads: int) -> None:
    """Capture those of the `views` that the stores in `folder` do not contain yet, for every level.

    Raises:
        FarfieldError: if Cycles cannot render the snapshot, or the disk is full.
    """
    source, settings = snapshot.source, snapshot.settings
    jobs: list[_ViewJob] = []
    for level, spec in enumerate(snapshot.specs):
        store = ShardStore(store_folder(folder, level))
        all_views = capture.build_views(source, settings.view_grid, spec.texels.texel_size)
        suns = [] if settings.shadow_grid is None else capture.build_views(source, settings.shadow_grid, spec.texels.texel_size)
        jobs += [
            _ViewJob(store, spec, index, all_views[index], suns[index :: len(all_views)]) for index in views if not store.exists(index)
        ]
    visibility_and_seconds = []
    with capture.open_face_id_renderer(source, settings, threads) as face_id_renderer:
        for job in jobs:
            start = face_id_renderer.render_seconds
            job.store.face_ids.write(job.index, face_id_renderer.render_face_ids(job.view.supersample(ID_BUFFER_SCALE)))
            visibility = [_sun_visibility(job.spec, source, sun, face_id_renderer.render_face_ids(sun)) for sun in job.suns]
            visibility_and_seconds.append((visibility, face_id_renderer.render_seconds - start))
    with capture.open_radiance_renderer(snapshot.objects, source, settings, threads) as radiance_renderer:
        for job, (visibility, seconds) in zip(jobs, visibility_and_seconds, strict=True):
            start = radiance_renderer.render_seconds
            render = radiance_renderer.render_view(job.view, job.store.face_ids.read(job.index))
            observation = observe(job.spec.texels, job.view, render, job.spec.quad_faces, job.spec.error)
            reference = compute_reference_image(render, low_order_lights(settings.light_grid))
            job.store.write(job.index, observation, reference, visibility, seconds + radiance_renderer.render_seconds - start)


@dataclass(frozen=True)
class _ViewJob:
    """One view of a level, with the views from those Suns whose visibility is captured along with it."""

    store: ShardStore
    spec: LevelCaptureSpec
    index: int
    view: OrthographicView
    suns: list[OrthographicView]


def _sun_visibility(spec: LevelCaptureSpec, source: Source, sun: OrthographicView, face_ids: np.ndarray) -> np.ndarray:
    heights = capture.compute_heights(source, sun, face_ids)
    return encode_visibility(*visible_subsamples(spec.texels, sun, face_ids, heights, spec.quad_faces, spec.error))
