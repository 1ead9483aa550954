"""Vertical errors of a grid of degrees in the local frame, for `bench_bdam.py`.

A store bounds errors in the grid and adds a bound of how far the projection curves triangles (`build/curvature_errors.py`). Here they are
measured where they count: between the triangles of a cut, straight in the local frame, and the projected samples.
"""

from argparse import Namespace
from typing import Any

import numpy as np
from bdam_stores import Workplace, build_cut_mesh, build_from

from farfield.addon.core.bdam.fields.terrain_field import FieldSettings, open_field
from farfield.addon.core.bdam.ground.heights import HeightQuery
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view.caches import PatchCache
from farfield.addon.core.bdam.view.extraction import extract_uniform_cut
from farfield.addon.core.geometry.surfaces import MeshSurface, find_ground
from farfield.addon.core.jobs.progress import run_to_end

FILE = "N46E008.tif"
MAX_ERRORS = (2.0, 20.0)  # meters, of cuts
LIMIT_SLACK = 1e-6  # meters, of rounding


def measure_geographic(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Measure the largest vertical distance in the local frame between uniform cuts of N46E008 and all known samples."""
    source, folder = given.data / FILE, workplace.folder / "geographic"
    if not source.is_file():
        return {"skipped": f"{source} does not exist"}
    if not folder.exists():
        build_from(workplace, source, folder, 1.0)
    field = open_field([source], FieldSettings())
    heights = field.read(slice(0, field.shape[0]), slice(0, field.shape[1])).astype(np.float64)
    y, x = np.nonzero(np.isfinite(heights))
    points, known = np.stack(field.frame.to_local(x, y), axis=1), heights[y, x]
    figures: dict[str, Any] = {"file": FILE, "samples": len(known), "cuts": {}}
    with TerrainStore(folder) as store:
        cache = PatchCache(store)
        for max_error in MAX_ERRORS:
            cut = extract_uniform_cut(store, max_error)
            mesh = build_cut_mesh(cache, cut)
            shown, _ = run_to_end(find_ground(MeshSurface([(mesh.positions, mesh.triangles)]), points))
            outside = np.flatnonzero(np.isnan(shown))  # Outside the straight border of the mesh, the planes of the triangles there count.
            shown[outside] = HeightQuery(store, cut).find(points[outside])[0]
            distances = np.abs(shown - known)
            figures["cuts"][str(max_error)] = {
                "triangles": len(mesh.triangles),
                "largest_m": round(float(np.nanmax(distances)), 4),
                "above": int((distances > max_error + LIMIT_SLACK).sum()),
                "beside_border": len(outside),
                "without_triangle": int(np.isnan(shown).sum()),
                "largest_error_of_patches_m": round(cut.max_error, 4),
            }
    return figures
