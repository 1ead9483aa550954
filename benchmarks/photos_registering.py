"""Cameras registered by pairs of points with noise, for `bench_photos.py`."""

from typing import Any, NamedTuple

import numpy as np

from farfield.addon.core.geometry.lenses import Lens, PhotoCamera
from farfield.addon.core.photos.registration.registration import register

SIZE = (1600, 1200)
CASES = 40
NOISE = 1.0  # pixels, standard deviation per coordinate
CHECKED = 200  # other points that are projected
PAIR_COUNTS = ((6, False), (8, False), (12, False), (4, True), (6, True))  # and whether the lens is known
WRONG_COUNTS = ((7, False), (8, False), (10, False), (6, True))
WRONG_PIXELS = (60.0, 300.0)


class PointScene(NamedTuple):
    """Points (N, 3), their true positions (N, 2) in pixels, and the camera."""

    points: np.ndarray
    positions: np.ndarray
    camera: PhotoCamera


def make_scene(count: int, random: np.random.Generator) -> PointScene:
    """Return random points in a cube, seen by a camera with a random focal length, distortion and rotation."""
    focal = random.uniform(0.6, 2.0) * SIZE[0]
    points = random.uniform(-1.0, 1.0, (count, 3))
    rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    lens = Lens("SIMPLE_RADIAL", SIZE, (focal, focal), (0.5 * SIZE[0], 0.5 * SIZE[1]), (0.05 * random.normal(),))
    camera = PhotoCamera("photograph", lens, rotation, np.array([0.0, 0.0, 2.8 * 1.2 * focal / SIZE[1]]))
    return PointScene(points, camera.project(points)[0], camera)


def measure_registering(random: np.random.Generator) -> dict[str, Any]:
    """Return the distances in pixels by which other points are projected wrongly, and how often a wrong pair, and no other, was found."""
    figures: dict[str, Any] = {"noise": [], "wrong_pair": []}
    for count, has_lens in PAIR_COUNTS:
        errors = []
        for _ in range(CASES):
            scene = make_scene(count + CHECKED, random)
            found = register("photograph", scene.points[:count], _add_noise(scene, count, random), SIZE, _lens(scene, has_lens)).camera
            errors.append(np.linalg.norm(found.project(scene.points[count:])[0] - scene.positions[count:], axis=1).mean())
        row = {"pairs": count, "lens": has_lens, "cases": CASES}
        figures["noise"].append(
            row | {name: round(float(of(errors)), 2) for name, of in (("mean", np.mean), ("median", np.median), ("max", np.max))}
        )
    for count, has_lens in WRONG_COUNTS:
        flagged = 0
        for _ in range(CASES):
            scene = make_scene(count, random)
            positions, wrong, angle = _add_noise(scene, count, random), int(random.integers(count)), random.uniform(0.0, 2.0 * np.pi)
            positions[wrong] += random.uniform(*WRONG_PIXELS) * np.array([np.cos(angle), np.sin(angle)])
            is_wrong = register("photograph", scene.points, positions, SIZE, _lens(scene, has_lens)).is_wrong
            flagged += bool(is_wrong[wrong] and is_wrong.sum() == 1)
        figures["wrong_pair"].append({"pairs": count, "lens": has_lens, "cases": CASES, "flagged": flagged})
    return figures


def _add_noise(scene: PointScene, count: int, random: np.random.Generator) -> np.ndarray:
    return scene.positions[:count] + NOISE * random.normal(size=(count, 2))


def _lens(scene: PointScene, has_lens: bool) -> Lens | None:
    return scene.camera.lens if has_lens else None
