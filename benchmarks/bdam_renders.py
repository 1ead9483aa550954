"""Pictures of a full grid and of a view-dependent cut in Cycles, for `bench_bdam.py`."""

import tempfile
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bdam_builds import measure_process
from bdam_stores import Workplace, build_fractal
from bdam_terrains import FractalTerrain
from bdam_views import FIELD_OF_VIEW, SIZE, fly_over

from farfield.addon.bridge.bdam.objects import TerrainChange, create_root
from farfield.addon.bridge.rendering.render_scene import RenderScene, prepare_cycles, render_scene
from farfield.addon.core.bdam.settings import ViewSettings
from farfield.addon.core.bdam.store.terrain_store import TerrainStore
from farfield.addon.core.bdam.view.engine import BdamEngine
from farfield.addon.core.geometry.viewers import Viewer
from farfield.addon.core.imaging.colors import encode_signed_srgb
from farfield.addon.core.jobs.progress import run_to_end
from lib.flip_metric import mean_flip

MAX_SIZE = 4097  # a full grid of more samples does not fit into the memory of small machines
SAMPLES = 32
FRAME = 100  # This frame of the fly-over is rendered.
SUN_DIRECTION, SUN_STRENGTH, SKY = (0.5, -0.4, 0.5), 2.0, 0.3
FLIP_BOUND = 0.02
TOLERANCES = (3.0, 2.0, 1.0, 0.5)  # pixels
COSTS = ("seconds", "mesh_seconds", "render_seconds", "cpu_seconds", "peak_memory_above_imports_mb")


def measure_full_grid(given: Namespace, workplace: Workplace) -> dict[str, Any]:
    """Compare a full grid with cuts as the extension shows them, with their normal maps and without: seconds and memory of processes that
    make the meshes and render them, and FLIP of the pictures. All have the material of the terrain, colored by height.

    The noise of the renders alone makes a difference, which is that of two pictures of the full grid.
    """
    size = min(given.size, MAX_SIZE)
    build_fractal(workplace, FractalTerrain(size, given.seed)).close()
    figures: dict[str, Any] = {"size": size, "samples_per_pixel": SAMPLES, "flip_bound": FLIP_BOUND}
    pictures = []
    with tempfile.TemporaryDirectory(prefix="farfield-benchmark-") as folder:
        out = Path(folder) / "picture.npy"
        cuts = [(f"cut_{each:g}{'' if has_maps else '_plain'}", each, 0, has_maps) for has_maps in (True, False) for each in TOLERANCES]
        for name, tolerance, render_seed, has_maps in [("full", 0.0, 0, False), ("full_again", 0.0, 1, False), *cuts]:
            flags = ["--tolerance", str(tolerance), "--out", str(out), "--size", str(size), "--seed", str(given.seed)]
            command = ["render", str(workplace.folder / f"fractal-{size}"), *flags, "--render-seed", str(render_seed)]
            command += ["--normal-maps"] if has_maps else []
            figures[name] = measure_process(command)
            pictures.append(np.load(out, allow_pickle=False))
            if tolerance:
                for cost in COSTS:
                    figures[name][f"{cost}_full_over_cut"] = round(figures["full"][cost] / figures[name][cost], 2)
    flips = mean_flip([(pictures[0], picture) for picture in pictures[1:]])
    if flips is None:
        return figures | {"flip": "skipped: the reference tools are not installed"}
    for name, flip in zip([name for name in figures if name.startswith(("full_", "cut_"))], flips, strict=True):
        figures[name]["flip"] = round(flip, 4)
    return figures


def render_view(
    store_folder: Path, out: Path, tolerance: float, terrain: FractalTerrain, render_seed: int, has_maps: bool
) -> dict[str, Any]:
    """Render one frame of the fly-over of a terrain, and write the picture (H, W, 3) float32, sRGB from 0 to 1.

    tolerance: pixels, of the cut that is rendered; 0 for all samples with the smooth normals of Blender. has_maps: whether the normal maps
    of the store are used.
    """
    settings = ViewSettings(tolerance=tolerance or 1.0, shading="height", triangle_budget=0, culling=False)
    engine = BdamEngine(store_folder, settings)
    store = engine.store
    if not has_maps:
        store.normals = None
    with render_scene("Farfield Terrain") as work:
        viewer = list(fly_over(terrain, store))[FRAME]
        started = time.perf_counter()
        root = create_root(work.scene, str(store_folder), engine)
        if tolerance == 0.0:
            data = work.own(bpy.data.meshes.new("Terrain"))
            fill_with_grid(data, terrain, store)
            data.materials.append(root.ensure_material(settings.shading, engine))
            work.add_object(data)
            triangles = 2 * (terrain.size - 1) ** 2
        else:
            change, update = TerrainChange(root, engine), run_to_end(engine.move(viewer))
            while not engine.finished_blocks.empty():
                for _ in change.fill(*engine.finished_blocks.get_nowait()):
                    pass
            for _ in change.show(update):
                pass
            triangles = update.figures.triangles
        mesh_seconds = time.perf_counter() - started
        prepare_view(work, viewer)
        work.scene.cycles.seed = render_seed
        picture = work.render()[..., :3]
        np.save(out, np.clip(encode_signed_srgb(picture), 0.0, 1.0).astype(np.float32))
        render_seconds = work.render_seconds
    return {"triangles": triangles, "mesh_seconds": round(mesh_seconds, 2), "render_seconds": round(render_seconds, 2)}


def fill_with_grid(mesh: bpy.types.Mesh, terrain: FractalTerrain, store: TerrainStore) -> None:
    """Give a mesh all samples of a terrain, in quads with smooth shading, as tools do that import whole elevation models."""
    heights = terrain.read_all()
    side = terrain.size
    y, x = np.mgrid[:side, :side]
    vertices = np.stack([*store.frame.to_local(x.ravel(), y.ravel()), heights.ravel()], axis=1).astype(np.float32)
    numbers = np.arange(side * side, dtype=np.int32).reshape(side, side)
    quads = np.stack([numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, 1:], numbers[1:, :-1]], axis=-1).reshape(-1, 4)
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.ravel())
    mesh.loops.add(quads.size)
    mesh.loops.foreach_set("vertex_index", quads.ravel())
    mesh.polygons.add(len(quads))
    mesh.polygons.foreach_set("loop_start", np.arange(0, quads.size, 4, dtype=np.int32))
    mesh.update(calc_edges=True)


def prepare_view(work: RenderScene, viewer: Viewer) -> None:
    """Set up Cycles, a sun, a sky, and the camera of a viewer."""
    prepare_cycles(work.scene, SAMPLES, 8)
    work.scene.render.film_transparent = False
    work.scene.world = work.own(work.add_world(SKY))
    work.scene.render.resolution_x, work.scene.render.resolution_y = SIZE
    camera = work.camera.data
    camera.type, camera.sensor_fit = "PERSP", "HORIZONTAL"
    camera.angle = np.radians(FIELD_OF_VIEW)
    camera.clip_start, camera.clip_end = viewer.projection.near, viewer.projection.far
    work.camera.matrix_world = viewer.matrix.T
    light = work.own(bpy.data.lights.new("Sun", "SUN"))
    light.energy = SUN_STRENGTH
    sun = work.add_object(light)
    direction = np.array(SUN_DIRECTION) / np.linalg.norm(SUN_DIRECTION)
    right = np.cross([0.0, 0.0, 1.0], direction)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = right, np.cross(direction, right), direction
    sun.matrix_world = matrix.T
