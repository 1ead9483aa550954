"""Other methods that Unwrap is compared with: Blender's Minimum Stretch, SLIM of libigl, and xatlas; and the figures of all maps."""

import time
from dataclasses import asdict, replace
from typing import Any

import bpy
import numpy as np

from farfield.addon.bridge.geometry.mesh_arrays import read_uvs
from farfield.addon.bridge.unwrap import uv_maps
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.cutting.boundaries import boundary_loops, fill_holes
from farfield.addon.core.unwrap.cutting.chart import Chart
from farfield.addon.core.unwrap.cutting.charts import cut_into_charts
from farfield.addon.core.unwrap.distortion import DistortionMetrics, compute_stretches, measure_distortion
from farfield.addon.core.unwrap.parameterization.parameterize import Balance, Boundary, parameterize
from farfield.addon.core.unwrap.parameterization.tutte import circle_outline, tutte_embedding

SLIM_ITERATIONS = 10  # Between two tests for convergence.
SLIM_TOLERANCE = 3e-5  # Relative decrease of symmetric Dirichlet energy per test below which SLIM has converged.


def measure_blender(item: bpy.types.Object, target: uv_maps.UvTarget, repeats: int) -> dict[str, Any]:
    """Measure the UV map of Blender's Minimum Stretch."""
    bpy.context.view_layer.objects.active = item
    item.select_set(True)
    layer = item.data.uv_layers.get("Blender") or item.data.uv_layers.new(name="Blender")
    item.data.uv_layers.active = layer
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    seconds = np.inf
    for _ in range(repeats):
        started = time.process_time()
        bpy.ops.uv.unwrap(method="MINIMUM_STRETCH", margin=0.0, fill_holes=False, correct_aspect=False)
        seconds = min(seconds, time.process_time() - started)
    bpy.ops.object.mode_set(mode="OBJECT")
    uvs = read_uvs(item.data.uv_layers["Blender"])
    return summarize(compute_metrics(target.mesh, uvs[target.loops].astype(np.float64)), seconds)


def measure_xatlas(mesh: TriangleMesh, repeats: int) -> dict[str, Any]:
    """Measure the UV map of xatlas, which chooses the number of UV islands."""
    import xatlas

    seconds = np.inf
    for _ in range(repeats):
        started = time.process_time()
        atlas = xatlas.Atlas()
        atlas.add_mesh(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
        atlas.generate()
        seconds = min(seconds, time.process_time() - started)
    _, triangles, uvs = atlas.get_mesh(0)
    corner_uvs = uvs[triangles].astype(np.float64) * [atlas.width, atlas.height] / max(atlas.width, atlas.height)
    return {**summarize(compute_metrics(mesh, corner_uvs), seconds), "islands": atlas.chart_count}


def compute_metrics(mesh: TriangleMesh, corner_uvs: np.ndarray) -> DistortionMetrics:
    """Return the metrics of a UV map `corner_uvs` (T, 3, 2) with uniform importance."""
    stretches = run_to_end(compute_stretches(mesh, corner_uvs))
    return run_to_end(measure_distortion(mesh, corner_uvs, stretches, np.zeros(len(corner_uvs))))


def summarize(metrics: DistortionMetrics, seconds: float) -> dict[str, Any]:
    """Return rounded metrics; None for the infinite stretch of collapsed triangles."""
    values = {name: value for name, value in asdict(metrics).items() if name != "densities"}
    return {**{name: round(value, 4) if np.isfinite(value) else None for name, value in values.items()}, "seconds": round(seconds, 2)}


def measure_slim(mesh: TriangleMesh) -> dict[str, Any] | None:
    """Measure the converged map of SLIM (libigl) of a disk; None where the package `igl` is not installed.

    Handles, as between fingers that touch, are cut like for Farfield. It starts from the same Tutte embedding, or from Farfield's own map
    where that embedding fails. Its map may overlap itself.
    """
    try:
        import igl
    except ImportError:
        return None
    surface = Chart(mesh.vertices, mesh.triangles, np.ones(len(mesh.triangles)))
    [cut] = run_to_end(cut_into_charts(surface, np.zeros((0, 2), int), further_cuts=False))
    mesh = TriangleMesh(cut.chart.vertices, cut.chart.triangles)
    areas, _ = face_areas_and_normals(mesh.corners)
    vertices = (mesh.vertices - mesh.vertices[0]) / np.sqrt(areas.sum())
    loop, *holes = boundary_loops(mesh.triangles, vertices)
    lengths = np.linalg.norm(np.roll(vertices[loop], -1, axis=0) - vertices[loop], axis=1)
    started = time.process_time()
    uv = tutte_embedding(*fill_holes(vertices, mesh.triangles, holes), loop, circle_outline(lengths)) if holes else None
    uv = tutte_embedding(vertices, mesh.triangles, loop, circle_outline(lengths)) if uv is None else uv[: len(vertices)]
    if uv is None:
        uv = run_to_end(parameterize(replace(cut.chart, vertices=vertices), Boundary.FREE, 0.0, Balance.SYMMETRIC))
    data = igl.slim_precompute(
        np.asfortranarray(vertices),
        np.asfortranarray(mesh.triangles, np.int32),
        np.asfortranarray(uv),
        igl.MappingEnergyType.SYMMETRIC_DIRICHLET,
        np.zeros(0, np.int32),
        np.zeros((0, 2), order="F"),
        0.0,
    )
    energy, previous = np.finfo(float).max, np.inf
    while energy < (1.0 - SLIM_TOLERANCE) * previous:
        previous = energy
        uv = np.asarray(igl.slim_solve(data, SLIM_ITERATIONS))[:, :2]
        seconds = time.process_time() - started
        metrics = compute_metrics(mesh, uv[mesh.triangles])
        energy = metrics.symmetric_dirichlet
    return summarize(metrics, seconds)
