"""The cases of `bench_restore.py`: a texture with a mask, restored by every method and scored."""

from argparse import Namespace
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from restore_holes import MASKS
from restore_methods import Methods, Restored
from restore_pictures import ALL_PHOTOGRAPHS, SCENES, read_photograph, render
from restore_scores import boundary_energy, contour_error, find_nearby, has_false_edge, hole_flip, low_band_psnr, patch_distances
from restore_textures import GENERATED, PHOTOGRAPHS, SIZE, add_gradient, crop

from farfield.addon.core.errors import FarfieldError

Change = Callable[[np.ndarray, np.random.Generator, int], np.ndarray]


class Case(NamedTuple):
    """An image (H, W, C) float32 of 8-bit values and the mask (H, W) bool of one restoration. `seed` is that of the scores."""

    texture: str
    mask_name: str
    image: np.ndarray
    mask: np.ndarray
    seed: int

    @property
    def name(self) -> str:
        """The name in the report."""
        return f"{self.texture}, {self.mask_name}"


class Comparison(NamedTuple):
    """A case, the scores by method, and the restored images by method. The truth is a method; one that failed has no image."""

    case: Case
    scores: dict[str, dict[str, Any]]
    images: dict[str, np.ndarray]


Score = Callable[[Case, Restored], dict[str, Any]]


def build_cases(texture: str, given: Namespace, methods: Methods, change: Change) -> Iterator[Case]:
    """Yield one texture with each mask, the same for equal seeds, whatever else is selected."""
    seeds = [given.seed, (*PHOTOGRAPHS, *GENERATED).index(texture)]
    image = read_texture(texture, np.random.default_rng(seeds), given, methods)
    for name in given.masks:
        index = list(MASKS).index(name)
        random = np.random.default_rng([*seeds, index])
        mask = MASKS[name](random, image.shape[:2])
        yield Case(texture, name, change(image, random, index), mask, given.seed + index)


def build_picture_cases(name: str, given: Namespace, methods: Methods) -> Iterator[Case]:
    """Yield one picture with each mask, the same for equal seeds, whatever else is selected."""
    seeds = [given.seed, *name.encode()]
    random, kind = np.random.default_rng(seeds), name.rsplit(" ", 1)[0]
    image = render(kind, random) if kind in SCENES else read_photograph(ALL_PHOTOGRAPHS[name], random, methods.read, given.pictures)
    for mask_name in given.masks:
        index = list(MASKS).index(mask_name)
        mask = MASKS[mask_name](np.random.default_rng([*seeds, index]), image.shape[:2])
        yield Case(name, mask_name, round_to_8_bits(image), mask, given.seed + index)


def read_texture(name: str, random: np.random.Generator, given: Namespace, methods: Methods) -> np.ndarray:
    """Generate a texture, or cut it out of a photograph: (H, W, C) float32 of 8-bit values.

    Raises:
        FarfieldError: there is no such photograph.
    """
    if name in GENERATED:
        return round_to_8_bits(GENERATED[name](random, (SIZE, SIZE)))
    area = PHOTOGRAPHS[name]
    if area.file.startswith("skimage:"):
        return crop(methods.read(area.file), area, random)
    path = given.data.absolute() / area.file
    if not path.is_file():
        raise FarfieldError(f'There is no photograph "{path}"; name another folder with --data, or select textures with --textures.')
    return crop(methods.read(str(path)), area, random)


def keep(image: np.ndarray, _random: np.random.Generator, _index: int) -> np.ndarray:
    """Return `image` as it is."""
    return image


def apply_gradient(image: np.ndarray, random: np.random.Generator, index: int) -> np.ndarray:
    """Return `image` under a gradient of intensity, which multiplies it or, for every other mask, is added to it."""
    return round_to_8_bits(add_gradient(image, random, multiply=index % 2 == 0))


def round_to_8_bits(image: np.ndarray) -> np.ndarray:
    """Return `image` with 256 different values."""
    return (np.rint(np.clip(image, 0.0, 1.0) * 255.0) / 255.0).astype(np.float32)


def compare(case: Case, names: list[str], methods: Methods, score: Score) -> Comparison:
    """Restore a case by the named methods and score the results."""
    results = {"truth": Restored(case.image)} | {name: methods.run(name, case.image, case.mask) for name in names}
    scores = {name: score(case, restored) for name, restored in results.items()}
    return Comparison(case, scores, {name: restored.image for name, restored in results.items() if restored.image is not None})


def score_picture(case: Case, restored: Restored) -> dict[str, Any]:
    """Return the measures of one restored picture, or its error."""
    if restored.image is None:
        return {"error": restored.error}
    return {
        "contours": round(contour_error(restored.image, case.image, case.mask), 3),
        "flip": round(hole_flip(restored.image, case.image, case.mask), 4),
        "false_edge": has_false_edge(restored.image, case.image, case.mask),
        "low_band_db": round(low_band_psnr(restored.image, case.image, case.mask), 2),
        "seconds": round(restored.seconds, 2),
    }


def score_texture(case: Case, restored: Restored) -> dict[str, Any]:
    """Return the measures of one restored texture, or its error."""
    if restored.image is None:
        return {"error": restored.error}
    distance, distance_to_truth = patch_distances(restored.image, case.image, case.mask, case.seed)
    figures = {
        "distance": round(distance, 5),
        "distance_to_truth": round(distance_to_truth, 5),
        "boundary": round(boundary_energy(restored.image, case.mask), 3),
        "boundary_nearby": round(boundary_energy(restored.image, case.mask, find_nearby(case.mask)), 3),
        "low_band_db": round(low_band_psnr(restored.image, case.image, case.mask), 2),
        "seconds": round(restored.seconds, 2),
    }
    return figures if restored.kappa is None else figures | {"kappa": restored.kappa}
