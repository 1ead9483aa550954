"""Holes in finished textures, filled by Farfield and by others, for `bench_photos.py`."""

import time
from pathlib import Path
from typing import Any

import numpy as np
from photos_inputs import Unwrapped
from photos_methods import fill_with_lagrange
from scipy import ndimage

from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.photographs.surface import Surface
from farfield.addon.core.photos.texels.face_visibility import order_by_corner
from farfield.addon.core.photos.texels.hole_filling import HoleFiller
from farfield.addon.core.photos.texels.hole_interpolation import interpolate_colors, interpolate_holes
from farfield.addon.core.photos.texels.texel_map import TexelMap
from lib.contact_sheet import write_png
from lib.flip_metric import mean_flip

CROP = 16  # texels around a hole that are compared, too
VARIATION = 0.3  # Random part of the area of a hole.
ROWS, WINDOW = 6, 160  # Rows of the pictures and pixels of their side.


def punch_holes(unwrapped: Unwrapped, seen: np.ndarray, fraction: float, count: int, random: np.random.Generator) -> np.ndarray:
    """Return where (S, S) bool the texture is missing: `count` round holes on the surface, of `fraction` of all texels of the image, with
    centers that are `seen` (S, S), so that they may lie across the seams of the UV map."""
    size = len(seen)
    tiles = list(TexelMap(unwrapped.corner_uvs, size).tiles())
    texels = np.concatenate([tile.texels for tile in tiles])
    points = np.concatenate([tile.interpolate(unwrapped.mesh.corners) for tile in tiles])
    usable = np.flatnonzero(seen.ravel()[texels])
    goal = fraction * size * size / count
    missing = np.zeros(size * size, bool)
    for center in random.choice(usable, count, replace=False):
        distances = np.linalg.norm(points - points[center], axis=1)
        number = int(goal * random.uniform(1.0 - VARIATION, 1.0 + VARIATION))
        missing[texels[np.argpartition(distances, number)[:number]]] = True
    return missing.reshape(size, size) & seen


def fill_and_score(
    unwrapped: Unwrapped, texture: np.ndarray, covered: np.ndarray, missing: np.ndarray, sheet: Path | None
) -> dict[str, Any]:
    """Fill the `missing` texels (S, S) of the `covered` ones (S, S) of a `texture` (S, S, 3) by all methods.

    Returns the seconds and the FLIP around the holes against the texture, mean over the holes. `sheet` names a picture of some of them: the
    hole, the truth, then all methods.
    """
    mesh, corner_uvs = unwrapped
    texel_map = TexelMap(corner_uvs, len(texture))
    known = covered & ~missing
    started = time.perf_counter()
    interpolated = interpolate(unwrapped, texel_map, texture, known)
    results = {"interpolate": (interpolated, time.perf_counter() - started)}
    restored = interpolated.reshape(-1, 3).copy()
    started = time.perf_counter()
    counts = run_to_end(HoleFiller(Surface.around_origin(mesh), texel_map, restored, known.ravel()).fill())
    results["restore"] = (restored.reshape(texture.shape), time.perf_counter() - started)
    figures: dict[str, Any] = {"texels": int(missing.sum()), "found": counts.found, "restored": counts.restored}
    filled = fill_with_lagrange(mesh, corner_uvs, texture, known)
    if filled.colors is None:
        figures["lagrange"] = filled.error
    else:
        results["lagrange"] = (filled.colors, filled.seconds)
    crops = find_crops(missing)
    for name, (image, seconds) in results.items():
        composed = np.where(missing[..., None], image, texture)
        errors = mean_flip([(texture[crop], composed[crop]) for crop in crops])
        figures[name] = {"seconds": round(seconds, 2), "flip": None if errors is None else round(float(np.mean(errors)), 4)}
    if sheet is not None:
        sheet.parent.mkdir(parents=True, exist_ok=True)
        images = [np.where(missing[..., None], np.float32(0.0), texture), texture, *(image for image, _ in results.values())]
        write_png(sheet, np.concatenate([cut_windows(image, crops) for image in images], axis=1))
    return figures


def cut_windows(image: np.ndarray, crops: list[tuple[slice, slice]]) -> np.ndarray:
    """Return windows (ROWS * WINDOW, WINDOW, 3) of an image around some of `crops`, one above the other."""
    windows = []
    for crop in crops[:ROWS]:
        starts = [min(max((side.start + side.stop - WINDOW) // 2, 0), len(image) - WINDOW) for side in crop]
        windows.append(image[starts[0] : starts[0] + WINDOW, starts[1] : starts[1] + WINDOW])
    return np.concatenate(windows)


def interpolate(unwrapped: Unwrapped, texel_map: TexelMap, texture: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the texture with colors of vertices, interpolated over the surface, where it is not known."""
    mesh, corner_uvs = unwrapped
    size = len(texture)
    positions = np.clip(np.floor(corner_uvs * size).astype(int), 0, size - 1).reshape(-1, 2)
    flat, vertices = positions[:, 1] * size + positions[:, 0], mesh.triangles.ravel()
    own = known.ravel()[flat]
    counts = np.bincount(vertices[own], minlength=len(mesh.vertices))
    colors = np.stack([np.bincount(vertices[own], texture[..., c].ravel()[flat[own]], len(mesh.vertices)) for c in range(3)], axis=1)
    colors, _ = interpolate_colors(colors / np.maximum(counts, 1)[:, None], counts > 0, find_edges(mesh.triangles, len(mesh.vertices)))
    result = np.where(known[..., None], texture, np.float32(0.0)).reshape(-1, 3).astype(np.float32)
    interpolate_holes(texel_map, result, known.ravel(), order_by_corner(colors[mesh.triangles]))
    return np.clip(result, 0.0, 1.0).reshape(texture.shape)


def find_crops(missing: np.ndarray) -> list[tuple[slice, slice]]:
    """Return the boxes around the connected parts of `missing`, except for specks."""
    parts, _ = ndimage.label(missing, np.ones((3, 3)))
    sizes = np.bincount(parts.ravel())
    boxes = [box for index, box in enumerate(ndimage.find_objects(parts)) if sizes[index + 1] >= CROP**2]
    return [tuple(slice(max(side.start - CROP, 0), side.stop + CROP) for side in box) for box in boxes]
