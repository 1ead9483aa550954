"""Packages on the disk: written completely or not at all, and checked when they are read."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import FileError
from ...files.atomic_write import atomic_folder
from ...files.file_access import convert_os_errors
from .increments import Increments, decode_increments
from .manifest import MANIFEST, MESH, TEXTURES, Manifest
from .manifest_json import encode_manifest, read_manifest
from .page_files import read_page

LEVELS_GLB = "levels.glb"


@dataclass(frozen=True, eq=False)
class PackageContent:
    """The checked content of a package. mesh, textures: the bytes of their files."""

    manifest: Manifest
    increments: Increments
    mesh: bytes
    textures: bytes


def write_package(manifest: Manifest, contents: dict[str, bytes], folder: Path) -> None:
    """Write a package with the page that shows it into `folder`; files of an earlier package are replaced, all or none.

    Args:
        contents: the bytes of the files by name, those of `manifest.files` included.

    Raises:
        FileError: a file cannot be written.
    """
    with atomic_folder(folder) as temporary:
        for name, content in contents.items():
            (temporary / name).write_bytes(content)
        for name, content in read_page().items():
            (temporary / name).write_bytes(content)
        (temporary / MANIFEST).write_bytes(encode_manifest(manifest))


def describe_file(content: bytes) -> tuple[int, str]:
    """Return the size and the SHA-256 of a file, as manifests list them."""
    return len(content), hashlib.sha256(content).hexdigest()


def read_package(folder: Path) -> PackageContent:
    """Read a package and check every byte of it.

    Raises:
        FileError: it is incomplete, damaged, of a newer version, or the manifest contradicts its files.
    """
    manifest = read_manifest(folder)
    contents = {name: _read_file(folder / name, manifest) for name in (MESH, TEXTURES)}
    textures = contents[TEXTURES]
    increments = decode_increments(manifest.increments.read(textures, TEXTURES), manifest)
    _check_increments(manifest, increments, textures)
    return PackageContent(manifest, increments, contents[MESH], textures)


def _read_file(path: Path, manifest: Manifest) -> bytes:
    size, digest = manifest.files[path.name]
    with convert_os_errors(f'Cannot read "{path}"'):
        if not path.is_file():
            raise FileError(f'The package lacks "{path.name}"; copy the whole folder again.')
        if path.stat().st_size != size:
            raise FileError(f'"{path.name}" has {path.stat().st_size:,} bytes instead of {size:,}; copy the whole package again.')
        content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != digest:
        raise FileError(f'"{path.name}" is damaged: its checksum differs from that in manifest.json; copy the whole package again.')
    return content


def _check_increments(manifest: Manifest, increments: Increments, textures: bytes) -> None:
    """Raise FileError if an increment differs from its checksum."""
    stored = np.frombuffer(manifest.checksums.read(textures, TEXTURES), "<u4")
    found = increments.compute_checksums(memoryview(textures)[manifest.first_increment :])
    if not np.array_equal(stored, found):
        raise FileError(f'"{TEXTURES}" of the package has increments that differ from their checksums; export the package again.')
