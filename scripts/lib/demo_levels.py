"""The part of the demo with perceptual levels: a textured ring of several UV islands, its levels, and how they look where they switch."""

from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.geometry.mesh_arrays import write_attribute, write_triangles
from farfield.addon.bridge.imaging.images import create_image
from farfield.addon.compat import enable_nodes
from farfield.addon.core.imaging.colors import encode_signed_srgb
from farfield.addon.core.imaging.mipmaps import build_mipmaps, resize_by_area
from farfield.addon.core.jobs.progress import Progress, StageClock, Steps, subprogress
from farfield.addon.core.texmesh.level_chain import LevelChain
from farfield.addon.core.texmesh.perception.views import ViewedSurface, frame_around, prepare_surface, render
from farfield.addon.core.texmesh.settings import SceneSettings, TexmeshSettings
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.texmesh.job import prepare_levels
from lib.contact_sheet import draw_contact_sheet, enlarge

CELL = 200  # pixels of a cell of the sheet, and of the largest image in which levels are compared
SAMPLES = 3  # per pixel along each side, at the size of a cell
DIRECTION = np.array([0.4, -0.7, 0.6]) / np.linalg.norm([0.4, -0.7, 0.6])  # from the model towards the viewer
ISLANDS = 4  # UV islands along the ring
TEXTURE_SIDE = 256
MAKE_END = 0.9  # This fraction of the progress is making the levels.


@dataclass(frozen=True)
class LevelsPreset:
    """The amount of work. segments: quadrilaterals along the ring, a multiple of 4. views: in which levels are compared."""

    segments: int
    views: int


@dataclass
class LevelsDemo:
    """Levels and their images. original, level: of each level but the first (CELL, CELL, 3), sRGB, as large as where they switch.
    enlarged: the level as large as the cell."""

    chain: LevelChain
    seconds: dict[str, float]
    original: list[np.ndarray] = field(default_factory=list)
    level: list[np.ndarray] = field(default_factory=list)
    enlarged: list[np.ndarray] = field(default_factory=list)

    def to_report(self) -> dict[str, Any]:
        """Return the figures for a JSON report."""
        levels = [
            {"triangles": len(item.mesh.triangles), "pixels": size, "difference": round(item.switch.difference, 4)}
            for item, size in zip(self.chain.levels[1:], switch_sizes(self.chain), strict=True)
        ]
        source = len(self.chain.levels[0].mesh.triangles)
        return {"triangles": source, "levels": levels, "seconds": {name: round(value, 3) for name, value in self.seconds.items()}}

    def draw_sheet(self) -> np.ndarray:
        """Return the contact sheet (H, W, 3)."""
        report = self.to_report()
        labels = [[f"{item['triangles']:,} triangles", f"up to {item['pixels']} pixels"] for item in report["levels"]]
        title = f"Levels of a ring of {report['triangles']:,} triangles, where each may replace the finer one"
        return draw_contact_sheet(title, [self.original, self.level, self.enlarged], ["original", "level", "from near"], labels)


def make_and_compare(preset: LevelsPreset) -> Steps[LevelsDemo]:
    """Make levels of a ring in a new scene, and render them."""
    clock = StageClock()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    ring = create_ring(preset.segments)
    settings = TexmeshSettings(views=preset.views, max_image=CELL)
    job = prepare_levels(bpy.context, [ring], settings, SceneSettings())
    with clock.stage("levels"):
        yield from subprogress(run_job(job), 0.0, MAKE_END)
    (chain,) = job.chains.values()
    yield Progress(MAKE_END, "Rendering levels")
    demo = LevelsDemo(chain, clock.seconds)
    with clock.stage("render"):
        mipmaps = [None if texture is None else build_mipmaps(texture) for texture in job.sources[0].textures]
        surfaces = [prepare_surface(level.mesh, mipmaps) for level in chain.levels]
        full = [render_level(surface, chain) for surface in surfaces]
        for image, size in zip(full[1:], switch_sizes(chain), strict=True):
            demo.original.append(show_in_cell(full[0], size))
            demo.level.append(show_in_cell(image, size))
            demo.enlarged.append(show_in_cell(image, CELL))
    return demo


