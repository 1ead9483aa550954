"""The files of a run: each argument that is a path says whether it is read or written, and all are checked before any work."""

import argparse
import json
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from urllib.parse import unquote

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.scene_paths import FILE, scene_inputs
from farfield.addon.core.errors import FileError
from farfield.addon.core.files.far_meshes import parse_material_library
from farfield.addon.core.files.file_access import check_writable, is_stream, is_unicode
from farfield.addon.core.files.outputs import Input, Output, check_outputs, is_named_by
from farfield.addon.core.messages import single_line
from lib.contact_sheet import check_own_images, is_own_png

MAX_SCENE_BYTES = 64 << 20  # Larger .gltf files are not searched for the names of others.
MAX_HEADER_BYTES = 1 << 16
THE_INPUT = "the input"  # the name of the argument `input` in messages


def parse_path(text: str) -> Path:
    """Return the path written as `text` on a command line.

    Raises:
        argparse.ArgumentTypeError: it is empty, or no text.
    """
    if not text.strip():
        raise argparse.ArgumentTypeError('the path is empty; write "." for the current folder')
    if not is_unicode(text):
        raise argparse.ArgumentTypeError(f'the path "{single_line(text)}" is not valid UTF-8 text; rename the file or the folder')
    return Path(text)


@dataclass(frozen=True)
class PathType:
    """The type of an argument that is a path.

    Attributes:
        is_output: whether it is written.
        check: of an output: raises FileError if it cannot be written there.
        is_folder: of an output: whether it is a folder, in which files may be replaced.
        is_exclusive: of an output folder: whether no other output may lie in it.
        is_closed: of an input: whether it is a folder into which nothing may be written.
        changes_scenes: of an output: whether it may be the .blend file that is the input, which is then changed in place.
        may_be_stream: of an output: whether it may be a device or a pipe, which is written to.
        extensions: of an output: what its name may end in, in lower case; anything if there are none.
    """

    is_output: bool = False
    check: Callable[[Path], None] = check_writable
    is_folder: bool = False
    is_exclusive: bool = False
    is_closed: bool = False
    changes_scenes: bool = False
    may_be_stream: bool = False
    extensions: tuple[str, ...] = ()

    def ending_in(self, *extensions: str) -> "PathType":
        """Return the type of files with one of these extensions."""
        return replace(self, extensions=extensions)

    def __call__(self, text: str) -> Path:
        """Parse the argument."""
        return parse_path(text)


def check_image_folder(folder: Path) -> None:
    """Check that a file can be written to `folder`, and that all images in it are of earlier runs.

    Raises:
        FileError: it cannot, or one is not.
    """
    check_writable(folder / "image.png")
    check_own_images(folder)


def accept_any(_path: Path) -> None:
    """Check nothing: the job checks its work folder when it opens it."""


INPUT, CLOSED_FOLDER = PathType(), PathType(is_closed=True)
OUTPUT, OUTPUT_SCENE = PathType(is_output=True), PathType(is_output=True, changes_scenes=True)
REPORT = PathType(is_output=True, may_be_stream=True)
WORK_FOLDER = PathType(is_output=True, is_folder=True, check=accept_any)
IMAGE_FOLDER = PathType(is_output=True, is_folder=True, is_exclusive=True, check=check_image_folder)


@dataclass
class RunFiles:
    """What a run reads and writes."""

    inputs: list[Input] = field(default_factory=list)
    outputs: list[Output] = field(default_factory=list)

    def check_arguments(self, arguments: Sequence[tuple[str, PathType, Path]]) -> None:
        """Check the arguments that are given: their names, types and values. Raises FileError, see `check_outputs`."""
        outputs, inputs = [], []
        for name, kind, path in arguments:
            if not kind.is_output:
                inputs.append(Input(name, path, kind.is_closed))
            elif not (kind.may_be_stream and is_stream(path)):
                changes = THE_INPUT if kind.changes_scenes and path.suffix.lower() == ".blend" else ""
                outputs.append(Output(name, path, kind.check, kind.is_folder, kind.is_exclusive, changes))
        self.check(outputs, inputs)
        for name, kind, path in arguments:
            if kind.extensions and path.suffix.lower() not in kind.extensions:
                some = "one of " if len(kind.extensions) > 1 else ""
                raise FileError(f'{name} is "{path}"; it must end in {some}{", ".join(kind.extensions)}.')

    def check(self, outputs: Iterable[Output] = (), inputs: Iterable[Input] = ()) -> None:
        """Check all files if there are further ones. Raises FileError, see `check_outputs`."""
        new_outputs, new_inputs = [output for output in outputs if output not in self.outputs], list(inputs)
        self.outputs += new_outputs
        self.inputs += new_inputs
        if new_outputs or new_inputs:
            check_outputs(self.outputs, self.inputs)

    def check_scene(self, path: Path | None = None) -> None:
        """Check the outputs against the files of the open scene, which was read from `path`. Images of earlier runs may be replaced.

        Raises:
            FileError: see `check_outputs`.
        """
        inputs = [*scene_inputs(), *(Input(FILE, other) for other in ([] if path is None else referenced_files(path)))]
        self.check(inputs=[given for given in inputs if not is_own_png(given.path)])


def obj_materials(out: Path, materials: Path | None = None) -> list[Output]:
    """Return the file of materials that is written with `out`; none unless `out` is an .obj. materials: its path, if not OUT.mtl."""
    if out.suffix.lower() != ".obj":
        return []
    return [Output("the material file of --out", materials or out.with_suffix(".mtl"), is_ours=partial(is_named_by, out))]


def referenced_files(path: Path) -> list[Path]:
    """Return the files that an .obj or a .gltf file names, but for images, which Blender's importers name in the scene."""
    names: list[str] = []
    with suppress(OSError, ValueError, AttributeError, TypeError):  # Blender's importer says what is wrong
        if path.suffix.lower() == ".obj":
            with path.open("rb") as file:
                names = [name for line in file.read(MAX_HEADER_BYTES).splitlines() if (name := parse_material_library(line)) is not None]
        elif path.suffix.lower() == ".gltf" and path.stat().st_size <= MAX_SCENE_BYTES:
            document = json.loads(path.read_text(encoding="utf-8"))
            names = [unquote(buffer["uri"]) for buffer in document.get("buffers", []) if "uri" in buffer]
    return [
        path.parent / name for name in names if not name.startswith("data:") and "\0" not in name
    ]  # No file has a zero byte in its name.
