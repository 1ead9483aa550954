"""What a campaign checks: exit codes, messages of one line, outputs that are complete or untouched, nothing left behind."""

import glob
import hashlib
import json
import re
import stat
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from farfield.addon.core.files.complete_files import is_complete_blend, is_complete_png
from farfield.addon.core.messages import single_line
from lib.command_line import SAVED

OLD_CONTENT = b"the old content"
NOTICE = re.compile(r"Skipped: |--[a-z-]+ is not used with ")
CANCELLED = 130  # exit code after Ctrl+C
LIBRARY_MESSAGE = re.compile(  # printed by the libraries that read images for Blender, and by its dependency graph about metaballs
    r"libpng (error|warning): |PNG library error|ImageInput::\w+\(\) failed: |IMB_load_image_from_memory: "
    r"|find_node component: |-{20,}$|Failed to add relation |Could not find op_(to|from): |Trace:$"
    r"|Depth +Type +Name$|-----    ----  |\d+ +Object  "
)
TEMPORARY_NAME = re.compile(r"\.?farfield-|.*\.part$")
BLENDER_FOLDER = re.compile(r"blender_|farfield-stores-")  # Blender's own temporary folder and samples live as long as the process.
VARYING = re.compile(r"\"[^\"]*\"|'[^']*'|\d+")

State = dict[str, tuple[str, str]]  # relative path: kind, digest


@dataclass(frozen=True)
class Problem:
    """A promise that was broken. kind: a few words that are equal for equal problems."""

    kind: str
    text: str

    @property
    def signature(self) -> str:
        """The problem without names and numbers: equal for findings that are probably the same."""
        return f"{self.kind}: {VARYING.sub('#', self.text.strip().splitlines()[-1] if self.text.strip() else '')[:200]}"


def read_state(folder: Path) -> State:
    """Return the kind and digest of everything below `folder`."""
    state: State = {}
    for path in sorted(folder.rglob("*")):
        mode = path.lstat().st_mode
        if stat.S_ISLNK(mode):
            state[str(path.relative_to(folder))] = ("link", str(path.readlink()))
        elif stat.S_ISREG(mode):
            state[str(path.relative_to(folder))] = ("file", hashlib.sha256(path.read_bytes()).hexdigest())
        else:
            state[str(path.relative_to(folder))] = ("folder" if stat.S_ISDIR(mode) else "other", "")
    return state


def check_messages(code: int, stdout: str, stderr: str, interrupted: bool) -> list[Problem]:
    """Check the exit code and what a script printed."""
    printed = [line for line in stderr.splitlines() if line.strip() and not LIBRARY_MESSAGE.match(line)]
    lines = [line for line in printed if not NOTICE.match(line)]
    problems = []
    if "Traceback" in stderr:
        problems.append(Problem("traceback", stderr))
    elif code == 1 or "defect of Farfield" in stderr:
        problems.append(Problem("defect", stderr))
    elif code not in (0, 2) and not (code == CANCELLED and interrupted):
        problems.append(Problem(f"exit code {code}", stderr))
    elif len(lines) != (0 if code == 0 else 1):
        problems.append(Problem(f"{len(lines)} lines on stderr with exit code {code}", stderr))
    if code == 0 and len(stdout.splitlines()) > 1 and not stdout.startswith("usage:"):
        problems.append(Problem("more than a result on stdout", stdout))
    return problems


def find_saved(stderr: str, outputs: list[str]) -> list[str]:
    """Return those `outputs` that the message of a run says it has saved before it ended early, or files that are named after them."""
    listed = next((line.partition(SAVED)[2] for line in stderr.splitlines()[::-1] if SAVED in line), "")
    is_shortened = re.search(r" and [\d,]+ more\.$", listed) is not None
    return [output for output in outputs if is_shortened or re.search(rf'[/\\"]{re.escape(single_line(Path(output).stem))}[^/"]*"', listed)]


