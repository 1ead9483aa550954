"""Install third-party reference tools that tests and benchmarks compare with: `python3 scripts/reference_tools.py`.

The tools are btf-extractor, which reads `.btf` files, flip-evaluator, which compares images, and OpenCV, PyPatchMatch and scikit-image,
which fill missing parts of images. Farfield itself does not need them. They require other package versions than Blender, so they have an
environment of their own; `find_python` returns its Python.
"""

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

from lib import environment

PYTHON_VERSION = (3, 11)
LOCK = environment.ROOT / "requirements" / "reference-tools.txt"
SOURCES_LOCK = environment.ROOT / "requirements" / "reference-tools-sources.txt"
CHECK = "import btf_extractor, cv2.xphoto, flip_evaluator, patchmatch, skimage; assert patchmatch.patchmatch_available"


def find_python() -> Path | None:
    """Return the Python of the environment with the reference tools, None if it is not installed."""
    folder = _folder()
    return environment.environment_python(folder) if environment.read_stamp(folder) == _digest() else None


def install() -> None:
    """Create the environment. Exits with code 2 and an error message if that fails."""
    command = environment.find_interpreter(PYTHON_VERSION)
    if command is None:
        _fail(f"there is no Python {PYTHON_VERSION[0]}.{PYTHON_VERSION[1]} with its venv module")
    folder = _folder()
    shutil.rmtree(folder, ignore_errors=True)
    install = [
        str(environment.environment_python(folder)),
        "-m",
        "pip",
        "install",
        "--quiet",
        "--require-hashes",
        "--no-deps",
        "--no-input",
    ]
    install.append("--disable-pip-version-check")
    try:
        _run([*command, "-m", "venv", str(folder)])
        _run([*install, "--only-binary", ":all:", "-r", str(LOCK)])
        _run([*install, "--no-build-isolation", "--no-binary", ":all:", "-r", str(SOURCES_LOCK)])
        _run([str(environment.environment_python(folder)), "-c", CHECK])
        (folder / environment.STAMP_FILE).write_text(_digest(), encoding="utf-8")
    except (OSError, subprocess.CalledProcessError) as error:
        shutil.rmtree(folder, ignore_errors=True)
        _fail(f"{error}; see the lines above")


def _folder() -> Path:
    return environment.environments_folder() / "reference-tools"


def _digest() -> str:
    return hashlib.sha256(LOCK.read_bytes() + SOURCES_LOCK.read_bytes()).hexdigest()


def _run(command: list[str]) -> None:
    subprocess.run(command, check=True, stdout=sys.stderr)


def _fail(reason: str) -> None:
    print(f"The reference tools cannot be installed: {reason}. Tests that need them are skipped.", file=sys.stderr)
    sys.exit(2)


def main() -> None:
    if find_python() is None:
        install()
    print(f"The reference tools are installed in {_folder()}")


if __name__ == "__main__":
    main()
