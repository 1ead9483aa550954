"""Vertices at equal measured error, for `bench_bdam.py`: simplifiers alone, uniform cuts and view-dependent cuts."""

from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from bdam_methods import Field, Triangulation, interpolate_vertices, open_field_for_methods
from bdam_stores import Workplace, build_cut_mesh, build_store
from bdam_terrains import CELL_SIZE, HEIGHT_STEP, FractalTerrain, create_cliffs, read_real
from bdam_views import draw_viewer, nearest_visible

from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view.caches import PatchCache
from farfield.addon.core.bdam.view.cut_meshes import CutMesh
from farfield.addon.core.bdam.view.extraction import CutSettings, extract_cut, extract_uniform_cut

ANCHORS = (8, 32, 128, 512)  # samples per vertex of Farfield's meshes whose errors the others must reach
FRACTAL_DEGREES = (0.75, 0.85, 0.95)  # roughness of the fractals that judge; the first ones are rougher
REAL_CELL = 90.0  # meters, of three arc seconds; only scales the gradients for quadrics
CLIFF_ERRORS = (5.0, 10.0, 20.0, 50.0)  # meters
UNIFORM_ERRORS = (1.0, 2.0, 4.0, 8.0, 16.0)  # meters
VIEWS = 5
BOUNDS = {"alone": 1.15, "cliffs_pydelatin": 1.8, "cliffs_pymartini": 1.0, "uniform_pydelatin": 1.8, "uniform_pymartini": 0.9, "view": 0.5}


