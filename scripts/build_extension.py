"""Build the extension's zips, one per platform and Python, each with the wheels of the packages that Blender's Python lacks.

    python3 scripts/build_extension.py [--platform linux-x64 ...] [--python 3.13 ...] [--out dist]

Writes `farfield-<version>-<platform>-python<python>.zip` for every platform and Python of blender.org's Blender, and
`farfield-<version>.zip` for the running ones. Other Pythons, of distributions that build Blender themselves, are built where --python names
them. Blender's extension tool builds and validates each zip. Wheels are downloaded once, checked against requirements/wheels.txt, and
cached in build/wheels.
"""

import argparse
import hashlib
import importlib.util
import json
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from itertools import product
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
from lib import environment

environment.ensure(extra_modules=("markdown",))

import tomllib  # only after ensure(): older Pythons, which can start this script, lack it

from lib.docs_html import write_pages
from lib.wheel_copyrights import read_copyrights

ROOT = environment.ROOT
WHEELS_LOCK = ROOT / "requirements" / "wheels.txt"
WHEELS_CACHE = ROOT / "build" / "wheels"
STAGED_FILES = ("addon", "__init__.py", "LICENSE")  # in addition to the manifest, to which the wheels are added
# The first version of Blender with a Python, and the first one with a newer Python: those of blender.org, then those of distributions.
BLENDER_VERSIONS = {"3.11": ("4.5.0", "5.1.0"), "3.13": ("5.1.0", None)}
OTHER_VERSIONS = {"3.14": ("4.5.0", None)}
PLATFORMS = {  # wheel tags for the oldest systems that Blender 4.5 and 5.2 support
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"),
    "macos-arm64": ("macosx_12_0_arm64",),
    "macos-x64": ("macosx_12_0_x86_64",),
    "windows-x64": ("win_amd64",),
}


class BuildError(Exception):
    """A zip cannot be built; the message says why."""


def read_locked_wheels() -> dict[str, set[str]]:
    """Return the sha256 hashes of the allowed wheels by package name, spelled as in wheel file names."""
    hashes: dict[str, set[str]] = {}
    for line in WHEELS_LOCK.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            continue
        if "==" in line:
            package = hashes.setdefault(line.split("==")[0].replace("-", "_"), set())
        package_hash = re.search(r"--hash=sha256:([0-9a-f]{64})", line)
        if package_hash:
            package.add(package_hash[1])
    return hashes


def cached_wheels(folder: Path) -> list[Path]:
    """Return the wheels in `folder` if every locked package is there once with a locked hash, otherwise an empty list."""
    wheels = sorted(folder.glob("*.whl"))
    locked = read_locked_wheels()
    names = [wheel.name.split("-")[0].lower() for wheel in wheels]
    is_complete = sorted(names) == sorted(locked) and all(
        hashlib.sha256(wheel.read_bytes()).hexdigest() in locked[name] for wheel, name in zip(wheels, names, strict=True)
    )
    return wheels if is_complete else []


def fetch_wheels(target: str, python: str) -> list[Path]:
    """Return the wheels for Blender's platform `target` and this Python version, from the cache or downloaded by pip.

    Raises:
        BuildError: pip cannot download them.
    """
    folder = WHEELS_CACHE / f"{target}-{python}"
    wheels = cached_wheels(folder)
    if wheels:
        return wheels
    shutil.rmtree(folder, ignore_errors=True)
    if python in OTHER_VERSIONS:
        return download_available(folder, target, python)
    outcome = download(WHEELS_LOCK, folder, target, python)
    wheels = cached_wheels(folder)
    if outcome.returncode != 0 or not wheels:
        raise BuildError(f"pip could not download the wheels for {target} and Python {python}: {outcome.stderr.strip()}")
    return wheels


