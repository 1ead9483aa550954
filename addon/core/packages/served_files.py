"""The files of a package that a web server may send, and the range of a file that a request asks for.

They are listed and opened once, when the server starts: requests select one of them by name and never open a file.
"""

import gzip
import hashlib
import io
import os
import re
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from ..errors import FileError
from ..files.file_access import error_reason
from .files import INDEX, LEVELS_GLB, read_page
from .manifest import MANIFEST, MESH, TEXTURES, read_manifest

LOOPBACK = "127.0.0.1"
OWN_NAMES = (LOOPBACK, "localhost")
HEADERS = {"Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff"}
PRIVATE_HEADERS = HEADERS | {"Cross-Origin-Resource-Policy": "same-origin"}
SINGLE_RANGE = re.compile(r"bytes=[ \t]*(\d{0,18})-(\d{0,18})[ \t]*", re.IGNORECASE | re.ASCII)

TEXT_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
}
CONTENT_TYPES = TEXT_TYPES | {".bin": "application/octet-stream", ".glb": "model/gltf-binary"}
READ_BYTES = 2**20


@dataclass(frozen=True, eq=False)
class PackageFile:
    """An open file.

    Attributes:
        size: in bytes.
        content_type: MIME type.
        digest: hexadecimal SHA-256.
        compressed: gzip of the file, None for files that are sent in ranges.
        handle: of the file.
    """

    size: int
    content_type: str
    digest: str
    compressed: bytes | None
    handle: BinaryIO

    def read(self, offset: int, size: int) -> bytes:
        """Return `size` bytes at `offset`; fewer if the file has been truncated since the start."""
        self.handle.seek(offset)
        return self.handle.read(size)


def open_package(folder: Path) -> dict[str, PackageFile]:
    """Return the files of the package in `folder` by the path of their URL, open for reading: manifest.json, mesh.bin, textures.bin and
    levels.glb; and the page of this Farfield, whatever page the folder has. Links and everything else in the folder are left out.

    Raises:
        FileError: the manifest is damaged, a file is missing, cannot be read, or has another size than the manifest says.
    """
    manifest = read_manifest(folder)
    paths: dict[str, Path] = {}
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name in (MANIFEST, MESH, TEXTURES, LEVELS_GLB) and entry.is_file(follow_symlinks=False):
                    paths[entry.name] = folder / entry.name
    except OSError as error:
        raise FileError(f'The folder "{folder}" cannot be read ({error_reason(error)}); choose the folder of a package.') from error
    files = {name: _to_file(io.BytesIO(content), Path(name).suffix) for name, content in read_page(manifest.mirrors).items()}
    try:
        for name, path in paths.items():
            files[name] = _open_file(path)
        for name, (size, _) in manifest.files.items():
            if name in (MESH, TEXTURES) and (name not in files or files[name].size != size):
                raise FileError(f'"{folder / name}" is missing or does not have {size} bytes; export the package again.')
        if MANIFEST not in files:
            raise FileError(f'"{folder / MANIFEST}" is a link; copy the package instead of linking to its files.')
    except FileError:
        close_package(files)
        raise
    return {f"/{name}": file for name, file in files.items()} | {"/": files[INDEX]}


def close_package(files: Mapping[str, PackageFile]) -> None:
    """Close all files."""
    for file in files.values():
        file.handle.close()


def read_range(header: str, size: int) -> tuple[int, int] | None:
    """Return first byte and end of the range that a Range header asks of a file with `size` bytes; None for the whole file, which also
    answers several ranges and headers that are not valid (RFC 9110, 14.2). The range is empty if the file has none of its bytes."""
    match = SINGLE_RANGE.fullmatch(header)
    if match is None or not (match[1] or match[2]):
        return None
    if not match[1]:
        return max(size - int(match[2]), 0), size
    first, last = int(match[1]), int(match[2]) if match[2] else size - 1
    if match[2] and last < first:
        return None
    return min(first, size), min(last + 1, size)


def _open_file(path: Path) -> PackageFile:
    """Raise FileError if `path` is no regular file or cannot be read."""
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
        handle = os.fdopen(descriptor, "rb")
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            handle.close()
            raise FileError(f'"{path}" is no file; export the package again.')
        return _to_file(handle, path.suffix)
    except OSError as error:
        raise FileError(f'"{path}" cannot be read ({error_reason(error)}); check its permissions.') from error


def _to_file(handle: BinaryIO, suffix: str) -> PackageFile:
    digest, size = hashlib.sha256(), 0
    while block := handle.read(READ_BYTES):
        digest.update(block)
        size += len(block)
    compressed = None
    if suffix in TEXT_TYPES:
        handle.seek(0)
        compressed = gzip.compress(handle.read(), 9, mtime=0)
    return PackageFile(size, CONTENT_TYPES[suffix], digest.hexdigest(), compressed, handle)