def check_files(
    code: int, before: State, after: State, outputs: list[str], ignored: str | None, saved: Sequence[str] = ()
) -> list[Problem]:
    """Compare the folder of a case before and after the run. `ignored` is the relative path of a folder that may change,
    or be made with the folders that contain it.

    A cancelled run may have written some of its `outputs`, and another one that ends early those that it says it has `saved`;
    `check_written` tells whether they are complete.
    """

    def is_ignored(name: str) -> bool:
        return ignored is not None and (name == ignored or name.startswith(ignored + "/") or ignored.startswith(name + "/"))

    problems = [
        Problem("left behind", name)
        for name in after
        if name not in before and TEMPORARY_NAME.match(Path(name).name) and not is_ignored(name)
    ]
    if code == 0:
        kept = {name for output in outputs for name in (output, str(Path(output).parent))}
        problems += [
            Problem("input changed", name)
            for name in before
            if after.get(name) != before[name] and name not in kept and not _is_beside(name, outputs)
        ]
        return problems
    for name in sorted(set(before) | set(after)):
        if before.get(name) == after.get(name) or is_ignored(name) or TEMPORARY_NAME.match(Path(name).name):
            continue
        if _belongs_to_output(name, outputs if code == CANCELLED else saved):
            continue
        kind = (
            "removed" if name not in after else "changed" if name in before else "new folder" if after[name][0] == "folder" else "new file"
        )
        problems.append(Problem(f"{kind} although the exit code is {code}", name))
    return problems


def check_output(path: Path) -> list[Problem]:
    """Check that a file or folder exists and is complete, as far as its format tells."""
    # The levels of a cloud or a mesh and the tiles of a texture have files of their own.
    pattern = glob.escape(path.name).replace("<UDIM>", "*") if "<UDIM>" in path.name else f"{glob.escape(path.stem)}[-_]*{path.suffix}"
    parts = sorted(path.parent.glob(pattern)) if path.suffix and path.parent.is_dir() else []
    if parts:
        return [problem for part in parts if part != path for problem in check_output(part)]
    if not path.exists():
        return [Problem("output missing", path.name)]
    if path.is_dir():
        return [problem for child in path.iterdir() for problem in check_output(child)]
    return [] if _is_complete(path) else [Problem("output not complete", path.name)]


def check_written(folder: Path, before: State, after: State, outputs: list[str]) -> list[Problem]:
    """Check that those `outputs` in `folder` that a run has written are complete."""
    written = [output for output in outputs if output in after and before.get(output) != after[output]]
    return [problem for output in written for problem in check_output(folder / output)]


def check_leftovers(folder: Path) -> list[Problem]:
    """Check that nothing but Blender's own folder is in a temporary folder."""
    return [Problem("left in the temporary folder", path.name) for path in folder.iterdir() if not BLENDER_FOLDER.match(path.name)]


def _is_beside(name: str, outputs: Sequence[str]) -> bool:
    """Whether a file belongs to an output: the materials and images of an .obj, for instance."""
    return any(Path(name).parent == Path(output).parent and Path(name).name.startswith(Path(output).stem) for output in outputs)


def _belongs_to_output(name: str, outputs: Sequence[str]) -> bool:
    """Whether a path is an output, in one, next to one, or a folder that holds one."""
    is_part = any(name == output or name.startswith(output + "/") or output.startswith(name + "/") for output in outputs)
    return is_part or _is_beside(name, outputs)


def _is_complete(path: Path) -> bool:
    suffix, content = path.suffix.lower(), path.read_bytes()
    if content == OLD_CONTENT:
        return False
    if suffix == ".blend":
        return is_complete_blend(path)
    if suffix == ".png":
        return is_complete_png(path)
    if suffix == ".json":
        return _is_json(content)
    if suffix == ".glb":
        return len(content) >= 12 and struct.unpack_from("<I", content, 8)[0] == len(content)
    if suffix == ".ply":
        return _is_complete_ply(content)
    return bool(content) and (suffix != ".obj" or content.endswith(b"\n"))


def _is_json(content: bytes) -> bool:
    try:
        json.loads(content)
    except ValueError:
        return False
    return True


def _is_complete_ply(content: bytes) -> bool:
    """Whether a .ply file of scripts/clipbox.py has all vertices (36 bytes) and triangles (13 bytes)."""
    header, end, data = content.partition(b"end_header\n")
    counts = [int(line.split()[2]) for line in header.splitlines() if line.startswith(b"element")]
    return bool(end) and len(counts) == 2 and len(data) == 36 * counts[0] + 13 * counts[1]
