"""Files of strangers through all scripts that read them: `python3 benchmarks/campaign_files.py FOLDER ... [flags]`.

Prints JSON. Each file below the folders that a tool reads goes through it with small settings. The script must end with exit code 0, or
with 2 and one sentence; it changes no input and leaves nothing behind. Results are compared with references: level 0 of a mesh and
unwrapped meshes with what Blender's importers read, in numbers and renders; heights with those of GDAL; pixels outside of the mask with
those of tifffile, libpng, libjpeg and OpenEXR; projections of cameras with those of COLMAP. FARFIELD_REFERENCES names a Python that has
rasterio, tifffile with imagecodecs, OpenEXR and pycolmap; files without a reference are counted. FARFIELD_BPY selects the Blender.
"""

import hashlib
import json
import shutil
import sys
import tempfile
import time
from argparse import ArgumentDefaultsHelpFormatter, Namespace
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()
sys.path.append(str(environment.ROOT / "tests"))

import bpy
from campaign_batches import BatchOptions, run_cases
from campaign_checks import Problem

from farfield.addon.core.jobs.progress import Progress
from lib import command_line

WORKER = Path(__file__).with_name("campaign_file_worker.py")
MESHES = (".blend", ".obj", ".ply", ".stl", ".glb", ".gltf", ".fbx", ".usd", ".usda", ".usdc", ".usdz")
HEIGHTS = (".tif", ".tiff", ".asc", ".hgt", ".npy", ".png", ".exr", ".hdr", ".webp", ".bmp")
IMAGES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".exr", ".webp", ".bmp", ".tga", ".hdr", ".dds")
CAMERAS = (".sfm", ".nvm", ".out", ".mvs", ".pairs", ".xml", ".json")
EXTENSIONS = {
    "texmesh": MESHES,
    "unwrap": MESHES,
    "billboards": MESHES,
    "bdam": HEIGHTS,
    "clipbox": (*HEIGHTS, ".vdb", ".nii", ".raw"),
    "restore": IMAGES,
    "photos": CAMERAS,
}
CAMERA_MARKS = (b"<document", b"<chunk", b'"frames"', b'"views"', b"NVM_V3", b"# Bundle", b"points")  # at the start of a file
NAMED = (" lacks ", "taken as unknown", "Skipped: ")  # in results that differ from the input and say how
CASE_SECONDS = 90.0


