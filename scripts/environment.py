"""Bring a script into an environment that has what Farfield needs, with nothing but the standard library.

Every script begins with

    environment.ensure()
    farfield = environment.import_farfield()

`ensure` returns at once inside Blender, inside an environment that it made before, and wherever the needed packages stand already.
Otherwise it makes `.venv/<lock>` from `requirements/<lock>.txt`, once, and starts the script again in it.

FARFIELD_VENV names another folder than `.venv` to keep environments in. FARFIELD_BPY chooses the Blender line: 4.5, 5.0 or 5.2.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import NamedTuple, NoReturn

ROOT = Path(__file__).resolve().parent.parent
NEEDED = ("numpy", "scipy")  # by every tool
BROUGHT = ("xatlas", "fast_simplification", "threadpoolctl", "tifffile")  # by the locks and the zip too, each for the tools that use it
STAMP = "farfield-lock"  # in an environment: the digest of the lock that it was made from, or UNFINISHED
UNFINISHED = "unfinished"
WINDOWS = os.name == "nt"


class Lock(NamedTuple):
    """A locked set of packages: the Blender line and the Python that it is for."""

    blender: str
    python: tuple[int, int]

    @property
    def name(self) -> str:
        """The name of the lock file and of the environment, for instance `py311-bpy5.0`."""
        return f"py{self.python[0]}{self.python[1]}-bpy{self.blender}"

    @property
    def path(self) -> Path:
        """The lock file."""
        return ROOT / "requirements" / f"{self.name}.txt"

    def digest(self) -> str:
        """What an environment made from this lock carries as its stamp."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()


LOCKS = (Lock("5.0", (3, 11)), Lock("5.2", (3, 13)), Lock("4.5", (3, 11)))  # of two for the same Python the first is taken


def ensure(also: tuple[str, ...] = ()) -> None:
    """Return when the running Python has everything, else restart the script in an environment that has.

    `also` names modules that this script needs besides those of the extension. Exits with code 2 and one sentence on stderr when no
    environment can be made, and with 130 when the user stops it.
    """
    if _runs_in_blender():
        _require_in_blender(also)
        return
    lock = _wanted_lock()
    if stamp(Path(sys.prefix)) == lock.digest() or _complete_without_help(lock, also):
        return
    folder = environments() / lock.name
    try:
        if stamp(folder) != lock.digest():
            _make(folder, lock)
        _restart(python_of(folder))
    except KeyboardInterrupt:
        sys.exit(130)


