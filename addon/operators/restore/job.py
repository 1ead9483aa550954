"""The jobs of the operator: what they have in common, and the job for images and their UDIM tiles."""

from collections.abc import Mapping
from dataclasses import dataclass

import bpy
import numpy as np

from ...bridge.objects import find_by_uid
from ...bridge.restore import image_users, results
from ...bridge.restore.image_pixels import PixelFormat, to_display, to_stored
from ...core.errors import ImageError
from ...core.jobs.progress import Progress, Steps, subprogress
from ...core.restore.restoration import restore
from ...core.restore.settings import MaskSettings, RestoreSettings
from .. import image_editors
from .guides import UNTILED, Guides, find_missing


@dataclass
class RestoreJob:
    """What restorations of all kinds of images have in common.

    name, uid: of the image. editor: the Image Editor that shows the result, see `image_editors`.
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

    def finish(self, source: bpy.types.Image, image: bpy.types.Image, missing_count: int) -> str:
        """Connect the new `image` with its `source`, replace and show it; return the message for the user."""
        image[image_users.ORIGINAL_PROPERTY] = source
        skipped = image_users.replace_image(source, image) if self.masks.replace_in_materials else []
        image.use_fake_user = image.users == 0
        image_editors.show_image(self.editor, image)
        message = f'Restored {missing_count:,} pixels of "{source.name}" as "{image.name}".'
        if skipped:
            names = ", ".join(f'"{name}"' for name in dict.fromkeys(skipped))
            message += f" Not replaced in linked or overridden data: {names}."
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
        check_any_missing(self.name, missing_count)
        return restored, missing_count

    def scene_steps(self, core_result: tuple[dict[int, np.ndarray], int]) -> Steps[str]:
        """Create the new image."""
        yield Progress(0.0, "Creating the image")
        source = self.find_source()
        image = results.create_result(source, core_result[0])
        return self.finish(source, image, core_result[1])


def check_any_missing(name: str, missing_count: int) -> None:
    """Raise ImageError if no pixel of the image `name` is missing."""
    if missing_count == 0:
        raise ImageError(f'No pixel of "{name}" is marked as missing; paint the mask or change the settings of the mask.')
