"""Image error of terrain in nested boxes: `python3 benchmarks/bench_clipbox_images.py [flags]`.

Prints JSON. Parts (`--only`): `error`, the paper's Figure 18: the fraction of pixels whose gray value differs by more than 20 of 255 from
that of boxes with 192 voxels per side and the same extent, for 32, 64, 96 and 128; `uniform`, depth errors compared with one marching cubes
mesh with as many triangles and the same extent; `moves`, FLIP between frames of a camera that stays while boxes of 64 voxels move on, in
random views, with and without *Smooth Moves*.
`--sheet FILE.png` shows the renders of `error`.
"""

import sys
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import benchmark_cli
import bpy
import numpy as np

from farfield.addon.bridge.geometry.mesh_pool import fill_mesh
from farfield.addon.bridge.rendering.render_scene import RenderScene, prepare_cycles, render_scene
from farfield.addon.bridge.shading.node_builder import NodeBuilder
from farfield.addon.compat import enable_nodes
from farfield.addon.core.clipbox.clearings import find_clearing
from farfield.addon.core.clipbox.engine import TerrainEngine, WeldedMesh, weld
from farfield.addon.core.clipbox.layout import layout_around
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.generators import build_sampler
from farfield.addon.core.clipbox.terrains.grids import Grid
from farfield.addon.core.jobs.progress import run_to_end
from lib import command_line
from lib.contact_sheet import draw_contact_sheet, write_png
from lib.flip_metric import flip_maps
from lib.studio import look_at_matrix

sys.path.append(str(environment.ROOT / "tests"))

from surface_extraction import extract_surface

