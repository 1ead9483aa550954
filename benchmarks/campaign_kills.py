"""Runs that are killed at random moments: what stood before stands or the new file is complete, and the next run removes what is left."""

import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import campaign_checks
import campaign_projects
import campaign_runs
import numpy as np
from campaign_checks import OLD_CONTENT, TEMPORARY_NAME
from campaign_inputs import Samples
from campaign_runs import BAKE_FLAGS, BUILD_FLAGS, POLL_SECONDS, RESTORE_FLAGS, TERRAIN_FLAGS, Campaign, RunningProcess, script
from campaign_values import small_flags

from farfield.addon.core.bdam import TerrainStore
from farfield.addon.core.errors import FarfieldError

ORPHAN_SECONDS = 15.0  # workers must notice within this time that their run has died
KILLS_PER_RUN = 5  # then a complete run in the same folder must remove what is left
MIN_FRACTION = 0.2  # Before this fraction of its time, a run loads Blender.
WRITING_FRACTION = 0.75  # Half of the kills come after this fraction of a run's time, when files are written.


@dataclass
class KilledJob:
    """A job that is killed again and again in its own folder. seconds: how long it takes undisturbed."""

    name: str
    command: list[str]
    outputs: list[Path]
    folder: Path
    seconds: float = 0.0
    kills: int = 0
    counts: dict[str, int] = field(default_factory=lambda: {"kills": 0, "old": 0, "new": 0, "finished before": 0, "complete runs": 0})


def measure_kills(campaign: Campaign, figures: dict[str, Any], kills: int) -> None:
    """Kill `kills` runs of builds, bakes, exports and terrains at random moments, and fill `figures` on the way: what was found, by job."""
    source = campaign.sandbox / "kill input"
    cloud = campaign_runs.create_cloud(campaign, source)
    jobs = _create_jobs(campaign, source, cloud)
    figures.update({job.name: job.counts for job in jobs})
    for job in jobs:
        _run_completely(campaign, job)
    random = Random(f"kill {campaign.seed}")
    for _ in range(kills):
        job = random.choice(jobs)
        fraction = random.uniform(random.choice((MIN_FRACTION, WRITING_FRACTION)), 1.05)
        _kill(campaign, job, fraction * job.seconds)
        if job.counts["kills"] % KILLS_PER_RUN == 0:
            _run_completely(campaign, job)


def _create_jobs(campaign: Campaign, source: Path, cloud: Path) -> list[KilledJob]:
    root, cube = campaign.sandbox / "killed", source / "cube.obj"
    images, work = campaign_runs.write_image_and_mask(source), source / "work"
    samples, project, heights = Samples(source / "samples"), source / "project", source / "heights.npy"
    ball = samples.mesh_file(".glb")
    campaign_projects.write_photo_project(project)
    photographs = [project / "plane.obj", "--cameras", project / "transforms.json", "--images", project / "images"]
    np.save(heights, np.add.outer(np.arange(257.0), np.sin(np.arange(257.0))))
    campaign_runs.run_successfully(
        campaign, "preparing", script("btf", cloud, "--out", source / "baked.blend", "--work", work, *BAKE_FLAGS)
    )

    def job(name: str, tool: str, arguments: list[Any], outputs: dict[str, str]) -> KilledJob:
        folder = root / name
        folder.mkdir(parents=True)
        paths = {flag: folder / output for flag, output in outputs.items()}
        flags = [text for flag, path in paths.items() for text in (flag, str(path))]
        return KilledJob(name, script(tool, *arguments, *flags), list(paths.values()), folder)

    return [
        job("build", "billboards", [cube, *BUILD_FLAGS], {"--out": "out.blend", "--report": "report.json"}),
        job("build as .obj", "billboards", [cube, *BUILD_FLAGS], {"--out": "out.obj"}),
        job("bake", "btf", [cloud, *BAKE_FLAGS], {"--out": "out.blend", "--curve": "curve.png"}),
        job("bake with --work", "btf", [cloud, *BAKE_FLAGS, "--work", root / "bake with --work" / "work"], {"--out": "out.blend"}),
        job("export", "btf", [cloud, *BAKE_FLAGS, "--work", work], {"--out": "out.blend", "--export": "images"}),
        job("unwrap", "unwrap", [cube], {"--out": "out.glb", "--image": "image.png"}),
        job("restoration", "restore", [*images, *RESTORE_FLAGS], {"--out": "out.png", "--report": "report.json"}),
        job(
            "restoration with stages",
            "restore",
            [*images, "--pyramid-levels", "1"],
            {"--out": "out.exr", "--stages": "stages", "--curve": "curve.png"},
        ),
        job("terrain", "clipbox", [*TERRAIN_FLAGS], {"--out": "out.blend"}),
        job("terrain as .ply", "clipbox", [*TERRAIN_FLAGS], {"--out": "out.ply", "--report": "report.json"}),
        job("levels", "texmesh", ["levels", ball, *small_flags("texmesh")], {"--out": "out.blend", "--report": "report.json"}),
        job("package", "packages", ["build", ball, *small_flags("packages")], {"--out": "package"}),
        job("photo texture", "photos", [*photographs, "--size", "64"], {"--texture": "texture.png", "--out": "out.glb"}),
        job("large terrain", "bdam", ["build", heights, *small_flags("bdam")], {"--out": "store"}),
        job("large terrain, processes", "bdam", ["build", heights, "--patch-size", "16", "--executor", "processes:2"], {"--out": "store"}),
    ]


