"""Finds the files of photographs and their masks by the names in files with cameras.

Programs write names with folders of another computer, without extension, with that of a raw image, or in another case than the file.
"""

import os
import unicodedata
from collections.abc import Callable
from pathlib import Path, PurePosixPath

from ...core.errors import FileError
from ...core.files.file_access import has_companion
from ..imaging.image_files import EXTENSIONS

RAW_EXTENSIONS = ("dng", "cr2", "cr3", "nef", "arw", "raf", "orf", "rw2", "pef", "srw", "3fr", "iiq", "raw")
OTHER_EXTENSIONS = ("jpe", "bmp", "webp", "heic", "heif", "avif", "jp2", "jxl", "tga", "gif")
IMAGE_EXTENSIONS = {*EXTENSIONS, *(f".{each}" for each in RAW_EXTENSIONS + OTHER_EXTENSIONS)}  # another one may take their place
MAX_DEPTH = 32  # folders of a name, from the last one on, that may be folders here
MASK_SUFFIXES = (".png", "_mask.png")  # the latter is that of Metashape


class PhotoFolder:
    """A folder with photographs or masks. Lists the files of each of its folders once, when a name does not fit exactly."""

    def __init__(self, folder: Path) -> None:
        """Read nothing yet."""
        self.folder = folder
        self._listings: dict[Path, dict[str, str]] = {}
        self._names: dict[Path, str] = {}

    def find_photograph(self, name: str) -> Path:
        """Return the path of the photograph `name`, which may lie without some of its folders, have another extension or case, or an
        extension that the name lacks.

        Raises:
            FileError: there is no such file, or it is that of another name already.
        """
        found = self._find(name, _photograph_names) or _find_exactly(self.folder, name)  # an absolute path, or one with ..
        if found is None:
            raise FileError(
                f'There is no photograph "{name:.200}" in "{self.folder}"; name the folder with the images that the cameras were computed '
                "from."
            )
        other = self._names.setdefault(found, name)
        if other != name:
            raise FileError(
                f'The photographs "{other}" and "{name}" are both "{found}"; give their files different names, or name the folder above.'
            )
        return found

    def find_mask(self, name: str) -> Path | None:
        """Return the mask of the photograph `name`, None if there is none: NAME.jpg.png, NAME.png or NAME_mask.png."""
        return self._find(name, _mask_names)

    def _find(self, name: str, candidates_of: Callable[[str], list[str]]) -> Path | None:
        found = PurePosixPath(name.replace("\\", "/")).parts[-MAX_DEPTH:]
        parts = [part for part in found if part not in ("/", "..") and not part.endswith(":")]
        for first in range(len(parts)):
            folder = self.folder.joinpath(*parts[first:-1])
            for find in (_find_exactly, self._find_in_listing):
                found = next((path for each in candidates_of(parts[-1]) if (path := find(folder, each)) is not None), None)
                if found is not None:
                    return found
        return None

    def _find_in_listing(self, folder: Path, name: str) -> Path | None:
        if folder not in self._listings:
            self._listings[folder] = _list_files(folder)
        found = self._listings[folder].get(_comparison_key(name))
        return None if found is None else folder / found


def strip_extension(name: str) -> str:
    """Return the name of a photograph without folders and without the extension of an image, if it has one."""
    last = PurePosixPath(name).name
    stem, extension = os.path.splitext(last)  # noqa: PTH122 - the name of a path would lose a dot at its end
    return stem if extension.lower() in IMAGE_EXTENSIONS else last


def _find_exactly(folder: Path, name: str) -> Path | None:
    path = folder / name
    return path if has_companion(path) else None


def _photograph_names(name: str) -> list[str]:
    """Return the file names that a photograph may have."""
    stem = strip_extension(name)
    return [name, *(name + each for each in EXTENSIONS), *(stem + each for each in EXTENSIONS if stem != name)]


def _mask_names(name: str) -> list[str]:
    """Return the file names that the mask of a photograph may have."""
    stem = strip_extension(name)
    stems = [name, stem] if stem != name else [name, *(name + each for each in EXTENSIONS)]
    return [each + suffix for each in stems for suffix in MASK_SUFFIXES]


def _list_files(folder: Path) -> dict[str, str]:
    """Return the names of files in a folder by keys that ignore case; of names that differ in nothing else, the first one."""
    try:
        names = sorted(os.listdir(folder), reverse=True)  # noqa: PTH208 - no paths are needed
    except (OSError, ValueError):
        return {}
    return {_comparison_key(name): name for name in names if has_companion(folder / name)}


def _comparison_key(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()
