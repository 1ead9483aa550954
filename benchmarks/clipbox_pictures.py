"""Terrain in nested boxes, judged by its pictures: `python3 benchmarks/clipbox_pictures.py [flags]`.

Prints JSON. Parts (`--only`): `error`, the paper's Figure 18: the share of pixels whose grey differs by more than 20 of 255 from that of
boxes of 192 voxels a side over the same extent, for 32, 64, 96 and 128; `uniform`, errors of depth beside one mesh of marching cubes with
as many triangles over the same extent. `--sheet FILE.png` shows the pictures of `error`.
"""

import sys
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

import environment

environment.ensure()

import bpy
import numpy as np
import parts

import command_line
from contact_sheet import contact_sheet, write_png
from farfield.addon.bridge.cycles_renders import prepare_cycles
from farfield.addon.bridge.temporary import TemporaryScene, temporary_scene
from farfield.addon.bridge.terrain_objects import fill_mesh
from farfield.addon.bridge.wiring import Wiring
from farfield.addon.compat import give_nodes
from farfield.addon.core.clipbox.grids import Grid
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.surface import surface_of
from farfield.addon.core.clipbox.terrain import Terrain, Welded, welded
from farfield.addon.core.clipbox.terrains import terrain_of
from farfield.addon.core.progress import finish
from studio import looking_along

EXTENT = 128.0  # scene units that the innermost box has
BOXES = 7
REFERENCE = 192
RESOLUTIONS = (32, 64, 96, 128)
GREY_STEP = 20 / 255
SIZE = (640, 360)
LIGHT = (0.5, -0.4, 0.77)
NEAR = 64.0  # scene units: half of the innermost box
VIEWERS = {  # where from, and against which direction
    "valley": ((0.0, 0.0, 45.0), (-0.62, -0.74, 0.26)),
    "ridge": ((300.0, -150.0, 60.0), (0.7, -0.66, 0.27)),
    "plain": ((-700.0, 420.0, 50.0), (-0.2, 0.95, 0.24)),
}


def parser() -> command_line.Parser:
    """All arguments of the benchmark."""
    made = parts.parser("clipbox_pictures.py", __doc__, PARTS)
    made.add_argument("--terrain", default="cascades", help="the terrain to measure on")
    made.add_argument("--viewers", nargs="+", choices=list(VIEWERS), default=list(VIEWERS), help="where to look from")
    made.add_argument("--sheet", type=Path, help="a PNG with the pictures of the first viewer, and where they are wrong")
    return made


def main(arguments: list[str], _line: command_line.ProgressLine) -> None:
    """Measure; raises FarfieldError when the input is bad."""
    parts.measure(parser().parse_args(arguments), PARTS)


def error(given: Namespace) -> dict[str, Any]:
    """Shares of wrong pixels by resolution."""
    found = {}
    for number, viewer in enumerate(given.viewers):
        place, direction = (np.array(each) for each in VIEWERS[viewer])
        with view(place, direction, shading) as picture:
            best = picture(nested(given.terrain, REFERENCE, place))
            pictures = {resolution: picture(nested(given.terrain, resolution, place)) for resolution in RESOLUTIONS}
        wrong = {resolution: np.abs(each - best).max(axis=2) > GREY_STEP for resolution, each in pictures.items()}
        found[viewer] = {str(resolution): round(float(mask.mean()), 4) for resolution, mask in wrong.items()}
        if number == 0 and given.sheet is not None:
            write_sheet(given.sheet, [*pictures.values(), best], [*wrong.values(), np.zeros_like(wrong[32])], found[viewer])
    means = [float(np.mean([shares[str(resolution)] for shares in found.values()])) for resolution in RESOLUTIONS]
    return {"by_viewer": found, "mean": [round(mean, 4) for mean in means], "falls_at_each_step": bool((np.diff(means) < 0).all())}


def write_sheet(path: Path, pictures: list[np.ndarray], wrong: list[np.ndarray], shares: dict[str, float]) -> None:
    """The pictures by resolution, those of the reference last, and their wrong pixels below them, at half their size."""
    masks = [np.repeat(1.0 - 0.85 * mask[..., None], 3, axis=2) for mask in wrong]
    labels = [[name, f"{share:.1%} wrong"] for name, share in shares.items()] + [[f"{REFERENCE}", ""]]
    rows = [[picture[::2, ::2] for picture in row] for row in (pictures, masks)]
    write_png(path, contact_sheet("Voxels along each side of seven boxes", rows, ["picture", "wrong"], labels))


