"""Cameras registered by pairs of points with noise and then refined against other photographs, and merges of photographs with wrong poses,
for `bench_photos.py`."""

from dataclasses import replace
from typing import Any

import numpy as np
from photos_inputs import unwrap_mesh
from photos_models import Shoot, make_knot, make_paint, make_rock, photograph_model
from photos_scores import find_truth, score_truth

from farfield.addon.core.files.scratch import Scratch
from farfield.addon.core.geometry.lenses import PhotoCamera
from farfield.addon.core.geometry.mesh import TriangleMesh, vertex_normals
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.photos.merging import merge
from farfield.addon.core.photos.photographs.views import View
from farfield.addon.core.photos.registration.refinement import refine
from farfield.addon.core.photos.registration.registration import register
from farfield.addon.core.photos.settings import PhotosSettings

MODELS = {"rock": make_rock, "knot": make_knot}
SHOOTS = 3  # Shoots per model.
CAMERAS = 4  # Cameras per shoot that are registered and refined, one at a time.
PAIRS, NOISE = 6, 1.0  # pixels, standard deviation per coordinate
OTHERS_NOISE = 0.3  # pixels, mean error of the other cameras
POSE_NOISES = (0.0, 0.3, 2.0, 4.0)  # pixels, mean errors of all cameras that are not refined


def measure_refining(random: np.random.Generator) -> dict[str, Any]:
    """Return for each model the mean errors in pixels of visible vertices after registration with six pairs, and after refinement."""
    figures: dict[str, Any] = {}
    for name, make in MODELS.items():
        rows = []
        for _ in range(SHOOTS):
            mesh = make(random)
            shoot = photograph_model(mesh, make_paint(mesh.vertices, random), random, pose_noise=OTHERS_NOISE)
            rows += [_refine_one(mesh, shoot, int(index), random) for index in random.permutation(len(shoot.photographs))[:CAMERAS]]
        figures[name] = _summarize(rows)
    return figures


def measure_alignment(seed: int, size: int) -> dict[str, Any]:
    """Return the PSNR of textures against the truth, without and with alignment, by the mean error in pixels of the poses."""
    figures: dict[str, Any] = {}
    for name, make in MODELS.items():
        for pose_noise in POSE_NOISES:
            random = np.random.default_rng([seed, 700, round(10 * pose_noise)])
            unwrapped = unwrap_mesh(make(random))
            paint = make_paint(unwrapped.mesh.vertices, random)
            shoot = photograph_model(unwrapped.mesh, paint, random, pose_noise=pose_noise)
            truth = find_truth(*unwrapped, size, paint, shoot.true_cameras)
            scores = [
                score_truth(run_to_end(merge(*unwrapped, shoot.photographs, PhotosSettings(size=size, alignment=on))).colors, truth)
                for on in (False, True)
            ]
            figures[f"{name}, {pose_noise} pixels"] = {"without": scores[0], "with": scores[1]}
    return figures


def _refine_one(mesh: TriangleMesh, shoot: Shoot, index: int, random: np.random.Generator) -> dict[str, Any]:
    """Register the camera of a photograph, refine it, and return its errors."""
    truth = shoot.true_cameras[index]
    visible = mesh.vertices[View(truth, mesh).see(mesh.vertices, vertex_normals(mesh.vertices, mesh.triangles)).indices]
    points = visible[random.choice(len(visible), PAIRS, replace=False)]
    positions = truth.project(points)[0] + NOISE * random.normal(size=(PAIRS, 2))
    registered = register(truth.name, points, positions, truth.lens.size).camera
    photographs = list(shoot.photographs)
    photographs[index] = replace(photographs[index], camera=registered)
    with Scratch() as scratch:
        [found] = run_to_end(refine(mesh, photographs, [index], scratch, has_free_lens=[True]))
    return {
        "registered": _error(registered, truth, visible),
        "refined": _error(found.camera, truth, visible),
        "measured_before": found.before,
        "measured_after": found.after,
        "is_refused": bool(found.problem),
    }


def _error(camera: PhotoCamera, truth: PhotoCamera, points: np.ndarray) -> float:
    return float(np.linalg.norm(camera.project(points)[0] - truth.project(points)[0], axis=1).mean())


def _summarize(rows: list[dict[str, Any]]) -> dict[str, Any]:
    summary: dict[str, Any] = {"cameras": len(rows), "refused": sum(row["is_refused"] for row in rows)}
    for key in ("registered", "refined", "measured_before", "measured_after"):
        values = [row[key] for row in rows]
        summary[key] = {name: round(float(of(values)), 3) for name, of in (("mean", np.mean), ("median", np.median), ("max", np.max))}
    return summary | {"each": [[round(row["registered"], 3), round(row["refined"], 3)] for row in rows]}
