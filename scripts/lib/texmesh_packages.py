"""The commands of `texmesh.py` that build packages, check them, and serve them on this machine."""

from argparse import Namespace, _SubParsersAction
from typing import Any

import bpy

from lib import command_line, environment

environment.import_farfield()

from farfield.addon.core.errors import FileError
from farfield.addon.core.jobs.progress import StageClock, run_to_end
from farfield.addon.core.settings import Settings, add_flags, from_flags
from farfield.addon.core.texmesh.streaming.package import PackageReport
from farfield.addon.core.texmesh.streaming.package_files import read_package
from farfield.addon.core.texmesh.streaming.settings import PackageSettings
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.texmesh.packages import CORE_SETTINGS, prepare_packages
from lib.texmesh_inputs import open_objects, read_all_settings

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8765
COMMANDS = ("build", "verify", "serve", "view")


def add_commands(commands: "_SubParsersAction[command_line.Parser]") -> None:
    """Add the parsers of the commands."""
    build = commands.add_parser("build", description="Build a package of files for a web server, with a page that shows it in time.")
    build.add_argument("input", type=command_line.parse_path, help="a .blend .obj .ply .stl .glb .gltf .fbx or .usd file")
    build.add_argument("--out", type=command_line.parse_path, required=True, help="the folder to write; one folder in it per object")
    build.add_argument("--report", type=command_line.parse_path, help="write a report of the run to this JSON file")
    for settings_type in (*CORE_SETTINGS, PackageSettings):
        add_flags(build, settings_type)
    verify = commands.add_parser("verify", description="Check every byte of a package.")
    serve = commands.add_parser("serve", description="Serve a package over HTTP, by default on this machine only.")
    view = commands.add_parser("view", description="Serve a package on this machine and show it in the web browser.")
    for command in (verify, serve, view):
        command.add_argument("folder", type=command_line.parse_path, help="the folder of a package")
    serve.add_argument("--address", default=LOOPBACK, help=f"address to listen on; others than {LOOPBACK} can be reached from elsewhere")
    for command in (serve, view):
        command.add_argument("--port", type=int, default=DEFAULT_PORT, help=f"port, 0 for a free one (default: {DEFAULT_PORT})")
        command.add_argument("--rate", help="limit the rate of the line, such as 2Mbit or 300kB")


def run_command(given: Namespace, line: command_line.ProgressLine) -> str:
    """Run one of COMMANDS and return the summary. Raises FarfieldError."""
    if given.command == "build":
        return _build(given, line)
    return _verify(given) if given.command == "verify" else _serve(given, line)


def _build(given: Namespace, line: command_line.ProgressLine) -> str:
    settings = read_all_settings(given, CORE_SETTINGS)
    package_settings: Settings = from_flags(PackageSettings, given)
    out = given.out.absolute()
    if out.is_file():
        raise FileError(f'--out is the file "{given.out}"; give a folder.')
    clock = StageClock()
    with clock.stage("read"):
        job = prepare_packages(bpy.context, open_objects(given.input), settings, package_settings, out)
    with clock.stage("build"):
        summary = run_to_end(run_job(job), line.show)
    line.clear()
    if given.report is not None:
        report = {
            "packages": [_describe(item) for item in job.reports],
            "skipped": job.skipped,
            "seconds": {stage: round(duration, 4) for stage, duration in clock.seconds.items()},
            "peak_memory_mb": round(command_line.peak_memory_mb(), 1),
        }
        command_line.write_report(given.report.absolute(), report)
    return summary


def _describe(report: PackageReport) -> dict[str, Any]:
    table = report.table
    return {
        "name": report.name,
        "triangles": list(report.levels),
        "mesh_bytes": report.mesh_bytes,
        "texture_bytes": report.texture_bytes,
        "errors_of_levels": [float(error) for error in table.level_errors[::-1]],
        "increments": [int(count) for count in table.counts],
        "errors_of_textures": [float(error) for error in table.texture_errors],
        "exponent": table.exponent,
        "largest_residual": table.residual,
    }


def _verify(given: Namespace) -> str:
    content = read_package(given.folder.absolute())
    manifest = content.manifest
    size = (len(content.mesh) + len(content.textures)) / 1e6
    return f'"{manifest.name}" is complete: {len(manifest.levels)} levels, {manifest.increment_count:,} increments, {size:.2f} MB.'


def _serve(given: Namespace, line: command_line.ProgressLine) -> str:
    from lib.line_rate import LineRate, parse_rate  # here: Blender's Python lacks the web server
    from lib.package_server import open_view, serve

    rate = None if given.rate is None else LineRate(((0.0, parse_rate(given.rate)),))

    def announce(url: str) -> None:
        line.clear()
        command_line.print_message(f"{url} (press Ctrl+C to stop)")

    folder = given.folder.absolute()
    if given.command == "view":
        open_view(folder, given.port, rate, announce, line.check_cancel)
    else:
        serve(folder, given.address, given.port, rate, announce, line.check_cancel)
    return "Stopped."
