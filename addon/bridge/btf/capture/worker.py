"""Worker process of a bake: opens the snapshot, captures its views, and writes each as soon as it is finished."""

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....core.btf.capture.capture_spec import LevelCaptureSpec
from ....core.btf.capture.observations import (
    ID_BUFFER_SCALE,
    ViewRender,
    compute_reference_image,
    low_order_lights,
    observe,
    visible_subsamples,
)
from ....core.btf.capture.shard_files import encode_visibility
from ....core.btf.capture.shards import ShardStore
from ....core.errors import FarfieldError
from ....core.geometry.cameras import OrthographicView
from ....core.jobs.core_worker import EXIT_ERROR, encode_error
from ....core.jobs.dispatch import Shard
from ....core.jobs.heartbeat import exit_when_run_ends
from ...worker_processes import worker_command
from . import source_renderers
from .snapshot import Snapshot, open_snapshot, store_folder
from .source_renderers import open_surface_renderer


def shard_command(folder: Path, snapshot_folder: Path, shard: Shard[int], *, run_drivers: bool) -> list[str]:
    """Return the command line that captures a shard of the bake in `folder`.

    run_drivers: whether drivers in the snapshot may run any Python.
    """
    arguments = ["--folder", str(folder), "--snapshot", str(snapshot_folder), "--heartbeat", str(shard.heartbeat_file)]
    if run_drivers:
        arguments.append("--run-drivers")
    arguments += ["--workers-per-machine", str(shard.workers_per_machine), "--views", *map(str, shard.items)]
    return worker_command("addon.bridge.btf.capture.worker", arguments)


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
    jobs = _find_missing_views(snapshot, folder, views)
    capture_images = _capture_lit_views if snapshot.settings.bakes_emission else _capture_surface_views
    capture_images(snapshot, jobs, _capture_face_ids(snapshot, jobs, threads), threads)


def _find_missing_views(snapshot: Snapshot, folder: Path, views: list[int]) -> list["_ViewJob"]:
    source, settings = snapshot.source, snapshot.settings
    jobs: list[_ViewJob] = []
    for level, spec in enumerate(snapshot.specs):
        store = ShardStore(store_folder(folder, level))
        all_views = source_renderers.build_views(source, settings.view_grid, spec.texels.texel_size)
        suns = [] if settings.shadow_grid is None else source_renderers.build_views(source, settings.shadow_grid, spec.texels.texel_size)
        jobs += [
            _ViewJob(store, spec, index, all_views[index], suns[index :: len(all_views)]) for index in views if not store.exists(index)
        ]
    return jobs


def _capture_face_ids(snapshot: Snapshot, jobs: list["_ViewJob"], threads: int) -> list[tuple[list[np.ndarray], float]]:
    """Store the ID buffers of all views. Return per view the visibility of its Suns, and the render time in seconds."""
    source, visibility_and_seconds = snapshot.source, []
    with source_renderers.open_face_id_renderer(source, snapshot.settings, threads) as face_id_renderer:
        for job in jobs:
            start = face_id_renderer.work.render_seconds
            face_ids = face_id_renderer.render_face_ids(job.view.supersample(ID_BUFFER_SCALE))
            job.store.face_ids.write(job.index, {"face_ids": face_ids}, compressed=True)
            visibility = []
            for sun in job.suns:
                face_ids = face_id_renderer.render_face_ids(sun)
                heights = source_renderers.compute_heights(source, sun, face_ids)
                spec = job.spec
                counts = visible_subsamples(spec.texels, sun, face_ids, heights, spec.quad_faces, spec.error)
                visibility.append(encode_visibility(*counts))
            visibility_and_seconds.append((visibility, face_id_renderer.work.render_seconds - start))
    return visibility_and_seconds


def _capture_lit_views(
    snapshot: Snapshot, jobs: list["_ViewJob"], visibility_and_seconds: list[tuple[list[np.ndarray], float]], threads: int
) -> None:
    """Capture all views under every light of the model *emission*."""
    source, settings = snapshot.source, snapshot.settings
    with source_renderers.open_radiance_renderer(snapshot.objects, source, settings, threads) as radiance_renderer:
        for job, (visibility, seconds) in zip(jobs, visibility_and_seconds, strict=True):
            start = radiance_renderer.work.render_seconds
            render = radiance_renderer.render_view(job.view, job.read_face_ids())
            job.write(render, low_order_lights(settings.light_grid), visibility, seconds + radiance_renderer.work.render_seconds - start)


def _capture_surface_views(
    snapshot: Snapshot, jobs: list["_ViewJob"], visibility_and_seconds: list[tuple[list[np.ndarray], float]], threads: int
) -> None:
    """Capture the material channels of all views, for the model *surface*."""
    source, settings = snapshot.source, snapshot.settings
    with open_surface_renderer(source, settings, threads) as renderer:
        for job, (visibility, seconds) in zip(jobs, visibility_and_seconds, strict=True):
            start = renderer.work.render_seconds
            render = renderer.render_view(job.view, job.read_face_ids())
            seconds += renderer.work.render_seconds - start
            job.write(render, np.eye(len(render.radiance), dtype=np.float32), visibility, seconds)


@dataclass(frozen=True)
class _ViewJob:
    """One view of a level, with the views from those Suns whose visibility is captured along with it.

    Attributes:
        store: Finished views of the level.
        spec: Specification of the level.
        index: Index of the view.
        view: The view.
        suns: Views from the Suns.
    """

    store: ShardStore
    spec: LevelCaptureSpec
    index: int
    view: OrthographicView
    suns: list[OrthographicView]

    def read_face_ids(self) -> np.ndarray:
        """Return the ID buffer (H, W) int32 of the view."""
        return self.store.face_ids.read(self.index, "face_ids")[0]

    def write(self, render: ViewRender, reference_weights: np.ndarray, visibility: list[np.ndarray], seconds: float) -> None:
        """Write the finished view. reference_weights (L, M): of the images of `render` in the colors of the reference image."""
        observation = observe(self.spec.texels, self.view, render, self.spec.quad_faces, self.spec.error)
        self.store.write(self.index, observation, compute_reference_image(render, reference_weights), visibility, seconds)