def download_available(folder: Path, target: str, python: str) -> list[Path]:
    """Download the locked wheels that exist for a platform and a Python to `folder`, and print the names of the others.

    Raises:
        BuildError: pip cannot download one that exists.
    """
    entries = re.findall(r"(?m)^[\w-]+==(?:.*\\\n)+.*$", WHEELS_LOCK.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as temporary:
        for entry in entries:
            lock = Path(temporary) / "lock.txt"
            lock.write_text(entry, encoding="utf-8")
            outcome = download(lock, folder, target, python)
            name = entry.split("==")[0]
            if "No matching distribution found" in outcome.stderr:
                print(f"{name} has no wheel for {target} and Python {python}; the zip does without it.", file=sys.stderr)
            elif outcome.returncode != 0:
                raise BuildError(f"pip could not download {name} for {target} and Python {python}: {outcome.stderr.strip()}")
    return sorted(folder.glob("*.whl"))


def download(lock: Path, folder: Path, target: str, python: str) -> subprocess.CompletedProcess:
    """Let pip download the wheels of a lock file to `folder`."""
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary", ":all:"]
    command += ["--require-hashes", "-r", str(lock), "--dest", str(folder), "--python-version", python]
    command += [argument for tag in PLATFORMS[target] for argument in ("--platform", tag)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def stage_files(target: str, python: str, folder: Path) -> None:
    """Copy the contents of the zip for `target` and a Python version to `folder`: the package, its manifest and its wheels."""
    for name in STAGED_FILES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(ROOT / name, folder / name)
    write_pages(ROOT / "docs", folder / "manual")
    (folder / "wheels").mkdir()
    wheels = fetch_wheels(target, python)
    for wheel in wheels:
        shutil.copy2(wheel, folder / "wheels")
    manifest = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    names = [f"./wheels/{wheel.name}" for wheel in wheels]
    completed = complete_manifest(manifest, target, python, names, read_copyrights(wheels))
    (folder / "blender_manifest.toml").write_text(completed, encoding="utf-8")


def complete_manifest(manifest: str, target: str, python: str, wheels: list[str], copyrights: list[str]) -> str:
    """Return the manifest of a zip: with its platform, the versions of Blender that have its Python, the paths of `wheels` in the zip, and
    their copyright holders."""
    first, end = (BLENDER_VERSIONS | OTHER_VERSIONS)[python]
    last = "" if end is None else f'blender_version_max = "{end}"  # the first version with another Python\n'
    manifest = re.sub(r"(?m)^blender_version_min = .*\n", f'blender_version_min = "{first}"\n{last}', manifest)
    manifest = re.sub(r"(?m)^copyright = \[(.*)\]\n", lambda match: f"copyright = [\n  {match[1]},\n{_toml_lines(copyrights)}]\n", manifest)
    before, table, after = manifest.partition("[permissions]")  # top-level keys must precede the first table
    return f'{before}platforms = ["{target}"]\nwheels = [\n{_toml_lines(wheels)}]\n\n{table}{after}'


def _toml_lines(texts: list[str]) -> str:
    """Return the entries of a TOML array of strings, which are written as in JSON."""
    return "".join(f"  {json.dumps(text, ensure_ascii=False)},\n" for text in texts)


def run_blender_tool(*arguments: str) -> None:
    """Run Blender's extension tool, which is part of pip's bpy.

    Raises:
        BuildError: the tool is missing or fails.
    """
    package = Path(importlib.util.find_spec("bpy").origin).parent
    tools = sorted(package.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not tools:
        raise BuildError(f"Blender's extension tool was not found below {package}; run this with pip's bpy 4.5 or newer.")
    outcome = subprocess.run([sys.executable, str(tools[-1]), *arguments], capture_output=True, text=True, check=False)
    if outcome.returncode != 0:
        raise BuildError(f"Blender's extension tool cannot {arguments[0]} the extension: {(outcome.stdout + outcome.stderr).strip()}")


def build(target: str, python: str, out: Path, version: str) -> Path:
    """Build and validate the zip for Blender's platform `target` and a Python version. It appears in `out` complete or not at all."""
    archive = out / f"farfield-{version}-{target}-python{python}.zip"
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "farfield"
        tree.mkdir()
        stage_files(target, python, tree)
        built = Path(folder) / archive.name
        run_blender_tool("build", "--source-dir", str(tree), "--output-filepath", str(built))
        run_blender_tool("validate", str(built))
        copy_atomically(built, archive)
    return archive


def copy_atomically(source: Path, target: Path) -> None:
    """Copy `source` to `target`, which never exists partially written."""
    temporary = target.with_suffix(".part")
    shutil.copyfile(source, temporary)
    temporary.replace(target)


def running_platform() -> str:
    """Return this machine's platform as Blender names it."""
    system = {"darwin": "macos"}.get(platform.system().lower(), platform.system().lower())
    machine = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}.get(platform.machine().lower(), platform.machine().lower())
    return f"{system}-{machine}"


def main() -> int:
    parser = argparse.ArgumentParser(description="Build the extension's zips.")
    parser.add_argument("--platform", action="append", choices=list(PLATFORMS), help="build for this platform only (may be repeated)")
    pythons = [*BLENDER_VERSIONS, *OTHER_VERSIONS]
    parser.add_argument("--python", action="append", choices=pythons, help="build for this Python only (may be repeated)")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for the zips (default: dist)")
    arguments = parser.parse_args()
    version = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))["version"]
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
        running = running_platform(), f"{sys.version_info[0]}.{sys.version_info[1]}"
        for target, python in product(arguments.platform or PLATFORMS, arguments.python or BLENDER_VERSIONS):
            archive = build(target, python, arguments.out, version)
            print(f"{archive}  {archive.stat().st_size / 1e6:.1f} MB")
            if (target, python) == running:
                copy_atomically(archive, arguments.out / f"farfield-{version}.zip")
                print(f"{arguments.out / f'farfield-{version}.zip'}  (this platform and Python)")
    except BuildError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f'Cannot read or write "{error.filename}": {error.strerror}.', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
