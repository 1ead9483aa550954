"""Measures rebaked textures of levels for `bench_texmesh.py`: FLIP of renders with and without them, and bytes of images."""

import json
import sys
import time
from argparse import Namespace
from typing import Any

import numpy as np
from texmesh_chains import TexturedModel, make_chain, model_names, open_textured
from texmesh_texture_views import random_directions

from farfield.addon.core.imaging.coded_images import encode
from farfield.addon.core.imaging.colors import encode_signed_srgb
from farfield.addon.core.imaging.mipmaps import Mipmaps, build_mipmaps
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.level_chain import LevelChain
from farfield.addon.core.texmesh.perception.level_images import LevelImages, measure_difference
from farfield.addon.core.texmesh.perception.views import frame_around, prepare_surface
from farfield.addon.core.texmesh.rebaking.rebake import rebake_textures
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

VIEWS = 8
NEARER = 3  # times as near as the switch
MAX_PIXELS = 1024  # of an image of a nearer level


def measure_rebakes(given: Namespace) -> dict[str, Any]:
    """Return figures of the levels of all models, with the original's and with rebaked textures."""
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
    steps = rebake_textures(model.mesh, model.textures, [level.mesh for level in levels], [level.pixel_size for level in levels])
    rebaked = run_to_end(steps)
    seconds = time.process_time() - started
    settings, frame = TexmeshSettings(), frame_around(model.mesh.vertices)

    def view(mesh: TexturedMesh, mipmaps: list[Mipmaps | None]) -> LevelImages:
        return LevelImages(prepare_surface(mesh, mipmaps, settings.shaded), frame, directions, settings.pixels_per_degree)

    shared = model.mipmaps
    original = finer = finer_rebaked = view(model.mesh, shared)
    rows = []
    for level, textures in zip(levels, rebaked.levels, strict=True):
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
    return {"seconds": round(seconds, 1), "repeated": list(rebaked.repeated), "original": measure_images(model.textures), "levels": rows}


def measure_images(textures: tuple[np.ndarray | None, ...]) -> dict[str, Any]:
    """Return sizes, and bytes as PNG and JPEG, of all different images."""
    images = list({id(texture): texture for texture in textures if texture is not None}.values())
    coded = [np.rint(255.0 * np.clip(encode_signed_srgb(image), 0.0, 1.0)).astype(np.uint8) for image in images]
    return {
        "sizes": [list(image.shape[1::-1]) for image in images],
        "png": sum(len(encode(image, "png")) for image in coded),
        "jpeg": sum(len(encode(image, "jpeg")) for image in coded),
    }
