"""Install third-party reference tools that tests and benchmarks compare with.

    python3 scripts/reference_tools.py                  what most tests and benchmarks need, see below
    python3 scripts/reference_tools.py texture-tools    Lagrange and PyMeshLab, for benchmarks/bench_photos.py
    python3 scripts/reference_tools.py docs-tools       MkDocs, for scripts/build_docs.py, which installs it itself

The first set contains btf-extractor, flip-evaluator, OpenCV, pydelatin, pymartini, PyPatchMatch and scikit-image.
Farfield itself does not need them. They require other package versions than Blender, so each set has an environment of its own.
`find_python` returns its Python. PyMeshLab needs a display with OpenGL for textures, and libraries of Qt: without a screen, the
Debian packages xvfb and libqt5gui5.
"""

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from lib import environment

PYTHON_VERSION = (3, 11)
REQUIREMENTS = environment.ROOT / "requirements"


class ToolSet(NamedTuple):
    """Tools in one environment: locks of wheels, and of source packages that are built with them, if any; `check` is run at the end.
    `debian_packages` are needed to run them, and are not installed here."""

    name: str
    lock: Path
    sources_lock: Path | None
    check: str
    debian_packages: tuple[str, ...] = ()


REFERENCE_TOOLS = ToolSet(
    "reference-tools",
    REQUIREMENTS / "reference-tools.txt",
    REQUIREMENTS / "reference-tools-sources.txt",
    "import btf_extractor, cv2.xphoto, flip_evaluator, patchmatch, pydelatin, pymartini, skimage; assert patchmatch.patchmatch_available",
)
TEXTURE_TOOLS = ToolSet(
    "texture-tools", REQUIREMENTS / "texture-tools.txt", None, "import lagrange.texproc, PIL, pymeshlab", ("xvfb", "libqt5gui5")
)
DOCS_TOOLS = ToolSet("docs-tools", REQUIREMENTS / "docs-tools.txt", None, "import material, mkdocs")
TOOL_SETS = {tools.name: tools for tools in (REFERENCE_TOOLS, TEXTURE_TOOLS, DOCS_TOOLS)}


def find_python(tools: ToolSet = REFERENCE_TOOLS) -> Path | None:
    """Return the Python of the environment with a set of tools, None if it is not installed."""
    folder = _folder(tools)
    return environment.environment_python(folder) if environment.read_stamp(folder) == _digest(tools) else None


def install(tools: ToolSet = REFERENCE_TOOLS) -> None:
    """Create the environment. Exits with code 2 and an error message if that fails."""
    command = environment.find_interpreter(PYTHON_VERSION)
    if command is None:
        _fail(tools, f"there is no Python {PYTHON_VERSION[0]}.{PYTHON_VERSION[1]} with its venv module")
    folder = _folder(tools)
    shutil.rmtree(folder, ignore_errors=True)
    python = str(environment.environment_python(folder))
    pip = [python, "-m", "pip", "install", "--quiet", "--require-hashes", "--no-deps", "--no-input", "--disable-pip-version-check"]
    try:
        _run([*command, "-m", "venv", str(folder)])
        _run([*pip, "--only-binary", ":all:", "-r", str(tools.lock)])
        if tools.sources_lock is not None:
            _run([*pip, "--no-build-isolation", "--no-binary", ":all:", "-r", str(tools.sources_lock)])
        _run([python, "-c", tools.check])
        (folder / environment.STAMP_FILE).write_text(_digest(tools), encoding="utf-8")
    except (OSError, subprocess.CalledProcessError) as error:
        shutil.rmtree(folder, ignore_errors=True)
        _fail(tools, f"{error}; see the lines above{_describe_needs(tools)}")


def _folder(tools: ToolSet) -> Path:
    return environment.environments_folder() / tools.name


def _digest(tools: ToolSet) -> str:
    locks = [tools.lock] if tools.sources_lock is None else [tools.lock, tools.sources_lock]
    return hashlib.sha256(b"".join(lock.read_bytes() for lock in locks)).hexdigest()


def _run(command: list[str]) -> None:
    subprocess.run(command, check=True, stdout=sys.stderr)


def _fail(tools: ToolSet, reason: str) -> None:
    print(f"The {tools.name} cannot be installed: {reason}. What needs them is skipped.", file=sys.stderr)
    sys.exit(2)


def _describe_needs(tools: ToolSet) -> str:
    return f"; they need the Debian packages {' and '.join(tools.debian_packages)}" if tools.debian_packages else ""


def main() -> None:
    unknown = [name for name in sys.argv[1:] if name not in TOOL_SETS]
    if unknown:
        print(f'There is no set of tools "{unknown[0]}"; choose from {", ".join(TOOL_SETS)}.', file=sys.stderr)
        sys.exit(2)
    for name in sys.argv[1:] or [REFERENCE_TOOLS.name]:
        if find_python(TOOL_SETS[name]) is None:
            install(TOOL_SETS[name])
        print(f"The {name} are installed in {_folder(TOOL_SETS[name])}{_describe_needs(TOOL_SETS[name])}")


if __name__ == "__main__":
    main()