@dataclass
class Tally:
    """What happened to the files of one tool. formats: counts by extension and by what happened; differences, refusals, missing
    references and findings: sentences with the files that they are about."""

    formats: dict[str, Counter] = field(default_factory=lambda: defaultdict(Counter))
    differences: list[dict[str, Any]] = field(default_factory=list)
    refusals: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    missing: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    findings: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    seconds: float = 0.0

    def add(self, path: Path, result: dict[str, Any]) -> None:
        """Count the result of one file."""
        counts, comparison = self.formats[path.suffix.lower() or "folder"], result.get("comparison")
        counts["files"] += 1
        for kind, text in result["problems"]:
            counts["findings"] += 1
            self.findings[Problem(kind, text).signature].append(str(path))
        if result.get("code") == 2:
            counts["refused"] += 1
            self.refusals[Problem("", result["stderr"]).signature.removeprefix(": ")].append(f"{path}: {result['stderr'].strip()}")
        if result.get("code") == 0:
            counts["success"] += 1
        if comparison is None:
            return
        if "no_reference" in comparison:
            counts["no reference"] += 1
            self.missing[comparison["no_reference"]].append(str(path))
        else:
            counts["compared"] += 1
            counts["equal"] += "problem" not in comparison
            counts["named"] += "problem" in comparison and any(word in result["stdout"] for word in NAMED)
        if "problem" in comparison:
            self.differences.append({"file": str(path), **comparison, "said": result["stdout"].strip()})

    def figures(self) -> dict[str, Any]:
        """Return everything as JSON."""
        return {
            "formats": {name: dict(counts) for name, counts in sorted(self.formats.items())},
            "findings": dict(self.findings),
            "differences": self.differences,
            "refusals": dict(self.refusals),
            "without_reference": dict(self.missing),
            "seconds": round(self.seconds, 1),
        }


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the campaign."""
    parser = command_line.Parser(
        prog="campaign_files.py", description=__doc__.split("\n")[0], formatter_class=ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="folders with files, or files")
    parser.add_argument("--tool", nargs="+", choices=list(EXTENSIONS), default=list(EXTENSIONS), help="tools to run")
    parser.add_argument("--per-format", type=int, default=60, help="files per tool and extension, evenly spread")
    parser.add_argument("--max-bytes", type=int, default=1_500_000, help="larger files are left out")
    parser.add_argument("--part", default="0/1", help="I/N for every N-th file from I on")
    parser.add_argument("--minutes", type=float, default=600.0, help="time limit of all tools together")
    parser.add_argument("--memory-gb", type=float, default=8.0, help="address space of a worker process, in GiB")
    parser.add_argument("--report", type=Path, help="a JSON file for the results")
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the campaign and return the results as JSON; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    results: dict[str, Any] = {"blender": bpy.app.version_string, "tools": {}}
    files = find_files(given.folders, given.max_bytes)
    results["files"] = len({path for paths in files.values() for path in paths})
    sandbox, end = Path(tempfile.mkdtemp(prefix="farfield-campaign-")), time.monotonic() + 60.0 * given.minutes
    chosen: set[Path] = set()
    try:
        for tool in given.tool:
            paths = choose_files(files, tool, given)
            chosen.update(paths)
            results["tools"][tool] = run_tool(tool, paths, sandbox, given, end, line).figures()
            results["chosen"] = len(chosen)
            if given.report is not None:
                command_line.write_report(given.report.absolute(), results)
    except KeyboardInterrupt:
        results["ended"] = "cancelled"
    finally:
        shutil.rmtree(sandbox, ignore_errors=True)
    return json.dumps(results, indent=1)


def find_files(folders: Iterable[Path], max_bytes: int) -> dict[str, list[Path]]:
    """Return all different files below folders that a tool may read, and folders of COLMAP ("folder"), by extension."""
    found: dict[str, list[Path]] = defaultdict(list)
    seen: set[bytes] = set()
    extensions = {extension for known in EXTENSIONS.values() for extension in known}
    for folder in folders:
        for path in sorted([folder.absolute()] if folder.is_file() else folder.absolute().rglob("*")):
            extension = path.suffix.lower()
            if path.is_dir() and any((path / f"images.{kind}").is_file() for kind in ("txt", "bin")):
                found["folder"].append(path)
            if extension not in extensions or not path.is_file() or path.stat().st_size > max_bytes:
                continue
            content = path.read_bytes()
            digest = hashlib.sha256(content).digest()
            if digest not in seen and (extension not in CAMERAS or any(mark in content[:4096] for mark in CAMERA_MARKS)):
                seen.add(digest)
                found[extension].append(path)
    return found


def choose_files(files: dict[str, list[Path]], tool: str, given: Namespace) -> list[Path]:
    """Return the files for a tool, at most as many of each extension as wanted."""
    index, count = map(int, given.part.split("/"))
    extensions = (*EXTENSIONS[tool], *(["folder"] if tool == "photos" else []))
    chosen = []
    for extension in extensions:
        paths = files.get(extension, [])
        step = max(1.0, len(paths) / given.per_format)
        chosen += [paths[int(position * step)] for position in range(min(len(paths), given.per_format))]
    return chosen[index::count]


def run_tool(tool: str, paths: list[Path], sandbox: Path, given: Namespace, end: float, line: command_line.ProgressLine) -> Tally:
    """Run one tool on all files."""
    (sandbox / "jobs.json").write_text(json.dumps([{"tool": tool, "path": str(path)} for path in paths]), encoding="utf-8")
    tally, start = Tally(), time.monotonic()

    def show() -> None:
        done = sum(counts["files"] for counts in tally.formats.values())
        line.show(Progress(done / len(paths), f"{tool}: {done} files"))

    options = BatchOptions(0, sandbox, CASE_SECONDS, given.memory_gb, keep=False, worker=WORKER)
    for result in run_cases(tool, range(len(paths)), options, show):
        tally.add(paths[result["case"]], result)
        if time.monotonic() > end:
            break
    tally.seconds = time.monotonic() - start
    counts = sum(tally.formats.values(), Counter())
    print(f"{tool}: {dict(counts)}", file=sys.stderr)
    return tally


if __name__ == "__main__":
    command_line.run(main)
