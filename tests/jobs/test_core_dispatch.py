"""The folder of a job is resumed by the same job only, and its items are split evenly."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.errors import FileError
from farfield.addon.core.jobs.dispatch import split_evenly
from farfield.addon.core.jobs.job_folder import JOB_FILE, open_job_folder, remove_temporary_files


@given(st.integers(0, 300), st.integers(1, 40), st.integers(1, 100))
def test_runs_cover_all_items_in_order_and_use_all_slots(count, slots, max_items):
    items = list(range(count))
    runs = split_evenly(items, slots, max_items)
    assert [item for run in runs for item in run] == items
    lengths = [len(run) for run in runs]
    assert max(lengths, default=0) <= min(min(lengths, default=0) + 1, max_items)
    assert len(runs) == len(items) or len(runs) % slots == 0


def test_only_the_same_job_resumes_a_folder(tmp_path):
    folder = tmp_path / "new" / "work"
    open_job_folder(folder, "size=4 ü", "the build of another terrain")
    open_job_folder(folder, "size=4 ü", "the build of another terrain")
    with pytest.raises(FileError, match=r'work" contains the build of another terrain; choose another one or empty it\.$'):
        open_job_folder(folder, "size=5 ü", "the build of another terrain")
    (folder / JOB_FILE).write_text("[" * 100_000, encoding="utf-8")
    with pytest.raises(FileError, match="another terrain"):
        open_job_folder(folder, "size=4 ü", "the build of another terrain")


def test_a_job_folder_that_cannot_be_created_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match=r'file" cannot be used'):
        open_job_folder(tmp_path / "file", "job", "another job")


def test_unfinished_files_are_removed(tmp_path):
    for name in ("a.4711.part", "a.tile"):
        (tmp_path / name).touch()
    (tmp_path / "b.1.part" / "folder").mkdir(parents=True)
    remove_temporary_files(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.tile", "b.1.part"]
