"""Worker process of `campaign_fuzz.py`: runs cases one after the other and writes what happened to a log, one JSON object per line.

python3 benchmarks/campaign_worker.py SPECIFICATION.json
"""

import faulthandler
import functools
import importlib
import json
import logging
import os
import shutil
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()
sys.path.append(str(environment.ROOT / "tests"))

import campaign_checks
import campaign_commands
import campaign_operators
from campaign_checks import Problem
from campaign_commands import CommandCase
from campaign_inputs import Samples

import random_inputs
from lib import command_line

OPERATORS_FRACTION = 0.3
MAX_TEXT = 3000
ROOT_FOLDER = Path(random_inputs.ABSOLUTE_NAME).parent


@dataclass(frozen=True)
class Specification:
    """What to run. sandbox: the folder of this worker. keep: whether folders of cases with problems stay."""

    tool: str
    seed: int
    cases: list[int]
    sandbox: Path
    log: Path
    memory_gb: float
    keep: bool


def main() -> None:
    content = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    specification = Specification(**content | {name: Path(content[name]) for name in ("sandbox", "log")})
    limit_memory(specification.memory_gb)
    samples = _create_samples(specification)
    crash_log = (specification.sandbox / "crash.txt").open("w", encoding="utf-8")
    faulthandler.enable(crash_log)
    if hasattr(faulthandler, "register"):
        faulthandler.register(signal.SIGUSR1, crash_log)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with specification.log.open("a", encoding="utf-8", buffering=1) as log:
        for index in specification.cases:

            def write(event: str, index: int = index, **fields: Any) -> None:
                log.write(json.dumps({"case": index, "event": event, **fields}) + "\n")

            write("start")
            write("end", **run_case(specification, index, samples, lambda step, write=write: write("step", step=step)))
    os._exit(0)  # Blender 4.5 hangs during shutdown


def run_case(specification: Specification, index: int, samples: Samples, record: Callable[[str], None]) -> dict[str, Any]:
    """Run one case and return what happened. `record` is called with each step before it is taken."""
    random = Random(f"{specification.tool} {specification.seed} {index}")
    jail = specification.sandbox / "jail" / "a" / "b"
    folder = jail / f"case-{index}"
    shutil.rmtree(specification.sandbox / "jail", ignore_errors=True)
    folder.mkdir(parents=True)
    os.chdir(folder)
    os.environ["PWD"] = str(folder)  # Blender prefers it to the working directory
    start, had_root_folder = time.monotonic(), ROOT_FOLDER.exists()
    try:
        if random.random() < OPERATORS_FRACTION:
            result = _run_operators(random, specification, folder, samples, record)
        else:
            result = _run_command(random, specification, folder, samples, record)
    except Exception:  # noqa: BLE001 a defect of the campaign must not end it
        result = {"kind": "campaign", "problems": [("campaign", traceback.format_exc()[-MAX_TEXT:])]}
    problems = list(result["problems"])
    escaped = [path for path in (jail, jail.parent, jail.parent.parent) if len(list(path.iterdir())) > 1]
    problems += [("wrote outside its folder", str(sorted(child.name for child in path.iterdir()))) for path in escaped]
    if ROOT_FOLDER.exists() and not had_root_folder:
        problems.append(("wrote outside its folder", str(ROOT_FOLDER)))
    if problems and specification.keep:
        with suppress(OSError):
            shutil.copytree(folder, specification.sandbox / "kept" / folder.name, symlinks=True, dirs_exist_ok=True)
    for path in (specification.sandbox / "tmp").iterdir():
        if not campaign_checks.BLENDER_FOLDER.match(path.name):
            shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink()
    return result | {"problems": problems, "seconds": round(time.monotonic() - start, 3)}


def _create_samples(specification: Specification) -> Samples:
    """Return the valid files, those with clouds already created: this needs the extension."""
    samples, farfield = Samples(specification.sandbox / "samples"), environment.import_farfield()
    if specification.tool == "bdam":
        samples.store()
    if specification.tool == "packages":
        farfield.register()
        samples.package()
        farfield.unregister()
    if specification.tool in ("billboards", "btf"):
        farfield.register()
        samples.cloud_file()
        if specification.tool == "btf":
            samples.baked_file()
            _shrink_exports()
        farfield.unregister()
    return samples


def _shrink_exports() -> None:
    """Let exports render 36 frames of an octahedral atlas instead of 576, and write 81 images for "bonn" instead of 6,561.

    In full they take minutes on a busy machine, whatever the input.
    """
    from farfield.addon.operators.btf import export_job

    small_atlas, directions = {"frames_per_side": 3, "frame_resolution": 32, "samples": 1}, export_job.bonn_directions()[::9]
    export_job.write_octahedral_atlas = functools.partial(export_job.write_octahedral_atlas, **small_atlas)
    export_job.bonn_directions = lambda: directions


