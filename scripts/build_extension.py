"""Build the extension's zips, one a platform, each with the wheels that Blender's Python lacks there.

    python3 scripts/build_extension.py [--platform linux-x64 ...] [--out dist]

Leaves `farfield-<version>-<platform>.zip` for every platform and `farfield-<version>.zip` for the one it runs on. Each is built and
validated by Blender's own tool. Wheels are fetched once, checked against requirements/wheels.txt, and kept in build/wheels.
"""

import argparse
import hashlib
import importlib.util
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
import environment

environment.ensure()

import tomllib  # older Pythons, which can only start this script, lack it

ROOT = environment.ROOT
WHEELS_LOCK = ROOT / "requirements" / "wheels.txt"
WHEELS_CACHE = ROOT / "build" / "wheels"
STAGED = ("addon", "__init__.py", "LICENSE")  # the manifest comes along too, with the wheels written into it
PYTHONS = ("3.11", "3.13")  # of Blender 4.5 and 5.0, and of 5.1 and later
PLATFORMS = {  # the oldest systems that Blender 4.5 and 5.2 run on
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"),
    "macos-arm64": ("macosx_12_0_arm64",),
    "macos-x64": ("macosx_12_0_x86_64",),
    "windows-x64": ("win_amd64",),
}


class BuildError(Exception):
    """A zip cannot be built; one sentence says why."""


def locked_wheels() -> dict[str, set[str]]:
    """sha256 hashes of the allowed wheels, by package name as wheel files spell it."""
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


def wheels_at_hand(folder: Path) -> list[Path]:
    """The wheels in `folder` if every locked package is there, once and untouched; else none."""
    found = sorted(folder.glob("*.whl"))
    locked = locked_wheels()
    names = [wheel.name.split("-")[0].lower() for wheel in found]
    whole = sorted(names) == sorted(locked) and all(
        hashlib.sha256(wheel.read_bytes()).hexdigest() in locked[name] for wheel, name in zip(found, names, strict=True)
    )
    return found if whole else []


def fetch_wheels(target: str, python: str) -> list[Path]:
    """The wheels for Blender's platform `target` and this Python, from the cache or through pip.

    Raises:
        BuildError: when pip cannot get them.
    """
    folder = WHEELS_CACHE / f"{target}-{python}"
    wheels = wheels_at_hand(folder)
    if wheels:
        return wheels
    shutil.rmtree(folder, ignore_errors=True)
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps", "--only-binary", ":all:"]
    command += ["--require-hashes", "-r", str(WHEELS_LOCK), "--dest", str(folder), "--python-version", python]
    command += [word for tag in PLATFORMS[target] for word in ("--platform", tag)]
    outcome = subprocess.run(command, stdout=sys.stderr, check=False)
    wheels = wheels_at_hand(folder)
    if outcome.returncode != 0 or not wheels:
        raise BuildError(f"pip could not fetch the wheels for {target} and Python {python}; see the lines above.")
    return wheels


def stage(target: str, folder: Path) -> None:
    """Lay out in `folder` what goes into the zip for `target`: the package, its manifest and its wheels."""
    for name in STAGED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(ROOT / name, folder / name)
    (folder / "wheels").mkdir()
    names = []
    for python in PYTHONS:
        for wheel in fetch_wheels(target, python):
            shutil.copy2(wheel, folder / "wheels")
            names.append(f"./wheels/{wheel.name}")
    listed = "".join(f'  "{name}",\n' for name in sorted(set(names)))
    generated = f'platforms = ["{target}"]\nwheels = [\n{listed}]\n\n'
    manifest = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    before, table, after = manifest.partition("[permissions]")  # top-level keys must stand before the first table
    (folder / "blender_manifest.toml").write_text(before + generated + table + after, encoding="utf-8")


def run_blender_tool(*arguments: str) -> None:
    """Run Blender's extension tool, which lies inside pip's bpy.

    Raises:
        BuildError: when it refuses.
    """
    package = Path(importlib.util.find_spec("bpy").origin).parent
    tools = sorted(package.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not tools:
        raise BuildError(f"Blender's extension tool was not found below {package}; run this with pip's bpy 4.5 or newer.")
    outcome = subprocess.run([sys.executable, str(tools[-1]), *arguments], capture_output=True, text=True, check=False)
    if outcome.returncode != 0:
        raise BuildError(f"Blender's tool refuses to {arguments[0]} the extension: {(outcome.stdout + outcome.stderr).strip()}")


def build(target: str, out: Path, version: str) -> Path:
    """Build and validate the zip for Blender's platform `target`; it appears in `out` whole or not at all."""
    archive = out / f"farfield-{version}-{target}.zip"
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "farfield"
        tree.mkdir()
        stage(target, tree)
        built = Path(folder) / archive.name
        run_blender_tool("build", "--source-dir", str(tree), "--output-filepath", str(built))
        run_blender_tool("validate", str(built))
        replace(built, archive)
    return archive


def replace(source: Path, target: Path) -> None:
    """Copy `source` over `target` in one step, so that nobody sees a part of it."""
    part = target.with_suffix(".part")
    shutil.copyfile(source, part)
    part.replace(target)


def running_platform() -> str:
    """This machine's platform, as Blender names it."""
    system = {"darwin": "macos"}.get(platform.system().lower(), platform.system().lower())
    machine = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}.get(platform.machine().lower(), platform.machine().lower())
    return f"{system}-{machine}"


def main() -> int:
    parser = argparse.ArgumentParser(description="Build the extension's zips.")
    parser.add_argument("--platform", action="append", choices=list(PLATFORMS), help="build for this platform only (may be repeated)")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for the zips (default: dist)")
    arguments = parser.parse_args()
    version = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))["version"]
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
        for target in arguments.platform or PLATFORMS:
            archive = build(target, arguments.out, version)
            print(f"{archive}  {archive.stat().st_size / 1e6:.1f} MB")
            if target == running_platform():
                replace(archive, arguments.out / f"farfield-{version}.zip")
                print(f"{arguments.out / f'farfield-{version}.zip'}  (this machine's)")
    except BuildError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f'"{error.filename}" cannot be read or written: {error.strerror}.', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
