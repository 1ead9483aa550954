"""Compares renders of levels with those of the original, for `bench_texmesh.py`: FLIP at the distance where each level switches.

Other programs make levels with as many triangles from the same mesh. All are seen from random directions, which the search for switches
does not use, with the same images and the same light.
"""

import json
import sys
import tempfile
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import texmesh_files
import texmesh_peers
from packages_views import random_directions
from PIL import Image
from texmesh_chains import TexturedModel, make_chain, model_names, open_textured

from farfield.addon.core.imaging.coded_images import encode
from farfield.addon.core.imaging.colors import encode_signed_srgb
from farfield.addon.core.imaging.mipmaps import Mipmaps, build_mipmaps
from farfield.addon.core.texmesh.level_chain import LevelChain
from farfield.addon.core.texmesh.perception.level_images import LevelImages, measure_difference
from farfield.addon.core.texmesh.perception.views import frame_around, prepare_surface
from farfield.addon.core.texmesh.rebaking.image_sizes import choose_halvings, halve_size
from farfield.addon.core.texmesh.rebaking.smaller_images import Content, shrink_image
from farfield.addon.core.texmesh.rebaking.uv_layout import find_coverage
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

VIEWS = 8
MAX_EXCESS, MIN_REACHED = 1.02, 0.9  # Relative to the triangles of a level; with more or fewer a peer is not comparable.
MAX_RATIO = 1.0  # Ratio of the difference to that of the best peer.
NEARER = 3  # times as near as the switch
MAX_PIXELS = 1024  # Pixels of an image of a nearer level.


def measure_renders(given: Namespace) -> dict[str, Any]:
    """Return the FLIP of each level and of those of other programs against the original, of all models."""
    results = {}
    for name in model_names(given):
        model, chain = open_textured(given.data, name, given.seed), make_chain(given.data, name, given.seed)
        with tempfile.TemporaryDirectory() as folder:
            results[name] = compare_levels(model, chain, np.random.default_rng([given.seed, 1]), Path(folder))
        print(name, json.dumps(results[name]), file=sys.stderr)
    return results


