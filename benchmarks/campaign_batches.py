"""Runs the cases of a campaign in worker processes: a crash or a hang costs one case, and the next worker continues after it."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lib import environment

WORKER = Path(__file__).with_name("campaign_worker.py")
BATCH_SIZE = 50  # cases per process; Blender's memory grows with each
POLL_SECONDS = 0.05
START_SECONDS = 120.0  # a worker may take this long before its first case
DUMP_SECONDS = 1.0  # for the stacks of a process that hangs
IMPORTERS = ("open_scene", "open_near_origin", "read_image", "write_damaged", "_open_scene")  # functions that hand a file to Blender


@dataclass(frozen=True)
class BatchOptions:
    """sandbox: a folder that may be deleted. case_seconds: time limit of a case. keep: whether to keep folders of cases with problems.
    worker: the script that runs the cases, None for WORKER."""

    seed: int
    sandbox: Path
    case_seconds: float
    memory_gb: float
    keep: bool
    worker: Path | None = None


def run_cases(tool: str, cases: Sequence[int], options: BatchOptions, on_wait: Callable[[], None]) -> Iterator[dict[str, Any]]:
    """Run cases of `tool` and yield what happened in each; `on_wait` is called while they run and may raise to end all.

    A case that ended its worker has the kind "crash" or "slow", the signal, and the stacks.
    """
    remaining = list(cases)
    while remaining:
        batch, last = remaining[:BATCH_SIZE], None
        for result in _run_worker(tool, batch, options, on_wait):
            yield result
            last = result["case"]
        if last is None:
            raise RuntimeError(f"The worker ended before its first case; see {options.sandbox / 'worker.txt'}.")
        remaining = remaining[batch.index(last) + 1 :]


def _run_worker(tool: str, cases: list[int], options: BatchOptions, on_wait: Callable[[], None]) -> Iterator[dict[str, Any]]:
    sandbox = options.sandbox
    for name in ("tmp", "cache", "resources"):
        shutil.rmtree(sandbox / name, ignore_errors=True)
        (sandbox / name).mkdir(parents=True)
    log, specification = sandbox / "log.jsonl", sandbox / "specification.json"
    log.write_bytes(b"")
    fields = {"tool": tool, "seed": options.seed, "cases": cases, "sandbox": str(sandbox), "log": str(log)}
    specification.write_text(json.dumps(fields | {"memory_gb": options.memory_gb, "keep": options.keep}), encoding="utf-8")
    variables = os.environ | dict.fromkeys(("TMPDIR", "TMP", "TEMP"), str(sandbox / "tmp"))
    variables |= {
        "XDG_CACHE_HOME": str(sandbox / "cache"),
        "BLENDER_USER_RESOURCES": str(sandbox / "resources"),
        "PYTHONIOENCODING": "utf-8",
    }
    with (sandbox / "worker.txt").open("w", encoding="utf-8") as output:
        process = subprocess.Popen(
            [sys.executable, str(options.worker or WORKER), str(specification)],
            cwd=environment.ROOT,
            env=variables,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,
        )
        try:
            yield from _follow(process, log, options, on_wait)
        finally:
            _kill_group(process)


def _follow(process: subprocess.Popen, log: Path, options: BatchOptions, on_wait: Callable[[], None]) -> Iterator[dict[str, Any]]:
    """Yield the results in the log as they appear, and one for the case during which the worker died or took too long."""
    running, since, is_over, steps = None, time.monotonic(), False, []
    with log.open(encoding="utf-8") as file:
        line = ""
        while True:
            line += file.readline()
            if line.endswith("\n"):
                entry, line = json.loads(line), ""
                if entry["event"] == "step":
                    steps.append(entry["step"])
                    continue
                running, since, steps = (entry["case"] if entry["event"] == "start" else None), time.monotonic(), []
                if entry["event"] == "end":
                    yield entry
                continue
            if is_over:
                break
            on_wait()
            limit = options.case_seconds if running is not None else START_SECONDS
            if time.monotonic() - since > limit:
                _dump_stacks(process)
                if running is not None:
                    yield _describe_end(running, "slow", f"more than {limit:g} s", options) | {"steps": steps}
                return
            is_over = process.poll() is not None  # then read the rest of the log
            time.sleep(0 if is_over else POLL_SECONDS)
    if running is not None:
        yield _describe_end(running, "crash", _name_of_end(process.returncode), options) | {"steps": steps}


def _describe_end(case: int, kind: str, reason: str, options: BatchOptions) -> dict[str, Any]:
    """Return the result of a case that ended its worker."""
    if options.keep:
        folder = options.sandbox / "jail" / "a" / "b" / f"case-{case}"
        shutil.copytree(folder, options.sandbox / "kept" / folder.name, symlinks=True, dirs_exist_ok=True)
    crash_log = options.sandbox / "crash.txt"
    stacks = crash_log.read_text(encoding="utf-8", errors="replace") if crash_log.exists() else ""
    is_importer = kind == "crash" and any(f" in {name}" in stacks for name in IMPORTERS)
    problem = (f"{kind} in Blender's importer" if is_importer else kind, f"{_innermost(stacks)} {reason}")
    return {"case": case, "kind": kind, "is_importer": is_importer, "stacks": stacks[-6000:], "problems": [problem]}


def _innermost(stacks: str) -> str:
    """Return the innermost function of the main thread that belongs to this checkout."""
    lines = [
        line for line in stacks.partition("most recent call first")[2].splitlines() if str(environment.ROOT) in line and ".venv" not in line
    ]
    return lines[0].split('"')[-1].strip(" ,") if lines else "?"


def _name_of_end(code: int) -> str:
    try:
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"
    except ValueError:
        return f"signal {-code}"


def _dump_stacks(process: subprocess.Popen) -> None:
    if hasattr(signal, "SIGUSR1"):
        process.send_signal(signal.SIGUSR1)
        time.sleep(DUMP_SECONDS)


def _kill_group(process: subprocess.Popen) -> None:
    """Kill a worker with the processes that it started."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
    process.wait()