def _kill(campaign: Campaign, job: KilledJob, delay: float) -> None:
    """Start a run, kill its process after `delay` seconds, and check the outputs and the workers."""
    for path in job.outputs:
        if "bdam" not in job.command[1]:  # whose folder is replaced
            _remove_complete_folder(path)
        if path.suffix:  # others are folders
            path.write_bytes(OLD_CONTENT)
    with campaign.start(job.command, _variables(campaign, job)) as process:
        end = time.monotonic() + delay
        while process.poll() is None and time.monotonic() < end:
            campaign.check(f"kill, {job.name}")
            time.sleep(POLL_SECONDS)
        job.counts["kills"] += 1
        job.counts["finished before"] += process.poll() is not None
        process.process.kill()
        process.process.wait()
        _wait_for_workers(campaign, job, process, delay)
    for path in job.outputs:
        if job.command[2:3] == ["build"] and "bdam" in job.command[1]:
            _check_store(campaign, job, path, delay)
            continue
        if (path.read_bytes() == OLD_CONTENT) if path.is_file() else not path.suffix and _is_empty(path):
            job.counts["old"] += 1
            continue
        for problem in campaign_checks.check_output(path):
            campaign.add_finding(f"kill, {job.name}, after {delay:.2f} s", f"{problem.kind}: {problem.text}", job.command)
        job.counts["new"] += 1


def _check_store(campaign: Campaign, job: KilledJob, path: Path, delay: float) -> None:
    """Check that a large terrain is complete, or was renamed a moment ago, in which case the next build gives it its name back."""
    store = path if path.exists() else path.with_name(f".{path.name}.farfield-replaced")
    if not store.exists():
        job.counts["old"] += 1  # There was none.
        return
    try:
        with TerrainStore(store) as opened:
            damaged = list(opened.verify())
    except FarfieldError as error:
        damaged = [str(error)]
    job.counts["new"] += 1
    if damaged:
        campaign.add_finding(f"kill, {job.name}, after {delay:.2f} s", f"damaged: {damaged[0]}", job.command)


def _wait_for_workers(campaign: Campaign, job: KilledJob, process: RunningProcess, delay: float) -> None:
    end = time.monotonic() + ORPHAN_SECONDS
    while process.living_members():
        if time.monotonic() > end:
            campaign.add_finding(
                f"kill, {job.name}, after {delay:.2f} s", f"workers live {ORPHAN_SECONDS:g} s longer than their run", job.command
            )
            return
        time.sleep(POLL_SECONDS)


def _run_completely(campaign: Campaign, job: KilledJob) -> None:
    """Run the job undisturbed: it must succeed and remove what the killed runs have left."""
    for path in job.outputs:
        _remove_complete_folder(path)
    start = time.monotonic()
    outcome = campaign.run(f"kill, {job.name}", job.command, _variables(campaign, job))
    job.seconds = time.monotonic() - start
    job.counts["complete runs"] += 1
    if outcome.code != 0:
        campaign.add_finding(f"next run, {job.name}", f"exit code {outcome.code}: {outcome.stderr}", job.command)
    for path in job.outputs:
        for problem in campaign_checks.check_output(path):
            campaign.add_finding(f"next run, {job.name}", f"{problem.kind}: {problem.text}", job.command)
    left = [str(path.relative_to(campaign.sandbox)) for path in _leftovers(job)]
    if left:
        campaign.add_finding(f"next run, {job.name}", f"does not remove {', '.join(left)}", job.command)
    for path in list(_leftovers(job)):
        shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink()


def _remove_complete_folder(path: Path) -> None:
    """Remove a folder that a run has written, because no run replaces it; what killed runs have left in it stays."""
    if path.is_dir() and not _is_empty(path):
        shutil.rmtree(path)


def _is_empty(folder: Path) -> bool:
    """Whether a folder does not exist, or holds nothing but what killed runs have left."""
    return not folder.exists() or all(TEMPORARY_NAME.match(child.name) for child in folder.iterdir())


def _variables(campaign: Campaign, job: KilledJob) -> dict[str, str]:
    """Return environment variables with a temporary folder of this job's own: runs of other tools need not remove what it leaves."""
    folder = job.folder / "tmp"
    folder.mkdir(exist_ok=True)
    return campaign.variables(TMPDIR=str(folder), TMP=str(folder), TEMP=str(folder))


def _leftovers(job: KilledJob) -> Iterator[Path]:
    """Yield what runs left next to the outputs of a job and in its temporary folder, except for Blender's own folders."""
    yield from (path for path in job.folder.rglob("*") if TEMPORARY_NAME.match(path.name) and path.exists())
