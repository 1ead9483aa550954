"""The work folder of a bake belongs to its user, the snapshot in it to one run, and neither decides what a worker may do."""

import hashlib
import json
import os
import shutil
import stat
from pathlib import Path

import pytest

pytest.importorskip("bpy")

import bpy

import btf
from bridge import blender_scenes
from bridge.bakes import SMALL, build_small_cloud, copy_finished_views, finished_views, finished_views_of_small_cloud, prepare_job
from farfield.addon.bridge.billboards.scene_clouds import SceneCloud, clouds_in
from farfield.addon.bridge.btf.capture.snapshot import METADATA_FILE, open_snapshot
from farfield.addon.bridge.snapshots import may_run_python_drivers
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.errors import FileError
from farfield.addon.core.files import user_folders
from farfield.addon.core.jobs.dispatch import Shard
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators import user_cache
from farfield.addon.operators.btf import estimates
from farfield.addon.operators.btf import job as job_module

posix_only = pytest.mark.skipif(os.name == "nt", reason="Windows has access control lists instead of owners and modes")


@pytest.fixture(autouse=True)
def fresh_scene(extension, tmp_path, monkeypatch):
    """An empty scene, and a cache folder of its own."""
    monkeypatch.setattr(user_cache, "user_cache_folder", lambda: tmp_path / "cache" / "farfield")
    blender_scenes.reset_scene()


@pytest.fixture
def cloud() -> SceneCloud:
    return build_small_cloud()


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def bake(**settings) -> None:
    bpy.ops.farfield.btf_bake(**SMALL, executor="serial", **settings)


@posix_only
def test_only_the_user_may_read_the_work_folder(cloud, tmp_path):
    folder = tmp_path / "work"
    folder.mkdir(mode=0o755)
    job = prepare_job(cloud, folder)
    assert mode(folder) == 0o700 and mode(job.run.snapshot_folder) == 0o700
    assert job.run.snapshot_folder.parent == folder


@pytest.mark.slow
@posix_only
def test_the_operator_uses_a_private_folder_of_the_user(monkeypatch):
    views = finished_views_of_small_cloud()
    cloud = build_small_cloud()
    folder = estimates.capture_folder(cloud, BtfSettings(**SMALL, executor="serial"))
    assert folder == user_cache.user_cache_folder() / "btf" / folder.name
    prepared = []
    original = os.mkdir

    def record(path, *arguments, **keywords):
        original(path, *arguments, **keywords)
        prepared.append((Path(path), mode(Path(path))))

    def provide_views(_held, stores, *_arguments):
        for store in stores:
            shutil.copytree(views / store.folder.name, store.folder, dirs_exist_ok=True)
        yield from ()
        return 0

    monkeypatch.setattr(os, "mkdir", record)
    monkeypatch.setattr(job_module, "render_missing_views", provide_views)
    bake()
    modes = dict(prepared)
    assert modes[folder] == modes[folder.parent] == 0o700
    assert not folder.exists()


@posix_only
def test_the_operator_rejects_a_link_and_a_folder_of_another_user(cloud, tmp_path, monkeypatch):
    folder = estimates.capture_folder(cloud, BtfSettings(**SMALL, executor="serial"))
    folder.parent.mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    folder.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RuntimeError, match="is a link"):
        bake()
    folder.unlink()
    folder.mkdir()
    other = os.geteuid() + 1
    monkeypatch.setattr(user_folders.os, "geteuid", lambda: other)
    with pytest.raises(RuntimeError, match="belongs to another user"):
        bake()
    assert not list((tmp_path / "elsewhere").iterdir()) and not list(folder.iterdir())


@posix_only
def test_the_script_rejects_a_work_folder_of_another_user(cloud, tmp_path, monkeypatch):
    (tmp_path / "work").mkdir()
    other = os.geteuid() + 1
    monkeypatch.setattr(user_folders.os, "geteuid", lambda: other)
    with pytest.raises(FileError, match="belongs to another user"):
        btf.prepare_jobs(BtfSettings(**SMALL), tmp_path / "work", [])
    assert not list((tmp_path / "work").iterdir())


@pytest.mark.parametrize("name", ["../../escaped", "{outside}/absolute", "..", "a/b"])
def test_the_name_of_a_cloud_does_not_choose_a_folder(cloud, tmp_path, name):
    cloud.collection.name = name.format(outside=tmp_path / "outside")
    work = tmp_path / "jail" / "work"
    (job,) = btf.prepare_jobs(BtfSettings(**SMALL), work, [])
    assert job.folder.parent == work
    assert [path.name for path in tmp_path.iterdir()] == ["jail"] and [path.name for path in work.parent.iterdir()] == ["work"]


def test_a_later_run_in_the_same_folder_takes_over(cloud, tmp_path):
    first = prepare_job(cloud, tmp_path)
    second = prepare_job(cloud, tmp_path)
    assert not first.run.snapshot_folder.exists() and second.run.snapshot_folder.exists()
    with pytest.raises(FileError, match="Another run has started"):
        run_to_end(first.core_steps())
    assert second.run.snapshot_folder.exists()
    second.run.heartbeat.renew()


def test_a_run_that_ends_leaves_no_snapshot(cloud, tmp_path):
    job = prepare_job(cloud, tmp_path)
    steps = job.core_steps()
    next(steps)
    snapshot_folder = job.run.snapshot_folder
    assert (snapshot_folder / METADATA_FILE).exists()
    steps.close()
    assert not snapshot_folder.exists() and not list(tmp_path.glob("*.heartbeat"))
    unused = prepare_job(cloud, tmp_path)
    snapshot_folder = unused.run.snapshot_folder
    del unused
    assert not snapshot_folder.exists() and not list(tmp_path.glob("*.heartbeat"))