EXTENT = 128.0  # side of the innermost box, scene units
BOXES = 7
REFERENCE_RESOLUTION = 192
RESOLUTIONS = (32, 64, 96, 128)
MAX_GRAY_ERROR = 20 / 255
SIZE = (640, 360)
LIGHT_DIRECTION = (0.5, -0.4, 0.77)
KINDS_OF_MOVES = {"smooth": True, "in steps": False}  # By the value of *Smooth Moves*.
SAMPLES_OF_MOVES, SIZE_OF_MOVES = 16, (480, 270)  # Per pixel, and pixels.
SCAN_STEP = 0.25  # Voxels between two viewers.
DOWNWARD, MAX_HEIGHT, LOWEST = (0.0, 0.5), 40.0, -500.0  # Slopes of random views, their height above clearings, and where these may begin.
NEAR_DISTANCE = 64.0  # scene units, half of the innermost box
VIEWERS = {  # position, and direction towards the viewer
    "valley": ((0.0, 0.0, 45.0), (-0.62, -0.74, 0.26)),
    "ridge": ((300.0, -150.0, 60.0), (0.7, -0.66, 0.27)),
    "plain": ((-700.0, 420.0, 50.0), (-0.2, 0.95, 0.24)),
}


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the benchmark."""
    parser = benchmark_cli.build_parser("bench_clipbox_images.py", __doc__, PARTS)
    parser.add_argument("--terrain", default="cascades", help="the terrain to measure")
    parser.add_argument("--viewers", nargs="+", choices=list(VIEWERS), default=list(VIEWERS), help="viewer positions")
    parser.add_argument("--views", type=int, default=4, help="random views of the part moves")
    parser.add_argument("--seed", type=int, default=1, help="random seed of these views")
    parser.add_argument(
        "--sheet", type=Path, help="a PNG file for the renders of the first viewer and their wrong pixels; its name begins those of moves"
    )
    return parser


def main(arguments: list[str], _line: command_line.ProgressLine) -> str:
    """Measure and return the results as JSON; raises FarfieldError if the input is invalid."""
    return benchmark_cli.run_parts(build_parser().parse_args(arguments), PARTS)


def error(given: Namespace) -> dict[str, Any]:
    """Measure the fraction of wrong pixels by resolution."""
    figures = {}
    for index, viewer in enumerate(given.viewers):
        position, direction = (np.array(vector) for vector in VIEWERS[viewer])
        with renderer(position, direction, shade_lambert) as render:
            reference = render(build_nested(given.terrain, REFERENCE_RESOLUTION, position))
            images = {resolution: render(build_nested(given.terrain, resolution, position)) for resolution in RESOLUTIONS}
        wrong = {resolution: np.abs(image - reference).max(axis=2) > MAX_GRAY_ERROR for resolution, image in images.items()}
        figures[viewer] = {str(resolution): round(float(mask.mean()), 4) for resolution, mask in wrong.items()}
        if index == 0 and given.sheet is not None:
            write_sheet(given.sheet, [*images.values(), reference], [*wrong.values(), np.zeros_like(wrong[32])], figures[viewer])
    means = [float(np.mean([fractions[str(resolution)] for fractions in figures.values()])) for resolution in RESOLUTIONS]
    return {"by_viewer": figures, "mean": [round(mean, 4) for mean in means], "falls_at_each_step": bool((np.diff(means) < 0).all())}


def write_sheet(path: Path, images: list[np.ndarray], wrong: list[np.ndarray], fractions: dict[str, float]) -> None:
    """Write the renders by resolution, the reference last, and their wrong pixels below them, at half size."""
    masks = [np.repeat(1.0 - 0.85 * mask[..., None], 3, axis=2) for mask in wrong]
    labels = [[name, f"{fraction:.1%} wrong"] for name, fraction in fractions.items()] + [[f"{REFERENCE_RESOLUTION}", "reference"]]
    rows = [[image[::2, ::2] for image in row] for row in (images, masks)]
    write_png(path, draw_contact_sheet("Voxels along each side of seven boxes", rows, ["render", "wrong"], labels))


def uniform(given: Namespace) -> dict[str, Any]:
    """Measure the relative depth errors of nested boxes and of a uniform mesh with as many triangles, near the viewer and everywhere."""
    figures = {}
    for viewer in given.viewers:
        position, direction = (np.array(vector) for vector in VIEWERS[viewer])
        nested_mesh = build_nested(given.terrain, 64, position)
        uniform_mesh = build_uniform(given.terrain, position, len(nested_mesh.triangles))
        with renderer(position, direction, shade_distance) as render:
            reference_mesh = build_nested(given.terrain, REFERENCE_RESOLUTION, position)
            reference, *depths = (render(mesh)[..., 0] for mesh in (reference_mesh, nested_mesh, uniform_mesh))
        figures[viewer] = {"triangles": [len(nested_mesh.triangles), len(uniform_mesh.triangles)]}
        for name, mask in (("near", (reference > 0) & (reference < NEAR_DISTANCE)), ("everywhere", reference > 0)):
            errors = [np.abs(depth - reference)[mask] / reference[mask] for depth in depths]
            figures[viewer][name] = {
                "pixels": int(mask.sum()),
                "mean_error": [round(float(np.minimum(error, 1.0).mean()), 4) if mask.any() else None for error in errors],
                "median_error": [round(float(np.median(error)), 5) if mask.any() else None for error in errors],
            }
    return {"order": ["nested boxes", "uniform marching cubes"], "by_viewer": figures}


def moves(given: Namespace) -> dict[str, Any]:
    """Measure FLIP between two frames of a camera that stays, before and after the border of a box in front of it moves on, for each box
    in random views.

    The camera is where the viewer is. Whatever else moves at the same time counts as well.
    """
    figures: dict[str, Any] = {}
    for kind, smooth_moves in KINDS_OF_MOVES.items():
        settings = ClipboxSettings(terrain=given.terrain, boxes=BOXES, smooth_moves=smooth_moves)
        sampler, random, views = build_sampler(settings), np.random.default_rng(given.seed), []
        for index in range(given.views):
            ground, heading, pitch = random.uniform(-2_000.0, 2_000.0, 2), random.uniform(0.0, 2.0 * np.pi), random.uniform(*DOWNWARD)
            height, direction, flips = random.uniform(0.0, MAX_HEIGHT), np.array([np.cos(heading), np.sin(heading), pitch]), []
            for level in range(BOXES - 1):
                viewers = find_move(settings, ground, level, direction)
                position = find_clearing(sampler, np.array([*viewers[0], LOWEST]), settings.voxel_size) + [0.0, 0.0, height]
                images = render_moves(settings, position, direction, [np.array([*viewer, position[2]]) for viewer in viewers])
                (flip_map,) = flip_maps([images])
                flips.append(round(float(flip_map.mean()), 4))
                if given.sheet is not None:
                    row = [[*images, np.repeat(flip_map[..., None], 3, axis=2)]]
                    path = given.sheet.with_name(f"{given.sheet.stem}_{kind}_{index}_{level}.png")
                    write_png(path, draw_contact_sheet(f"Box {level + 1}", row, [kind], [["before"], ["after"], [f"FLIP {flips[-1]}"]]))
            views.append(flips)
        figures[kind] = {"by_view_and_box": views, "mean": round(float(np.mean(views)), 4), "max": max(map(max, views))}
    return figures | {"bound": 0.02}


def find_move(settings: ClipboxSettings, ground: np.ndarray, level: int, direction: np.ndarray) -> list[np.ndarray]:
    """Return two viewers (2,) near `ground` (2,), a quarter of the smallest voxels apart along an axis, between whom the border of a level
    moves on that somebody sees who looks against `direction` (3,)."""
    axis = int(np.abs(direction[:2]).argmax())

    def viewer_at(steps: int) -> np.ndarray:
        return ground + np.eye(2)[axis] * (SCAN_STEP * settings.voxel_size * steps)

    def border_at(steps: int) -> int:
        visible = layout_around(np.array([*viewer_at(steps), 0.0]), settings).visible[level]
        return int((visible.low if direction[axis] > 0 else visible.high)[axis])

    low, stride = 0, 2**level
    while border_at(low) == border_at(low + stride):
        low += stride
    low += next(step for step in range(stride) if border_at(low + step) != border_at(low + step + 1))
    return [viewer_at(low), viewer_at(low + 1)]


def render_moves(
    settings: ClipboxSettings, position: np.ndarray, direction: np.ndarray, viewers: list[np.ndarray]
) -> tuple[np.ndarray, ...]:
    """Render the terrain around each of `viewers` (3,) by a camera at `position`, as in `renderer`."""
    engine, images = TerrainEngine(settings), []
    with renderer(position, direction, shade_lambert, SAMPLES_OF_MOVES, SIZE_OF_MOVES) as render:
        for viewer in viewers:
            run_to_end(engine.move(viewer))
            images.append(render(weld(list(engine.extract_all()))))
    return tuple(images)


def build_nested(terrain: str, resolution: int, position: np.ndarray) -> WeldedMesh:
    """Build seven boxes around a viewer, with the same extent for every resolution."""
    settings = ClipboxSettings(terrain=terrain, resolution=resolution, voxel_size=EXTENT / resolution, boxes=BOXES)
    return weld(list(run_to_end(TerrainEngine(settings).move(position)).meshes.values()))


def build_uniform(terrain: str, position: np.ndarray, triangles: int) -> WeldedMesh:
    """Build a marching cubes mesh with the same extent and about as many triangles; surface nets if scikit-image is not installed."""
    sampler, side = build_sampler(ClipboxSettings(terrain=terrain)), EXTENT * 2 ** (BOXES - 1)
    low, high, best = 16, 320, None
    while high - low > 4:
        count = (low + high) // 2
        voxel_size = side / count
        origin = np.floor(position / voxel_size).astype(np.int64) - count // 2
        mesh = marching_cubes(sampler.densities(Grid(tuple(origin.tolist()), (count,) * 3, voxel_size)).astype(np.float32))
        best = WeldedMesh((mesh.vertices + origin) * voxel_size, mesh.normals, mesh.triangles)
        low, high = (count, high) if len(mesh.triangles) < triangles else (low, count)
    return best


def marching_cubes(densities: np.ndarray) -> WeldedMesh:
    """Extract the surface of a volume; vertices in voxels, whose centers have half-integer coordinates."""
    try:
        from skimage import measure
    except ImportError:
        surface = extract_surface(densities)
        triangles = np.concatenate([surface.quads[:, [0, 1, 2]], surface.quads[:, [0, 2, 3]]])
        return WeldedMesh(surface.vertices, surface.normals, triangles)
    vertices, triangles, normals, _ = measure.marching_cubes(densities, 0.0, gradient_direction="ascent")
    return WeldedMesh(vertices.astype(np.float64) + 0.5, normals, triangles.astype(np.int32))


@contextmanager
def renderer(
    position: np.ndarray,
    direction: np.ndarray,
    shade: Callable[[NodeBuilder], None],
    samples: int = 1,
    size: tuple[int, int] = SIZE,
) -> Iterator[Callable[[WeldedMesh], np.ndarray]]:
    """Yield a function that renders a mesh (H, W, 3) from `position` against `direction`; `shade` adds emission. samples: per pixel."""
    with render_scene("Farfield Terrain") as work:
        prepare_cycles(work.scene, samples, 8)
        work.scene.cycles.filter_width = 0.01 if samples == 1 else 1.5
        work.scene.render.resolution_x, work.scene.render.resolution_y = size
        work.camera.data.type, work.camera.data.angle = "PERSP", 1.2
        work.camera.data.clip_end = 1e6
        work.camera.matrix_world = look_at_matrix(direction / np.linalg.norm(direction), position)
        yield lambda mesh: render_mesh(work, mesh, shade)


def render_mesh(work: RenderScene, source: WeldedMesh, shade: Callable[[NodeBuilder], None]) -> np.ndarray:
    """Render one mesh."""
    mesh = work.own(bpy.data.meshes.new("Terrain"))
    fill_mesh(mesh, source.vertices, source.triangles, source.normals)
    material = work.own(bpy.data.materials.new("Terrain"))
    enable_nodes(material)
    material.node_tree.nodes.clear()
    shade(NodeBuilder(material.node_tree))
    mesh.materials.append(material)
    item = work.add_object(mesh)
    image = work.render()[..., :3]
    item.hide_render = True
    return image


def shade_lambert(builder: NodeBuilder) -> None:
    """Emit gray by the angle between the light and the normal."""
    normal = builder.node("ShaderNodeNewGeometry").outputs["Normal"]
    diffuse = builder.math("MULTIPLY", builder.math("MAXIMUM", builder.vector("DOT_PRODUCT", normal, LIGHT_DIRECTION), 0.0), 0.85)
    _emit(builder, builder.math("ADD", diffuse, 0.1))


def shade_distance(builder: NodeBuilder) -> None:
    """Emit the distance from the camera."""
    _emit(builder, builder.node("ShaderNodeCameraData").outputs["View Distance"])


def _emit(builder: NodeBuilder, gray: bpy.types.NodeSocket) -> None:
    emission = builder.node("ShaderNodeEmission")
    builder.connect(builder.combine(gray, gray, gray), emission.inputs["Color"])
    builder.connect(emission.outputs[0], builder.node("ShaderNodeOutputMaterial").inputs["Surface"])


PARTS = {"error": error, "uniform": uniform, "moves": moves}


if __name__ == "__main__":
    command_line.run(main)
