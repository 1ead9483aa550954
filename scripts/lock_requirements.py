"""Write the lock files in requirements/: exact versions with the hashes of the wheels for every platform.

    python3 scripts/lock_requirements.py                                       all lock files
    python3 scripts/lock_requirements.py py311-bpy5.0 wheels reference-tools   only these

pip resolves each set of packages once per platform, from the index in its configuration.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from lib.environment import LOCKS, ROOT, Lock, find_interpreter
from reference_tools import DOCS_TOOLS as DOCS_SET
from reference_tools import PYTHON_VERSION as REFERENCE_PYTHON
from reference_tools import REFERENCE_TOOLS as REFERENCE_SET
from reference_tools import TEXTURE_TOOLS as TEXTURE_SET
from reference_tools import ToolSet

PLATFORMS = {  # wheel tags by Blender's name of the platform; each list of tags is resolved separately, as the wheels may differ
    "linux-x64": [["manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64"]],
    "linux-arm64": [["manylinux_2_28_aarch64", "manylinux_2_27_aarch64", "manylinux_2_17_aarch64", "manylinux2014_aarch64"]],
    "macos-arm64": [["macosx_12_0_arm64"], ["macosx_15_0_arm64"]],
    "macos-x64": [["macosx_12_0_x86_64"], ["macosx_15_0_x86_64"]],
    "windows-x64": [["win_amd64"]],
}
BPY = {"4.5": "4.5.15", "5.0": "5.0.1", "5.2": "5.2.3"}
WHEELS = [
    "scipy==1.17.1",
    "xatlas==0.0.11",
    "fast-simplification==0.2.0",
    "threadpoolctl==3.8.0",
    "tifffile==2026.3.3",  # the last version for Python 3.11
    "meshopt==0.1.0",  # meshoptimizer's codecs for .glb files; the last version for Python 3.11
    "pillow==13.0.0",  # codes texture tiles as JPEG, WebP and PNG, and decodes images, without Blender
]  # bundled with the extension, the same for both Pythons
DEVELOPMENT = [  # not bundled
    *["pytest==9.2.0", "pytest-timeout==2.4.0", "pytest-xdist==3.8.0", "hypothesis==6.170.15"],
    "ruff==0.17.5",
    "codespell==2.4.3",  # American spelling of code and docs, see pyproject.toml
    "markdown==3.11.3",  # pages of the docs as HTML in the zip
    "distributed==2026.8.0",  # Dask
]
OTHER_PYTHONS = [(3, 14)]  # Distributions that build Blender themselves have these; wheels only.
NUMPY = {(3, 11): "numpy==1.26.4", (3, 13): "numpy==2.5.5"}  # Blender 4.5 and 5.0 contain 1.26
REFERENCE_TOOLS = [  # see reference_tools.py, with what btf-extractor needs to be built and run
    "flip-evaluator==1.7",
    *["cython==3.1.6", "poetry-core==2.2.1", "setuptools==80.9.0"],
    *["imageio==2.38.1", "nptyping==1.4.4", "numpy==1.26.4", "pillow==13.0.0", "simplejpeg==1.9.0", "typish==1.9.3"],
    # Inpainting. Newer versions of opencv have no wheels for macOS 12.
    *["opencv-contrib-python-headless==4.10.0.84", "pypatchmatch==2.2.0", "scikit-image==0.26.0", "scipy==1.17.1"],
    *["lazy-loader==0.6", "networkx==3.6.1", "packaging==26.3", "tifffile==2026.3.3"],  # what scikit-image needs
    *["pydelatin==0.4.0", "pymartini==0.6.0"],  # triangulations of height fields
]
TEXTURE_TOOLS = [  # textures from photographs, see reference_tools.py
    *["adobe-lagrange==6.49.0", "colorama==0.4.6", "nanobind-backend==1.0.0", "numpy==1.26.4", "pillow==13.0.0"],
    *["pymeshlab==2025.7.post1", "scipy==1.17.1"],
]
DOCS_TOOLS = ["mkdocs==1.6.1", "mkdocs-material==9.8.2"]  # the docs as a site, see build_docs.py
TEXTURE_PLATFORMS = {  # newer than what Blender needs
    "linux-x64": [[f"manylinux_2_{minor}_x86_64" for minor in (35, 28, 27, 17)] + ["manylinux2014_x86_64"]],
    "macos-arm64": [["macosx_15_0_arm64"]],
    "windows-x64": [["win_amd64"]],
}
REFERENCE_SOURCES = {"btf-extractor==1.7.0": {"5d2107344395e82280c384f6bfc8dcd5466f9a25d8a2b9e1cf00afb39af0b38d"}}  # has no wheels
ON_WINDOWS = ["colorama==0.4.6"]  # pytest requires it there; pip evaluates such conditions for the machine that it runs on

Pins = dict[str, set[str]]  # "name==version" to sha256 hashes


class MissingWheel(Exception):
    """A package has no wheel for a platform."""


def resolve(python: tuple[int, int], tags: list[str], requirements: list[str], *, dependencies: bool) -> Pins:
    """Return the packages that pip would install on a platform with these wheel tags.

    Raises:
        MissingWheel: a package has no wheel for this platform.
    """
    command = [
        *(find_interpreter(python) or [sys.executable]),
        "-m",
        "pip",
        "install",
        "--dry-run",
        "--ignore-installed",
        "--only-binary",
        ":all:",
        "--quiet",
    ]
    command += ["--python-version", f"{python[0]}.{python[1]}"] + [argument for tag in tags for argument in ("--platform", tag)]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command += ["--target", folder, "--report", str(report), *([] if dependencies else ["--no-deps"]), *requirements]
        outcome = subprocess.run(command, capture_output=True, text=True, check=False)
        if outcome.returncode != 0:
            if "No matching distribution found for " in outcome.stderr:
                raise MissingWheel(outcome.stderr.rpartition("No matching distribution found for ")[2].split()[0])
            raise SystemExit(outcome.stderr)
        installs = json.loads(report.read_text(encoding="utf-8"))["install"]
    return {
        "{name}=={version}".format_map(item["metadata"]).lower().replace("_", "-"): {
            item["download_info"]["archive_info"]["hashes"]["sha256"]
        }
        for item in installs
    }


def resolve_everywhere(
    python: tuple[int, int], requirements: list[str], *, dependencies: bool, platforms: dict[str, list[list[str]]] = PLATFORMS
) -> tuple[dict[str, Pins], dict[str, str]]:
    """Return the pins by platform, and for each skipped platform the package that has no wheel there."""
    pins: dict[str, Pins] = {}
    skipped: dict[str, str] = {}
    for platform, tag_lists in platforms.items():
        platform_requirements = requirements + (ON_WINDOWS if dependencies and platform.startswith("windows") else [])
        platform_pins: Pins = {}
        try:
            for tags in tag_lists:
                for pin, hashes in resolve(python, tags, platform_requirements, dependencies=dependencies).items():
                    platform_pins.setdefault(pin, set()).update(hashes)
        except MissingWheel as missing:
            skipped[platform] = str(missing)
            continue
        pins[platform] = platform_pins
    return pins, skipped


def write(path: Path, comments: list[str], pins: dict[str, Pins]) -> None:
    """Write one lock file. Packages that only Windows needs get an environment marker."""
    lines = []
    for pin in sorted({pin for platform_pins in pins.values() for pin in platform_pins}):
        platforms = [platform for platform, platform_pins in pins.items() if pin in platform_pins]
        marker = ' ; sys_platform == "win32"' if all(platform.startswith("windows") for platform in platforms) else ""
        hashes = sorted({digest for platform in platforms for digest in pins[platform][pin]})
        lines.append(" \\\n".join([pin + marker, *(f"    --hash=sha256:{digest}" for digest in hashes)]))
    if len({line.split("==")[0] for line in lines}) < len(lines):
        raise SystemExit(f"{path.name}: platforms resolve to different versions of one package; pin it in {Path(__file__).name}.")
    path.write_text("\n".join([*(f"# {comment}" for comment in comments), *lines, ""]), encoding="utf-8", newline="\n")
    print(f"{path.relative_to(ROOT)}: {len(lines)} packages for {', '.join(pins)}")


def lock_environment(lock: Lock) -> None:
    """Write the lock of an environment: bpy, the packages bundled with the extension, and the test tools."""
    requirements = [f"bpy=={BPY[lock.blender]}", NUMPY[lock.python], *WHEELS, *DEVELOPMENT]
    pins, skipped = resolve_everywhere(lock.python, requirements, dependencies=True)
    comments = [
        f"Blender {lock.blender} on Python {lock.python[0]}.{lock.python[1]}. Written by scripts/lock_requirements.py; change it there."
    ]
    comments += [f"Not for {platform}: {package} has no wheel there." for platform, package in skipped.items()]
    write(lock.path, comments, pins)


def lock_wheels() -> None:
    """Write the lock of the wheels in the extension's zips."""
    merged: dict[str, Pins] = {}
    comments = [
        "The wheels inside the extension's zips, for Python 3.11, 3.13 and 3.14. Written by scripts/lock_requirements.py; change it there."
    ]
    pythons = sorted({lock.python for lock in LOCKS})
    # Zips for other Pythons do without what has no wheel there, so each package is resolved alone.
    for python, wheels in [*((python, WHEELS) for python in pythons), *((python, [wheel]) for python in OTHER_PYTHONS for wheel in WHEELS)]:
        pins, skipped = resolve_everywhere(python, wheels, dependencies=False)
        comments += [f"Not for {platform} on {python[0]}.{python[1]}: {package} has no wheel." for platform, package in skipped.items()]
        for platform, platform_pins in pins.items():
            for pin, hashes in platform_pins.items():
                merged.setdefault(platform, {}).setdefault(pin, set()).update(hashes)
    write(ROOT / "requirements" / "wheels.txt", comments, merged)


