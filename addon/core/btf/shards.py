"""Sightings on disk, one file a view, so that a bake that was stopped goes on from what stands."""

import hashlib
import io
import json
import uuid
import zipfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FileError
from .fragments import Fragments
from .photographs import Photograph
from .texels import Sighting

JOB = "job.json"
LAYOUT = 5  # of the files: a folder that an earlier one filled is another bake's
PART = ".part"
UNKNOWN = 255  # in bytes of what suns reach
DIGEST = hashlib.sha256().digest_size


@dataclass(frozen=True)
class ShardStore:
    """The views of one bake in `folder`. Files appear whole or not at all; a digest before the arrays tells damaged ones."""

    folder: Path

    def open(self, fingerprint: str) -> None:
        """Make the folder, or make sure that what is in it belongs to the bake with this `fingerprint`.

        Raises:
            FileError: when it is another bake's or cannot be written.
        """
        job, fingerprint = self.folder / JOB, f"{fingerprint} layout={LAYOUT}"
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
        return self.folder / f"view-{view:04d}.shard"

    def remove_parts(self) -> None:
        """Remove what dead processes have left unfinished; nobody may be writing here now."""
        self._remove(f"*{PART}")

    def keeps(self, view: int) -> bool:
        """Whether a view stands; what is left of a damaged one is removed, so that from then on `has` says the same."""
        standing = self.stands(view)
        if not standing:
            self.path(view).unlink(missing_ok=True)
        return standing

    def has(self, view: int) -> bool:
        """Whether a view is finished; `stands` tells whether it is undamaged too."""
        return self.path(view).exists()

    def write(self, view: int, sighting: Sighting, photograph: Photograph, lit: Sequence[np.ndarray], render_seconds: float) -> None:
        """Keep what is known from a view; its picture of faces is needed no longer. What its renders took lies beside it, so that the
        view's own file has the same bytes whoever renders it.

        lit: bytes (N,) of what some suns reach, see `lit_bytes`.

        Raises:
            FileError: when the disk does not take it.
        """
        arrays = {
            "known": np.packbits(sighting.known),
            "coverage": _bytes(sighting.coverage),
            "visible": sighting.visible,
            "parts": sighting.parts,
            "radiance": _half(sighting.radiance),
            "glow": _half(np.zeros((0, 3)) if sighting.glow is None else sighting.glow),
            "photograph": _half(photograph.colours),
            "silhouette": _bytes(photograph.coverage),
            "lit": np.array(lit, np.uint8),
        }
        self._keep(self._figures_path(view), json.dumps({"render_seconds": render_seconds}).encode())
        self._write(self.path(view), np.savez, arrays)
        self._faces_path(view).unlink(missing_ok=True)

    def write_faces(self, view: int, faces: np.ndarray) -> None:
        """Keep the picture of faces (H, W) int32 of a view until its other pictures are there. Raises FileError like `write`."""
        self._write(self._faces_path(view), np.savez_compressed, {"faces": faces})

    def read_faces(self, view: int) -> np.ndarray:
        """What `write_faces` has kept."""
        return self._read(self._faces_path(view), "faces")[0]

    def write_rest(self, view: int, visible: np.ndarray, rest: np.ndarray) -> None:
        """Keep what is left of the colours of texels `visible` (M,), (M, L * 3), for the time of compression. Raises like `write`."""
        self._write(self._rest_path(view), np.savez, {"visible": visible, "rest": _half(rest)})

    def read_rest(self, view: int) -> tuple[np.ndarray, np.ndarray]:
        """What `write_rest` has kept; raises like `read`."""
        visible, rest = self._read(self._rest_path(view), "visible", "rest")
        return visible, rest

    def remove_rests(self) -> None:
        """Remove what `write_rest` has kept."""
        self._remove("rest-*.shard")

    def write_look(self, view: int, fragments: Fragments, colours: np.ndarray) -> None:
        """Keep what rays of a view meet and the `colours` (F, D) float16 of that, for the time of refinement. Raises like `write`."""
        arrays = {"rays": np.array(fragments.rays), "ray": fragments.ray, "texels": fragments.texels, "shares": fragments.shares}
        self._write(self._look_path(view), np.savez, {**arrays, "colours": colours})

    def read_look(self, view: int) -> tuple[Fragments, np.ndarray]:
        """What `write_look` has kept; raises like `read`."""
        rays, ray, texels, shares, colours = self._read(self._look_path(view), "rays", "ray", "texels", "shares", "colours")
        return Fragments(int(rays), ray, texels, shares), colours

    def remove_looks(self) -> None:
        """Remove what `write_look` has kept."""
        self._remove("look-*.shard")

    def read(self, view: int, *names: str) -> list[np.ndarray]:
        """Some of what `write` has kept of a view, as it lies in its file: known, coverage, visible, parts, radiance.

        Raises:
            FileError: when the file is gone or damaged.
        """
        return self._read(self.path(view), *names)

    def lit(self, views: int) -> np.ndarray:
        """What suns reach: bytes (D, N), see `lit_bytes`. They lie with all `views` in turn; raises like `read`."""
        parts = [self.read(view, "lit")[0] for view in range(views)]
        made = np.empty((sum(map(len, parts)), parts[0].shape[1]), np.uint8)
        for view, part in enumerate(parts):
            made[view::views] = part
        return made

    def glow(self, view: int) -> tuple[np.ndarray, np.ndarray]:
        """Texels (M,) of a view and what they shine by themselves (M, 3) float32, none where nothing does; raises like `read`."""
        visible, glow = self.read(view, "visible", "glow")
        return visible[: len(glow)], glow.astype(np.float32)

    def photograph(self, view: int) -> Photograph:
        """The photograph that `write` has kept of a view; raises like `read`."""
        colours, coverage = self.read(view, "photograph", "silhouette")
        return Photograph(colours.astype(np.float32), coverage / np.float32(255.0))

    def render_seconds(self, views: int) -> float:
        """What Cycles took for those of all `views` that are finished, also in runs before this one, as far as is known."""
        total = 0.0
        for path in (self._figures_path(view) for view in range(views) if self.has(view)):
            with suppress(OSError, KeyError, TypeError, ValueError):  # a figure that is gone is not worth a view
                total += float(json.loads(path.read_bytes())["render_seconds"])
        return total

    def _remove(self, pattern: str) -> None:
        for path in self.folder.glob(pattern):
            path.unlink(missing_ok=True)

    def _figures_path(self, view: int) -> Path:
        return self.folder / f"view-{view:04d}.json"

    def _faces_path(self, view: int) -> Path:
        return self.folder / f"faces-{view:04d}.shard"

    def _look_path(self, view: int) -> Path:
        return self.folder / f"look-{view:04d}.shard"

    def _rest_path(self, view: int) -> Path:
        return self.folder / f"rest-{view:04d}.shard"

    def _read(self, path: Path, *names: str) -> list[np.ndarray]:
        try:
            with zipfile.ZipFile(path) as file:  # finds its arrays behind the digest, and reads no others
                return [_array(file, name) for name in names]
        except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise FileError(f'The file "{path}" of a bake cannot be read: {error}. Bake again; views that stand are kept.') from error

    def _write(self, path: Path, save: Callable[..., None], arrays: dict[str, np.ndarray]) -> None:
        buffer = io.BytesIO()
        save(buffer, **arrays)
        content = buffer.getvalue()
        self._keep(path, hashlib.sha256(content).digest() + content)

    def _keep(self, path: Path, content: bytes) -> None:
        try:
            _write_whole(path, content)
        except OSError as error:
            raise FileError(f'A finished view cannot be kept in "{self.folder}": {error}. Free some space there and resume.') from error

    def stands(self, view: int) -> bool:
        """Whether a view is finished and undamaged."""
        try:
            content = self.path(view).read_bytes()
        except OSError:
            return False
        return hashlib.sha256(content[DIGEST:]).digest() == content[:DIGEST]

    def bytes(self, views: int) -> int:
        """What the files of all `views` take."""
        return sum(self.path(view).stat().st_size for view in range(views) if self.has(view))


def lit_bytes(own: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """The share (N,) of texels that a sun reaches, 0 to 254, where it sees `own` (N,) parts and others are `hidden`; else UNKNOWN."""
    parts = own + hidden
    return np.where(parts > 0.0, np.rint((UNKNOWN - 1) * own / np.maximum(parts, 1.0)), UNKNOWN).astype(np.uint8)


def _write_whole(path: Path, content: bytes) -> None:
    temporary = path.with_suffix(f".{uuid.uuid4().hex}{PART}")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def _array(file: zipfile.ZipFile, name: str) -> np.ndarray:
    """One of the arrays that `numpy.savez` has put into `file`."""
    with file.open(f"{name}.npy") as member:
        return np.lib.format.read_array(member, allow_pickle=False)


def _half(values: np.ndarray) -> np.ndarray:
    largest = np.finfo(np.float16).max
    return np.clip(values, -largest, largest).astype(np.float16)


def _bytes(shares: np.ndarray) -> np.ndarray:
    return np.rint(255.0 * np.clip(shares, 0.0, 1.0)).astype(np.uint8)