def test_a_snapshot_that_cannot_be_written_is_one_sentence(cloud, tmp_path, monkeypatch):
    from farfield.addon.bridge import snapshots

    monkeypatch.setattr(snapshots, "is_complete_blend", lambda _: False)  # as on a full disk, which Blender does not report
    with pytest.raises(FileError, match="snapshot for the workers cannot be written") as raised:
        prepare_job(cloud, tmp_path)
    assert "free some space there." in str(raised.value) and "\n" not in str(raised.value)
    assert not list(tmp_path.glob("*.snapshot")) and not list(tmp_path.glob("*.heartbeat"))


class TestDrivers:
    """A worker runs Python in drivers only if this session does so for the open file."""

    def evil_cloud(self, marker: Path) -> SceneCloud:
        """Build a cloud whose source has a driver that writes a file, if it runs. It does not affect the shape."""
        cloud = build_small_cloud()
        driver = cloud.sources[0].driver_add("color", 0).driver
        driver.type, driver.expression = "SCRIPTED", f"1.0 if open({str(marker)!r}, 'w') else 1.0"
        return cloud

    def reopen(self, path: Path, marker: Path, *, use_scripts: bool) -> SceneCloud:
        """Save and open the file; `marker` then tells whether opening it has run the driver."""
        bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
        marker.unlink(missing_ok=True)
        bpy.ops.wm.open_mainfile(filepath=str(path), use_scripts=use_scripts)
        return clouds_in(bpy.context.scene)[0]

    @pytest.mark.parametrize("preference", [True, False])
    @pytest.mark.parametrize("is_trusted", [True, False])
    def test_a_worker_may_do_what_the_session_may_do(self, tmp_path, monkeypatch, preference, is_trusted):
        marker = tmp_path / "marker"
        self.evil_cloud(marker)
        filepaths = bpy.context.preferences.filepaths
        monkeypatch.setattr(filepaths, "use_scripts_auto_execute", preference)
        cloud = self.reopen(tmp_path / "file.blend", marker, use_scripts=is_trusted)
        names = [scene.name for scene in bpy.data.scenes]
        job = prepare_job(cloud, tmp_path / "work")
        assert marker.exists() == job.run_drivers == is_trusted
        assert ("--run-drivers" in job._shard_command(Shard([0], Path("x.heartbeat"), 1))) == is_trusted
        assert [scene.name for scene in bpy.data.scenes] == names and "farfield_driver_probe" not in bpy.app.driver_namespace
        marker.unlink(missing_ok=True)
        metadata_file = job.run.snapshot_folder / METADATA_FILE
        metadata = json.loads(metadata_file.read_text(encoding="utf-8")) | {"auto_run_scripts": True, "run_drivers": True}
        metadata_file.write_text(json.dumps(metadata), encoding="utf-8")
        open_snapshot(job.run.snapshot_folder, run_drivers=job.run_drivers)
        assert marker.exists() == is_trusted

    def test_files_without_python_drivers_need_no_permission(self, cloud):
        driver = cloud.sources[0].driver_add("scale", 2).driver
        driver.type, driver.expression = "SCRIPTED", "1.0 + 0.0"
        assert not may_run_python_drivers()


@pytest.mark.slow
def test_nothing_is_kept_of_a_cancelled_bake_but_finished_views(cloud):
    """They are found again in the folder of the user, under the same settings."""
    settings = BtfSettings(**SMALL, executor="serial")
    job = prepare_job(cloud, estimates.capture_folder(cloud, settings))
    steps = job.core_steps()
    for _ in steps:
        if finished_views(job.folder):
            break
    steps.close()
    count = len(finished_views(job.folder))
    assert estimates.count_finished_views(cloud, settings) == count > 0
    names = {path.name for path in job.folder.iterdir()}
    assert names == {"level-0", "level-1"}


def test_a_user_without_home_gets_a_sentence(cloud, monkeypatch):
    def no_cache():
        raise FileError("There is no home folder.")

    monkeypatch.setattr(user_cache, "user_cache_folder", no_cache)
    assert estimates.count_finished_views(cloud, BtfSettings(**SMALL)) == 0
    with pytest.raises(RuntimeError, match="There is no home folder"):
        bake()


@pytest.mark.exhaustive  # as in `test_dispatch`, but with real views
def test_damaged_finished_views_are_captured_again(tmp_path):
    """Also those with the right checksum, which anyone can compute."""
    copy_finished_views(tmp_path)
    job = prepare_job(build_small_cloud(), tmp_path)
    assert run_to_end(job._capture()) == 0
    path = job.levels[0].store.path(1)
    undamaged = path.read_bytes()
    content = b"no archive"
    path.write_bytes(hashlib.sha256(content).digest() + content)
    assert run_to_end(job._capture()) == 1
    assert path.read_bytes() == undamaged


def test_the_operator_spreads_over_processes_only(cloud):
    with pytest.raises(RuntimeError, match="Executor must be serial, processes"):
        bpy.ops.farfield.btf_bake(**SMALL, executor="dask:tcp://farm.example:8786")
    assert not estimates.capture_folder(cloud, BtfSettings(**SMALL)).exists(), "refused before anything is written"