def _run_command(
    random: Random, specification: Specification, folder: Path, samples: Samples, record: Callable[[str], None]
) -> dict[str, Any]:
    case = campaign_commands.build_case(random, specification.tool, folder, samples)
    for step in (*case.changes, " ".join(case.arguments)):
        record(step)
    before = campaign_checks.read_state(folder)
    with captured(specification.sandbox) as texts:
        code = run_script(case)
    stdout, stderr = texts
    after = campaign_checks.read_state(folder)
    outputs = [os.path.relpath(path, folder) for path in case.outputs]
    outputs += [state[1] for path, state in before.items() if state[0] == "link" and path in outputs]  # what the link leads to is replaced
    ignored = None if case.work is None else os.path.relpath(case.work, folder)
    problems = campaign_checks.check_messages(code, stdout, stderr, case.interrupt_after is not None)
    saved = campaign_checks.find_saved(stderr, outputs)
    problems += campaign_checks.check_files(code, before, after, outputs, ignored, saved)
    if code == 0 and not stdout.startswith("usage:"):
        problems += [problem for path in case.outputs for problem in campaign_checks.check_output(path)]
    elif code == campaign_checks.CANCELLED or saved:
        problems += campaign_checks.check_written(folder, before, after, outputs)
    problems = add_leftovers(problems, specification.sandbox)
    return {
        "kind": "script",
        "code": code,
        "steps": case.changes + case.arguments,
        "stderr": stderr[-MAX_TEXT:],
        "problems": as_pairs(problems),
    }


def run_script(case: CommandCase) -> int:
    """Run a script as the command line does, and return its exit code."""
    module = importlib.import_module(case.tool)
    sys.argv = [f"{case.tool}.py", *case.arguments]
    timer = None
    if case.interrupt_after is not None:
        timer = threading.Timer(case.interrupt_after, os.kill, (os.getpid(), signal.SIGINT))
        timer.start()
    try:
        command_line.run(module.main)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    except KeyboardInterrupt:
        traceback.print_exc()
        return -1
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if timer is not None:
            timer.cancel()


def _run_operators(
    random: Random, specification: Specification, folder: Path, samples: Samples, record: Callable[[str], None]
) -> dict[str, Any]:
    with captured(specification.sandbox) as texts:
        case = campaign_operators.run_case(random, specification.tool, folder, samples, record)
    _, stderr = texts
    problems = case.problems + ([Problem("traceback of a handler", stderr)] if "Traceback" in stderr else [])
    problems = add_leftovers(problems, specification.sandbox)
    counts = {"finished": case.finished, "refused": case.refused}
    return {"kind": "operators", **counts, "steps": case.steps, "stderr": stderr[-MAX_TEXT:], "problems": as_pairs(problems)}


def add_leftovers(problems: list[Problem], sandbox: Path) -> list[Problem]:
    """Return `problems` with what was left in the temporary folder. The logs of defects stand for the sentences about them."""
    logs, others = [], []
    for problem in campaign_checks.check_leftovers(sandbox / "tmp"):
        path = sandbox / "tmp" / problem.text
        if path.suffix == ".log":
            logs.append(Problem("defect", path.read_text(encoding="utf-8")))
        else:
            others.append(problem)
    return logs + [problem for problem in problems if not logs or not problem.kind.startswith("defect")] + others


def as_pairs(problems: list[Problem]) -> list[tuple[str, str]]:
    """Return problems as pairs of kind and text, which JSON can store."""
    return [(problem.kind, problem.text[-MAX_TEXT:]) for problem in problems]


@contextmanager
def captured(sandbox: Path) -> Iterator[list[str]]:
    """Send descriptors 1 and 2 to files; at the end of the block, the list that was yielded holds both texts."""
    paths = [sandbox / "stdout.txt", sandbox / "stderr.txt"]
    originals, texts = [os.dup(1), os.dup(2)], []
    sys.stdout.flush(), sys.stderr.flush()
    for descriptor, path in zip((1, 2), paths, strict=True):
        with path.open("w", encoding="utf-8") as file:
            os.dup2(file.fileno(), descriptor)
    try:
        yield texts
    finally:
        sys.stdout.flush(), sys.stderr.flush()
        for descriptor, original in zip((1, 2), originals, strict=True):
            os.dup2(original, descriptor)
            os.close(original)
        for name in ("glTFImporter", "glTFImporter_errors"):  # Their handlers keep the streams of an earlier case.
            logging.getLogger(name).handlers.clear()
        texts += [path.read_text(encoding="utf-8", errors="backslashreplace") for path in paths]


def limit_memory(memory_gb: float) -> None:
    """Let allocations beyond `memory_gb` fail, so that one case cannot take all memory of the machine."""
    with suppress(ImportError):  # Windows
        import resource

        limit = int(memory_gb * 2**30)
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    main()
