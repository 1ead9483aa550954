"""Packages on the disk: written completely or not at all, and checked when they are read.

The page that shows a package is three files that any static web server sends with it, made of the modules in the folder page.
"""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FileError
from ..files.atomic_write import atomic_folder
from ..files.file_access import check_writable, convert_os_errors, exists, is_file
from .increments import Increments, decode_increments
from .manifest import MANIFEST, MESH, TEXTURES, Manifest, encode_manifest, find_origin, read_manifest

LEVELS_GLB = "levels.glb"
PAGE_FOLDER = Path(__file__).resolve().parent / "page"
INDEX, STYLE, SCRIPT = "index.html", "style.css", "main.js"
PACKAGE_FILES = (MANIFEST, MESH, TEXTURES, LEVELS_GLB, INDEX, STYLE, SCRIPT)
COMMENT = re.compile(r"^[ \t]*(?://[^\n]*|/\*\*.*?\*/)\n|[ \t]+// [^\n]*", re.MULTILINE | re.DOTALL)
IMPORT = re.compile(r'^import \{ ([^}]+) \} from "\./(\w+)\.js";$', re.MULTILINE)
# Texts, templates without further ones, and regular expressions that begin with ^ keep their spaces; others around signs mean nothing.
KEPT = re.compile(r"""("(?:\\.|[^"\\\n])*"|`(?:\\.|[^`\\])*`|/\^[^\n]*?/(?=\.))""")
SPACES = re.compile(r" *([,;{}()=?:&|<>*!\[\]]) *")
VERSION_LENGTH = 16  # Digits of the SHA-256 in URLs.
POLICY_SOURCES = "connect-src 'self'"  # in the page's Content Security Policy
EXPORT = re.compile(r"^export ((?:async )?(?:function\*?|class|const) (\w+))", re.MULTILINE)


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
        FileError: a file cannot be written, or would replace one that is no part of a package.
    """
    check_package_folder(folder)
    with atomic_folder(folder) as temporary:
        for name, content in contents.items():
            (temporary / name).write_bytes(content)
        for name, content in read_page(manifest.mirrors).items():
            (temporary / name).write_bytes(content)
        (temporary / MANIFEST).write_bytes(encode_manifest(manifest))


def check_package_folder(folder: Path) -> None:
    """Check that a package can be written into `folder`, and that all files that it would replace are those of an earlier package.

    Raises:
        FileError: it cannot, or they are not.
    """
    check_writable(folder / MANIFEST)
    existing = [name for name in PACKAGE_FILES if exists(folder / name)]
    if existing and not _has_manifest(folder):
        raise FileError(f'The folder "{folder}" contains "{existing[0]}", but no package; choose an empty or a new folder.')


def _has_manifest(folder: Path) -> bool:
    try:
        read_manifest(folder)
    except FileError:
        return False
    return True


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
    if not is_file(path):
        raise FileError(f'The package lacks "{path.name}"; copy the whole folder again.')
    with convert_os_errors(f'Cannot read "{path}"'):
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


def read_page(mirrors: Sequence[str] = ()) -> dict[str, bytes]:
    """Return the files of the page by name, for a package with these mirrors: browsers let the page ask them and its own server, and no
    others.

    The URLs of script and style name their content, so that caches may keep them for ever. Modules are joined to one, so that a browser
    waits for fewer responses; comments (` // ` begins one anywhere), indentation, empty lines and spaces around signs are left out."""
    index = re.sub(r'<link rel="modulepreload"[^\n]*\n', "", (PAGE_FOLDER / INDEX).read_text("utf-8"))
    index = index.replace(POLICY_SOURCES, " ".join([POLICY_SOURCES, *dict.fromkeys(find_origin(url) for url in mirrors)]))
    script = COMMENT.sub("", join_modules({path.stem: path.read_text("utf-8") for path in sorted(PAGE_FOLDER.glob("*.js"))}))
    script = "".join(part if number % 2 else SPACES.sub(r"\1", part) for number, part in enumerate(KEPT.split(script)))
    parts = {name: _shorten(text) for name, text in ((STYLE, (PAGE_FOLDER / STYLE).read_text("utf-8")), (SCRIPT, script))}
    for name, content in parts.items():
        index = index.replace(f'"{name}"', f'"{name}?{find_version(describe_file(content)[1])}"')
    return {INDEX: _shorten(index), **parts}


def find_version(digest: str) -> str:
    """Return the query of the URL of a file with this SHA-256: a URL with it has the same content for ever."""
    return digest[:VERSION_LENGTH]


def _shorten(text: str) -> bytes:
    return "".join(f"{line.strip()}\n" for line in text.splitlines() if line.strip()).encode()


def join_modules(modules: dict[str, str]) -> str:
    """Return one JavaScript module that does what the module "main" does. Each of `modules`, by name, becomes a function that is called
    once, after those that it imports, and returns what the module exports."""
    parts: list[str] = []
    joined: set[str] = set()

    def add(name: str) -> None:
        joined.add(name)
        text = modules[name]
        for _, other in IMPORT.findall(text):
            if other not in joined:
                add(other)
        exported = ", ".join(found for _, found in EXPORT.findall(text))
        body = EXPORT.sub(r"\1", IMPORT.sub(r"const { \1 } = $\2;", text))
        parts.append(f"const ${name} = (() => {{\n{body}\nreturn {{ {exported} }};\n}})();\n")

    add(Path(SCRIPT).stem)
    return "".join(parts)
