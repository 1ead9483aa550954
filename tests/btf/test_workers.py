"""Worker processes render what this process would, give the same bytes under every executor, and lose nothing when they are killed."""

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

import environment
from bridge import blender_scenes
from bridge.bakes import KILL, cloud_of, digests, job_of, small_cloud, states, views, workers_of
from farfield.addon.bridge import btf_snapshot, btf_worker
from farfield.addon.bridge.images import pixels_of
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.btf.spreading import render_missing
from farfield.addon.core.errors import FarfieldError, FileError, GeometryError
from farfield.addon.core.progress import finish
from farfield.addon.operators.btf_job import prepare

SCRIPT = environment.ROOT / "scripts" / "btf.py"
SETTINGS = ["--views", "4", "--lights", "4", "--samples", "1", "--components", "2", "--alpha-components", "2", "--shadows", "16"]
on_linux = pytest.mark.skipif(not Path("/proc").is_dir(), reason="only Linux tells which processes work for a folder")


@pytest.fixture(autouse=True)
def fresh_scene(extension):
    blender_scenes.fresh()


@pytest.fixture(scope="module")
def saved(extension, tmp_path_factory) -> Path:
    """The small scene in a file."""
    blender_scenes.fresh()
    small_cloud()
    path = tmp_path_factory.mktemp("Größe") / "cloud ü.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
    return path


@pytest.fixture
def cloud(saved):
    """The small cloud, open."""
    from farfield.addon.operators.billboards_clouds import clouds_in

    bpy.ops.wm.open_mainfile(filepath=str(saved))
    return clouds_in(bpy.context.scene)[0]


@pytest.fixture(scope="module")
def undisturbed(saved, tmp_path_factory) -> dict[str, str]:
    """Digests of the views of a bake that nothing happened to, rendered by the functions that workers call, in this process."""
    from farfield.addon.operators.billboards_clouds import clouds_in

    bpy.ops.wm.open_mainfile(filepath=str(saved))
    folder = tmp_path_factory.mktemp("undisturbed")
    job = job_of(clouds_in(bpy.context.scene)[0], folder)
    btf_worker.capture_views(job.folder, list(range(4)), threads=2)
    found = digests(folder)
    assert len(found) == 8 and len(set(found.values())) == 8
    return found


def script(saved: Path, folder: Path, *more: str) -> list[str]:
    out = folder.parent / "out.blend"
    return [sys.executable, str(SCRIPT), str(saved), "--out", str(out), "--work", str(folder), *SETTINGS, *more]


@pytest.mark.parametrize("executor", ["serial", "processes:2"])
def test_processes_give_the_bytes_of_one_process(cloud, undisturbed, tmp_path, executor):
    job = job_of(cloud, tmp_path / "Arbeit ü", executor)
    finish(job.core_steps())
    assert digests(tmp_path / "Arbeit ü") == undisturbed
    assert sum(figure["renders"] for figure in job.figures) == 2 * 4 * 5
    assert all(figure["bare_render_seconds"] > 0.0 for figure in job.figures)


def test_dask_gives_the_same_bytes(cloud, undisturbed, scheduler, tmp_path):
    scheduler.start_workers(2)
    finish(job_of(cloud, tmp_path / "work", f"dask:{scheduler.address}").core_steps())
    assert digests(tmp_path / "work") == undisturbed


def kill_worker(job, folder: Path, number: int) -> None:
    """Kill one worker of a bake at a moment that `number` chooses, and let the bake go on to its end. A bake may end before that."""
    choice = random.Random(number)
    enough, pause = choice.randrange(8), choice.uniform(0.0, 0.4)
    killed = None
    views_then = {}
    for _ in job.core_steps():
        workers = workers_of(folder)
        if killed is None and workers and len(views(folder)) >= enough:
            time.sleep(pause)
            killed = choice.choice(workers)
            views_then = states(folder)
            with contextlib.suppress(ProcessLookupError):  # it may have come to its end
                os.kill(killed, KILL)
    assert views_then.items() <= states(folder).items(), "a finished view was rendered again"