def create_ring(segments: int) -> bpy.types.Object:
    """Add a bumpy ring with UV islands and a painted image to the scene."""
    sides = segments // 2
    along, around = np.meshgrid(np.arange(segments + 1), np.arange(sides + 1), indexing="ij")
    u, v = 2.0 * np.pi * along / segments, 2.0 * np.pi * around / sides
    radius = 0.38 + 0.03 * np.sin(9.0 * u) * np.cos(4.0 * v) + 0.02 * np.sin(2.0 * v + 5.0 * u)
    points = np.stack([(1.0 + radius * np.cos(v)) * np.cos(u), (1.0 + radius * np.cos(v)) * np.sin(u), radius * np.sin(v)], axis=2)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(segments), np.arange(sides), indexing="ij"))
    corners = np.concatenate(
        [np.stack([np.stack(pair, axis=1) for pair in pairs], axis=1) for pairs in triangle_corners(i, j)]
    )  # (T, 3, 2) along and around
    triangles = (corners[..., 0] % segments) * sides + corners[..., 1] % sides
    length = segments // ISLANDS
    islands = corners[:, :, 0].min(axis=1) // length
    fractions = np.stack([(corners[..., 0] - length * islands[:, None]) / length, corners[..., 1] / sides], axis=2)
    uvs = 0.02 + 0.46 * fractions + 0.5 * np.stack([islands % 2, islands // 2], axis=1)[:, None]
    mesh = bpy.data.meshes.new("Ring")
    write_triangles(mesh, points[:-1, :-1].reshape(-1, 3), triangles.astype(np.int32))
    write_attribute(mesh, "UVMap", "CORNER", uvs.astype(np.float32))
    mesh.materials.append(create_painted_material())
    ring = bpy.data.objects.new("Ring", mesh)
    bpy.context.scene.collection.objects.link(ring)
    mesh.shade_smooth()
    bpy.context.view_layer.update()
    return ring


def triangle_corners(i: np.ndarray, j: np.ndarray) -> list[list[tuple[np.ndarray, np.ndarray]]]:
    """Return the grid positions of the corners of both triangles of each cell."""
    a, b, c, d = (i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)
    return [[a, b, c], [a, c, d]]


def create_painted_material() -> bpy.types.Material:
    """Return a material with an image of stripes and dots."""
    y, x = np.mgrid[:TEXTURE_SIDE, :TEXTURE_SIDE] / TEXTURE_SIDE
    stripes = 0.5 + 0.5 * np.tanh(4.0 * np.sin(40.0 * y + 3.0 * np.sin(12.0 * x)))
    dots = (np.hypot((16.0 * x) % 1.0 - 0.5, (16.0 * y) % 1.0 - 0.5) < 0.28)[..., None]
    colors = stripes[..., None] * [0.85, 0.62, 0.35] + (1.0 - stripes[..., None]) * [0.25, 0.35, 0.55]
    pixels = np.concatenate([np.where(dots, [0.75, 0.2, 0.15], colors), np.ones_like(dots)], axis=2)
    material = bpy.data.materials.new("Painted")
    enable_nodes(material)
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = create_image("Painted", pixels, is_data=False)
    material.node_tree.links.new(node.outputs["Color"], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    return material


def switch_sizes(chain: LevelChain) -> list[int]:
    """Return the side of the image of the object, in pixels, up to which each level but the first may be shown."""
    return [max(int(chain.image_side / level.pixel_size), 1) for level in chain.levels[1:]]


def render_level(surface: ViewedSurface, chain: LevelChain) -> np.ndarray:
    """Return a linear image of a level with several samples per pixel of a cell."""
    return render(surface, DIRECTION, frame_around(chain.levels[0].mesh.vertices), SAMPLES * CELL).colors


def show_in_cell(image: np.ndarray, size: int) -> np.ndarray:
    """Return an sRGB image (CELL, CELL, 3) with `image` at `size` pixels per side in the center, its pixels as large as they fit."""
    small = enlarge(encode_signed_srgb(resize_by_area(image, min(size, CELL))), max(CELL // size, 1))
    cell = np.empty((CELL, CELL, 3), np.float32)
    cell[:] = small[0, 0]  # the background
    start = (CELL - len(small)) // 2
    cell[start : start + len(small), start : start + len(small)] = small
    return cell