def import_farfield() -> ModuleType:
    """The package `farfield`: this checkout, whatever its folder is called. Imports no bpy."""
    if "farfield" in sys.modules:
        return sys.modules["farfield"]
    spec = importlib.util.spec_from_file_location("farfield", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    package = importlib.util.module_from_spec(spec)
    sys.modules["farfield"] = package
    spec.loader.exec_module(package)
    return package


def environments() -> Path:
    """The folder that environments are kept in."""
    return Path(os.environ.get("FARFIELD_VENV") or ROOT / ".venv").absolute()


def interpreter(version: tuple[int, int]) -> list[str] | None:
    """The command that starts a Python of this version which can make environments, or None where there is none."""
    for command in _candidates(version):
        check = "import sys, venv, ensurepip; print(*sys.version_info[:2])"
        try:
            answer = subprocess.run([*command, "-c", check], capture_output=True, text=True, timeout=60, check=False)
        except (OSError, subprocess.TimeoutExpired):
            continue
        if answer.returncode == 0 and answer.stdout.split() == [str(number) for number in version]:
            return command
    return None


def _runs_in_blender() -> bool:
    """True in a Blender program, False under pip's bpy and in plain Python. Blender imports bpy before any script."""
    return "bpy" in sys.modules and not sys.modules["bpy"].app.module


def _require_in_blender(also: tuple[str, ...]) -> None:
    missing = _missing((*NEEDED, *also))
    if missing:
        _refuse(
            f"This Blender's Python lacks {', '.join(missing)}; install the Farfield extension in it, whose zip brings them "
            "(python3 scripts/build_extension.py makes the zip)."
        )


def _missing(modules: tuple[str, ...]) -> list[str]:
    return [module for module in modules if importlib.util.find_spec(module) is None]


def _complete_without_help(lock: Lock, also: tuple[str, ...]) -> bool:
    """True in a user's own environment that holds every package, unless another one was asked for."""
    if os.environ.get("FARFIELD_VENV") or _missing(("bpy", *NEEDED, *BROUGHT, *also)):
        return False
    try:
        version = importlib.metadata.version("bpy").split(".")
    except importlib.metadata.PackageNotFoundError:
        return False
    if os.environ.get("FARFIELD_BPY"):
        return ".".join(version[:2]) == lock.blender
    return (4, 5) <= (int(version[0]), int(version[1])) < (5, 3)


def _wanted_lock() -> Lock:
    """The lock for the Blender line that was asked for, else for the running Python, else for the first Python that is found."""
    line = os.environ.get("FARFIELD_BPY")
    if line:
        for lock in LOCKS:
            if lock.blender == line:
                return lock
        _refuse(f'FARFIELD_BPY is "{line}"; it must be one of {", ".join(sorted(lock.blender for lock in LOCKS))}.')
    for lock in LOCKS:
        if lock.python == sys.version_info[:2]:
            return lock
    found = next((lock for lock in LOCKS if interpreter(lock.python)), None)
    if found is None:
        _refuse(
            f"Farfield needs Python 3.11 or 3.13, this is {sys.version_info[0]}.{sys.version_info[1]} and no other was found; "
            "install one of them and run this script again."
        )
    return found


def _candidates(version: tuple[int, int]) -> list[list[str]]:
    """Commands that may start Python `version`, the likeliest first."""
    name = f"python{version[0]}.{version[1]}"
    commands = []
    if sys.version_info[:2] == version:
        base = Path(sys.base_prefix) / ("python.exe" if WINDOWS else f"bin/{name}")
        commands += [[str(base)], [sys.executable]]
    if WINDOWS:
        commands.append(["py", f"-{version[0]}.{version[1]}"])
    if shutil.which(name):
        commands.append([name])
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    for folder in sorted(pyenv.glob(f"versions/{version[0]}.{version[1]}.*"), reverse=True):
        commands.append([str(folder / "bin" / name)])
    for folder in sorted(pyenv.glob(f"pyenv-win/versions/{version[0]}.{version[1]}.*"), reverse=True):
        commands.append([str(folder / "python.exe")])
    return commands


def stamp(folder: Path) -> str | None:
    """What the environment in `folder` was made from, None where none of ours stands."""
    written = folder / STAMP
    return written.read_text(encoding="utf-8").strip() if written.is_file() else None


def python_of(folder: Path) -> Path:
    """The Python of the environment in `folder`."""
    return folder / ("Scripts/python.exe" if WINDOWS else "bin/python")


def _make(folder: Path, lock: Lock) -> None:
    """Make the environment of `lock` in `folder`. The stamp is written last, so one that was interrupted is never taken for whole."""
    python = interpreter(lock.python)
    version = ".".join(str(number) for number in lock.python)
    if python is None:
        _refuse(f"Blender {lock.blender} needs Python {version} with its venv module, which was not found; install it and run this again.")
    if folder.is_dir() and any(folder.iterdir()) and stamp(folder) is None:
        _refuse(f'"{folder}" holds something that Farfield did not make; move it away or name another folder with FARFIELD_VENV.')
    print(f"Farfield makes its environment in {folder}; this takes a few minutes, once.", file=sys.stderr, flush=True)
    install = [str(python_of(folder)), "-m", "pip", "install", "--require-hashes", "--only-binary", ":all:", "--no-input"]
    install += ["--disable-pip-version-check", "-r", str(lock.path)]
    if not sys.stderr.isatty():
        install.append("--quiet")
    finished = False
    try:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        (folder / STAMP).write_text(UNFINISHED, encoding="utf-8")
        for command in ([*python, "-m", "venv", str(folder)], install):
            subprocess.run(command, check=True, stdout=sys.stderr)
        (folder / STAMP).write_text(lock.digest(), encoding="utf-8")
        finished = True
    except subprocess.CalledProcessError as error:
        _refuse(f"The packages of {lock.path.name} could not be installed (code {error.returncode}); see the lines above.")
    except OSError as error:
        _refuse(f'The environment in "{folder}" cannot be made: {error.strerror or error}.')
    finally:
        if not finished:
            shutil.rmtree(folder, ignore_errors=True)


def _restart(python: Path) -> NoReturn:
    """Run this script with the same arguments in the environment of `python`, in place of this process where the system can do that."""
    command = [str(python), *sys.argv]
    sys.stdout.flush()
    if WINDOWS:
        sys.exit(subprocess.run(command, check=False).returncode)
    os.execv(command[0], command)


def _refuse(sentence: str) -> NoReturn:
    print(sentence, file=sys.stderr)
    sys.exit(2)