@on_linux
@pytest.mark.parametrize("number", [1, 2])
def test_a_worker_that_is_killed_costs_nothing_that_stands(cloud, undisturbed, tmp_path, number):
    kill_worker(job_of(cloud, tmp_path / "work", "processes:2"), tmp_path / "work", number)
    assert digests(tmp_path / "work") == undisturbed


def kill_main(saved: Path, folder: Path, number: int) -> None:
    """Kill the main process of a bake at a moment that `number` chooses, see its workers end, and bake again to the end."""
    choice = random.Random(number)
    enough, pause = choice.randrange(-1, 7), choice.uniform(0.0, 0.8)
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(script(saved, folder, "--executor", "processes:2"), **silent)
    while process.poll() is None and len(views(folder)) < enough:
        time.sleep(0.02)
    time.sleep(pause)
    process.kill()
    process.wait()
    started = time.monotonic()
    while workers_of(folder):
        assert time.monotonic() - started < 60.0, "workers outlive the bake"
        time.sleep(0.05)
    standing = states(folder)
    outcome = subprocess.run(script(saved, folder, "--executor", "processes:2"), capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    assert standing.items() <= states(folder).items(), "a finished view was rendered again"
    left = {path.suffix for path in folder.rglob("*") if path.is_file()}
    assert left <= {".shard", ".json", ".npz", ".blend"}, left


@on_linux
def test_a_bake_whose_main_process_is_killed_goes_on_from_what_stands(saved, undisturbed, tmp_path):
    folder = tmp_path / "work"
    kill_main(saved, folder, 3)
    baked = folder / "Ball Cloud"
    assert digests(baked) == undisturbed


@on_linux
@pytest.mark.slow
@pytest.mark.parametrize("number", range(3))
def test_kills_at_random_moments(cloud, saved, undisturbed, tmp_path, number):
    kill_worker(job_of(cloud, tmp_path / "one", "processes:2"), tmp_path / "one", 100 + number)
    assert digests(tmp_path / "one") == undisturbed
    kill_main(saved, tmp_path / "two", 200 + number)
    assert digests(tmp_path / "two" / "Ball Cloud") == undisturbed


def test_the_folder_of_another_cloud_is_refused(cloud, tmp_path):
    job_of(cloud, tmp_path)
    bpy.ops.mesh.primitive_cone_add()
    bpy.data.collections.remove(cloud.collection)
    other = cloud_of(bpy.context.object)
    with pytest.raises(FileError, match="holds the bake of another cloud"):
        job_of(other, tmp_path)


def test_an_executor_that_is_none_is_refused_before_anything_is_written(cloud, tmp_path):
    with pytest.raises(FarfieldError, match="must be serial"):
        prepare(bpy.context, cloud, BtfSettings(views=4, lights=4, executor="threads"), tmp_path / "work", keeps_work=True)
    assert not (tmp_path / "work").exists()


def test_a_bake_without_a_folder_of_its_own_leaves_none(cloud):
    job = job_of(cloud, None)
    folder = job.folder
    result = finish(job.core_steps())
    assert folder.is_dir()
    finish(job.scene_steps(result))
    assert not folder.exists()
    stopped = job_of(cloud, None)
    folder = stopped.folder
    del stopped
    assert not folder.exists()


def test_a_cloud_that_was_removed_meanwhile_is_named(cloud, tmp_path):
    job = job_of(cloud, tmp_path)
    bpy.data.collections.remove(cloud.collection)
    with pytest.raises(GeometryError, match="was removed while it was being baked"):
        finish(job.scene_steps([]))


@pytest.mark.skipif(os.name == "nt", reason="Windows has no limit for the size of files")
def test_a_full_disk_is_told_by_the_worker(cloud, tmp_path):
    import resource

    job = job_of(cloud, tmp_path)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000, before[1]))
    try:
        with pytest.raises(FarfieldError, match="Free some space"):
            finish(job.core_steps())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not views(tmp_path)


