"""A worker process of a bake: opens the snapshot, captures its views, and keeps each as soon as it is done."""

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.btf.orders import LevelOrder
from ..core.btf.photographs import broad_lights, photograph_of
from ..core.btf.shards import ShardStore, lit_bytes
from ..core.btf.spreading import REFUSED, Shard, refusal
from ..core.btf.texels import FINER, View, reached_parts, sight
from ..core.errors import FarfieldError
from . import btf_capture
from .btf_snapshot import open_snapshot, store_folder
from .meshes import Source
from .worker_processes import end_with, worker_command


def command(folder: Path, shard: Shard) -> list[str]:
    """The command line that captures a shard of the bake whose snapshot lies in `folder`."""
    arguments = ["--folder", str(folder), "--lease", str(shard.lease), "--sharing", str(shard.sharing), "--views", *map(str, shard.views)]
    return worker_command("addon.bridge.btf_worker", arguments)


def main(arguments: list[str]) -> int:
    """Capture what the arguments say; returns the exit code."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--lease", type=Path, required=True)
    parser.add_argument("--sharing", type=int, required=True)
    parser.add_argument("--views", type=int, nargs="+", required=True)
    given = parser.parse_args(arguments)
    end_with(given.lease)
    try:
        capture_views(given.folder, given.views, threads=max(1, (os.cpu_count() or 1) // given.sharing))
    except FarfieldError as error:
        print(refusal(error), file=sys.stderr, flush=True)
        return REFUSED
    return 0


def capture_views(folder: Path, views: list[int], threads: int) -> None:
    """Capture those of the `views` that the stores in `folder` do not hold yet, for every level.

    Raises:
        FarfieldError: when the snapshot cannot be opened, Cycles cannot render it, or the disk is full.
    """
    snapshot = open_snapshot(folder)
    source, settings = snapshot.source, snapshot.settings
    jobs: list[_Job] = []
    for level, order in enumerate(snapshot.orders):
        store = ShardStore(store_folder(folder, level))
        seen = btf_capture.views_of(source, settings.view_grid, order.texels.side)
        suns = [] if settings.shadow_grid is None else btf_capture.views_of(source, settings.shadow_grid, order.texels.side)
        jobs += [_Job(store, order, number, seen[number], suns[number :: len(seen)]) for number in views if not store.has(number)]
    numbered = []
    with btf_capture.number_booth(source, settings, threads) as numbers:
        for job in jobs:
            before = numbers.render_seconds
            job.store.write_faces(job.number, numbers.faces(job.view.finer(FINER)))
            lit = [_lit(job.order, source, sun, numbers.faces(sun)) for sun in job.suns]
            numbered.append((lit, numbers.render_seconds - before))
    with btf_capture.lit_booth(snapshot.objects, source, settings, threads) as booth:
        for job, (lit, seconds) in zip(jobs, numbered, strict=True):
            before = booth.render_seconds
            picture = booth.picture(job.view, job.store.read_faces(job.number))
            sighting = sight(job.order.texels, job.view, picture, job.order.belongs, job.order.error)
            photograph = photograph_of(picture, broad_lights(settings.light_grid))
            job.store.write(job.number, sighting, photograph, lit, seconds + booth.render_seconds - before)


@dataclass(frozen=True)
class _Job:
    """A view of a level, and what the suns see whose shadows are looked up along with it."""

    store: ShardStore
    order: LevelOrder
    number: int
    view: View
    suns: list[View]


def _lit(order: LevelOrder, source: Source, sun: View, faces: np.ndarray) -> np.ndarray:
    heights = btf_capture.heights_of(source, sun, faces)
    return lit_bytes(*reached_parts(order.texels, sun, faces, heights, order.belongs, order.error))
