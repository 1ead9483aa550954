"""Full disks: every writer of every script is run with room for 0, 1, ... 10 tenths of its output.

`measure_full_disks` starts this file as a process, where the system allows it in a mount namespace, in which it mounts a small disk in
memory. Elsewhere the size of every file is limited instead. A run must end with exit code 0 and a complete output, or with code 2, one
sentence, and a disk that is as it was.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()
sys.path.append(str(environment.ROOT / "tests"))

import campaign_checks
import campaign_runs
from campaign_checks import OLD_CONTENT, Problem
from campaign_runs import BAKE_FLAGS, BUILD_FLAGS, RESTORE_FLAGS, TERRAIN_FLAGS, Campaign, script

DISK_BYTES = 64 << 20
STEPS = 10
FILLER = "filler"
NAMESPACES = (("unshare", "--mount"), ("unshare", "--mount", "--map-root-user"))  # commands that allow mounts in their children
UNLIMITED_SECONDS = 1e9


@dataclass(frozen=True)
class Writer:
    """A run of a script that writes one thing to the small disk. target: its name there; arguments: "{target}" stands for its path. is_new:
    whether it must not exist before."""

    name: str
    tool: str
    arguments: tuple[str, ...]
    target: str
    is_new: bool = False


def writers(folder: Path) -> list[Writer]:
    """Return all writers; `folder` holds input files and takes the outputs that are not tested."""
    cube, cloud, spare, work = (str(folder / name) for name in ("cube.obj", "cloud.blend", "spare.blend", "work"))
    build, unwrap, terrain, bake = (cube, *BUILD_FLAGS), (cube,), TERRAIN_FLAGS, (cloud, *BAKE_FLAGS)
    restore, spare_image = (str(folder / "image.png"), str(folder / "mask.png"), *RESTORE_FLAGS), str(folder / "spare.png")
    result = []
    for suffix in (".png", ".tif", ".jpg", ".exr"):
        result.append(Writer(f"restore --out {suffix}", "restore", (*restore, "--out", "{target}"), f"out{suffix}"))
    result.append(Writer("restore --report", "restore", (*restore, "--out", spare_image, "--report", "{target}"), "report.json"))
    for flag, target in (("--curve", "curve.png"), ("--stages", "stages")):
        arguments = (*restore[:2], "--pyramid-levels", "1", "--out", spare_image, flag, "{target}")
        result.append(Writer(f"restore {flag}", "restore", arguments, target, is_new=flag == "--stages"))
    for tool, arguments, suffixes in (
        ("billboards", build, (".blend", ".obj", ".glb")), ("unwrap", unwrap, (".blend", ".obj", ".glb")),
        ("clipbox", terrain, (".blend", ".ply", ".obj")), ("btf", (*bake, "--work", work), (".blend",)),
    ):  # fmt: skip
        result += [Writer(f"{tool} --out {suffix}", tool, (*arguments, "--out", "{target}"), f"out{suffix}") for suffix in suffixes]
        result.append(Writer(f"{tool} --report", tool, (*arguments, "--out", spare, "--report", "{target}"), "report.json"))
    finished_bake = (*bake, "--work", work, "--out", spare)
    result += [
        Writer("unwrap --image", "unwrap", (*unwrap, "--out", spare, "--image", "{target}"), "image.png"),
        Writer("clipbox --convert-to-mesh", "clipbox", (*terrain, "--convert-to-mesh", "--out", "{target}"), "mesh.blend"),
        Writer("btf --curve", "btf", (*finished_bake, "--curve", "{target}"), "curve.png"),
        Writer("btf --work", "btf", (*bake, "--out", spare, "--work", "{target}"), "work", is_new=True),
    ]
    result += [
        Writer(
            f"btf --export {suffix or 'folder'}",
            "btf",
            (*finished_bake, "--export", "{target}"),
            f"export{suffix}",
            is_new=suffix != ".glb",  # the others are folders, or .btf files named after the two levels
        )
        for suffix in (".glb", ".btf", ".octahedral", "")
    ]
    return result


def measure_full_disks(campaign: Campaign, figures: dict[str, Any]) -> None:
    """Run all writers on full disks, and fill `figures` on the way: runs and exit codes by writer."""
    folder, log = campaign.sandbox / "input", campaign.sandbox / "disk.jsonl"
    campaign_runs.create_cloud(campaign, folder)
    campaign_runs.write_image_and_mask(folder)
    log.write_bytes(b"")
    prefix = next((list(command) for command in NAMESPACES if _can_mount(command)), [])
    figures.update(disk="tmpfs" if prefix else "limit of the size of each file", writers={})
    arguments = [str(campaign.sandbox), str(log), "mount" if prefix else "limit"]
    with campaign.start([*prefix, sys.executable, str(Path(__file__)), *arguments]) as process:
        for entry in campaign_runs.follow_log(campaign, "full disks", process, log):
            runs = figures["writers"].setdefault(entry["writer"], {"bytes": entry["bytes"], "exit_codes": {}})
            code = str(entry["code"])
            runs["exit_codes"][code] = runs["exit_codes"].get(code, 0) + 1
            for kind, text in entry["problems"]:
                campaign.add_finding(
                    f"{entry['writer']} with {entry['free']} of {entry['bytes']} bytes free", f"{kind}: {text}", entry["command"]
                )
        if process.poll() != 0:
            raise RuntimeError(process.outcome().stderr[-2000:])


def _can_mount(command: tuple[str, ...]) -> bool:
    """Whether a child of `command` may mount a disk in memory."""
    if shutil.which(command[0]) is None:
        return False
    return subprocess.run([*command, "mount", "-t", "tmpfs", "none", "/mnt"], capture_output=True, check=False).returncode == 0


def main() -> None:
    sandbox, log, is_mounted = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3] == "mount"
    disk = sandbox / "disk"
    disk.mkdir()
    if is_mounted:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "none", str(disk)], check=True)
    campaign = Campaign(sandbox, time.monotonic() + UNLIMITED_SECONDS, lambda _: None, 0)
    with log.open("a", encoding="utf-8", buffering=1) as file:
        for writer in writers(sandbox / "input"):
            for entry in _run_writer(campaign, writer, disk, is_mounted):
                file.write(json.dumps(entry) + "\n")


def _run_writer(campaign: Campaign, writer: Writer, disk: Path, is_mounted: bool) -> Iterator[dict[str, Any]]:
    """Run a writer with enough room, then with too little, and yield what happened each time."""
    command = script(writer.tool, *(argument.replace("{target}", str(disk / writer.target)) for argument in writer.arguments))
    _reset(disk, writer)
    outcome = campaign.run(writer.name, command)
    size = sum(_round_to_pages(path.stat().st_size) for path in disk.rglob("*") if path.is_file())
    problems = [] if outcome.code == 0 else [Problem("failed with enough room", outcome.stderr)]
    yield _entry(writer, command, size, DISK_BYTES, outcome.code, problems)
    steps = {_round_to_pages(size * step // STEPS) for step in range(STEPS + 1)} if outcome.code == 0 else set()
    for free in sorted(steps if is_mounted else steps - {0}):  # without any room in files, there would be no message either
        _reset(disk, writer)
        if is_mounted:
            _fill(disk, free)
        before = campaign_checks.read_state(disk)
        outcome = campaign.run(writer.name, command, before_exec=None if is_mounted else lambda free=free: _limit_file_size(free))
        after = campaign_checks.read_state(disk)
        problems = campaign_checks.check_messages(outcome.code, outcome.stdout, outcome.stderr, interrupted=False)
        if writer.target != "work":  # finished views stay
            saved = campaign_checks.find_saved(outcome.stderr, [writer.target])
            problems += campaign_checks.check_files(outcome.code, before, after, [writer.target], None, saved)
        if outcome.code == 0:
            problems += campaign_checks.check_output(disk / writer.target)
        problems += campaign_checks.check_leftovers(campaign.sandbox / "tmp")
        yield _entry(writer, command, size, free, outcome.code, problems)


def _entry(writer: Writer, command: list[str], size: int, free: int, code: int, problems: list[Problem]) -> dict[str, Any]:
    pairs = [(problem.kind, problem.text) for problem in problems]
    return {"writer": writer.name, "command": command, "bytes": size, "free": free, "code": code, "problems": pairs}


def _reset(disk: Path, writer: Writer) -> None:
    """Empty the disk, except for a file that the writer would replace."""
    for path in disk.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    if not writer.is_new:
        (disk / writer.target).write_bytes(OLD_CONTENT)


def _fill(disk: Path, free: int) -> None:
    """Leave `free` bytes on the disk."""
    status = os.statvfs(disk)
    size = status.f_bavail * status.f_frsize - free
    with (disk / FILLER).open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, max(1, size))


def _limit_file_size(limit: int) -> None:
    """Let writes beyond `limit` bytes of a file fail, in this process and its children."""
    import resource
    import signal

    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))


def _round_to_pages(size: int) -> int:
    return -(-size // 4096) * 4096


if __name__ == "__main__":
    main()
