"""Measures how many bytes textures of packages need for the same FLIP error as uniform quality, for `bench_packages.py`."""

import gzip
import io
import json
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import texmesh_models
from packages_views import PIXELS_PER_DEGREE, VIEWS, TextureJudge, list_left_out, list_members, random_directions
from PIL import Image
from sending.fragments import (
    CodedFragments,
    FragmentMap,
    assign_qualities,
    count_features,
    make_fragment_grid,
    normalize_counts,
    quality_of_scale,
)

from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.packages.increments import encode_increments
from farfield.addon.core.packages.settings import PackageSettings
from farfield.addon.core.packages.textures.avif_files import SPEED
from farfield.addon.core.packages.textures.building import BuiltTextures, build_textures
from farfield.addon.core.packages.textures.coding import decode_textures
from farfield.addon.core.packages.textures.texture_tiles import TextureSource
from farfield.addon.core.texmesh.scale_space.analysis import analyze_scale_space
from farfield.addon.core.texmesh.settings import AnalysisSettings
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

TARGETS = (0.15, 0.1, 0.07, 0.05, 0.035, 0.025, 0.018)  # mean FLIP errors
PAPER_SCALES = (2, 6, 9, 12, 14, 16, 18, 20)
WEBP_METHOD = 6
QUALITIES = (2, 4, 7, 11, 17, 25, 37, 50, 65, 80, 92)
Images = list[np.ndarray | None]


class Curve(NamedTuple):
    """Ascending bytes (N,) and the FLIP errors (N,) that they give."""

    byte_counts: np.ndarray
    flips: np.ndarray

    def bytes_at(self, flip: float) -> float:
        """Return the bytes that give `flip`, between measured ones by the logarithms of both; NaN outside."""
        order = np.argsort(self.byte_counts)
        counts, flips = self.byte_counts[order], np.minimum.accumulate(self.flips[order])
        if not flips[-1] <= flip <= flips[0]:
            return float("nan")
        return float(np.exp(np.interp(np.log(flip), np.log(flips[::-1]), np.log(counts[::-1]))))


def list_sources(mesh: TexturedMesh, images: Sequence[np.ndarray | None]) -> list[TextureSource]:
    """Return one source for each distinct texture."""
    groups: dict[int, list[int]] = {}
    for material, image in enumerate(images):
        if image is not None and (mesh.materials == material).any():
            groups.setdefault(id(image), []).append(material)
    return [TextureSource("base_color", images[materials[0]], mesh, tuple(materials)) for materials in groups.values()]


def spread_images(sources: Sequence[TextureSource], decoded: Sequence[np.ndarray], count: int) -> Images:
    """Return the decoded texture of each material."""
    images: Images = [None] * count
    for source, image in zip(sources, decoded, strict=True):
        for material in source.materials:
            images[material] = image
    return images


def measure_built(built: BuiltTextures, sources: Sequence[TextureSource], judge: Callable[[Images], float], count: int) -> Curve:
    """Return the curve of the states of the textures of a package, with the headers of tiles as servers compress manifests."""
    headers = json.dumps([[header.hex() for header in texture.headers] for texture in built.textures])
    fixed = len(gzip.compress(headers.encode(), 9)) + len(encode_increments(built.increments))
    sizes = built.increments.measure_states(built.increments.state_count)
    flips = [
        judge(spread_images(sources, decode_textures(built.textures, built.increments, built.content, state), count))
        for state in range(len(sizes))
    ]
    return Curve(np.array(sizes) + fixed, np.array(flips))


class ModelFiles:
    """The textures of a model, and files of them, which do not depend on the size of images: each is coded when it is needed first."""

    def __init__(self, model: texmesh_models.TexturedModel) -> None:
        self.sources, self.count = list_sources(model.mesh, model.images), len(model.images)
        self._files: dict[tuple[int, int, str], bytes] = {}

    def encode(self, quality: int, file_format: str) -> list[bytes]:
        """Return the files of all textures."""
        return [self._encode(index, quality, file_format) for index in range(len(self.sources))]

    @cached_property
    def fragments(self) -> list[tuple[CodedFragments, FragmentMap]]:
        """The fragments of the paper, and their features, of all textures."""
        textures = [LINEAR_OF_BYTE[source.image] for source in self.sources]
        scales = {}
        for source in self.sources:
            if id(source.mesh) not in scales:
                scales[id(source.mesh)] = run_to_end(analyze_scale_space(source.mesh, textures, AnalysisSettings())).last_scales
        coded = []
        for source in self.sources:
            grid = make_fragment_grid(source.image.shape[1], source.image.shape[0])
            coded.append((CodedFragments(source.image, grid), count_features(source.mesh, source.materials, scales[id(source.mesh)], grid)))
        return coded

    def _encode(self, index: int, quality: int, file_format: str) -> bytes:
        key = index, quality, file_format
        if key not in self._files:
            self._files[key] = encode_image(self.sources[index].image[::-1], quality, file_format)
        return self._files[key]


