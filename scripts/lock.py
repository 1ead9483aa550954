"""Write the lock files in requirements/: exact versions, with the hashes of the wheels for every platform.

    python3 scripts/lock.py              all of them
    python3 scripts/lock.py py311-bpy5.0 wheels peers    some of them

pip resolves each set once a platform, as it would install it there, from the index that this machine's pip is set up for.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from environment import LOCKS, ROOT, Lock, interpreter
from peers import LOCK as PEERS_LOCK
from peers import PYTHON as PEERS_PYTHON
from peers import SOURCES_LOCK as PEERS_SOURCES_LOCK

PLATFORMS = {  # wheel tags by the name that Blender gives a platform; older and newer tags of one platform may be different wheels
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
    "tifffile==2026.3.3",  # the last one for Python 3.11
]  # what the extension brings along, the same for both Pythons
TESTS = ["pytest==9.2.0", "pytest-timeout==2.4.0", "pytest-xdist==3.8.0", "hypothesis==6.170.15", "ruff==0.17.5", "distributed==2026.8.0"]
NUMPY = {(3, 11): "numpy==1.26.4", (3, 13): "numpy==2.5.5"}  # 1.26 is what Blender 4.5 and 5.0 hold
PEERS = [  # other people's programs that tests and benchmarks hold ours against, and what btf-extractor needs to be built and run
    "flip-evaluator==1.7",
    *["cython==3.1.6", "poetry-core==2.2.1", "setuptools==80.9.0"],
    *["imageio==2.38.1", "nptyping==1.4.4", "numpy==1.26.4", "pillow==13.0.0", "simplejpeg==1.9.0", "typish==1.9.3"],
]
PEER_SOURCES = {"btf-extractor==1.7.0": {"5d2107344395e82280c384f6bfc8dcd5466f9a25d8a2b9e1cf00afb39af0b38d"}}  # there are no wheels of it
ON_WINDOWS = ["colorama==0.4.6"]  # pytest asks for it there; pip weighs such conditions for the machine that it runs on

Pins = dict[str, set[str]]  # "name==version" to sha256 hashes


class MissingWheel(Exception):
    """A package has no wheel for a platform."""


def resolve(python: tuple[int, int], tags: list[str], requirements: list[str], *, dependencies: bool) -> Pins:
    """What pip would install for a platform with these wheel tags.

    Raises:
        MissingWheel: when a package has no wheel for it.
    """
    command = [*interpreter(python), "-m", "pip", "install", "--dry-run", "--ignore-installed", "--only-binary", ":all:", "--quiet"]
    command += ["--python-version", f"{python[0]}.{python[1]}"] + [word for tag in tags for word in ("--platform", tag)]
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


def resolve_everywhere(python: tuple[int, int], requirements: list[str], *, dependencies: bool) -> tuple[dict[str, Pins], dict[str, str]]:
    """Pins by platform, and for the platforms that are left out the package that has no wheel there."""
    pins: dict[str, Pins] = {}
    left_out: dict[str, str] = {}
    for platform, tag_lists in PLATFORMS.items():
        wanted = requirements + (ON_WINDOWS if dependencies and platform.startswith("windows") else [])
        found: Pins = {}
        try:
            for tags in tag_lists:
                for pin, hashes in resolve(python, tags, wanted, dependencies=dependencies).items():
                    found.setdefault(pin, set()).update(hashes)
        except MissingWheel as missing:
            left_out[platform] = str(missing)
            continue
        pins[platform] = found
    return pins, left_out


def write(path: Path, comments: list[str], pins: dict[str, Pins]) -> None:
    """Write one lock file. A package that only Windows needs is marked so."""
    lines = []
    for pin in sorted({pin for found in pins.values() for pin in found}):
        platforms = [platform for platform, found in pins.items() if pin in found]
        marker = ' ; sys_platform == "win32"' if all(platform.startswith("windows") for platform in platforms) else ""
        hashes = sorted({digest for platform in platforms for digest in pins[platform][pin]})
        lines.append(" \\\n".join([pin + marker, *(f"    --hash=sha256:{digest}" for digest in hashes)]))
    if len({line.split("==")[0] for line in lines}) < len(lines):
        raise SystemExit(f"{path.name}: platforms resolve to different versions of one package; pin it in {Path(__file__).name}.")
    path.write_text("\n".join([*(f"# {comment}" for comment in comments), *lines, ""]), encoding="utf-8", newline="\n")
    print(f"{path.relative_to(ROOT)}: {len(lines)} packages for {', '.join(pins)}")


def lock_environment(lock: Lock) -> None:
    """Write the lock of a whole environment: bpy, what the extension brings along, and the tools of the tests."""
    requirements = [f"bpy=={BPY[lock.blender]}", NUMPY[lock.python], *WHEELS, *TESTS]
    pins, left_out = resolve_everywhere(lock.python, requirements, dependencies=True)
    comments = [f"Blender {lock.blender} on Python {lock.python[0]}.{lock.python[1]}. Written by scripts/lock.py; change it there."]
    comments += [f"Not for {platform}: {package} has no wheel there." for platform, package in left_out.items()]
    write(lock.path, comments, pins)


def lock_wheels() -> None:
    """Write the lock of the wheels that the extension's zips hold."""
    merged: dict[str, Pins] = {}
    comments = ["The wheels inside the extension's zips, for Python 3.11 and 3.13. Written by scripts/lock.py; change it there."]
    for python in sorted({lock.python for lock in LOCKS}):
        pins, left_out = resolve_everywhere(python, WHEELS, dependencies=False)
        comments += [f"Not for {platform} on {python[0]}.{python[1]}: {package} has no wheel." for platform, package in left_out.items()]
        for platform, found in pins.items():
            for pin, hashes in found.items():
                merged.setdefault(platform, {}).setdefault(pin, set()).update(hashes)
    write(ROOT / "requirements" / "wheels.txt", comments, merged)


def lock_peers() -> None:
    """Write the locks of what scripts/peers.py installs: wheels, and sources that are built with them."""
    pins, left_out = resolve_everywhere(PEERS_PYTHON, PEERS, dependencies=False)
    comments = [
        f"What scripts/peers.py installs, for Python {PEERS_PYTHON[0]}.{PEERS_PYTHON[1]}. Written by scripts/lock.py; change it there."
    ]
    write(PEERS_LOCK, [*comments, *(f"Not for {platform}: {package} has no wheel there." for platform, package in left_out.items())], pins)
    write(
        PEERS_SOURCES_LOCK,
        [*comments, "Built from sources, after the wheels of the other file are in place."],
        {"every platform": PEER_SOURCES},
    )


def main() -> None:
    wanted = set(sys.argv[1:])
    for lock in LOCKS:
        if not wanted or lock.name in wanted:
            lock_environment(lock)
    if not wanted or "wheels" in wanted:
        lock_wheels()
    if not wanted or "peers" in wanted:
        lock_peers()


if __name__ == "__main__":
    main()
