"""The commands of `texmesh.py` that build packages, check them, serve them on this machine, and simulate lines."""

import json
from argparse import Namespace, _SubParsersAction
from typing import Any

import bpy
import numpy as np

from lib import command_line, environment

environment.import_farfield()

from farfield.addon.core.errors import FileError, SettingsError
from farfield.addon.core.jobs.progress import StageClock, run_to_end
from farfield.addon.core.settings import Settings, add_flags, from_flags
from farfield.addon.core.texmesh.streaming.package import PackageReport
from farfield.addon.core.texmesh.streaming.package_files import read_package
from farfield.addon.core.texmesh.streaming.settings import PackageSettings
from farfield.addon.core.texmesh.streaming.simulated_network import Line
from farfield.addon.core.texmesh.streaming.simulation import CLIENTS, build_sent_package, simulate
from farfield.addon.core.texmesh.streaming.traces import (
    Trace,
    burst_trace,
    cellular_trace,
    constant_trace,
    ramp_trace,
    read_trace,
    step_trace,
)
from farfield.addon.operators.job_run import run_job
from farfield.addon.operators.texmesh.operators import CORE_SETTINGS
from farfield.addon.operators.texmesh.packages import prepare_packages
from lib.line_rate import LineRate, parse_rate
from lib.texmesh_inputs import open_objects, read_all_settings

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8765
MIN_LIMIT, MAX_LIMIT = 0.1, 3600.0  # seconds
TRACE_LENGTH = 1.5  # of lines that are generated, relative to the limit; then they repeat
COMMANDS = ("build", "verify", "serve", "view", "simulate")
KINDS = ("constant", "step", "ramp", "burst", "3G", "4G")


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
    simulate = commands.add_parser("simulate", description="Simulate what a client gets of a package over a line.")
    for command in (verify, serve, view, simulate):
        command.add_argument("folder", type=command_line.parse_path, help="the folder of a package")
    serve.add_argument("--address", default=LOOPBACK, help=f"address to listen on; others than {LOOPBACK} can be reached from elsewhere")
    for command in (serve, view):
        command.add_argument("--port", type=int, default=DEFAULT_PORT, help=f"port, 0 for a free one (default: {DEFAULT_PORT})")
        command.add_argument("--rate", help="limit the rate of the line, such as 2Mbit or 300kB")
    simulate.add_argument(
        "--trace", type=command_line.parse_path, help="text file of the line: seconds and bytes per second, or Mahimahi's"
    )
    simulate.add_argument("--kind", choices=KINDS, default="constant", help="line to generate without --trace (default: constant)")
    simulate.add_argument("--rate", default="2Mbit", help="mean rate of the line that is generated (default: 2Mbit)")
    simulate.add_argument("--limit", type=float, help="time limit in seconds (default: that of the package)")
    simulate.add_argument("--client", choices=CLIENTS, default=CLIENTS[0], help=f"how the client asks (default: {CLIENTS[0]})")
    simulate.add_argument("--seed", type=int, default=0, help="of the line that is generated (default: 0)")
    simulate.add_argument("--report", type=command_line.parse_path, help="write the figures to this JSON file")


def run_command(given: Namespace, line: command_line.ProgressLine) -> str:
    """Run one of COMMANDS and return the summary. Raises FarfieldError."""
    if given.command == "build":
        return _build(given, line)
    if given.command == "simulate":
        return _simulate(given)
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
        "states": [int(state) for state in table.states],
        "errors_of_states": [float(error) for error in table.texture_errors],
        "exponent": table.exponent,
        "largest_residual": table.residual,
        "plan": [row._asdict() for row in report.plan],
    }


def _verify(given: Namespace) -> str:
    content = read_package(given.folder.absolute())
    manifest = content.manifest
    size = (len(content.mesh) + len(content.textures)) / 1e6
    return f'"{manifest.name}" is complete: {len(manifest.levels)} levels, {manifest.increment_count:,} increments, {size:.2f} MB.'


def _simulate(given: Namespace) -> str:
    content = read_package(given.folder.absolute())
    limit = content.manifest.time_limit if given.limit is None else given.limit
    if not MIN_LIMIT <= limit <= MAX_LIMIT:
        raise SettingsError(f"--limit is {limit:g}; it must be from {MIN_LIMIT:g} to {MAX_LIMIT:g} seconds.")
    trace = _make_trace(given, limit) if given.trace is None else read_trace(given.trace.absolute())
    package = build_sent_package(content.manifest, content.increments)
    report = simulate(package, (Line(trace),), limit, client=given.client, seed=given.seed)
    if given.report is not None:
        command_line.write_report(given.report.absolute(), json.loads(report.to_json()))
    return report.to_text().replace("\n", "; ")


def _make_trace(given: Namespace, limit: float) -> Trace:
    """Return a line of the wanted kind and mean rate."""
    rate, duration, rng = parse_rate(given.rate), TRACE_LENGTH * limit, np.random.default_rng(given.seed)
    if given.kind == "constant":
        return constant_trace(rate)
    if given.kind in ("3G", "4G"):
        return cellular_trace(rng, duration, int(given.kind[0]), rate)
    return {"step": step_trace, "ramp": ramp_trace, "burst": burst_trace}[given.kind](rng, duration, rate)


def _serve(given: Namespace, line: command_line.ProgressLine) -> str:
    from lib.package_server import open_view, serve  # here: Blender's Python lacks the web server

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
