"""A separate scene for Farfield's own renders, removed afterwards with all its data, and its Cycles settings."""

import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np

from ...compat import enable_nodes, set_file_format
from ...core.errors import FarfieldError, FileError
from ...core.files.temporary_folders import create_temporary_folder
from ..blender import error_sentence

MAX_TRANSPARENT_BOUNCES = 1024


class RenderScene:
    """A scene with a camera, a folder for its renders, and a list of all data created for it.

    render_seconds: total time of Blender's renders, without reading the images back.
    """

    def __init__(self, name: str, folder: Path) -> None:
        self.folder = folder
        self.render_seconds = 0.0
        self.owned: list[bpy.types.ID] = []
        self.scene = self.own(bpy.data.scenes.new(name))
        self.camera = self.add_object(self.own(bpy.data.cameras.new(name)))
        self.scene.camera = self.camera

    def own(self, data: bpy.types.ID) -> bpy.types.ID:
        """Register `data` for removal with the scene, and return it. A file that is saved meanwhile does not contain it."""
        data.is_runtime_data = True
        self.owned.append(data)
        return data

    def add_object(self, data: bpy.types.ID) -> bpy.types.Object:
        """Add an object of `data` to the scene."""
        item = self.own(bpy.data.objects.new(data.name, data))
        self.scene.collection.objects.link(item)
        return item

    def add_world(self, radiance: float) -> bpy.types.World:
        """Create a World with the same white `radiance` in all directions. Assign it to the scene to use it."""
        world = self.own(bpy.data.worlds.new(self.scene.name))
        enable_nodes(world)
        background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
        background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
        background.inputs["Strength"].default_value = radiance
        return world

    @contextmanager
    def show(self, objects: Sequence[bpy.types.Object]) -> Iterator[None]:
        """Link the user's `objects` to the scene and enable them in renders. Afterwards those that were disabled are disabled again."""
        hidden = [item.hide_render for item in objects]
        try:
            for item in objects:
                self.scene.collection.objects.link(item)
                item.hide_render = False
            yield
        finally:
            for item, was_hidden in zip(objects, hidden, strict=True):
                item.hide_render = was_hidden

    def show_only(self, visible: Sequence[bpy.types.Object]) -> None:
        """Render only `visible` of the objects of the scene; lights stay as they are."""
        for item in self.scene.collection.objects:
            if item.type not in {"CAMERA", "LIGHT"}:
                item.hide_render = item not in visible

    def render(self) -> np.ndarray:
        """Render the scene's camera: (height, width, 4) float32, scene-linear, premultiplied, row 0 at the bottom.

        Raises:
            FileError: the image cannot be written to the temporary folder.
        """
        settings = self.scene.render
        set_file_format(settings.image_settings, "OPEN_EXR")
        settings.image_settings.color_mode = "RGBA"
        settings.image_settings.color_depth = "32"
        settings.image_settings.exr_codec = "NONE"
        path = self.folder / "render.exr"
        path.unlink(missing_ok=True)  # otherwise a failed write would look like the previous render
        settings.filepath = str(path)
        start = time.perf_counter()
        try:
            bpy.ops.render.render(write_still=True, scene=self.scene.name)
        except RuntimeError as error:
            reason = error_sentence(error)
            raise FileError(
                f'Rendering into the temporary folder "{self.folder}" failed: {reason}; check that it can be written.'
            ) from error
        self.render_seconds += time.perf_counter() - start
        size = (side * settings.resolution_percentage // 100 for side in (settings.resolution_x, settings.resolution_y))
        pixels = _read_exr(path, *size)
        if pixels is None:  # Blender does not always notice that a disk is full
            raise FileError(f'Rendering into the temporary folder "{self.folder}" failed: the image is truncated; free some space there.')
        return pixels

    def close(self) -> None:
        """Remove all owned data and the folder.

        Persistent render data is freed first. Otherwise the render session and its dependency graph outlive the scene that they point
        to, and the next change of any property, in any scene, may crash Blender.
        """
        self.scene.render.use_persistent_data = False
        bpy.data.batch_remove(list(reversed(self.owned)))
        shutil.rmtree(self.folder, ignore_errors=True)


@contextmanager
def render_scene(name: str) -> Iterator[RenderScene]:
    """Create a scene next to the user's scenes, which are not touched; remove it with all its data at the end of the block.

    Raises:
        FileError: temporary files cannot be created.
        FarfieldError: the Cycles add-on is disabled.
    """
    try:
        folder = create_temporary_folder()
    except OSError as error:
        raise FileError(f"A temporary folder cannot be created ({error.strerror}); free some space on that disk.") from error
    work = RenderScene(name, folder)
    try:
        if not hasattr(work.scene, "cycles"):
            raise FarfieldError("Farfield renders with Cycles, which is disabled; enable the add-on Cycles Render Engine.")
        yield work
    finally:
        work.close()


def _read_exr(path: Path, width: int, height: int) -> np.ndarray | None:
    """Return the pixels of an uncompressed EXR image of 32-bit floats, as `render` returns them; None when the file is incomplete.

    Reading it through a Blender image takes as long as a small render. The pixels are at the end of such a file, line by line from the
    top: line number, byte count, and the channels in alphabetical order (OpenEXR file layout).
    """
    line = np.dtype([("number", "<i4"), ("bytes", "<i4"), ("alpha_blue_green_red", "<f4", (4, width))])
    start = path.stat().st_size - height * line.itemsize if path.exists() else -1
    if start < 0:
        return None
    lines = np.fromfile(path, line, count=height, offset=start)
    if (lines["number"] != np.arange(height)).any() or (lines["bytes"] != 16 * width).any():
        return None
    return np.ascontiguousarray(lines["alpha_blue_green_red"][::-1, ::-1].transpose(0, 2, 1))


def prepare_cycles(scene: bpy.types.Scene, samples: int, max_transparent_bounces: int) -> None:
    """Set up `scene` for orthographic Cycles renders on the CPU, with transparent film, all samples and `max_transparent_bounces`."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.film_transparent = True
    render.use_persistent_data = True
    render.resolution_percentage = 100
    render.use_compositing = render.use_sequencer = False
    cycles.device = "CPU"
    cycles.samples = samples
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.transparent_max_bounces = max_transparent_bounces
    # The minimum too: otherwise paths through stacks end at random, and color and coverage no longer match.
    cycles.min_transparent_bounces = max_transparent_bounces
    scene.camera.data.type = "ORTHO"


def prepare_channel_render(scene: bpy.types.Scene, width: int, height: int, seed: int) -> None:
    """Set up `scene` for Cycles renders of material channels, see `material_channels`: emission only, one sample per pixel, no bounces.

    Callers may raise the number of samples.
    """
    prepare_cycles(scene, 1, MAX_TRANSPARENT_BOUNCES)
    render, cycles = scene.render, scene.cycles
    render.resolution_x, render.resolution_y = width, height
    render.use_simplify = False
    cycles.seed = seed
    cycles.use_light_tree = False
    # The mean over each texel and nothing outside: the bilinear lookup in the finished texture blurs enough.
    cycles.pixel_filter_type = "BOX"
    cycles.max_bounces = 0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    scene.camera.data.sensor_fit = "HORIZONTAL"