def measure_uniform(files: ModelFiles, judge: Callable[[Images], float], file_format: str) -> Curve:
    """Return the curve of whole textures as AVIF or WebP files of one quality."""
    sizes, flips = [], []
    for quality in QUALITIES:
        coded = files.encode(quality, file_format)
        decoded = [np.asarray(Image.open(io.BytesIO(file)).convert("RGB"))[::-1] for file in coded]
        sizes.append(sum(map(len, coded)))
        flips.append(judge(spread_images(files.sources, decoded, files.count)))
    return Curve(np.array(sizes), np.array(flips))


def measure_fragments(files: ModelFiles, judge: Callable[[Images], float]) -> Curve:
    """Return the curve of the fragments of the paper, with the default quality of some scales and the mean threshold."""
    sizes, flips = [], []
    for scale in PAPER_SCALES:
        coded = [
            fragments.code(assign_qualities(normalize_counts(features.counts[scale]), quality_of_scale(scale)))
            for fragments, features in files.fragments
        ]
        decoded = [fragments.decode(items) for (fragments, _), items in zip(files.fragments, coded, strict=True)]
        sizes.append(sum(len(file) for items in coded for file in items))
        flips.append(judge(spread_images(files.sources, decoded, files.count)))
    return Curve(np.array(sizes), np.array(flips))


def encode_image(image: np.ndarray, quality: int, file_format: str) -> bytes:
    """Return an AVIF file, without subsampling of colors, or a WebP file of an image (H, W, 3) uint8."""
    file = io.BytesIO()
    picture = Image.fromarray(np.ascontiguousarray(image))
    options = {"speed": SPEED, "subsampling": "4:4:4"} if file_format == "AVIF" else {"method": WEBP_METHOD}
    picture.save(file, file_format, quality=quality, **options)
    return file.getvalue()


def build(sources: Sequence[TextureSource], settings: PackageSettings) -> BuiltTextures:
    """Build the textures of a package."""
    return run_to_end(build_textures(sources, settings, PIXELS_PER_DEGREE))


def measure_textures(given: Namespace) -> dict[str, Any]:
    """Return bytes at equal FLIP of packages and of other ways to send textures, for all models that judge and all sizes of images."""
    names = [*texmesh_models.JUDGING, *(f"{kind}:{given.seed + index}" for index, kind in enumerate(texmesh_models.GENERATORS))]
    results: dict[str, Any] = {}
    model, files, opened = None, None, ""
    for name, pixels in list_members(given, names):
        if name != opened:
            model, opened = texmesh_models.open_textured(given.data, name, given.seed), name
            files = ModelFiles(model)
        started = time.perf_counter()
        result = measure_model(model, files, pixels, np.random.default_rng([given.seed, pixels]))
        results[f"{name} at {pixels}"] = result | {"all_seconds": round(time.perf_counter() - started, 1)}
        print(name, pixels, json.dumps(results[f"{name} at {pixels}"]), file=sys.stderr)
    summary = {}
    for member in ("uniform", "paper", "webp"):
        ratios = [row[member] for result in results.values() for row in result["targets"] if row[member] is not None]
        summary[member] = {"mean": round(float(np.mean(ratios)), 3), "worst": max(ratios), "count": len(ratios)} if ratios else None
    return {"ratios": summary, "models": results, "left_out": list_left_out(given, names, results)}


def measure_model(model: texmesh_models.TexturedModel, files: ModelFiles, pixels: int, generator: np.random.Generator) -> dict[str, Any]:
    """Return bytes at equal FLIP errors, relative to those of uniform quality, to the paper's fragments and to WebP;
    None where one of them does not reach the error."""
    judge = TextureJudge(model.mesh, model.images, random_directions(VIEWS[pixels], generator), pixels).measure_flip
    sources, count = files.sources, files.count
    started = time.process_time()
    built = build(sources, PackageSettings(pixels=pixels))
    seconds = time.process_time() - started
    curves = {
        "package": measure_built(built, sources, judge, count),
        "uniform": measure_uniform(files, judge, "AVIF"),
        "paper": measure_fragments(files, judge),
        "webp": measure_uniform(files, judge, "WEBP"),
    }
    rows = []
    for flip in TARGETS:
        counts = {name: curve.bytes_at(flip) for name, curve in curves.items()}
        ratios = {name: counts["package"] / other for name, other in counts.items() if name != "package"}
        rows.append({"flip": flip} | {name: round(float(ratio), 3) if np.isfinite(ratio) else None for name, ratio in ratios.items()})
    return {
        "seconds": round(seconds, 1),
        "targets": rows,
        "curves": {name: [curve.byte_counts.tolist(), np.round(curve.flips, 4).tolist()] for name, curve in curves.items()},
    }
