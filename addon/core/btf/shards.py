"""Sightings on disk, one file a view, so that a bake that was stopped goes on from what stands."""

import json
import os
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FileError
from .texels import Sighting

JOB = "job.json"


@dataclass(frozen=True)
class ShardStore:
    """The views of one bake in `folder`. Files appear whole or not at all; their checksums (of the zip format) tell damaged ones."""

    folder: Path

    def open(self, fingerprint: str) -> None:
        """Make the folder, or make sure that what is in it belongs to the bake with this `fingerprint`.

        Raises:
            FileError: when it is another bake's or cannot be written.
        """
        job = self.folder / JOB
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if not job.exists():
                _write_whole(job, json.dumps({"fingerprint": fingerprint}).encode())
            standing = json.loads(job.read_text(encoding="utf-8")).get("fingerprint")
        except (OSError, ValueError) as error:
            raise FileError(f'The work folder "{self.folder}" cannot be used: {error}. Choose another one.') from error
        if standing != fingerprint:
            raise FileError(
                f'The work folder "{self.folder}" holds the bake of another cloud, or of other settings; choose another one or empty it.'
            )

    def path(self, view: int) -> Path:
        """Where a view's file is."""
        return self.folder / f"view-{view:04d}.npz"

    def write(self, view: int, sighting: Sighting) -> None:
        """Keep what is known from a view.

        Raises:
            FileError: when the disk does not take it.
        """
        temporary = self.path(view).with_suffix(f".{os.getpid()}.part")
        try:
            with temporary.open("wb") as file:
                np.savez(
                    file,
                    known=np.packbits(sighting.known),
                    coverage=np.rint(255.0 * sighting.coverage).astype(np.uint8),
                    visible=sighting.visible,
                    radiance=np.minimum(sighting.radiance, np.finfo(np.float16).max).astype(np.float16),
                )
            temporary.replace(self.path(view))
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise FileError(f'A finished view cannot be kept in "{self.folder}": {error}. Free some space there and resume.') from error

    def stands(self, view: int) -> bool:
        """Whether a view is finished and undamaged."""
        try:
            with zipfile.ZipFile(self.path(view)) as file:
                return file.testzip() is None
        except (OSError, zipfile.BadZipFile):
            return False

    def bytes(self, views: int) -> int:
        """What the files of all `views` take."""
        return sum(self.path(view).stat().st_size for view in range(views) if self.path(view).exists())


@dataclass(frozen=True)
class Colours:
    """The colours of a view, for `factors.factorise`: a column for every light and channel."""

    store: ShardStore
    view: int

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Visible texels (M,) and (M, L * 3) float32."""
        with np.load(self.store.path(self.view), allow_pickle=False) as file:
            radiance = file["radiance"]
            return file["visible"], np.ascontiguousarray(radiance.swapaxes(0, 1), np.float32).reshape(radiance.shape[1], -1)


@dataclass(frozen=True)
class Silhouettes:
    """The coverage of a view, for `factors.factorise`: one column."""

    store: ShardStore
    view: int

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Known texels (M,) and (M, 1) float32."""
        with np.load(self.store.path(self.view), allow_pickle=False) as file:
            coverage = file["coverage"]
            known = np.flatnonzero(np.unpackbits(file["known"], count=len(coverage)))
            return known, coverage[known, None].astype(np.float32) / 255.0


def _write_whole(path: Path, content: bytes) -> None:
    temporary = path.with_suffix(f".{os.getpid()}.part")
    temporary.write_bytes(content)
    temporary.replace(path)
