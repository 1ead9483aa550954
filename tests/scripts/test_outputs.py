"""Outputs are checked before any work is done: nothing is lost that the user did not name as an output, in any script."""

import os
from itertools import combinations
from pathlib import Path

import pytest

pytest.importorskip("bpy")

import bpy

import bdam
import billboards
import btf
import clipbox
import distance
import packages
import photos
import restore
import texmesh
import unwrap
from farfield.addon.core.errors import FarfieldError, FileError
from farfield.addon.core.files.outputs import Input, Output, check_outputs, is_named_by
from farfield.addon.core.photos.importers import CameraFile
from lib.atomic_output import blender_error_message
from lib.command_line import ProgressLine, argument_name
from lib.contact_sheet import is_own_png, write_png
from lib.run_files import PathType, check_image_folder, referenced_files

only_on_posix = pytest.mark.skipif(os.name == "nt", reason="Windows has other devices, and links need a privilege")
# The commands of all scripts that write files, and the arguments that they require in addition to paths.
COMMANDS = {
    "billboards": (billboards, None, []),
    "btf": (btf, None, []),
    "clipbox": (clipbox, None, ["--terrain", "heights", "--source", "{folder}/source.npy", "--source-color", "{folder}/color.png"]),
    "distance": (distance, None, []),
    "photos": (photos, None, []),
    "restore": (restore, None, []),
    "texmesh levels": (texmesh, "levels", []),
    "texmesh analyze": (texmesh, "analyze", []),
    "unwrap": (unwrap, None, []),
    "packages build": (packages, "build", []),
    "bdam build": (bdam, "build", []),
    "bdam info": (bdam, "info", []),
    "bdam verify": (bdam, "verify", []),
    "bdam extract": (bdam, "extract", ["--from", "0,0,9", "--to", "0,1,0"]),
}


@pytest.fixture
def folder(tmp_path) -> Path:
    """A folder with an input of each kind."""
    for name in ("in.obj", "in.blend", "other.png", "source.npy", "color.png"):
        (tmp_path / name).write_bytes(name.encode())
    for name in ("images", "store"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "photo.png").write_bytes(b"p")
    return tmp_path