def measure_simplifiers(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Compare quadric collapses (A), half-edge collapses on a whole field and by diamonds (B), greedy insertion (C), and right-triangulated
    meshes: vertices at equal measured error, and seconds."""
    figures: dict[str, Any] = {}
    size = min(given.size, 2049)
    for name, heights, step, cell in list_fields(given, size):
        with open_field_for_methods(heights, step, cell, given.peers_python) as field:
            figures[name] = {"samples": heights.size, "errors": compare_simplifiers(field, build_store(workplace, name, heights, cell))}
    return figures


def compare_simplifiers(field: Field, store: TerrainStore) -> list[dict[str, Any]]:
    """Return the figures of all methods at each error of the half-edge collapses."""
    halved, quadrics = list(field.halve()), list(field.with_quadrics())
    rows = []
    with store:
        cache = PatchCache(store)
        for mesh in select_anchors(halved, field.steps.size):
            greedy = field.with_pydelatin(mesh.error)
            needed = interpolate_vertices(quadrics, mesh.error)
            row: dict[str, Any] = {
                "error": round(mesh.error, 3),
                "A, quadric collapses": {"vertices": needed and round(needed)} | describe_cost(quadrics, mesh.error),
                "B, half-edge collapses, whole field": mesh.to_json(),
                "B, by diamonds, uniform cut": match_uniform_cut(field, cache, store, mesh.error).to_json(),
                "C, greedy insertion (pydelatin)": greedy.to_json(),
            }
            if is_power_of_two(len(field.steps) - 1) and field.steps.shape[0] == field.steps.shape[1]:
                row["right-triangulated (pymartini)"] = field.with_pymartini(mesh.error).to_json()
            rows.append(row)
    return rows


def select_anchors(meshes: list[Triangulation], samples: int) -> Iterator[Triangulation]:
    """Yield the meshes with about as many vertices as ANCHORS say."""
    for samples_per_vertex in ANCHORS:
        mesh = min(meshes, key=lambda each: abs(np.log(each.vertices * samples_per_vertex / samples)))
        if mesh.error > 0.0:
            yield mesh


def describe_cost(meshes: list[Triangulation], error: float) -> dict[str, float]:
    """Return the seconds of the mesh with the largest error up to `error`, and the triangles that point downwards in it."""
    finer = [mesh for mesh in meshes if mesh.error <= error]
    return {} if not finer else {"cpu_seconds": round(finer[-1].cpu_seconds, 2), "flipped": finer[-1].flipped}


def match_uniform_cut(field: Field, cache: PatchCache, store: TerrainStore, error: float) -> Triangulation:
    """Return the uniform cut for an error, measured again as a whole. It has no seconds: those of the build are measured there."""
    return measure_cut(field, build_cut_mesh(cache, extract_uniform_cut(store, error)))


def measure_cut(field: Field, mesh: CutMesh) -> Triangulation:
    """Measure a cut like any other mesh."""
    columns = field.steps.shape[1]
    return field.measure(np.stack([mesh.ids % columns, mesh.ids // columns], axis=1), mesh.triangles, seconds=0.0, cpu_seconds=0.0)


def measure_simplifier_alone(given: Namespace, _: Workplace) -> dict[str, Any]:
    """Compare half-edge collapses on a whole field with pydelatin at the same measured error."""
    figures: dict[str, Any] = {"bound": BOUNDS["alone"]}
    for name, heights, step, cell in list_fields(given, min(given.size, 1025)):
        with open_field_for_methods(heights, step, cell, given.peers_python) as field:
            rows = []
            for mesh in select_anchors(list(field.halve()), field.steps.size):
                peer = field.with_pydelatin(mesh.error)
                rows.append({"farfield": mesh.to_json(), "pydelatin": peer.to_json(), "ratio": round(mesh.vertices / peer.vertices, 3)})
            figures[name] = rows
    return figures | worst(figures, "ratio", BOUNDS["alone"])


def measure_uniform_cut(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Compare cuts of one error everywhere with pydelatin and pymartini at the error that is measured in the cut."""
    figures: dict[str, Any] = {"bounds": [BOUNDS["uniform_pydelatin"], BOUNDS["uniform_pymartini"]]}
    for name, heights, step, cell in list_fields(given, min(given.size, 2049)):
        with (
            open_field_for_methods(heights, step, cell, given.peers_python) as field,
            build_store(workplace, name, heights, cell) as store,
        ):
            cache, rows = PatchCache(store), []
            for error in UNIFORM_ERRORS:
                cut = match_uniform_cut(field, cache, store, error)
                if not cut.error > 0.0 or cut.vertices > 0.5 * heights.size:
                    continue
                peer = field.with_pydelatin(cut.error)
                row = {"tolerance": error, "farfield": cut.to_json(), "pydelatin": peer.to_json()}
                row["over_pydelatin"] = round(cut.vertices / peer.vertices, 3)
                if is_square_for_pymartini(heights):
                    other = field.with_pymartini(cut.error)
                    row |= {"pymartini": other.to_json(), "over_pymartini": round(cut.vertices / other.vertices, 3)}
                rows.append(row)
            figures[name] = rows
    return (
        figures
        | worst(figures, "over_pydelatin", BOUNDS["uniform_pydelatin"])
        | worst(figures, "over_pymartini", BOUNDS["uniform_pymartini"])
    )


def measure_cliffs(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Compare cuts of one error everywhere with pydelatin and pymartini for the same error, on ground with an escarpment and a mesa."""
    size = min(given.size, 2049)
    heights = create_cliffs(size, given.seed)
    with (
        open_field_for_methods(heights, HEIGHT_STEP, CELL_SIZE, given.peers_python) as field,
        build_store(workplace, f"cliffs-{size}", heights, CELL_SIZE) as store,
    ):
        cache, rows = PatchCache(store), []
        for error in CLIFF_ERRORS:
            cut, greedy, right = match_uniform_cut(field, cache, store, error), field.with_pydelatin(error), field.with_pymartini(error)
            ratios = {
                "cliffs_pydelatin": round(cut.triangles / greedy.triangles, 2),
                "cliffs_pymartini": round(cut.triangles / right.triangles, 2),
            }
            rows.append(
                {"tolerance": error, "farfield": cut.to_json(), "pydelatin": greedy.to_json(), "pymartini": right.to_json()} | ratios
            )
    figures: dict[str, Any] = {"errors": rows}
    return (
        figures
        | worst(figures, "cliffs_pydelatin", BOUNDS["cliffs_pydelatin"])
        | worst(figures, "cliffs_pymartini", BOUNDS["cliffs_pymartini"])
    )


def measure_view_cut(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Compare view-dependent cuts at one pixel with the pymartini mesh whose measured error is one pixel at its nearest visible point.

    Both cover the whole field: nothing outside of the view is coarser.
    """
    figures: dict[str, Any] = {"bound": BOUNDS["view"]}
    size = min(given.size, 2049)
    random = np.random.default_rng([given.seed, 30])
    heights = FractalTerrain(size, given.seed).read_all()
    with (
        open_field_for_methods(heights, HEIGHT_STEP, CELL_SIZE, given.peers_python) as field,
        build_store(workplace, f"fractal-{size}", heights, CELL_SIZE) as store,
    ):
        cache, rows = PatchCache(store), []
        for _ in range(VIEWS):
            viewer = draw_viewer(random, store, heights)
            mesh = build_cut_mesh(cache, extract_cut(store, viewer, CutSettings()))
            culled = build_cut_mesh(cache, extract_cut(store, viewer, CutSettings(culls=True)))
            error = nearest_visible(viewer, store, heights)
            peer = field.with_pymartini(max(error, HEIGHT_STEP))
            rows.append(
                {
                    "error_at_nearest": round(error, 3),
                    "farfield": {
                        "vertices": len(mesh.positions),
                        "triangles": len(mesh.triangles),
                        "vertices_if_culled": len(culled.positions),
                    },
                    "pymartini": peer.to_json(),
                    "ratio": round(len(mesh.positions) / peer.vertices, 3),
                }
            )
        figures["views"] = rows
    return figures | worst(figures, "ratio", BOUNDS["view"])


def list_fields(given: Namespace, size: int) -> Iterator[tuple[str, np.ndarray, float, float]]:
    """Yield the name, heights (H, W), step and cell size in meters of fields.

    They are fractals that the seed of this run makes, and parts of real elevation models. With --set tuning, they are a fixed fractal and
    N46E008; settings may be tuned on those.
    """
    if given.set == "tuning":
        yield f"fractal-tuning-{size}", FractalTerrain(size, 1).read_all(), HEIGHT_STEP, CELL_SIZE
        names: tuple[str, ...] = ("N46E008",)
    else:
        for index, hurst in enumerate(FRACTAL_DEGREES):
            yield f"fractal-{hurst}-{size}", FractalTerrain(size, given.seed + index, hurst).read_all(), HEIGHT_STEP, CELL_SIZE
        names = ("N46E008", "N49W123", "N49W124")
    for name in names:
        path = Path(given.data) / f"{name}.tif"
        if path.is_file():
            heights, step = read_real(path)
            side = min(size, *heights.shape)
            side = (1 << int(np.log2(side - 1))) + 1  # pymartini needs it
            row, column = ((count - side) // 2 for count in heights.shape)
            yield f"{name}-{side}", np.ascontiguousarray(heights[row : row + side, column : column + side]), step, REAL_CELL


def is_power_of_two(number: int) -> bool:
    """Return whether a positive number is a power of two."""
    return number & (number - 1) == 0


def is_square_for_pymartini(heights: np.ndarray) -> bool:
    """Return whether pymartini can triangulate a field."""
    return heights.shape[0] == heights.shape[1] and is_power_of_two(len(heights) - 1)


def worst(figures: dict[str, Any], name: str, bound: float) -> dict[str, Any]:
    """Return the largest of the ratios called `name` in all rows, and whether it is within the bound."""
    ratios = [row[name] for rows in figures.values() if isinstance(rows, list) for row in rows if isinstance(row, dict) and name in row]
    return {f"largest_{name}": max(ratios), f"{name}_is_met": max(ratios) <= bound} if ratios else {}
