"""What the parts of `campaign_faults.py` share: a time limit, processes that end with the campaign, input files, results on the way."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lib import environment
from mesh_files import CUBE
from terrain_files import write_png

SCRIPTS = environment.ROOT / "scripts"
POLL_SECONDS = 0.02
BUILD_FLAGS = ("--error", "10%", "--levels", "2", "--nested-levels", "--samples", "1")
BAKE_FLAGS = (
    "--model", "emission", "--views-per-side", "2", "--lights-per-side", "2", "--samples", "1", "--components", "2",
    "--alpha-components", "2", "--shadows-per-side", "2", "--shadow-components", "2", "--executor", "serial", "--directions", "baked",
)  # fmt: skip
RESTORE_FLAGS = ("--pyramid-levels", "1", "--sub-bands", "2")
TERRAIN_FLAGS = ("--at", "0,0,20", "--resolution", "32", "--boxes", "3")


class TimeLimitReached(Exception):
    """The campaign has used the time that it may take."""


@dataclass(frozen=True)
class Outcome:
    """How a process ended. code: its exit code, negative for a signal."""

    code: int
    stdout: str
    stderr: str


@dataclass
class Campaign:
    """A running campaign. end: when it must stop, by the monotonic clock; show: called while processes run, may raise to stop the campaign;
    sandbox: its folder; findings: promises that were broken, with what is needed to repeat them."""

    sandbox: Path
    end: float
    show: Callable[[str], None]
    seed: int
    findings: list[dict[str, Any]] = field(default_factory=list)

    def check(self, label: str) -> None:
        """Show what is being done.

        Raises:
            TimeLimitReached: the time is up.
        """
        self.show(f"{label}, {len(self.findings)} findings")
        if time.monotonic() > self.end:
            raise TimeLimitReached

    def add_finding(self, label: str, problem: str, command: list[str] | None = None) -> None:
        """Record a broken promise."""
        self.findings.append({"in": label, "problem": problem[-1500:]} | ({} if command is None else {"command": " ".join(command)}))

    def variables(self, **others: str) -> dict[str, str]:
        """Return environment variables with which a process keeps everything inside the sandbox; `others` replace them."""
        folders = {name: self.sandbox / name for name in ("tmp", "cache", "resources")}
        for folder in folders.values():
            folder.mkdir(parents=True, exist_ok=True)
        temporary = dict.fromkeys(("TMPDIR", "TMP", "TEMP"), str(folders["tmp"]))
        return (
            dict(os.environ)
            | temporary
            | {"XDG_CACHE_HOME": str(folders["cache"]), "BLENDER_USER_RESOURCES": str(folders["resources"]), "PYTHONIOENCODING": "utf-8"}
            | others
        )

    def run(
        self, label: str, command: list[str], variables: Mapping[str, str] | None = None, before_exec: Callable[[], None] | None = None
    ) -> Outcome:
        """Run a process to its end. Its process group is killed when the campaign is stopped, and after it has ended."""
        with self.start(command, variables, before_exec) as process:
            while process.poll() is None:
                self.check(label)
                time.sleep(POLL_SECONDS)
            return process.outcome()

    def start(
        self, command: list[str], variables: Mapping[str, str] | None = None, before_exec: Callable[[], None] | None = None
    ) -> "RunningProcess":
        """Start a process in a process group of its own, with the sandbox as its working directory."""
        folder = Path(tempfile.mkdtemp(dir=self.sandbox))
        streams = [(folder / name).open("wb") for name in ("stdout", "stderr")]
        try:
            process = subprocess.Popen(
                command,
                cwd=self.sandbox,
                env=dict(variables or self.variables()),
                stdin=subprocess.DEVNULL,
                stdout=streams[0],
                stderr=streams[1],
                start_new_session=True,
                preexec_fn=before_exec,
            )
        finally:
            for stream in streams:
                stream.close()
        return RunningProcess(process, folder)


@dataclass
class RunningProcess:
    """A process and the files that hold its output. As a context it kills the process group at its end."""

    process: subprocess.Popen
    folder: Path

    def __enter__(self) -> "RunningProcess":
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)

    def poll(self) -> int | None:
        """Return the exit code, or None while the process runs."""
        return self.process.poll()

    def outcome(self) -> Outcome:
        """Return how the process ended."""
        stdout, stderr = ((self.folder / name).read_text(encoding="utf-8", errors="backslashreplace") for name in ("stdout", "stderr"))
        return Outcome(self.process.wait(), stdout, stderr)

    def living_members(self) -> list[int]:
        """Return the processes of the group that still run. Only works on Linux."""
        return [process for process in _processes() if _group_of(process) == self.process.pid]


def script(name: str, *arguments: object) -> list[str]:
    """Return the command of a script."""
    return [sys.executable, str(SCRIPTS / f"{name}.py"), *map(str, arguments)]


def write_cube(folder: Path) -> Path:
    """Write a cube as .obj."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "cube.obj"
    path.write_text("o Cube\n" + CUBE, encoding="ascii")
    return path


def write_image_and_mask(folder: Path) -> tuple[Path, Path]:
    """Write a noisy gray image of 200 x 150 pixels, and a mask with one hole."""
    folder.mkdir(parents=True, exist_ok=True)
    image, mask = folder / "image.png", folder / "mask.png"
    write_png(image, np.random.default_rng(1).integers(60, 200, (150, 200)).astype(np.uint8))
    hole = np.zeros((150, 200), np.uint8)
    hole[40:70, 90:120] = 255
    write_png(mask, hole)
    return image, mask


def create_cloud(campaign: Campaign, folder: Path) -> Path:
    """Create a .blend file with a cube and its cloud."""
    path = folder / "cloud.blend"
    run_successfully(campaign, "preparing", script("billboards", write_cube(folder), "--out", path, *BUILD_FLAGS))
    return path


def run_successfully(campaign: Campaign, label: str, command: list[str]) -> Outcome:
    """Run a process that must succeed for the campaign to make sense."""
    outcome = campaign.run(label, command)
    if outcome.code != 0:
        raise RuntimeError(f"{' '.join(command)} ended with {outcome.code}: {outcome.stderr[-1000:]}")
    return outcome


def follow_log(campaign: Campaign, label: str, process: RunningProcess, log: Path) -> Iterator[dict[str, Any]]:
    """Yield the JSON objects that a process writes to the lines of `log`, until it ends."""
    with log.open(encoding="utf-8") as file:
        line, is_over = "", False
        while True:
            line += file.readline()
            if line.endswith("\n"):
                yield json.loads(line)
                line = ""
                continue
            if is_over:
                return
            campaign.check(label)
            is_over = process.poll() is not None
            time.sleep(0 if is_over else POLL_SECONDS)


def _processes() -> list[int]:
    return [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdecimal()] if Path("/proc").is_dir() else []


def _group_of(process: int) -> int | None:
    """Return the process group of a process, None if it has ended."""
    try:
        fields = Path(f"/proc/{process}/stat").read_bytes().rpartition(b")")[2].split()
    except OSError:
        return None
    return None if fields[0] in (b"Z", b"X") else int(fields[2])
