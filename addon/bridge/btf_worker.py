"""A worker process of a bake: opens the snapshot, captures its views, and keeps each as soon as it is done."""

import argparse
import os
import sys
from pathlib import Path

from ..core.btf.orders import LevelOrder
from ..core.btf.photographs import broad_lights, photograph_of
from ..core.btf.shards import ShardStore
from ..core.btf.spreading import REFUSED, Shard, refusal
from ..core.btf.texels import View, sight
from ..core.errors import FarfieldError
from . import btf_capture
from .btf_snapshot import open_snapshot, store_folder
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
    jobs: list[tuple[ShardStore, LevelOrder, View, int]] = []
    for level, order in enumerate(snapshot.orders):
        store = ShardStore(store_folder(folder, level))
        directions = btf_capture.views_of(source, settings, order.texels.side)
        jobs += [(store, order, directions[number], number) for number in views if not store.has(number)]
    number_seconds = []
    with btf_capture.number_booth(source, settings, threads) as numbers:
        for store, _, view, number in jobs:
            before = numbers.render_seconds
            store.write_faces(number, numbers.faces(view))
            number_seconds.append(numbers.render_seconds - before)
    with btf_capture.lit_booth(snapshot.objects, source, settings, threads) as booth:
        for (store, order, view, number), seconds in zip(jobs, number_seconds, strict=True):
            before = booth.render_seconds
            picture = booth.picture(view, store.read_faces(number))
            sighting = sight(order.texels, view, picture, order.belongs, order.error)
            photograph = photograph_of(picture, broad_lights(settings.light_grid))
            store.write(number, sighting, photograph, seconds + booth.render_seconds - before)
