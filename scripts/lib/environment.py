"""Run a script in an environment that has the packages of Farfield. Uses nothing but the standard library.

Every script begins with

    environment.ensure()
    farfield = environment.import_farfield()

`ensure` returns immediately inside Blender, inside an environment that it created earlier, and wherever the required packages are
installed. Otherwise it creates `.venv/<lock>` once from `requirements/<lock>.txt` and restarts the script in it.

FARFIELD_VENV names the folder of the environments (default: `.venv`). FARFIELD_BPY selects the Blender version: 4.5, 5.0 or 5.2.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import os
import runpy
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import NamedTuple, NoReturn

ROOT = Path(__file__).resolve().parents[2]
REQUIRED_MODULES = ("numpy", "scipy")  # by every tool
BUNDLED_MODULES = runpy.run_path(str(ROOT / "addon" / "core" / "bundled_modules.py"))["BUNDLED_MODULES"]
STAMP_FILE = "farfield-lock"  # in an environment: the digest of the lock that it was created from, or UNFINISHED
UNFINISHED = "unfinished"
IS_WINDOWS = os.name == "nt"


class Lock(NamedTuple):
    """A locked set of packages, identified by its versions of Blender and Python."""

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
        """Return the SHA-256 digest of the lock file, the stamp of environments created from it."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()


LOCKS = (Lock("5.0", (3, 11)), Lock("5.2", (3, 13)), Lock("4.5", (3, 11)))  # the first one for a Python is the default


def ensure(extra_modules: tuple[str, ...] = (), *, exits_on_signals: bool = False) -> None:
    """Return if the running Python has all packages, otherwise restart the script in an environment that has them.

    `extra_modules` names the modules that this script needs in addition to those of the extension. `exits_on_signals` says that the script
    ends in `command_line.run`, until which signals end it at once, with exit code 130. Exits with code 2 and an error message
    on stderr when no environment can be created, and with 130 when the user cancels.
    """
    _open_closed_streams()
    if _is_in_blender():
        _check_blender_modules(extra_modules)
        return
    lock = _select_lock()
    if read_stamp(Path(sys.prefix)) == lock.digest() or _is_user_environment_complete(lock, extra_modules):
        if exits_on_signals and "bpy" not in sys.modules:
            _exit_on_signals()
            _set_temporary_folder()
        find_blender_modules()
        return
    folder = environments_folder() / lock.name
    try:
        if read_stamp(folder) != lock.digest():
            _create(folder, lock)
        _restart(environment_python(folder))
    except KeyboardInterrupt:
        sys.exit(130)


def _exit_on_signals() -> None:
    """Let Ctrl+C and termination signals end the process while it imports modules: Blender prints the exceptions of its add-ons, goes on,
    and the signal would be lost. `command_line.run` installs other handlers."""

    def end(*_: object) -> NoReturn:
        os.write(2, b"Cancelled.\n")
        os._exit(130)

    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):  # others are the caller's
            signal.signal(number, end)


def _set_temporary_folder() -> None:
    """Let Blender use the temporary folder that Python uses, which can be written to; it prints warnings about one that cannot."""
    name = "TEMP" if IS_WINDOWS else "TMPDIR"
    if os.environ.get(name):
        with suppress(OSError):  # no folder can be written to
            os.environ[name] = tempfile.gettempdir()


def _open_closed_streams() -> None:
    """Open the null device as standard output or error where it was closed: messages would go into the next file that is opened."""
    for descriptor, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_WRONLY)
            if null != descriptor:
                os.dup2(null, descriptor)
                os.close(null)
            os.set_inheritable(descriptor, True)
            setattr(sys, name, os.fdopen(descriptor, "w", encoding="utf-8"))


