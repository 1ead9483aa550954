"""The job for image sequences: restores the frames one after the other into files."""

from dataclasses import dataclass
from pathlib import Path

from ...bridge.imaging.images import read_pixels
from ...bridge.restore import results
from ...bridge.restore.image_pixels import read_format
from ...bridge.restore.image_sources import load_frame
from ...core.files.atomic_write import atomic_folder
from ...core.files.filenames import safe_filename
from ...core.jobs.progress import Progress, Steps, subprogress
from .guides import GuideReader
from .job import RestoreJob, check_any_missing

MIN_DIGITS = 4  # of the frame numbers in names of files


@dataclass
class SequenceJob(RestoreJob):
    """Restores the frames of an image sequence into files, which a new sequence reads.

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
            check_any_missing(self.name, missing_count)
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
        filename = results.frame_filename(base, number, digits, pixel_format.is_float)
        with load_frame(self.find_source(), path) as frame:
            results.save_frame(frame, stored, folder / filename)
        return filename, count