def compare_levels(model: TexturedModel, chain: LevelChain, generator: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Return the figures of one model: per level those of Farfield and of each peer, and the ratio to the best peer."""
    source = write_source(model.mesh, folder)
    original, directions = chain.levels[0].mesh, random_directions(VIEWS, generator)
    rows = []
    for level in chain.levels[1:]:
        count = len(level.mesh.triangles)
        size = max(int(chain.image_side / level.pixel_size), 1)
        meshes, failures = {"farfield": level.mesh}, {}
        for peer, simplify in texmesh_peers.PEERS.items():
            made = simplify(source, folder, count)
            if made.mesh is None:
                failures[peer] = made.message
            else:
                meshes[peer] = made.mesh
        figures = {name: measure_render(model, original, mesh, directions, size) for name, mesh in meshes.items()}
        rows.append({"triangles": count, "pixels": size, **judge(figures, count), "methods": figures, "failures": failures})
    return {"max_ratio": MAX_RATIO, "is_met": all(row["is_met"] for row in rows), "levels": rows}


def measure_render(model: TexturedModel, original: TexturedMesh, mesh: TexturedMesh, directions: np.ndarray, size: int) -> dict[str, Any]:
    """Return the mean FLIP of `mesh` against the original over all views and in the worst one, and the 95th percentile there."""
    settings, frame, mipmaps = TexmeshSettings(), frame_around(original.vertices), model.mipmaps
    images = [
        LevelImages(prepare_surface(item, mipmaps, settings.shaded), frame, directions, settings.pixels_per_degree)
        for item in (original, mesh)
    ]
    difference = measure_difference(*images, size, range(len(directions)))
    return {
        "triangles": len(mesh.triangles),
        "mean": round(float(difference.means.mean()), 5),
        "largest": round(float(difference.means.max()), 5),
        "local": round(float(difference.highs.max()), 5),
    }


def judge(figures: dict[str, dict[str, Any]], count: int) -> dict[str, Any]:
    """Return the best peer with about as many triangles, the ratios to it, and whether the bound is met."""
    peers = {
        name: values
        for name, values in figures.items()
        if name != "farfield" and MIN_REACHED * count <= values["triangles"] <= MAX_EXCESS * count
    }
    best = min(peers, key=lambda name: peers[name]["mean"], default=None)
    if best is None:
        return {"best": None, "ratio": None, "is_met": True}
    ratio = figures["farfield"]["mean"] / max(peers[best]["mean"], 1e-9)
    return {"best": best, "ratio": round(ratio, 3), "is_met": ratio <= MAX_RATIO}


def write_source(mesh: TexturedMesh, folder: Path) -> Path:
    """Write the mesh for other programs, with a small image per material, and return its path."""
    textures = {int(material): f"texture_{material}.png" for material in np.unique(mesh.materials)}
    for texture in textures.values():
        Image.new("RGB", (4, 4)).save(folder / texture)
    texmesh_files.write_obj(folder / "fine.obj", mesh, textures)
    return folder / "fine.obj"


def measure_rebakes(given: Namespace) -> dict[str, Any]:
    """Return figures of the levels of all models, with the original's and with smaller textures."""
    results = {}
    for name in model_names(given):
        model, chain = open_textured(given.data, name, given.seed), make_chain(given.data, name, given.seed)
        results[name] = compare_textures(model, chain, random_directions(VIEWS, np.random.default_rng([given.seed, 2])))
        print(name, json.dumps(results[name]), file=sys.stderr)
    return results


def compare_textures(model: TexturedModel, chain: LevelChain, directions: np.ndarray) -> dict[str, Any]:
    """Return the figures of one model: bytes of its images, CPU seconds, and per level sizes and bytes of images, and the largest mean
    FLIP in `directions` against the original and against the finer level, at the switch and nearer, without and with rebaking."""
    levels, started = chain.levels[1:], time.process_time()
    rebaked = [make_smaller(model, level.mesh, level.pixel_size) for level in levels]
    seconds = time.process_time() - started
    settings, frame = TexmeshSettings(), frame_around(model.mesh.vertices)

    def view(mesh: TexturedMesh, mipmaps: list[Mipmaps | None]) -> LevelImages:
        return LevelImages(prepare_surface(mesh, mipmaps, settings.shaded), frame, directions, settings.pixels_per_degree)

    shared = model.mipmaps
    original = finer = finer_rebaked = view(model.mesh, shared)
    rows = []
    for level, textures in zip(levels, rebaked, strict=True):
        own = [mipmaps if texture is None else build_mipmaps(texture) for mipmaps, texture in zip(shared, textures, strict=True)]
        plain, changed = view(level.mesh, shared), view(level.mesh, own)
        row: dict[str, Any] = {"triangles": len(level.mesh.triangles), "pixels": level.switch.pixels, **measure_images(textures)}
        for label, size in (("switch", level.switch.pixels), ("nearer", min(NEARER * level.switch.pixels, MAX_PIXELS))):
            pairs = {
                "plain": (original, plain),
                "rebaked": (original, changed),
                "step": (finer, plain),
                "step_rebaked": (finer_rebaked, changed),
            }
            row[label] = {name: round(float(measure_difference(*pair, size, range(VIEWS)).means.max()), 4) for name, pair in pairs.items()}
        finer, finer_rebaked = plain, changed
        rows.append(row)
    return {"seconds": round(seconds, 1), "original": measure_images(model.textures), "levels": rows}


def make_smaller(model: TexturedModel, mesh: TexturedMesh, pixel_size: float) -> tuple[np.ndarray | None, ...]:
    """Return the textures (H, W, 3) of a level by material, linear light, in the size for pixels of `pixel_size`."""
    made: dict[int, np.ndarray] = {}
    for texture in (texture for texture in model.textures if texture is not None and id(texture) not in made):
        materials = [material for material, item in enumerate(model.textures) if item is texture]
        rows, original = np.isin(mesh.materials, materials), np.isin(model.mesh.materials, materials)
        size = texture.shape[1::-1]
        halvings = choose_halvings(mesh.vertices[mesh.triangles[rows]], mesh.corner_uvs[rows], pixel_size, size)
        coverage = find_coverage(model.mesh.corner_uvs[original], size)
        pixels = np.rint(255.0 * np.clip(encode_signed_srgb(texture), 0.0, 1.0)).astype(np.uint8)
        (made[id(texture)],) = shrink_image(pixels, coverage, Content.COLOR, [halve_size(size, halvings)])
    return tuple(None if texture is None else made[id(texture)] for texture in model.textures)


def measure_images(textures: tuple[np.ndarray | None, ...]) -> dict[str, Any]:
    """Return sizes, and bytes as PNG and JPEG, of all different images."""
    images = list({id(texture): texture for texture in textures if texture is not None}.values())
    coded = [np.rint(255.0 * np.clip(encode_signed_srgb(image), 0.0, 1.0)).astype(np.uint8) for image in images]
    return {
        "sizes": [list(image.shape[1::-1]) for image in images],
        "png": sum(len(encode(image, "png")) for image in coded),
        "jpeg": sum(len(encode(image, "jpeg")) for image in coded),
    }