def test_a_snapshot_that_is_gone_is_told_by_the_worker(cloud, tmp_path):
    job = job_of(cloud, tmp_path)
    (tmp_path / btf_snapshot.BLEND).unlink()
    stores = [level.store for level in job.levels]
    with pytest.raises(FarfieldError, match=r"The snapshot in .* cannot be read"):
        finish(render_missing(tmp_path, stores, 4, "serial", lambda shard: btf_worker.command(tmp_path, shard)))


class TestSnapshot:
    """What a worker finds is what the user sees."""

    def test_what_hides_an_original_does_not_change_it(self, cloud, tmp_path):
        source = cloud.sources[0]
        source.hide_viewport = source.hide_render = True
        source.hide_set(True)
        job_of(cloud, tmp_path)
        assert source.hide_viewport and source.hide_render
        snapshot = btf_snapshot.open_snapshot(tmp_path)
        assert [item.name for item in snapshot.objects] == ["Ball"]
        assert len(snapshot.orders) == 2 and snapshot.settings.views == 4

    def test_frame_drivers_modifiers_and_simplify_come_along(self, tmp_path):
        ball = blender_scenes.ball()
        scene = bpy.context.scene
        scene.render.use_simplify, scene.render.simplify_subdivision = True, 1
        ball.modifiers.new("Fine", "SUBSURF").levels = 3
        ball.keyframe_insert("location", frame=1)
        ball.location = (2.0, 0.0, 0.0)
        ball.keyframe_insert("location", frame=20)
        target = bpy.data.objects.new("Target", None)
        scene.collection.objects.link(target)
        target.location.z = 3.0
        driver = ball.driver_add("scale", 2).driver
        driver.type = "AVERAGE"
        variable = driver.variables.new()
        variable.targets[0].id, variable.targets[0].data_path = target, "location.z"
        scene.frame_set(7)
        cloud = cloud_of(ball)
        job = job_of(cloud, tmp_path)
        snapshot = btf_snapshot.open_snapshot(tmp_path)
        assert snapshot.source.fingerprint == job.fingerprint
        assert np.ptp(snapshot.source.mesh.vertices[:, 2]) == pytest.approx(6.0, rel=0.01)

    def test_strokes_that_were_never_saved_come_along(self, tmp_path):
        image = bpy.data.images.new("Gemälde", 8, 4)
        image.filepath_raw = str(tmp_path / "painted.png")
        image.file_format = "PNG"
        image.save()
        painted = np.random.default_rng(0).integers(0, 256, (4, 8, 4)).astype(np.float32) / 255.0
        red = blender_scenes.material("Painted")
        node = red.node_tree.nodes.new("ShaderNodeTexImage")
        node.image = image
        blender_scenes.link(red, node.outputs["Color"], blender_scenes.shader_of(red).inputs["Base Color"])
        cloud = cloud_of(blender_scenes.ball(made=red))
        image.pixels = painted.ravel().tolist()  # after the renders: Blender 4.5 and 5.0 without a window drop strokes when they render
        assert image.is_dirty
        (tmp_path / "work").mkdir()
        job_of(cloud, tmp_path / "work")
        assert image.is_dirty and not image.packed_files
        btf_snapshot.open_snapshot(tmp_path / "work")
        np.testing.assert_allclose(pixels_of(bpy.data.images["Gemälde"]), painted, atol=1e-6)

    def test_originals_that_are_linked_from_a_library_come_along(self, saved, tmp_path):
        with bpy.data.libraries.load(str(saved), link=True) as (_, linked):
            linked.objects = ["Ball"]
        bpy.context.scene.collection.objects.link(linked.objects[0])
        cloud = cloud_of(linked.objects[0])
        job = job_of(cloud, tmp_path)
        assert btf_snapshot.open_snapshot(tmp_path).source.fingerprint == job.fingerprint

    def test_an_original_that_looks_different_there_is_refused(self, cloud, tmp_path):
        job_of(cloud, tmp_path)
        words = json.loads((tmp_path / btf_snapshot.WORDS).read_text())
        (tmp_path / btf_snapshot.WORDS).write_text(json.dumps(words | {"fingerprint": "another"}))
        with pytest.raises(GeometryError, match="another shape in a worker process"):
            btf_snapshot.open_snapshot(tmp_path)
