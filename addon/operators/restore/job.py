"""The jobs of the operator: what they have in common, the job for images and their UDIM tiles, and the job for image sequences."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...bridge.imaging.images import EXTENSIONS, read_pixels, save_pixels
from ...bridge.objects import find_by_uid
from ...bridge.restore import image_users, results
from ...bridge.restore.image_pixels import PixelFormat, read_format, to_display, to_stored
from ...bridge.restore.image_sources import load_frame
from ...core.errors import ImageError
from ...core.files.atomic_write import atomic_folder
from ...core.files.filenames import safe_filename
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.messages import format_count, quote_names
from ...core.restore.restoration import restore
from ...core.restore.settings import MaskSettings, RestoreSettings
from .. import image_editors
from .guides import UNTILED, GuideReader, Guides, find_missing

MIN_DIGITS = 4  # digits of the frame numbers in names of files


@dataclass
class RestoreJob:
    """What restorations of all kinds of images have in common.

    Attributes:
        name, uid: those of the image.
        settings: how it is restored.
        masks: where pixels are missing, and where the result goes.
        is_normal_map: whether it holds normals.
        editor: the Image Editor that shows the result, see `image_editors`.
    """

    name: str
    uid: int
    settings: RestoreSettings
    masks: MaskSettings
    is_normal_map: bool
    editor: int

    def find_source(self) -> bpy.types.Image:
        """Return the image that is restored. Raises ImageError if it was removed in the meantime."""
        image = find_by_uid(bpy.data.images, self.uid)
        if image is None:
            raise ImageError(f'The image "{self.name}" was removed while it was being restored; nothing was changed.')
        return image

    def restore_pixels(self, stored: np.ndarray, pixel_format: PixelFormat, guides: Guides, part: str) -> Steps[tuple[np.ndarray, int]]:
        """Return the restored stored values (H, W, 4), equal to `stored` where no pixel is missing, and the number of missing pixels.

        part: names a tile or frame in messages; such a part may have no missing pixels. Raises ImageError.
        """
        display = to_display(stored, pixel_format)
        mask = find_missing(stored, display, self.masks) if guides.mask is None else guides.mask
        if part and not mask.any():
            return stored, 0
        has_alpha = bool((display[..., 3] != 1.0)[~mask].any())
        steps = restore(
            display if has_alpha else np.ascontiguousarray(display[..., :3]),
            mask,
            self.settings,
            source_mask=guides.source_mask,
            barriers=guides.barriers,
            is_color=not pixel_format.is_data and not self.is_normal_map,
            is_normal_map=self.is_normal_map,
        )
        try:
            restored = (yield from steps).pixels
        except ImageError as error:
            raise ImageError(f"{part}: {error}" if part else str(error)) from error
        filled = np.ones((int(mask.sum()), 4), np.float32)
        filled[:, : restored.shape[2]] = restored[mask]
        result = stored.copy()
        result[mask] = to_stored(filled, pixel_format)
        return result, len(filled)

    def check_any_missing(self, missing_count: int) -> None:
        """Raise ImageError if no pixel of the image is missing."""
        if missing_count == 0:
            raise ImageError(f'No pixel of "{self.name}" is marked as missing; paint the mask or change the settings of the mask.')

    def finish(self, source: bpy.types.Image, image: bpy.types.Image, missing_count: int) -> str:
        """Connect the new `image` with its `source`, replace and show it; return the message for the user."""
        image[image_users.ORIGINAL_PROPERTY] = source
        skipped = image_users.replace_image(source, image) if self.masks.replace_in_materials else []
        image.use_fake_user = image.users == 0
        image_editors.show_image(self.editor, image)
        message = f'Restored {format_count(missing_count, "pixel")} of "{source.name}" as "{image.name}".'
        if skipped:
            message += f" Not replaced in linked or overridden data: {quote_names(dict.fromkeys(skipped))}."
        return message


@dataclass
class ImageJob(RestoreJob):
    """Restores an image, or all tiles of a tiled one, as a packed image.

    tiles: stored values (H, W, 4) by tile number. guides: by tile number; tiles without are complete.
    """

    core_fraction = 0.97

    tiles: dict[int, np.ndarray]
    guides: Mapping[int, Guides]
    pixel_format: PixelFormat

    def core_steps(self) -> Steps[tuple[dict[int, np.ndarray], int]]:
        """Restore every tile."""
        restored, missing_count = {}, 0
        for index, (number, stored) in enumerate(self.tiles.items()):
            yield Progress(index / len(self.tiles), "Reading pixels")
            part = "" if number == UNTILED else f"Tile {number}"
            restored[number] = stored
            if number in self.guides:
                steps = self.restore_pixels(stored, self.pixel_format, self.guides[number], part)
                restored[number], count = yield from subprogress(steps, index / len(self.tiles), (index + 1) / len(self.tiles))
                missing_count += count
        self.check_any_missing(missing_count)
        return restored, missing_count

    def scene_steps(self, core_result: tuple[dict[int, np.ndarray], int]) -> Steps[str]:
        """Create the new image."""
        yield Progress(0.0, "Creating the image")
        source = self.find_source()
        image = results.create_result(source, core_result[0])
        return self.finish(source, image, core_result[1])


@dataclass
class SequenceJob(RestoreJob):
    """Restores the frames of an image sequence into files, completely or not at all, which a new sequence reads.

    Frames are loaded and saved by Blender, so all of the work is done on the main thread. frames: files by number.
    """

    core_fraction = 0.0

    frames: dict[int, Path]
    guides: GuideReader
    folder: Path

    def core_steps(self) -> Steps[None]:
        """Do nothing; loading files needs Blender."""
        yield Progress(0.0, "Reading frames")

    def scene_steps(self, core_result: None) -> Steps[str]:
        """Restore all frames into the folder, completely or not at all, and load them."""
        base, missing_count, filenames = safe_filename(self.name + results.SUFFIX), 0, []
        with atomic_folder(self.folder) as folder:
            for index, number in enumerate(self.frames):
                steps = self._restore_frame(number, folder, base)
                filename, count = yield from subprogress(steps, index / len(self.frames), (index + 1) / len(self.frames))
                filenames.append(filename)
                missing_count += count
            self.check_any_missing(missing_count)
        source = self.find_source()
        image = results.load_sequence(source, self.folder / filenames[0])
        return self.finish(source, image, missing_count)

    def _restore_frame(self, number: int, folder: Path, base: str) -> Steps[tuple[str, int]]:
        """Restore one frame into a file; return the file's name and the number of missing pixels."""
        label, path, count = f"Frame {number}", self.frames[number], 0
        yield Progress(0.0, label)
        with load_frame(self.find_source(), path) as frame:
            stored, pixel_format = read_pixels(frame), read_format(frame)
        guides = self.guides.read(number, stored.shape, label)
        if guides is not None:
            steps = self.restore_pixels(stored, pixel_format, guides, label)
            stored, count = yield from subprogress(steps, 0.0, 0.95)
        digits = max(MIN_DIGITS, len(str(max(self.frames))))
        filename = f"{base}_{number:0{digits}}.{EXTENSIONS[pixel_format.is_float]}"
        save_pixels(stored, folder / filename, is_float=pixel_format.is_float)
        return filename, count
