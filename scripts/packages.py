"""Packages of textured models that a web page loads within a time limit: `python3 scripts/packages.py build INPUT --out FOLDER [flags]`,
`verify FOLDER`, `serve FOLDER` and `view FOLDER`.

INPUT is a .blend, .obj, .ply, .stl, .glb, .gltf, .fbx or .usd file; each mesh that is visible in renders becomes a package. `verify` checks
every byte of a package, `serve` sends it to browsers, by default on this machine only, and `view` also opens one. The flags of the levels
are those of texmesh.py. `blender --background --python scripts/packages.py -- build INPUT --out FOLDER` does the same.
"""

import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not put a script's folder there

from lib import environment

environment.ensure(exits_on_signals=True)
environment.import_farfield()

import bpy

from farfield.addon.core.files.file_access import check_writable
from farfield.addon.core.jobs.progress import StageClock, run_to_end
from farfield.addon.core.messages import format_count, join_sentences
from farfield.addon.core.packages.files import check_package_folder, read_package
from farfield.addon.core.packages.manifest import MANIFEST
from farfield.addon.core.packages.package import PackageReport
from farfield.addon.core.packages.settings import FIXED_LEVEL_SETTINGS, PackageSettings
from farfield.addon.core.settings import add_flags, describe, from_flags
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.packages.operators import prepare_packages
from lib import command_line, run_files, scene_files
from lib.connection_rate import ConnectionRate, parse_rate
from lib.texmesh_inputs import add_answers_flag, open_objects, read_level_settings

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8765
PACKAGES = run_files.PathType(is_output=True, is_folder=True, check=lambda folder: check_writable(folder / MANIFEST))


def build_parser() -> command_line.Parser:
    """Return the parser of all arguments of the script."""
    parser = command_line.Parser(prog="packages.py", description="Build, check and serve packages of textured models for a web page.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="build|verify|serve|view")
    build = commands.add_parser("build", description="Build a package of files for a web server, with a page that shows it in time.")
    build.add_argument("input", type=run_files.INPUT, help="a .blend .obj .ply .stl .glb .gltf .fbx or .usd file")
    build.add_argument("--out", type=PACKAGES, required=True, help="the folder to write; one folder in it per object")
    build.add_argument("--report", type=run_files.REPORT, help="write a report of the run to this JSON file")
    add_flags(build, TexmeshSettings, [item.name for item in describe(TexmeshSettings) if item.name not in FIXED_LEVEL_SETTINGS])
    add_answers_flag(build)
    add_flags(build, PackageSettings)
    verify = commands.add_parser("verify", description="Check every byte of a package.")
    serve = commands.add_parser("serve", description="Serve a package over HTTP, by default on this machine only.")
    view = commands.add_parser("view", description="Serve a package on this machine and show it in the web browser.")
    for command in (verify, serve, view):
        command.add_argument("folder", type=run_files.CLOSED_FOLDER, help="the folder of a package")
    serve.add_argument("--address", default=LOOPBACK, help=f"address to listen on; others than {LOOPBACK} can be reached from elsewhere")
    for command in (serve, view):
        command.add_argument("--port", type=int, default=DEFAULT_PORT, help=f"port, 0 for a free one (default: {DEFAULT_PORT})")
        command.add_argument("--rate", help="limit the rate of the connection, such as 2Mbit or 300kB")
    return parser


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Run the script and return the summary; raises FarfieldError if the input is invalid."""
    given = build_parser().parse_args(arguments)
    if given.command == "build":
        return build(given, line)
    return verify(given) if given.command == "verify" else serve(given, line)


def build(given: Namespace, line: command_line.ProgressLine) -> str:
    """Build the packages of all objects in the input."""
    settings = read_level_settings(given)
    package_settings = from_flags(PackageSettings, given)
    out = given.out.absolute()
    clock = StageClock()
    with clock.stage("read"):
        objects, moved = open_objects(given)
        job = prepare_packages(bpy.context, objects, settings, package_settings, out)
        job.skipped.extend(scene_files.describe_missing())
        for folder in job.folders:
            check_package_folder(folder)
    with clock.stage("build"):
        summary = run_to_end(run_job(job), line.show)
    line.clear()
    if given.report is not None:
        report = {
            "packages": [describe_package(item) for item in job.reports],
            "skipped": job.skipped,
            "seconds": {stage: round(duration, 4) for stage, duration in clock.seconds.items()},
            "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
        }
        command_line.write_report(given.report.absolute(), report)
    return join_sentences([summary, moved])


def describe_package(report: PackageReport) -> dict[str, Any]:
    """Return the figures of one package."""
    table = report.table
    return {
        "name": report.name,
        "triangles": list(report.levels),
        "mesh_bytes": report.mesh_bytes,
        "texture_bytes": report.texture_bytes,
        "errors_of_levels": [float(error) for error in table.level_errors[::-1]],
        "states": [int(state) for state in table.states],
        "errors_of_states": [float(error) for error in table.texture_errors],
        "exponent": table.exponent,
        "largest_residual": table.residual,
        "plan": [row._asdict() for row in report.plan],
    }


def verify(given: Namespace) -> str:
    """Check a package."""
    content = read_package(given.folder.absolute())
    manifest = content.manifest
    size = (len(content.mesh) + len(content.textures)) / 1e6
    levels, increments = format_count(len(manifest.levels), "level"), format_count(manifest.increment_count, "increment")
    return f'"{manifest.name}" is complete: {levels}, {increments}, {size:.2f} MB.'


def serve(given: Namespace, line: command_line.ProgressLine) -> str:
    """Serve a package until Ctrl+C."""
    from lib import package_server  # here: Blender's Python lacks the web server

    rate = None if given.rate is None else ConnectionRate(((0.0, parse_rate(given.rate)),))

    def announce(url: str) -> None:
        line.clear()
        command_line.print_message(f"{url} (press Ctrl+C to stop)")

    folder = given.folder.absolute()
    if given.command == "view":
        package_server.open_view(folder, given.port, rate, announce, line.check_cancel)
    else:
        package_server.serve(folder, given.address, given.port, rate, announce, line.check_cancel)
    return "Stopped."


if __name__ == "__main__":
    command_line.run(main)