def state_of(folder: Path) -> dict[str, bytes]:
    """The content of every file by its path."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def arguments_with(command: str, folder: Path, paths: dict[str, Path]) -> list[str]:
    """Arguments of a command: `paths` by the names of arguments, and others for those that are required."""
    module, subcommand, more = COMMANDS[command]
    positional, options = [] if subcommand is None else [subcommand], [text.format(folder=folder) for text in more]
    for action in module.build_parser().path_arguments(subcommand):
        name = argument_name(action)
        if name not in paths and not action.required:
            continue
        kind = action.type
        suffix = "" if kind.is_folder else ".blend" if action.dest == "out" else ".png"
        default = folder / (f"new-{action.dest}{suffix}" if kind.is_output else "in.obj")
        given = options if action.option_strings else positional
        given += [*action.option_strings[:1], str(paths.get(name, default))]
    return [*positional, *([str(paths.get("the mask", "alpha"))] if command == "restore" else []), *options]


def path_arguments(command: str) -> tuple[list, list]:
    """The arguments of a command that are outputs and inputs."""
    module, subcommand, _ = COMMANDS[command]
    actions = module.build_parser().path_arguments(subcommand)
    return [item for item in actions if item.type.is_output], [item for item in actions if not item.type.is_output]


def is_refused(command: str, folder: Path, paths: dict[str, Path]) -> str:
    """The sentence with which a run ends. Nothing is changed."""
    before = state_of(folder)
    with pytest.raises(FarfieldError) as caught:
        COMMANDS[command][0].main(arguments_with(command, folder, paths), ProgressLine())
    assert state_of(folder) == before, "a file was changed"
    message = str(caught.value)
    assert message.endswith(".") and "\n" not in message
    return message


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_no_output_of_any_script_is_or_contains_or_lies_in_an_input(command, folder, extension):
    outputs, inputs = path_arguments(command)
    assert outputs, "a script that writes nothing needs no test"
    for output in outputs:
        for given in inputs:
            name, other = argument_name(output), argument_name(given)
            for place in (folder / "in.blend", folder / "images" / "photo.png", folder / "store" / "photo.png"):
                if not (output.type.changes_scenes and other == "the input" and place.suffix == ".blend"):
                    assert f"{name} and {other} are the same file" in is_refused(command, folder, {name: place, other: place})
            if output.type.is_folder:
                message = is_refused(command, folder, {name: folder / "store", other: folder / "store" / "photo.png"})
                assert f"contains {other}" in message
            else:
                message = is_refused(command, folder, {name: folder / "store" / "photo.png", other: folder / "store"})
                assert f"in the folder of {other}" in message


@pytest.mark.parametrize("command", COMMANDS)
def test_no_two_outputs_of_a_script_are_the_same(command, folder, extension):
    for first, second in combinations(path_arguments(command)[0], 2):
        names = argument_name(first), argument_name(second)
        message = is_refused(command, folder, dict.fromkeys(names, folder / "new.png"))
        assert "are the same file" in message


def test_paths_that_settings_and_words_name_are_inputs_too(folder, extension):
    for name in ("source.npy", "color.png"):
        assert "same file" in is_refused("clipbox", folder, {"--out": folder / "new.ply", "--report": folder / name})
    assert "same file" in is_refused("restore", folder, {"the mask": folder / "other.png", "--out": folder / "other.png"})


@pytest.mark.parametrize("command", COMMANDS)
def test_every_argument_that_is_a_path_says_what_it_is(command):
    module, subcommand, _ = COMMANDS[command]
    parser = module.build_parser()
    actions = [action for each in (parser, *parser.commands(subcommand)) for action in each._actions]
    mentions = [item for item in actions if any(word in (item.help or "").split() for word in ("file", "folder", "image")) and item.type]
    undeclared = [argument_name(item) for item in mentions if not isinstance(item.type, PathType) and item.nargs != 0 and not item.choices]
    assert set(undeclared) <= {"--source", "--source-color", "the mask"}


@pytest.fixture(scope="module")
def scene_file(extension, tmp_path_factory) -> Path:
    """A file whose object has a texture and that links to a library."""
    place = tmp_path_factory.mktemp("scene")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    material = bpy.data.materials.new("Linked")
    bpy.data.libraries.write(str(place / "library.blend"), {material})
    bpy.data.materials.remove(material)
    with bpy.data.libraries.load(str(place / "library.blend"), link=True) as (_, loaded):
        loaded.materials = ["Linked"]
    image = bpy.data.images.new("Texture", 4, 4)
    image.filepath_raw, image.file_format = str(place / "texture.png"), "PNG"
    image.save()
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.data.materials.append(bpy.data.materials["Linked"])
    bpy.data.images["Texture"].use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=str(place / "scene.blend"), check_existing=False)
    return place / "scene.blend"


@pytest.mark.parametrize("command", ["billboards", "btf", "photos", "texmesh levels", "texmesh analyze", "unwrap", "packages build"])
@pytest.mark.parametrize("name", ["texture.png", "library.blend"])
def test_files_of_the_scene_are_not_replaced(command, name, scene_file, monkeypatch):
    """Neither by reports nor by other outputs."""
    monkeypatch.setattr(photos, "read_camera_file", lambda *_: CameraFile([], []))
    place = scene_file.parent
    paths = {"the input": scene_file, "--report": place / name, "--out": place / ("new" if command == "packages build" else "new.blend")}
    if command == "texmesh analyze":
        del paths["--out"]
    assert "a file of the scene" in is_refused(command, place, paths)


def test_materials_of_a_mesh_that_is_moved_to_the_origin_are_not_replaced(tmp_path, extension):
    """Blender reads a copy of such a file from another folder."""
    positions = "".join(f"v {500000 + x} {4500000 + y} 0\n" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
    (tmp_path / "far.obj").write_text(f"mtllib colors.mtl\n{positions}f 1 2 3 4\n")
    (tmp_path / "colors.mtl").write_text("newmtl Own\n")
    paths = {"the input": tmp_path / "far.obj", "--out": tmp_path / "new.blend", "--report": tmp_path / "colors.mtl"}
    for command in ("unwrap", "billboards"):
        assert "a file of the scene" in is_refused(command, tmp_path, paths)


def test_files_that_inputs_name(tmp_path):
    (tmp_path / "a.obj").write_text("# x\nmtllib my colors.mtl\nmtllib da\0maged.mtl\nv 0 0 0\n")
    (tmp_path / "a.gltf").write_text('{"buffers": [{"uri": "a%20b.bin"}, {"uri": "a%00b.bin"}, {"uri": "data:,x"}, {}]}')
    (tmp_path / "bad.gltf").write_text("[1")
    assert [path.name for path in referenced_files(tmp_path / "a.obj")] == ["my colors.mtl"]
    assert [path.name for path in referenced_files(tmp_path / "a.gltf")] == ["a b.bin"]
    assert referenced_files(tmp_path / "bad.gltf") == referenced_files(tmp_path / "none.obj") == []


def test_files_that_the_user_does_not_name_are_replaced_only_if_they_are_ours(tmp_path):
    out, materials = tmp_path / "a.obj", tmp_path / "a.mtl"
    output = Output("the material file", materials, is_ours=lambda path: is_named_by(out, path))
    check_outputs([output], [])
    materials.write_text("newmtl Own\n")
    with pytest.raises(FileError, match=r"would replace .*a\.mtl.*which Farfield did not write"):
        check_outputs([output], [])
    out.write_text("mtllib a.mtl\n")
    check_outputs([output], [])


def test_folders_of_images_may_have_images_of_earlier_runs(tmp_path):
    import numpy as np

    check_image_folder(tmp_path / "new")
    write_png(tmp_path / "stage.png", np.zeros((2, 3, 3)))
    (tmp_path / "notes.txt").touch()
    check_image_folder(tmp_path)
    assert is_own_png(tmp_path / "stage.png") and bpy.data.images.load(str(tmp_path / "stage.png")).size[:] == (3, 2)
    (tmp_path / "HOLIDAY.PNG").write_bytes(b"\x89PNG")
    with pytest.raises(FileError, match=r"other images, such as .HOLIDAY\.PNG"):
        check_image_folder(tmp_path)


def test_a_scene_may_be_changed_in_place(folder):
    check_outputs([Output("--out", folder / "in.blend", changes="the input")], [Input("the input", folder / "in.blend")])


def test_folders_in_which_files_are_looked_up_may_get_new_ones(folder):
    images = Input("--images", folder / "images")
    check_outputs([Output("--texture", folder / "images" / "new.png")], [images])
    with pytest.raises(FileError, match="in the folder of --images"):
        check_outputs([Output("--texture", folder / "images" / "photo.png")], [images])
    with pytest.raises(FileError, match="in the folder of the store"):
        check_outputs([Output("--report", folder / "store" / "new.json")], [Input("the store", folder / "store", is_closed=True)])


@only_on_posix
def test_links_to_one_file_are_rejected(folder):
    (folder / "link.json").symlink_to(folder / "in.obj")
    (folder / "hard.json").hardlink_to(folder / "in.obj")
    (folder / "linked").symlink_to(folder / "store")
    for name in ("link.json", "hard.json"):
        with pytest.raises(FileError, match="same file"):
            check_outputs([Output("--report", folder / name)], [Input("the input", folder / "in.obj")])
    with pytest.raises(FileError, match="in the folder of the store"):
        check_outputs([Output("--report", folder / "linked" / "x.json")], [Input("the store", folder / "store", is_closed=True)])


@only_on_posix
def test_only_a_report_may_be_a_device(folder):
    for stream in ("/dev/stdout", os.devnull):
        given = unwrap.build_parser().parse_args([str(folder / "in.obj"), "--out", str(folder / "x.blend"), "--report", stream])
        assert [output.name for output in given.files.outputs] == ["--out"]
    with pytest.raises(FileError, match="device"):
        unwrap.build_parser().parse_args([str(folder / "in.obj"), "--out", os.devnull])


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
