"""The terrain part of the demo: a fractal landscape is built, loaded, flown over while it follows the camera, and rendered."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.bdam.objects import SceneTerrain
from farfield.addon.core.bdam import BdamSettings, FieldSettings, build_terrain, open_field
from farfield.addon.core.jobs.progress import Progress, StageClock, Steps, subprogress
from lib.contact_sheet import draw_contact_sheet
from lib.demo_photos import render, set_size
from lib.studio import SUN_STRENGTH, look_at_matrix, set_uniform_sky, sun_matrix

CELL_SIZE = 20.0  # meters
HEIGHT_FRACTION = 0.09  # The range of heights, as a fraction of the side of the terrain.
HURST_EXPONENT = 0.95  # A fractal with a larger exponent is smoother.
SEED = 11
CLEARANCE = 120.0  # meters between the camera and the highest ground below its path
LOOK_DOWN = 0.22  # meters per meter
SHADINGS = ("slope", "level")
BUILD_END = 0.5  # This fraction of the progress is building the terrain.
CLIP_DISTANCE = 1e6  # meters


@dataclass(frozen=True)
class TerrainPreset:
    """The amount of work. size: samples along each side. frames: of the flight. width: of a frame in pixels. samples: of Cycles."""

    size: int
    frames: int
    width: int
    samples: int


@dataclass
class TerrainDemo:
    """What was built and rendered. images: by shading, one (H, W, 3) per frame. triangles: of each frame."""

    size: int
    bytes_per_sample: float
    seconds: dict[str, float]
    triangles: list[int] = field(default_factory=list)
    images: dict[str, list[np.ndarray]] = field(default_factory=dict)

    def to_report(self) -> dict[str, Any]:
        """Return the figures for a JSON report."""
        return {
            "samples": self.size**2,
            "bytes_per_sample": round(self.bytes_per_sample, 2),
            "triangles": self.triangles,
            "seconds": {name: round(value, 3) for name, value in self.seconds.items()},
        }

    def draw_sheet(self) -> np.ndarray:
        """Return the contact sheet of the flight (H, W, 3)."""
        title = f"{self.size:,} x {self.size:,} samples within one pixel; {2 * (self.size - 1) ** 2:,} triangles at full resolution"
        rows = list(self.images.values())
        return draw_contact_sheet(
            title, rows, [f"by {name}" for name in self.images], [[f"{count:,} triangles"] for count in self.triangles]
        )


def build_and_fly(preset: TerrainPreset, folder: Path) -> Steps[TerrainDemo]:
    """Build a terrain in `folder`/terrain, and fly over it in a new scene. The heights are written to `folder`/heights.npy."""
    clock = StageClock()
    heights = fractal_heights(preset.size, SEED)
    source, store = folder / "heights.npy", folder / "terrain"
    np.save(source, heights[::-1])  # row 0 of files is in the north
    settings = BdamSettings(cell_size=CELL_SIZE)
    with clock.stage("build"):
        terrain_field = open_field([source], FieldSettings(cell_size=CELL_SIZE))
        yield from subprogress(build_terrain(terrain_field, [source], store, settings), 0.0, BUILD_END)
    size = sum(path.stat().st_size for path in store.rglob("*") if path.is_file())
    demo = TerrainDemo(preset.size, size / heights.size, clock.seconds)
    scene = prepare_flight(preset, heights)
    bpy.ops.farfield.bdam_load(directory=str(store), use_relative_path=False, frame_view=False)
    terrain = SceneTerrain.of_object(bpy.context.active_object)
    terrain.root.farfield_bdam_follow_camera = True
    with clock.stage("render"):
        for number, shading in enumerate(SHADINGS):
            bpy.ops.farfield.bdam_update(shading=shading)
            demo.images[shading] = []
            for frame in range(preset.frames):
                fraction = (number * preset.frames + frame) / (len(SHADINGS) * preset.frames)
                yield Progress(BUILD_END + (1.0 - BUILD_END) * fraction, "Flying over the terrain")
                scene.frame_set(frame)
                demo.images[shading].append(render(scene, folder / "frame.png"))
                if number == 0:
                    demo.triangles.append(terrain.figures.triangles)
    (folder / "frame.png").unlink()
    source.unlink()
    return demo


def fractal_heights(size: int, seed: int) -> np.ndarray:
    """Return heights (size, size) float32 in meters, row 0 in the south: fractional Brownian motion by spectral synthesis, folded at half
    of its height so that ridges form."""
    period = size + size // 8  # so that opposite borders do not match
    frequencies = np.hypot(np.fft.fftfreq(period)[:, None], np.fft.rfftfreq(period))
    frequencies[0, 0] = np.inf
    noise = np.fft.rfft2(np.random.default_rng(seed).standard_normal((period, period)))
    heights = np.fft.irfft2(noise * frequencies ** -(HURST_EXPONENT + 1.0), (period, period))[:size, :size]
    heights = (heights - heights.min()) / np.ptp(heights)
    ridged = 1.0 - np.abs(2.0 * heights - 1.0)
    return (HEIGHT_FRACTION * CELL_SIZE * size * (0.35 * heights + 0.65 * ridged**1.5)).astype(np.float32)


def prepare_flight(preset: TerrainPreset, heights: np.ndarray) -> bpy.types.Scene:
    """Create a scene with a Sun, a sky and a camera that flies over the ground, one keyframe per frame. Returns the scene."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.cycles.device = "CYCLES", preset.samples, "CPU"
    set_size(scene, preset.width, preset.width * 3 // 4)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.matrix_world = SUN_STRENGTH, sun_matrix()
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.clip_start, camera.data.clip_end = 1.0, CLIP_DISTANCE
    for item in (sun, camera):
        scene.collection.objects.link(item)
    scene.camera = camera
    scene.world = bpy.data.worlds.new("Sky")
    set_uniform_sky(scene.world)
    extent = CELL_SIZE * (preset.size - 1)
    center = (preset.size - 1) // 2
    for frame in range(preset.frames):
        progress = frame / max(preset.frames - 1, 1)
        x, y = 0.25 * extent * np.sin(3.0 * progress), extent * (0.1 + 0.5 * progress)
        column = min(max(int(center + x / CELL_SIZE), 0), preset.size - 1)
        ahead = heights[int(y / CELL_SIZE) : int(y / CELL_SIZE) + preset.size // 8, max(column - 8, 0) : column + 9]
        position = np.array([x, y - 0.5 * extent, ahead.max() + CLEARANCE])
        camera.matrix_world = look_at_matrix(np.array([-0.15 * np.cos(3.0 * progress), -1.0, LOOK_DOWN]), position)
        for path in ("location", "rotation_euler"):
            camera.keyframe_insert(path, frame=frame)
    return scene