def uniform(given: Namespace) -> dict[str, Any]:
    """Errors of depth, as shares of the depth, of nested boxes and of one uniform mesh with as many triangles, near and everywhere."""
    found = {}
    for viewer in given.viewers:
        place, direction = (np.array(each) for each in VIEWERS[viewer])
        ours = nested(given.terrain, 64, place)
        theirs = uniform_mesh(given.terrain, place, len(ours.triangles))
        with view(place, direction, distance) as picture:
            best, *others = (picture(surface)[..., 0] for surface in (nested(given.terrain, REFERENCE, place), ours, theirs))
        found[viewer] = {"triangles": [len(ours.triangles), len(theirs.triangles)]}
        for name, where in (("near", (best > 0) & (best < NEAR)), ("everywhere", best > 0)):
            shares = [np.abs(each - best)[where] / best[where] for each in others]
            found[viewer][name] = {
                "pixels": int(where.sum()),
                "mean_error": [round(float(np.minimum(share, 1.0).mean()), 4) if where.any() else None for share in shares],
                "median_error": [round(float(np.median(share)), 5) if where.any() else None for share in shares],
            }
    return {"order": ["nested boxes", "uniform marching cubes"], "by_viewer": found}


def nested(terrain: str, resolution: int, place: np.ndarray) -> Welded:
    """Seven boxes about a viewer, of one extent whatever their resolution."""
    settings = ClipboxSettings(terrain=terrain, resolution=resolution, voxel=EXTENT / resolution, boxes=BOXES)
    return welded(list(finish(Terrain(settings).move(place)).meshes.values()))


def uniform_mesh(terrain: str, place: np.ndarray, triangles: int) -> Welded:
    """Marching cubes over the same extent with about as many triangles; surface nets where scikit-image is not installed."""
    sampler, side = terrain_of(ClipboxSettings(terrain=terrain)), EXTENT * 2 ** (BOXES - 1)
    low, high, best = 16, 320, None
    while high - low > 4:
        count = (low + high) // 2
        voxel = side / count
        origin = np.floor(place / voxel).astype(np.int64) - count // 2
        made = marching_cubes(sampler.densities(Grid(tuple(origin.tolist()), (count,) * 3, voxel)).astype(np.float32))
        best = Welded((made.vertices + origin) * voxel, made.normals, made.triangles)
        low, high = (count, high) if len(made.triangles) < triangles else (low, count)
    return best


def marching_cubes(densities: np.ndarray) -> Welded:
    """The surface of a volume; vertices in voxels, whose centres lie at halves."""
    try:
        from skimage import measure
    except ImportError:
        made = surface_of(densities)
        return Welded(made.vertices, made.normals, np.concatenate([made.quads[:, [0, 1, 2]], made.quads[:, [0, 2, 3]]]))
    vertices, triangles, normals, _ = measure.marching_cubes(densities, 0.0, gradient_direction="ascent")
    return Welded(vertices.astype(np.float64) + 0.5, normals, triangles.astype(np.int32))


@contextmanager
def view(place: np.ndarray, direction: np.ndarray, shade: Any) -> Iterator[Any]:
    """Takes pictures (H, W, 3) of surfaces from a place against a direction, one sample a pixel, lit by nothing but `shade`."""
    with temporary_scene("Farfield Terrain") as work:
        prepare_cycles(work.scene, 1, 8)
        work.scene.cycles.filter_width = 0.01
        work.scene.render.resolution_x, work.scene.render.resolution_y = SIZE
        work.camera.data.type, work.camera.data.angle = "PERSP", 1.2
        work.camera.data.clip_end = 1e6
        work.camera.matrix_world = looking_along(direction / np.linalg.norm(direction), place)
        yield lambda surface: taken(work, surface, shade)


def taken(work: TemporaryScene, surface: Welded, shade: Any) -> np.ndarray:
    """A picture of one surface."""
    mesh = work.keep(bpy.data.meshes.new("Terrain"))
    fill_mesh(mesh, surface.vertices, surface.normals, surface.triangles)
    material = work.keep(bpy.data.materials.new("Terrain"))
    give_nodes(material)
    material.node_tree.nodes.clear()
    shade(Wiring(material.node_tree))
    mesh.materials.append(material)
    item = work.add(mesh)
    picture = work.render()[..., :3]
    item.hide_render = True
    return picture


def shading(wiring: Wiring) -> None:
    """Grey by the angle between a light and the normal."""
    normal = wiring.node("ShaderNodeNewGeometry").outputs["Normal"]
    lit = wiring.math("MULTIPLY", wiring.math("MAXIMUM", wiring.vector("DOT_PRODUCT", normal, LIGHT), 0.0), 0.85)
    _shine(wiring, wiring.math("ADD", lit, 0.1))


def distance(wiring: Wiring) -> None:
    """The distance from the camera."""
    _shine(wiring, wiring.node("ShaderNodeCameraData").outputs["View Distance"])


def _shine(wiring: Wiring, grey: bpy.types.NodeSocket) -> None:
    emission = wiring.node("ShaderNodeEmission")
    wiring.connect(wiring.combine(grey, grey, grey), emission.inputs["Color"])
    wiring.connect(emission.outputs[0], wiring.node("ShaderNodeOutputMaterial").inputs["Surface"])


PARTS = {"error": error, "uniform": uniform}


if __name__ == "__main__":
    command_line.run(main)
