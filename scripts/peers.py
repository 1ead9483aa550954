"""Other people's programs that tests and benchmarks hold ours against, in an environment of their own: `python3 scripts/peers.py` makes it.

They are btf-extractor, which reads `.btf` files, and flip-evaluator, which compares pictures. Nothing of Farfield needs them. They ask for
other versions than Blender has, so they are run as programs: `python()` names their Python.
"""

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

import environment

PYTHON = (3, 11)
LOCK = environment.ROOT / "requirements" / "peers.txt"
SOURCES_LOCK = environment.ROOT / "requirements" / "peers-sources.txt"
CHECK = "import btf_extractor, flip_evaluator"


def python() -> Path | None:
    """The Python of the peers' environment, or None where it does not stand."""
    folder = _folder()
    return environment.python_of(folder) if environment.stamp(folder) == _digest() else None


def make() -> None:
    """Make the environment anew. Exits with code 2 and one sentence where that cannot be."""
    command = environment.interpreter(PYTHON)
    if command is None:
        _refuse(f"there is no Python {PYTHON[0]}.{PYTHON[1]} with its venv module")
    folder = _folder()
    shutil.rmtree(folder, ignore_errors=True)
    install = [str(environment.python_of(folder)), "-m", "pip", "install", "--quiet", "--require-hashes", "--no-deps", "--no-input"]
    install.append("--disable-pip-version-check")
    try:
        _run([*command, "-m", "venv", str(folder)])
        _run([*install, "--only-binary", ":all:", "-r", str(LOCK)])
        _run([*install, "--no-build-isolation", "--no-binary", ":all:", "-r", str(SOURCES_LOCK)])
        _run([str(environment.python_of(folder)), "-c", CHECK])
        (folder / environment.STAMP).write_text(_digest(), encoding="utf-8")
    except (OSError, subprocess.CalledProcessError) as error:
        shutil.rmtree(folder, ignore_errors=True)
        _refuse(f"{error}; see the lines above")


def _folder() -> Path:
    return environment.environments() / "peers"


def _digest() -> str:
    return hashlib.sha256(LOCK.read_bytes() + SOURCES_LOCK.read_bytes()).hexdigest()


def _run(command: list[str]) -> None:
    subprocess.run(command, check=True, stdout=sys.stderr)


def _refuse(reason: str) -> None:
    print(f"The peers of Farfield cannot be installed: {reason}. Tests that need them will be left out.", file=sys.stderr)
    sys.exit(2)


def main() -> None:
    if python() is None:
        make()
    print(f"The peers of Farfield stand in {_folder()}")


if __name__ == "__main__":
    main()
