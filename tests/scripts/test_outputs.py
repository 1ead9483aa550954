"""Outputs are checked before any work is done: none replaces another one, an input or a device."""

import os
from pathlib import Path

import pytest

from farfield.addon.core.errors import FileError
from lib import environment
from lib.atomic_output import blender_error_message, check_outputs

assert environment.ROOT.is_dir()
only_on_posix = pytest.mark.skipif(os.name == "nt", reason="Windows has other devices, and links need a privilege")


@pytest.fixture
def folder(tmp_path):
    """A folder with an input of each kind."""
    for name in ("in.obj", "in.blend", "other.png"):
        (tmp_path / name).touch()
    return tmp_path


@pytest.mark.parametrize(
    ("outputs", "report", "names"),
    [
        ({"--out": "in.obj"}, None, ("--out", "the input")),
        ({"--out": "s.blend"}, "s.blend", ("--report", "--out")),
        ({"--out": "x.blend"}, "in.obj", ("--report", "the input")),
        ({"--out": "x.blend"}, "in.blend", ("--report", "the scene")),
        ({"--out": "x.blend", "--image": "z.png"}, "z.png", ("--report", "--image")),
        ({"--out": "x.blend", "--image": "below/../x.blend"}, None, ("--image", "--out")),
        ({"--out": "x.blend", "--image": "in.blend"}, None, ("--image", "the scene")),
    ],
)
def test_equal_paths_are_rejected(outputs, report, names, folder):
    (folder / "below").mkdir()
    inputs = {"the input": folder / "in.obj", "the scene": folder / "in.blend", "--path": None}
    with pytest.raises(FileError) as caught:
        check_outputs({name: folder / path for name, path in outputs.items()}, inputs, report and folder / report)
    assert all(name in str(caught.value) for name in names) and "same file" in str(caught.value)


def test_a_scene_may_be_changed_in_place(folder):
    check_outputs({"--out": folder / "in.blend", "--image": None}, {"the input": folder / "in.blend"}, folder / "report.json")


@only_on_posix
def test_links_to_one_file_are_rejected(folder):
    (folder / "link.json").symlink_to(folder / "in.obj")
    (folder / "hard.json").hardlink_to(folder / "in.obj")
    for name in ("link.json", "hard.json"):
        with pytest.raises(FileError, match="same file"):
            check_outputs({"--out": folder / "x.blend"}, {"the input": folder / "in.obj"}, folder / name)


@only_on_posix
def test_only_a_report_may_be_a_device(folder):
    check_outputs({"--out": folder / "x.blend"}, {}, Path("/dev/stdout"))
    check_outputs({"--out": folder / "x.blend"}, {}, Path(os.devnull))
    with pytest.raises(FileError, match="device"):
        check_outputs({"--out": Path(os.devnull)}, {})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Error: Cannot open file\n", "Cannot open file."),
        ("Traceback (most recent call last):\n  x\nOSError: [Errno 28] No space left\nLocation: y\n", "[Errno 28] No space left."),
        ("", "Blender gives no reason."),
    ],
)
def test_messages_of_operators(text, message):
    assert blender_error_message(RuntimeError(text)) == message
