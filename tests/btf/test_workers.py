"""Worker processes render the same as this process, write the same bytes under every executor, and lose no finished view when killed."""

import contextlib
import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy")

import bpy

from bridge import blender_scenes
from bridge.bakes import (
    KILL_SIGNAL,
    SMALL,
    build_cloud,
    build_small_cloud,
    copy_finished_views,
    digests,
    file_states,
    finished_views,
    finished_views_of_small_cloud,
    open_cloud,
    prepare_job,
    to_flags,
    worker_pids,
)
from farfield.addon.bridge.btf.capture import snapshot as btf_snapshot
from farfield.addon.bridge.imaging.images import read_pixels
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.errors import FarfieldError, FileError, GeometryError
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.btf.job import prepare_bake
from farfield.addon.operators.job_run import run_job
from lib import environment
from lib.executors import open_executor

SCRIPT = environment.ROOT / "scripts" / "btf.py"
only_on_linux = pytest.mark.skipif(not Path("/proc").is_dir(), reason="workers can only be identified on Linux")


@pytest.fixture(autouse=True)
def fresh_scene(extension):
    blender_scenes.reset_scene()


@pytest.fixture(scope="module")
def cloud_file(extension, tmp_path_factory) -> Path:
    """A file with the small scene."""
    blender_scenes.reset_scene()
    build_small_cloud()
    path = tmp_path_factory.mktemp("Größe") / "cloud ü.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
    return path


@pytest.fixture(scope="module")
def reference_digests(extension) -> dict[str, str]:
    """Digests of the views of an uninterrupted bake, rendered in this process by the functions that workers call."""
    view_digests = digests(finished_views_of_small_cloud())
    assert len(view_digests) == 8 and len(set(view_digests.values())) == 8
    return view_digests


@pytest.fixture
def cloud(reference_digests, cloud_file):
    """The small cloud in the open scene."""
    return open_cloud(cloud_file)


def script_command(cloud_file: Path, folder: Path, *more: str) -> list[str]:
    out = folder.parent / "out.blend"
    return [sys.executable, str(SCRIPT), str(cloud_file), "--out", str(out), "--work", str(folder), *to_flags(SMALL), *more]


@pytest.mark.slow
def test_several_processes_write_the_same_bytes(cloud, reference_digests, tmp_path):
    job = prepare_job(cloud, tmp_path / "Arbeit ü", "processes:2")
    run_to_end(job.core_steps())
    assert digests(tmp_path / "Arbeit ü") == reference_digests
    assert sum(figure["renders"] for figure in job.figures) == 2 * 4 * 5
    assert all(figure["bare_render_seconds"] > 0.0 for figure in job.figures)


@pytest.mark.exhaustive
def test_dask_writes_the_same_bytes(cloud, reference_digests, scheduler, tmp_path):
    scheduler.start_workers(2)
    with open_executor(f"dask:{scheduler.address}") as executor:
        bake = BtfSettings(**SMALL)
        job = prepare_bake(bpy.context, cloud, bake, tmp_path / "work", keep_finished_views=True, executor=executor)
        run_to_end(run_job(job))
    assert digests(tmp_path / "work") == reference_digests


def random_moments() -> random.Random:
    """Return a generator with a new seed, which is printed; FARFIELD_SEED sets it to repeat a failure."""
    seed = int(os.environ.get("FARFIELD_SEED") or random.SystemRandom().randrange(2**32))
    print(f"FARFIELD_SEED={seed}")
    return random.Random(seed)


