"""The jobs of the operator: what they have in common, the job for images and their UDIM tiles, and the job for image sequences."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import compress, pairwise
from pathlib import Path
from typing import NamedTuple

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
from ...core.messages import format_count, list_first, quote_names
from ...core.restore.restoration import restore
from ...core.restore.settings import MaskSettings, RestoreSettings
from .. import image_editors
from .guides import UNTILED, GuideReader, Guides, find_missing

MIN_DIGITS = 4  # digits of the frame numbers in names of files


class Map(NamedTuple):
    """An image that is restored: its name, its session UID, and whether it holds normals."""

    name: str
    uid: int
    is_normal_map: bool

    def find(self) -> bpy.types.Image:
        """Return the image. Raises ImageError if it was removed in the meantime."""
        image = find_by_uid(bpy.data.images, self.uid)
        if image is None:
            raise ImageError(f'The image "{self.name}" was removed while it was being restored; nothing was changed.')
        return image


@dataclass
class RestoreJob:
    """What restorations of all kinds of images have in common.

    Attributes:
        maps: the image, and the other maps that are restored with it.
        settings: how they are restored.
        masks: where pixels are missing, and where the results go.
        editor: the Image Editor that shows the result, see `image_editors`.
        replaces_results: whether the newest results of the maps are replaced, where nothing has happened to them since.
    """

    maps: list[Map]
    settings: RestoreSettings
    masks: MaskSettings
    editor: int
    replaces_results: bool

    def restore_pixels(self, stored: list[np.ndarray], formats: list[PixelFormat], guides: Guides, part: str) -> Steps[int]:
        """Restore the missing pixels of the stored values (H, W, 4) of all maps in place, and return the number of missing pixels.

        part: names a tile or frame in messages; such a part may have no missing pixels. Raises ImageError.
        """
        mask = guides.mask
        if mask is None:
            mask = find_missing(stored[0], to_display(stored[0], formats[0]), self.masks)
        if part and not mask.any():
            return 0
        stacks, starts = [], [0]
        for values, pixel_format, each in zip(stored, formats, self.maps, strict=True):
            may_be_gray = bool(stacks) and not each.is_normal_map
            stacks.append(_select_channels(to_display(values, pixel_format), mask, may_be_gray=may_be_gray))
            starts.append(starts[-1] + stacks[-1].shape[2])
        is_normal_map = [each.is_normal_map for each in self.maps]
        image = stacks[0] if len(stacks) == 1 else np.concatenate(stacks, axis=2)
        del stacks
        steps = restore(
            image,
            mask,
            self.settings,
            source_mask=guides.source_mask,
            barriers=guides.barriers,
            is_color=not formats[0].is_data and not is_normal_map[0],
            further_maps=tuple(starts[1:-1]),
            normal_channels=tuple(compress(starts, is_normal_map)),
        )
        try:
            restored = (yield from steps).pixels[mask]
        except ImageError as error:
            raise ImageError(f"{part}: {error}" if part else str(error)) from error
        for values, pixel_format, (start, stop) in zip(stored, formats, pairwise(starts), strict=True):
            values[mask] = to_stored(_complete_channels(restored[:, start:stop]), pixel_format)
        return len(restored)

    def check_any_missing(self, missing_count: int) -> None:
        """Raise ImageError if no pixel of the image is missing."""
        if missing_count == 0:
            raise ImageError(f'No pixel of "{self.maps[0].name}" is marked as missing; paint the mask or change the settings of the mask.')

    def finish(self, images: list[bpy.types.Image], missing_count: int, remark: str = "") -> str:
        """Connect the new `images` with the images of the maps, replace these and show the first one; return the message for the user.

        remark: added to its first sentence.
        """
        sources, skipped = [each.find() for each in self.maps], []
        formers = [image_users.find_replaceable(source) if self.replaces_results else None for source in sources]
        for source, image in zip(sources, images, strict=True):
            image[image_users.ORIGINAL_PROPERTY] = source
            image_editors.remember_former(image, source)
            skipped += image_users.replace_image(source, image) if self.masks.replace_in_materials else []
            image.use_fake_user = image.users == 0
        image_editors.show_image(self.editor, images[0])
        for image, former in zip(images, formers, strict=True):
            if former is not None:
                image_users.take_place(former, image)
            if self.replaces_results:
                image_users.mark_replaceable(image)
        remark += ", in place of the result before" if formers[0] is not None else ""
        message = f'Restored {format_count(missing_count, "pixel")} of "{sources[0].name}" as "{images[0].name}"{remark}.'
        if skipped:
            message += f" Not replaced in linked or overridden data: {quote_names(dict.fromkeys(skipped))}."
        return message


@dataclass
class ImageJob(RestoreJob):
    """Restores an image, or all tiles of a tiled one, and further maps of the same size, as packed images.

    Attributes:
        tiles: stored values (H, W, 4) by tile number, for each map; they change.
        formats: of each map.
        guides: by tile number; tiles without are complete.
        left_out: why other images of the material are not restored, by their names.
    """

    core_fraction = 0.97

    tiles: list[dict[int, np.ndarray]]
    formats: list[PixelFormat]
    guides: Mapping[int, Guides]
    left_out: Mapping[str, str]

    def core_steps(self) -> Steps[int]:
        """Restore every tile of all maps, and return the number of missing pixels."""
        missing_count, total = 0, len(self.tiles[0])
        for index, number in enumerate(self.tiles[0]):
            yield Progress(index / total, "Reading pixels")
            if number in self.guides:
                part = "" if number == UNTILED else f"Tile {number}"
                steps = self.restore_pixels([tiles[number] for tiles in self.tiles], self.formats, self.guides[number], part)
                missing_count += yield from subprogress(steps, index / total, (index + 1) / total)
        self.check_any_missing(missing_count)
        return missing_count

    def scene_steps(self, core_result: int) -> Steps[str]:
        """Create the new images, all of them or none."""
        images: list[bpy.types.Image] = []
        with ExitStack() as undo:
            for index, (each, tiles) in enumerate(zip(self.maps, self.tiles, strict=True)):
                yield Progress(index / len(self.maps), "Creating images")
                images.append(results.create_result(each.find(), tiles))
                undo.callback(bpy.data.images.remove, images[-1])
            message = self.finish(images, core_result, self._describe_maps())
            undo.pop_all()
        return message

    def _describe_maps(self) -> str:
        """Return how many maps were restored with the image, and which others were not."""
        if not self.masks.all_maps_of_material:
            return ""
        count = len(self.maps) - 1
        restored = f", with {format_count(count, 'other map') if count else 'no other map'} of its material"
        left_out = [f'"{name}" ({reason})' for name, reason in self.left_out.items()]
        return restored + (f"; left out: {list_first(left_out)}" if left_out else "")


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
        base, missing_count, filenames = safe_filename(self.maps[0].name + results.SUFFIX), 0, []
        with atomic_folder(self.folder) as folder:
            for index, number in enumerate(self.frames):
                steps = self._restore_frame(number, folder, base)
                filename, count = yield from subprogress(steps, index / len(self.frames), (index + 1) / len(self.frames))
                filenames.append(filename)
                missing_count += count
            self.check_any_missing(missing_count)
        return self.finish([results.load_sequence(self.maps[0].find(), self.folder / filenames[0])], missing_count)

    def _restore_frame(self, number: int, folder: Path, base: str) -> Steps[tuple[str, int]]:
        """Restore one frame into a file; return the file's name and the number of missing pixels."""
        label, path, count = f"Frame {number}", self.frames[number], 0
        yield Progress(0.0, label)
        with load_frame(self.maps[0].find(), path) as frame:
            stored, pixel_format = read_pixels(frame), read_format(frame)
        guides = self.guides.read(number, stored.shape, label)
        if guides is not None:
            steps = self.restore_pixels([stored], [pixel_format], guides, label)
            count = yield from subprogress(steps, 0.0, 0.95)
        digits = max(MIN_DIGITS, len(str(max(self.frames))))
        filename = f"{base}_{number:0{digits}}.{EXTENSIONS[pixel_format.is_float]}"
        save_pixels(stored, folder / filename, is_float=pixel_format.is_float)
        return filename, count


def _select_channels(display: np.ndarray, mask: np.ndarray, *, may_be_gray: bool) -> np.ndarray:
    """Return the channels of `display` (H, W, 4) that are restored: colors, or one of them if they are equal and `may_be_gray`, and alpha
    unless all known pixels are opaque."""
    known = ~mask
    is_gray = may_be_gray and all(np.array_equal(display[known, 0], display[known, channel]) for channel in (1, 2))
    channels = display[..., ::3] if is_gray else display
    has_alpha = (display[..., 3] != 1.0)[known].any()
    return np.ascontiguousarray(channels if has_alpha else channels[..., :-1])


def _complete_channels(pixels: np.ndarray) -> np.ndarray:
    """Return colors and alpha (P, 4) of `pixels` (P, C) that have the channels from `_select_channels`."""
    has_alpha = pixels.shape[1] % 2 == 0
    completed = np.ones((len(pixels), 4), np.float32)
    completed[:, :3] = pixels[:, :-1] if has_alpha else pixels
    if has_alpha:
        completed[:, 3] = pixels[:, -1]
    return completed
