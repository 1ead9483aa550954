"""A scene of one's own for renders, that leaves nothing behind."""

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np

from ..compat import set_file_format
from ..core.errors import FarfieldError, FileError


class TemporaryScene:
    """A scene with its camera, a folder for its pictures, and the list of all data made for it.

    render_seconds: what Blender's renders took so far, reading them back not counted.
    """

    def __init__(self, name: str, folder: Path) -> None:
        self.folder = folder
        self.render_seconds = 0.0
        self.made: list[bpy.types.ID] = []
        self.scene = self.keep(bpy.data.scenes.new(name))
        self.camera = self.add(self.keep(bpy.data.cameras.new(name)))
        self.scene.camera = self.camera

    def keep(self, made: bpy.types.ID) -> bpy.types.ID:
        """Remember `made` for removal; returns it."""
        self.made.append(made)
        return made

    def add(self, data: bpy.types.ID) -> bpy.types.Object:
        """A new object of `data` in the scene."""
        placed = self.keep(bpy.data.objects.new(data.name, data))
        self.scene.collection.objects.link(placed)
        return placed

    def render(self) -> np.ndarray:
        """The scene as seen by its camera: (height, width, 4) float32, scene-linear, premultiplied, row 0 at the bottom.

        Raises:
            FileError: when the temporary folder cannot take the picture.
        """
        settings = self.scene.render
        set_file_format(settings.image_settings, "OPEN_EXR")
        settings.image_settings.color_mode = "RGBA"
        settings.image_settings.color_depth = "32"
        settings.image_settings.exr_codec = "NONE"
        path = self.folder / "picture.exr"
        path.unlink(missing_ok=True)  # or one that cannot be written would look like the one before
        settings.filepath = str(path)
        started = time.perf_counter()
        try:
            bpy.ops.render.render(write_still=True, scene=self.scene.name)
        except RuntimeError as error:
            reason = str(error).strip()
            raise FileError(f'Rendering into the temporary folder "{self.folder}" failed: {reason} Free some space there.') from error
        self.render_seconds += time.perf_counter() - started
        size = (side * settings.resolution_percentage // 100 for side in (settings.resolution_x, settings.resolution_y))
        picture = _read_picture(path, *size)
        if picture is None:  # Blender does not always see that a disk is full
            raise FileError(f'Rendering into the temporary folder "{self.folder}" failed: the picture is cut off. Free some space there.')
        return picture

    def close(self) -> None:
        """Remove all that was made, and the folder."""
        bpy.data.batch_remove(list(reversed(self.made)))
        shutil.rmtree(self.folder, ignore_errors=True)


@contextmanager
def temporary_scene(name: str) -> Iterator[TemporaryScene]:
    """A scene beside the user's, which is neither shown nor touched; gone with all its data when the block ends, however it ends.

    Raises:
        FileError: when there is no place for temporary files.
        FarfieldError: when Cycles is switched off.
    """
    try:
        folder = Path(tempfile.mkdtemp(prefix="farfield-"))
    except OSError as error:
        raise FileError(f"No temporary folder can be made ({error.strerror}); free some space on that disk.") from error
    work = TemporaryScene(name, folder)
    try:
        if not hasattr(work.scene, "cycles"):
            raise FarfieldError("Textures are captured with Cycles, which is switched off; enable the add-on Cycles Render Engine.")
        yield work
    finally:
        work.close()


def _read_picture(path: Path, width: int, height: int) -> np.ndarray | None:
    """The pixels of an EXR picture of 32-bit floats without compression, as `render` returns them; None when it is not whole.

    Blender's own way, by an image of the scene, takes as long as a small render does. The pixels are the last in such a file, line by line
    from the top: the number of the line, its bytes, and its channels in alphabetical order (OpenEXR file layout).
    """
    line = np.dtype([("number", "<i4"), ("bytes", "<i4"), ("alpha_blue_green_red", "<f4", (4, width))])
    start = path.stat().st_size - height * line.itemsize if path.exists() else -1
    if start < 0:
        return None
    lines = np.fromfile(path, line, count=height, offset=start)
    if (lines["number"] != np.arange(height)).any() or (lines["bytes"] != 16 * width).any():
        return None
    return np.ascontiguousarray(lines["alpha_blue_green_red"][::-1, ::-1].transpose(0, 2, 1))
