"""Damaged stores for `bench_bdam.py`: flipped bytes must be found and named, and the rest must be usable."""

import shutil
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from bdam_stores import Workplace, build_fractal
from bdam_terrains import AerialImage, FractalTerrain
from bdam_textures import build_texture_store

from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.textures.store import TextureStore
from farfield.addon.core.errors import FileError

MAX_SIZE = 2049  # samples per side of the terrain; the image has two pixels per cell
COUNTS = ("flips", "refused_on_opening", "found_on_opening", "found_by_verify", "found_on_reading", "not_found", "rest_unusable")

Damage = tuple[set[str], set[str], set[str]]  # names of files that opening gives, all that `verify` gives, and of what cannot be read


def measure_flips(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Flip bytes of each file of a store.

    `not_found` counts flips that neither opening nor `verify` finds, or where reading refuses other patches or tiles than `verify` names;
    `rest_unusable` those that make more than one patch or tile unreadable, or the whole store.
    """
    random, size = np.random.default_rng([given.seed, 70]), min(given.size, MAX_SIZE)
    build_fractal(workplace, FractalTerrain(size, given.seed)).close()
    textures = build_texture_store(workplace.folder / "flip-textures", AerialImage(2 * (size - 1), given.seed), "jpeg")
    figures: dict[str, Any] = {"size": size}
    for source, examine in ((workplace.folder / f"fractal-{size}", examine_patches), (textures, examine_tiles)):
        for path in sorted(path for path in source.iterdir() if path.is_file()):
            figures[path.name] = flip_bytes(source, path.name, examine, random, given.flips)
    return figures


def flip_bytes(source: Path, name: str, examine: Callable[[Path], Damage], random: np.random.Generator, flips: int) -> dict[str, int]:
    """Flip a byte of a file in copies of a store, and count what is found."""
    counts, damaged = dict.fromkeys(COUNTS, 0), source.with_name("damaged")
    for _ in range(flips):
        shutil.rmtree(damaged, ignore_errors=True)
        shutil.copytree(source, damaged)
        flip_byte(damaged / name, random)
        counts["flips"] += 1
        try:
            files, named, refused = examine(damaged)
        except FileError:
            counts["refused_on_opening"] += 1
            counts["rest_unusable"] += 1
            continue
        counts["found_on_opening"] += bool(files)
        counts["found_by_verify"] += bool(named)
        counts["found_on_reading"] += bool(refused)
        counts["not_found"] += not named or named != files | refused
        counts["rest_unusable"] += len(refused) > 1
    return counts


def flip_byte(path: Path, random: np.random.Generator) -> None:
    """Change a random byte of a file; every tenth time one of the first 64."""
    size = path.stat().st_size
    position = int(random.integers(min(64, size) if random.integers(10) == 0 else size))
    with path.open("r+b") as file:
        file.seek(position)
        value = file.read(1)[0]
        file.seek(position)
        file.write(bytes([value ^ int(random.integers(1, 256))]))


def examine_patches(folder: Path) -> Damage:
    """Return the damaged files and patches of a store. Raises FileError if it cannot be opened."""
    refused = set()
    with TerrainStore(folder) as store:
        files, named = {damage.name for damage in store.file_damages}, set(store.verify())
        for level, patches in enumerate(store.levels):
            for row in range(len(patches.indices)):
                try:
                    store.read(level, row)
                except FileError:
                    refused.add(store.label(level, row))
    return files, named, refused


def examine_tiles(folder: Path) -> Damage:
    """Return the damaged files and tiles of a store of textures. Raises FileError if it cannot be opened."""
    refused = set()
    with TextureStore(folder) as store:
        files = {damage.name for damage in store.damages}
        named = files | {store.label(number) for number in store.verify()}
        for number in range(len(store)):
            try:
                store.read(number)
            except FileError:
                refused.add(store.label(number))
    return files, named, refused