def import_farfield() -> ModuleType:
    """Import this checkout as the package `farfield`, whatever its folder is called. Does not import bpy."""
    if "farfield" in sys.modules:
        return sys.modules["farfield"]
    spec = importlib.util.spec_from_file_location("farfield", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    package = importlib.util.module_from_spec(spec)
    sys.modules["farfield"] = package
    spec.loader.exec_module(package)
    return package


def find_blender_modules() -> None:
    """Let Python find the modules that pip's bpy brings along, such as OpenImageIO. They come last: installed packages replace them."""
    spec = importlib.util.find_spec("bpy")
    if spec is not None and spec.origin and not _is_in_blender():
        package = Path(spec.origin).parent
        folders = map(str, [*package.glob("*/python/lib/python3.*/site-packages"), *package.glob("*/python/lib/site-packages")])
        sys.path += [folder for folder in folders if folder not in sys.path]


def environments_folder() -> Path:
    """Return the folder of the environments."""
    return Path(os.environ.get("FARFIELD_VENV") or ROOT / ".venv").absolute()


def find_interpreter(version: tuple[int, int]) -> list[str] | None:
    """Return the command of a Python of this version that can create environments, None where there is none."""
    for command in _python_commands(version):
        check = "import sys, venv, ensurepip; print(*sys.version_info[:2])"
        try:
            outcome = subprocess.run([*command, "-c", check], capture_output=True, text=True, timeout=60, check=False)
        except (OSError, subprocess.TimeoutExpired):
            continue
        if outcome.returncode == 0 and outcome.stdout.split() == [str(number) for number in version]:
            return command
    return None


def _is_in_blender() -> bool:
    """True inside the Blender program, False with pip's bpy and in plain Python. Blender imports bpy before it runs a script."""
    return "bpy" in sys.modules and not sys.modules["bpy"].app.module


def _check_blender_modules(extra_modules: tuple[str, ...]) -> None:
    missing = _missing_modules((*REQUIRED_MODULES, *extra_modules))
    if missing:
        _fail(
            f"This Blender's Python lacks {', '.join(missing)}; install the Farfield extension, whose zip contains them "
            "(python3 scripts/build_extension.py builds the zip)."
        )


def _missing_modules(modules: tuple[str, ...]) -> list[str]:
    return [module for module in modules if importlib.util.find_spec(module) is None]


def _is_user_environment_complete(lock: Lock, extra_modules: tuple[str, ...]) -> bool:
    """True if the user's own environment has every package and neither variable selects another one."""
    if os.environ.get("FARFIELD_VENV") or _missing_modules(("bpy", "numpy", *BUNDLED_MODULES, *extra_modules)):
        return False
    try:
        version = importlib.metadata.version("bpy").split(".")
    except importlib.metadata.PackageNotFoundError:
        return False
    if os.environ.get("FARFIELD_BPY"):
        return ".".join(version[:2]) == lock.blender
    return (4, 5) <= (int(version[0]), int(version[1])) < (5, 3)


def _select_lock() -> Lock:
    """Return the lock for the Blender version in FARFIELD_BPY, else for the running Python, else for the first Python that is found."""
    blender = os.environ.get("FARFIELD_BPY")
    if blender:
        for lock in LOCKS:
            if lock.blender == blender:
                return lock
        _fail(f'FARFIELD_BPY is "{blender}"; it must be one of {", ".join(sorted(lock.blender for lock in LOCKS))}.')
    for lock in LOCKS:
        if lock.python == sys.version_info[:2]:
            return lock
    available = next((lock for lock in LOCKS if find_interpreter(lock.python)), None)
    if available is None:
        _fail(
            f"Farfield needs Python 3.11 or 3.13, this is {sys.version_info[0]}.{sys.version_info[1]} and no other was found; "
            "install one of them and run the script again."
        )
    return available


def _python_commands(version: tuple[int, int]) -> list[list[str]]:
    """Return commands that may start Python `version`, the likeliest first."""
    name = f"python{version[0]}.{version[1]}"
    commands = []
    if sys.version_info[:2] == version:
        base = Path(sys.base_prefix) / ("python.exe" if IS_WINDOWS else f"bin/{name}")
        commands += [[str(base)], [sys.executable]]
    if IS_WINDOWS:
        commands.append(["py", f"-{version[0]}.{version[1]}"])
    if shutil.which(name):
        commands.append([name])
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    for folder in sorted(pyenv.glob(f"versions/{version[0]}.{version[1]}.*"), reverse=True):
        commands.append([str(folder / "bin" / name)])
    for folder in sorted(pyenv.glob(f"pyenv-win/versions/{version[0]}.{version[1]}.*"), reverse=True):
        commands.append([str(folder / "python.exe")])
    return commands


def read_stamp(folder: Path) -> str | None:
    """Return the digest of the lock that the environment in `folder` was created from, None if `ensure` did not create it."""
    path = folder / STAMP_FILE
    return path.read_text(encoding="utf-8").strip() if path.is_file() else None


def environment_python(folder: Path) -> Path:
    """Return the path of the Python in the environment `folder`."""
    return folder / ("Scripts/python.exe" if IS_WINDOWS else "bin/python")


def _create(folder: Path, lock: Lock) -> None:
    """Create the environment of `lock` in `folder`. The stamp is written last, so an interrupted one never counts as complete."""
    python = find_interpreter(lock.python)
    version = ".".join(str(number) for number in lock.python)
    if python is None:
        _fail(
            f"Blender {lock.blender} needs Python {version} with its venv module, which was not found; install it and run the script again."
        )
    if folder.is_dir() and any(folder.iterdir()) and read_stamp(folder) is None:
        _fail(f'"{folder}" contains files that Farfield did not create; move them away or set FARFIELD_VENV to another folder.')
    print(f"Farfield creates its environment in {folder}. This takes a few minutes, once.", file=sys.stderr, flush=True)
    install = [str(environment_python(folder)), "-m", "pip", "install", "--require-hashes", "--only-binary", ":all:", "--no-input"]
    install += ["--disable-pip-version-check", "-r", str(lock.path)]
    if not sys.stderr.isatty():
        install.append("--quiet")
    finished = False
    try:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        (folder / STAMP_FILE).write_text(UNFINISHED, encoding="utf-8")
        for command in ([*python, "-m", "venv", str(folder)], install):
            subprocess.run(command, check=True, stdout=sys.stderr)
        (folder / STAMP_FILE).write_text(lock.digest(), encoding="utf-8")
        finished = True
    except subprocess.CalledProcessError as error:
        _fail(f"The packages of {lock.path.name} could not be installed (code {error.returncode}); see the lines above.")
    except OSError as error:
        _fail(f'The environment in "{folder}" cannot be created: {error.strerror or error}.')
    finally:
        if not finished:
            shutil.rmtree(folder, ignore_errors=True)


def _restart(python: Path) -> NoReturn:
    """Restart this script with `python` and the same arguments, replacing this process where the system can."""
    command = [str(python), *sys.argv]
    sys.stdout.flush()
    if IS_WINDOWS:
        sys.exit(subprocess.run(command, check=False).returncode)
    os.execv(command[0], command)


def _fail(message: str) -> NoReturn:
    print(message, file=sys.stderr)
    sys.exit(2)