def lock_reference_tools() -> None:
    """Write the locks of the reference tools: wheels, and source packages that are built with them."""
    comments = _lock_tools(REFERENCE_SET, REFERENCE_TOOLS, PLATFORMS)
    write(
        REFERENCE_SET.sources_lock,
        [*comments, "Built from sources, after the wheels of the other file are in place."],
        {"every platform": REFERENCE_SOURCES},
    )


def _lock_tools(tools: ToolSet, requirements: list[str], platforms: dict[str, list[list[str]]], *, dependencies: bool = False) -> list[str]:
    """Write the lock of the wheels of a set of tools; returns the comment at its top."""
    pins, skipped = resolve_everywhere(REFERENCE_PYTHON, requirements, dependencies=dependencies, platforms=platforms)
    python = ".".join(map(str, REFERENCE_PYTHON))
    comments = [f"What scripts/reference_tools.py installs, for Python {python}. Written by scripts/lock_requirements.py; change it there."]
    write(tools.lock, [*comments, *(f"Not for {platform}: {package} has no wheel there." for platform, package in skipped.items())], pins)
    return comments


def main() -> None:
    names = set(sys.argv[1:])
    for lock in LOCKS:
        if not names or lock.name in names:
            lock_environment(lock)
    if not names or "wheels" in names:
        lock_wheels()
    if not names or "reference-tools" in names:
        lock_reference_tools()
    if not names or "texture-tools" in names:
        _lock_tools(TEXTURE_SET, TEXTURE_TOOLS, TEXTURE_PLATFORMS)
    if not names or "docs-tools" in names:
        _lock_tools(DOCS_SET, DOCS_TOOLS, PLATFORMS, dependencies=True)


if __name__ == "__main__":
    main()
