"""Finished views on disk, one file per view, from which an interrupted bake resumes. They may come from anyone, so they are checked."""

import json
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...imaging.images import to_bytes
from ...jobs.job_folder import open_job_folder, remove_temporary_files
from .observations import SUBSAMPLES, Observation, ReferenceImage
from .shard_files import ViewFiles, to_half, write_view_file

FORMAT_VERSION = 8  # A folder written with another version of the files belongs to another bake.
ARRAYS = (
    "known",
    "coverage",
    "visible",
    "subsample_counts",
    "radiance",
    "emission",
    "reference_colors",
    "reference_coverage",
    "visibility",
)
HALF_FLOAT_EXPONENT = 0x7C00  # All bits of the exponent are set in infinities and NaN.


@dataclass(frozen=True)
class ShardLayout:
    """What determines the shapes of the arrays of a finished view.

    Attributes:
        texel_count: Number of texels.
        image_count: Number of renders that are stored per texel.
        reference_count: Number of colors of the reference image.
        resolution: Pixels per side of a render.
        view_count: Number of view directions of the whole bake.
        shadow_count: Number of its shadow directions.
    """

    texel_count: int
    image_count: int
    reference_count: int
    resolution: int
    view_count: int
    shadow_count: int

    def matches(self, view: int, arrays: Sequence[np.ndarray]) -> bool:
        """Whether `arrays`, in the order of ARRAYS, have the dtypes, shapes and ranges of those of a view, see `ShardStore.write`."""
        known, coverage, visible, subsample_counts, radiance, emission, reference_colors, reference_coverage, visibility = arrays
        texels, visible_count, side = self.texel_count, visible.size, self.resolution
        shadows_of_view = len(range(view, self.shadow_count, self.view_count))
        expected = (
            (known, np.uint8, (-(-texels // 8),)),
            (coverage, np.uint8, (texels,)),
            (visible, np.int32, (visible_count,)),
            (subsample_counts, np.uint8, (visible_count,)),
            (radiance, np.float16, (self.image_count, visible_count, 3)),
            (emission, np.float16, (visible_count if emission.size else 0, 3)),
            (reference_colors, np.float16, (self.reference_count, side, side, 3)),
            (reference_coverage, np.uint8, (side, side)),
            (visibility, np.uint8, (shadows_of_view, texels)),
        )
        if any(array.dtype != dtype or array.shape != shape for array, dtype, shape in expected):
            return False
        if visible_count and (visible[0] < 0 or visible[-1] >= texels or (np.diff(visible) <= 0).any()):
            return False
        if (subsample_counts > SUBSAMPLES**2).any():
            return False
        return all(_is_finite(array) for array in (radiance, emission, reference_colors))


def _is_finite(values: np.ndarray) -> bool:
    """Whether all `values` float16 are finite. Faster than `np.isfinite`, which converts them."""
    bits = np.ascontiguousarray(values).view(np.uint16)
    return not ((bits & HALF_FLOAT_EXPONENT) == HALF_FLOAT_EXPONENT).any()


@dataclass(frozen=True)
class ShardStore:
    """The finished views of one level of a bake in `folder`. Views that do not match the `layout`, if it is known, count as damaged."""

    folder: Path
    layout: ShardLayout | None = None

    @property
    def face_ids(self) -> ViewFiles:
        """The ID buffers of unfinished views: `face_ids` (H, W) int32."""
        return ViewFiles(self.folder, "face-ids")

    def open(self, fingerprint: str) -> None:
        """Create the folder, or check that it belongs to the bake with this `fingerprint`.

        Raises:
            FileError: the folder belongs to another bake or cannot be written.
        """
        open_job_folder(self.folder, f"{fingerprint} format={FORMAT_VERSION}", "a bake of another cloud or with other settings")

    def path(self, view: int) -> Path:
        """Return the path of the file of a view."""
        return self._files.path(view)

    def remove_temporary_files(self) -> None:
        """Delete the unfinished files of dead processes. No process may be writing to the folder."""
        remove_temporary_files(self.folder)

    def validate_or_remove(self, view: int) -> bool:
        """Return whether a view is finished and undamaged. A damaged file is deleted, so that `exists` agrees from then on.

        Raises:
            FileError: it cannot be deleted.
        """
        is_valid = self.is_valid(view)
        if not is_valid:
            self._files.remove(view)
        return is_valid

    def exists(self, view: int) -> bool:
        """Whether a view is finished; its file may be damaged, see `is_valid`."""
        return self.path(view).is_file()

    def is_valid(self, view: int) -> bool:
        """Whether a view is finished and undamaged: its checksum is right, and its arrays match the layout if it is known."""
        if self.layout is None:
            return self._files.read_valid(view) is not None
        arrays = self._files.read_valid(view, *ARRAYS)
        return arrays is not None and self.layout.matches(view, arrays)

    def write(
        self, view: int, observation: Observation, reference: ReferenceImage, visibility: Sequence[np.ndarray], render_seconds: float
    ) -> None:
        """Write a finished view and delete its ID buffer.

        The render time goes to a file of its own: the view's file has the same bytes on every machine.

        visibility: bytes (N,) for each light whose shadows are captured along with this view, see `encode_visibility`.

        Raises:
            FileError: the file cannot be written.
        """
        arrays = {
            "known": np.packbits(observation.known),
            "coverage": to_bytes(observation.coverage),
            "visible": observation.visible,
            "subsample_counts": observation.subsample_counts,
            "radiance": to_half(observation.radiance),
            "emission": to_half(np.zeros((0, 3)) if observation.emission is None else observation.emission),
            "reference_colors": to_half(reference.colors),
            "reference_coverage": to_bytes(reference.coverage),
            "visibility": np.array(visibility, np.uint8).reshape(len(visibility), len(observation.known)),
        }
        write_view_file(self._timing_path(view), json.dumps({"render_seconds": render_seconds}).encode())
        self._files.write(view, arrays)
        self.face_ids.remove(view)

    def read(self, view: int, *names: str) -> list[np.ndarray]:
        """Return the arrays called `names` of a view, as `write` stores them: known, coverage, visible, subsample_counts, radiance.

        Raises:
            FileError: the file is missing or damaged.
        """
        return self._files.read(view, *names)

    def read_visibility(self, view_count: int) -> np.ndarray:
        """Return the visibility bytes (D, N) of all lights; view v holds the lights v, v + view_count, ... Raises FileError."""
        by_view = [self.read(view, "visibility")[0] for view in range(view_count)]
        visibility = np.empty((sum(map(len, by_view)), by_view[0].shape[1]), np.uint8)
        for view, rows in enumerate(by_view):
            visibility[view::view_count] = rows
        return visibility

    def read_emission(self, view: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the visible texels (M,) of a view and their emission (M, 3) float32; M is 0 without emission. Raises FileError."""
        visible, emission = self.read(view, "visible", "emission")
        return visible[: len(emission)], emission.astype(np.float32)

    def read_reference(self, view: int) -> ReferenceImage:
        """Return the reference image of a view. Raises FileError."""
        colors, coverage = self.read(view, "reference_colors", "reference_coverage")
        return ReferenceImage(colors.astype(np.float32), coverage / np.float32(255.0))

    def render_seconds(self, view_count: int) -> float:
        """Return the Cycles render time of all finished views, those of earlier runs included, as far as it is known."""
        total = 0.0
        for path in (self._timing_path(view) for view in range(view_count) if self.exists(view)):
            with suppress(OSError, KeyError, TypeError, ValueError, RecursionError):  # A missing time is not an error.
                seconds = float(json.loads(path.read_bytes())["render_seconds"])
                total += seconds if math.isfinite(seconds) else 0.0
        return total

    def total_bytes(self, view_count: int) -> int:
        """Return the total size of the files of all finished views."""
        return sum(self.path(view).stat().st_size for view in range(view_count) if self.exists(view))

    @property
    def _files(self) -> ViewFiles:
        return ViewFiles(self.folder, "view")

    def _timing_path(self, view: int) -> Path:
        return self.folder / f"view-{view:04d}.json"
