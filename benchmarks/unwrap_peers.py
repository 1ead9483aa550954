"""Other methods that Unwrap is compared with: Minimum Stretch and Smart UV Project of Blender, SLIM of libigl, and xatlas."""

import time
from dataclasses import asdict, replace
from typing import Any

import bpy
import numpy as np

from farfield.addon.bridge.geometry.mesh_arrays import read_uvs
from farfield.addon.bridge.unwrap import uv_maps
from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals, longest_side
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.cutting.boundaries import boundary_loops, fill_holes
from farfield.addon.core.unwrap.cutting.chart import Chart
from farfield.addon.core.unwrap.cutting.charts import cut_into_charts
from farfield.addon.core.unwrap.distortion import DistortionMetrics, compute_stretches, measure_distortion
from farfield.addon.core.unwrap.parameterization.parameterize import Balance, Boundary, parameterize
from farfield.addon.core.unwrap.parameterization.tutte import circle_outline, tutte_embedding

XATLAS_SIDE = 1024  # Texels per side of the square that xatlas chooses, approximately.
SLIM_ITERATIONS = 10  # Between two tests for convergence.
SLIM_TOLERANCE = 3e-5  # Relative decrease of symmetric Dirichlet energy per test below which SLIM has converged.


def measure_blender(item: bpy.types.Object, target: uv_maps.UvTarget, repeats: int) -> dict[str, Any]:
    """Measure the UV map of Blender's Minimum Stretch."""
    edit_alone(item, "Blender")
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
    seconds = np.inf
    for _ in range(repeats):
        started = time.process_time()
        corner_uvs, island_count = unwrap_with_xatlas(mesh)
        seconds = min(seconds, time.process_time() - started)
    return {**summarize(compute_metrics(mesh, corner_uvs), seconds), "islands": island_count}


def unwrap_with_xatlas(mesh: TriangleMesh, margin: float = 0.0) -> tuple[np.ndarray, int]:
    """Return the corner UVs (T, 3, 2) of xatlas and the number of its UV islands. margin: relative to the side of the square."""
    import xatlas

    options = xatlas.PackOptions()
    options.padding = round(margin * XATLAS_SIDE)
    atlas = xatlas.Atlas()
    atlas.add_mesh(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
    atlas.generate(pack_options=options)
    _, triangles, uvs = atlas.get_mesh(0)
    return uvs[triangles].astype(np.float64) * [atlas.width, atlas.height] / max(atlas.width, atlas.height), atlas.chart_count


def unwrap_with_smart_project(item: bpy.types.Object, loops: np.ndarray, margin: float) -> np.ndarray:
    """Return the corner UVs (T, 3, 2) of Blender's Smart UV Project with its default angle. loops: (T, 3)."""
    edit_alone(item, "Smart")
    bpy.ops.uv.smart_project(island_margin=margin, margin_method="FRACTION")
    bpy.ops.object.mode_set(mode="OBJECT")
    return read_uvs(item.data.uv_layers["Smart"])[loops].astype(np.float64)


def edit_alone(item: bpy.types.Object, uv_map: str) -> None:
    """Enter Edit Mode with all faces of an object selected and the map `uv_map` active."""
    for other in bpy.context.selected_objects:
        other.select_set(False)
    bpy.context.view_layer.objects.active = item
    item.select_set(True)
    item.data.uv_layers.active = item.data.uv_layers.get(uv_map) or item.data.uv_layers.new(name=uv_map)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")


def compute_seam_length(mesh: TriangleMesh, corner_uvs: np.ndarray) -> float:
    """Return the length of all edges where a UV map is cut, without boundaries of the surface, over the square root of its area.

    Vertices at the same position count as one.
    """
    side = longest_side(mesh.vertices)
    _, welded = np.unique(np.round((mesh.vertices - mesh.vertices.min(axis=0)) / side * 1e6), axis=0, return_inverse=True)
    triangles = welded.reshape(-1)[mesh.triangles]
    halfedges = find_edges(triangles).interior_halfedges
    (first, second), corners = (halfedges // 3).T, halfedges % 3
    starts, ends = ((corners[:, 0] + 1) % 3, (corners[:, 0] + 2) % 3), ((corners[:, 1] + 1) % 3, (corners[:, 1] + 2) % 3)
    is_parallel = triangles[first, starts[0]] == triangles[second, ends[0]]
    is_cut = np.zeros(len(halfedges), bool)
    for index in range(2):
        other = np.where(is_parallel, ends[index], ends[1 - index])
        is_cut |= np.abs(corner_uvs[first, starts[index]] - corner_uvs[second, other]).max(axis=1) > 1e-5
    lengths = np.linalg.norm(mesh.corners[first, starts[0]] - mesh.corners[first, starts[1]], axis=1)
    return float(lengths[is_cut].sum() / np.sqrt(face_areas_and_normals(mesh.corners)[0].sum()))


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