def start_and_kill(command: list[str], folder: Path, min_view_count: int, pause: float) -> None:
    """Start a bake, kill its main process `pause` seconds after `min_view_count` views are finished, and wait until its workers exit."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and len(finished_views(folder)) < min_view_count:
        time.sleep(0.02)
    time.sleep(pause)
    process.kill()
    process.wait()
    started = time.monotonic()
    while worker_pids(folder):
        assert time.monotonic() - started < 60.0, "workers outlive the bake"
        time.sleep(0.05)


@only_on_linux
@pytest.mark.once
@pytest.mark.exhaustive  # `test_dispatch` has crashing workers, and the next test kills a whole bake.
def test_killing_a_worker_at_a_random_moment_loses_no_finished_view(cloud, reference_digests, tmp_path):
    moments, folder = random_moments(), tmp_path / "work"
    min_view_count, pause = moments.randrange(8), moments.uniform(0.0, 0.4)
    killed, states_at_kill = None, {}
    for _ in prepare_job(cloud, folder, "processes:2")._capture():
        workers = worker_pids(folder)
        if killed is None and workers and len(finished_views(folder)) >= min_view_count:  # the bake may finish first
            time.sleep(pause)
            killed = moments.choice(workers)
            states_at_kill = file_states(folder)
            with contextlib.suppress(ProcessLookupError):  # it may have exited
                os.kill(killed, KILL_SIGNAL)
    assert states_at_kill.items() <= file_states(folder).items(), "a finished view was rendered again"
    assert digests(folder) == reference_digests


@only_on_linux
@pytest.mark.once
@pytest.mark.slow
def test_a_bake_killed_at_a_random_moment_resumes_from_its_finished_views(cloud_file, reference_digests, tmp_path):
    """The kill may precede the first view."""
    moments, folder = random_moments(), tmp_path / "work"
    command = script_command(cloud_file, folder, "--executor", "processes:2")
    start_and_kill(command, folder, moments.randrange(-1, 4), moments.uniform(0.0, 0.8))
    states_at_kill = file_states(folder)
    job = prepare_job(open_cloud(cloud_file), folder / "Ball Cloud")
    run_to_end(job._capture())
    job.run.close()
    assert states_at_kill.items() <= file_states(folder).items(), "a finished view was rendered again"
    assert digests(folder / "Ball Cloud") == reference_digests
    left = {path.suffix for path in folder.rglob("*") if path.is_file()}
    assert left <= {".shard", ".json"}, left


@pytest.mark.slow
def test_the_work_folder_of_another_cloud_is_rejected(cloud, tmp_path):
    prepare_job(cloud, tmp_path)
    bpy.ops.mesh.primitive_cone_add()
    bpy.data.collections.remove(cloud.collection)
    other = build_cloud(bpy.context.object, textures=False)
    with pytest.raises(FileError, match="contains a bake of another cloud"):
        prepare_job(other, tmp_path)


def test_an_unknown_executor_is_rejected_before_anything_is_written(cloud, tmp_path):
    with pytest.raises(FarfieldError, match="must be serial"):
        prepare_bake(
            bpy.context,
            cloud,
            BtfSettings(views_per_side=2, lights_per_side=2, executor="threads"),
            tmp_path / "work",
            keep_finished_views=True,
        )
    assert not (tmp_path / "work").exists()


@pytest.mark.slow
def test_a_temporary_work_folder_is_deleted(cloud):
    job = prepare_job(cloud, None)
    folder = copy_finished_views(job.folder)
    result = run_to_end(job.core_steps())
    assert folder.is_dir()
    run_to_end(job.scene_steps(result))
    assert not folder.exists()
    stopped = prepare_job(cloud, None)
    folder = stopped.folder
    del stopped
    assert not folder.exists()


def test_a_cloud_removed_during_the_bake_is_named(cloud, tmp_path):
    job = prepare_job(cloud, tmp_path)
    bpy.data.collections.remove(cloud.collection)
    with pytest.raises(GeometryError, match="was removed while it was being baked"):
        run_to_end(job.scene_steps([]))


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no limit for the size of files")
def test_the_worker_reports_a_full_disk(cloud, tmp_path):
    import resource

    job = prepare_job(cloud, tmp_path)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000, before[1]))
    try:
        with pytest.raises(FarfieldError, match="free some space"):
            run_to_end(job.core_steps())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not finished_views(tmp_path)


@pytest.mark.slow
def test_the_worker_reports_a_missing_snapshot(cloud, tmp_path):
    job = prepare_job(cloud, tmp_path)
    (job.run.snapshot_folder / btf_snapshot.BLEND_FILE).unlink()
    with pytest.raises(FarfieldError, match=r"The snapshot in .* cannot be read"):
        run_to_end(job.core_steps())


class TestSnapshot:
    """A worker reads the same scene as the user sees."""

    def test_hidden_sources_are_captured_and_stay_hidden(self, cloud, tmp_path):
        source = cloud.sources[0]
        source.hide_viewport = source.hide_render = True
        source.hide_set(True)
        job = prepare_job(cloud, tmp_path)
        assert source.hide_viewport and source.hide_render
        snapshot = btf_snapshot.open_snapshot(job.run.snapshot_folder, run_drivers=False)
        assert [item.name for item in snapshot.objects] == ["Ball"]
        assert len(snapshot.specs) == 2 and snapshot.settings.view_count == 4

    def test_frame_drivers_modifiers_and_simplify_are_included(self, tmp_path):
        box = blender_scenes.box()
        scene = bpy.context.scene
        scene.render.use_simplify, scene.render.simplify_subdivision = True, 1
        box.modifiers.new("Fine", "SUBSURF").levels = 3
        box.keyframe_insert("location", frame=1)
        box.location = (2.0, 0.0, 0.0)
        box.keyframe_insert("location", frame=20)
        target = bpy.data.objects.new("Target", None)
        scene.collection.objects.link(target)
        target.location.z = 3.0
        driver = box.driver_add("scale", 2).driver
        driver.type = "AVERAGE"
        variable = driver.variables.new()
        variable.targets[0].id, variable.targets[0].data_path = target, "location.z"
        rounded_height = np.ptp([vertex.co.z for vertex in box.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices])
        scene.frame_set(7)
        cloud = build_cloud(box, textures=False, levels=1)
        job = prepare_job(cloud, tmp_path)
        snapshot = btf_snapshot.open_snapshot(job.run.snapshot_folder, run_drivers=False)
        assert snapshot.source.fingerprint == job.fingerprint
        assert len(snapshot.source.mesh.triangles) == 2 * 4 * 6  # One subdivision, as simplified, and the height of the target.
        assert np.ptp(snapshot.source.mesh.vertices[:, 2]) == pytest.approx(3.0 * rounded_height)

    def test_unsaved_paint_strokes_are_included(self, tmp_path):
        image = bpy.data.images.new("Gemälde", 8, 4)
        image.filepath_raw = str(tmp_path / "painted.png")
        image.file_format = "PNG"
        image.save()
        painted = np.random.default_rng(0).integers(0, 256, (4, 8, 4)).astype(np.float32) / 255.0
        red = blender_scenes.create_material("Painted")
        node = red.node_tree.nodes.new("ShaderNodeTexImage")
        node.image = image
        blender_scenes.link(red, node.outputs["Color"], blender_scenes.shader_of(red).inputs["Base Color"])
        cloud = build_cloud(blender_scenes.box(material=red), textures=False, levels=1)
        image.pixels = painted.ravel().tolist()
        assert image.is_dirty
        (tmp_path / "work").mkdir()
        job = prepare_job(cloud, tmp_path / "work")
        assert image.is_dirty and not image.packed_files
        btf_snapshot.open_snapshot(job.run.snapshot_folder, run_drivers=False)
        np.testing.assert_allclose(read_pixels(bpy.data.images["Gemälde"]), painted, atol=1e-6)

    def test_sources_linked_from_a_library_are_included(self, cloud_file, tmp_path):
        with bpy.data.libraries.load(str(cloud_file), link=True) as (_, linked):
            linked.objects = ["Ball"]
        bpy.context.scene.collection.objects.link(linked.objects[0])
        cloud = build_cloud(linked.objects[0], textures=False, levels=1)
        job = prepare_job(cloud, tmp_path)
        assert btf_snapshot.open_snapshot(job.run.snapshot_folder, run_drivers=False).source.fingerprint == job.fingerprint

    def test_a_source_with_another_fingerprint_is_rejected(self, cloud, tmp_path):
        job = prepare_job(cloud, tmp_path)
        metadata_file = job.run.snapshot_folder / btf_snapshot.METADATA_FILE
        metadata_file.write_text(json.dumps(json.loads(metadata_file.read_text()) | {"fingerprint": "another"}))
        with pytest.raises(GeometryError, match="a different shape in a worker process"):
            btf_snapshot.open_snapshot(job.run.snapshot_folder, run_drivers=False)
