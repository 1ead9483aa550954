"""`scripts/restore.py`: masks, formats, tiles and frames, outputs, the report and the exit codes."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

import restore
import strategies
from farfield.addon.core.errors import FarfieldError, FileError, ImageError, SettingsError
from farfield.addon.core.jobs.progress import Progress
from image_data import read_image, write_image
from lib import command_line, environment, restore_jobs

pytestmark = pytest.mark.usefixtures("extension")
SCRIPT = environment.ROOT / "scripts" / "restore.py"
SMOOTH = ("--split", "diffusion")
SIZE = 40
HOLE = (slice(10, 18), slice(20, 30))  # rows from the top


def texture(dtype=np.uint8, channels=3):
    """A noisy gradient (SIZE, SIZE, C) as stored."""
    values = np.random.default_rng(7).random((SIZE, SIZE, channels)) * 0.4 + np.linspace(0.2, 0.5, SIZE)[:, None]
    return (values * (np.iinfo(dtype).max if np.dtype(dtype).kind == "u" else 2.0)).astype(dtype)


def hole():
    mask = np.zeros((SIZE, SIZE, 1), np.uint8)
    mask[HOLE] = 255
    return mask


@pytest.fixture
def folder(tmp_path):
    """A folder with spaces and non-ASCII letters, with image.png and mask.png."""
    folder = tmp_path / "été à la mer 樹"
    folder.mkdir()
    write_image(folder / "image.png", texture())
    write_image(folder / "mask.png", hole())
    return folder


@pytest.fixture
def calls(monkeypatch):
    """What the script hands to the restoration: image, mask, settings and keyword arguments."""
    calls, original = [], restore_jobs.restore

    def record(image, mask, settings, **options):
        calls.append((image, mask, settings, options))
        return original(image, mask, settings, **options)

    monkeypatch.setattr(restore_jobs, "restore", record)
    return calls


def run(*arguments):
    return restore.main([str(argument) for argument in arguments], command_line.ProgressLine())


def assert_restored(source, target, area=HOLE):
    """Only the pixels of the area differ, and they are about as bright as the image."""
    before, after = read_image(source)[0], read_image(target)[0]
    kept = np.ones(before.shape[:2], bool)
    kept[area] = False
    assert after.dtype == before.dtype and after[kept].tobytes() == before[kept].tobytes()
    assert (after[area] != before[area]).mean() > 0.5
    assert after[area].mean() == pytest.approx(before[kept].mean(), rel=0.3)


@pytest.mark.parametrize(
    ("name", "dtype", "channels", "depth"),
    [
        ("a.png", np.uint8, 1, "8"),
        ("a.png", np.uint16, 4, "16"),
        ("a.tif", np.uint8, 3, "8"),
        ("a.tif", np.float32, 4, "float"),
        ("a.exr", np.float16, 3, "half"),
        ("a.exr", np.float32, 1, "float"),
    ],
)
def test_every_format_keeps_its_depth_and_its_other_pixels(folder, name, dtype, channels, depth):
    image = write_image(folder / name, texture(dtype, channels))
    out, report = folder / f"out-{name}", folder / "report.json"
    assert run(image, folder / "mask.png", "--out", out, *SMOOTH, "--report", report) == "Restored 80 pixels in 1 hole."
    assert_restored(image, out)
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert (figures["masked_pixels"], figures["holes"], figures["size"], figures["depth"]) == (80, 1, [SIZE, SIZE], depth)
    assert figures["channels"] == channels and figures["kappa"] is None and figures["peak_memory_mb"] > 0
    assert 0.0 < figures["seconds"]["write"] < figures["seconds"]["total"]


def test_jpeg(folder):
    y, x = np.mgrid[:SIZE, :SIZE]
    image = write_image(folder / "a.jpg", np.stack([x + 90, y + 90, x + y + 50], axis=2).astype(np.uint8), {"Compression": "jpeg:95"})
    run(image, folder / "mask.png", "--out", folder / "out.jpg", *SMOOTH)
    before, after = (read_image(folder / name)[0].astype(int) for name in ("a.jpg", "out.jpg"))
    assert np.abs(after - before).max() < 12  # the gradient continues in the hole


def test_texture_is_synthesized_and_the_same_seed_gives_the_same_bytes(folder, calls):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        flags = ("--sub-bands", "2", "--pyramid-levels", "1", "--seed", seed)
        run(folder / "image.png", folder / "mask.png", "--out", folder / f"{name}.png", *flags)
    assert (folder / "a.png").read_bytes() == (folder / "b.png").read_bytes()
    assert [chosen.seed for _, _, chosen, _ in calls] == [3, 3, 4]
    assert_restored(folder / "image.png", folder / "a.png")
    assert read_image(folder / "a.png")[0][HOLE].std() > 0.5 * read_image(folder / "image.png")[0][HOLE].std()


def test_alpha_as_mask(folder):
    stored = texture(channels=4)
    stored[..., 3] = 255
    stored[HOLE] = (7, 8, 9, 0)
    write_image(folder / "alpha.png", stored)
    run(folder / "alpha.png", "alpha", "--out", folder / "out.png", *SMOOTH)
    after = read_image(folder / "out.png")[0]
    assert (after[..., 3] == 255).all() and (after[HOLE][..., :3] > 20).all()


@pytest.mark.parametrize(("tolerance", "count"), [((), 80), (("--color-tolerance", "0"), 79), (("--color-tolerance", "10%"), 81)])
def test_a_color_as_mask(folder, tolerance, count):
    stored = texture()
    stored[HOLE] = (255, 0, 16)
    stored[10, 20] = (252, 3, 16)
    stored[30, 5] = (240, 16, 30)
    write_image(folder / "red.png", stored)
    assert f"{count} pixels" in run(folder / "red.png", "#fF0010", "--out", folder / "out.png", *SMOOTH, *tolerance)


@pytest.mark.parametrize("name", ["float.exr", "rgba.png", "rgba.exr"])
def test_bright_opaque_pixels_of_a_mask_count(folder, name):
    mask = hole().repeat(4, axis=2)[..., : 1 if name == "float.exr" else 4]
    if name == "float.exr":
        mask = np.where(mask > 0, 0.51, 0.49).astype(np.float32)
    elif name == "rgba.png":
        mask[..., :3] = 255  # white everywhere, transparent outside
    else:
        mask = (mask / 255.0).astype(np.float16)
    write_image(folder / name, mask)
    assert "80 pixels" in run(folder / "image.png", folder / name, "--out", folder / "out.png", *SMOOTH)
    assert_restored(folder / "image.png", folder / "out.png")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("extension", "orientation"),
    [(".jpg", orientation) for orientation in range(2, 9)]
    + [(".png", 6), (".tif", 8)]
    + [
        pytest.param(extension, orientation, marks=pytest.mark.exhaustive)
        for extension in (".png", ".tif")
        for orientation in (2, 3, 4, 5, 7)
    ],
)
def test_a_mask_of_the_upright_photograph_is_turned_as_the_photograph_is_stored(folder, calls, orientation, extension):
    stored, mask = texture()[:30], np.zeros((30, SIZE, 1), np.uint8)
    mask[HOLE] = 255
    image = write_image(folder / f"photo{extension}", stored, {"Orientation": orientation})
    transposition = {2: 0, 3: 3, 4: 1, 5: 5, 6: 4, 7: 6, 8: 2}[orientation]  # as Pillow shows an image with this orientation upright
    upright = np.asarray(Image.fromarray(mask[..., 0]).transpose(transposition))
    write_image(folder / "upright.png", upright[..., None])
    write_image(folder / "stored.png", mask, {"Orientation": orientation})
    out = folder / f"out{extension}"
    message = run(image, folder / "upright.png", "--out", out, *SMOOTH, "--report", folder / "report.json")
    remark = f"The mask was turned as the image is stored, with the orientation {orientation}."
    assert message == f"Restored 80 pixels in 1 hole. {remark}"
    assert json.loads((folder / "report.json").read_text(encoding="utf-8"))["images"][0]["remarks"] == [remark]
    out.unlink()
    assert run(image, folder / "stored.png", "--out", out, *SMOOTH) == "Restored 80 pixels in 1 hole."
    assert all(np.array_equal(call[1], mask[::-1, :, 0] > 0) for call in calls)
    write_image(folder / "small.png", mask[:-1])
    with pytest.raises(ImageError, match=f"40 x 30, stored with the orientation {orientation}; they must have the same size"):
        run(image, folder / "small.png", "--out", folder / "none.png")


def test_masks_and_kinds_of_data_reach_the_restoration(folder, calls):
    write_image(folder / "source.png", 255 - hole())
    write_image(folder / "barriers.png", np.flipud(hole()))
    masks = ("--source-mask", folder / "source.png", "--barriers", folder / "barriers.png")
    flags = ("--sub-bands", "3", "--tileable", "--order", "scanline")
    run(folder / "image.png", folder / "mask.png", "--out", folder / "out.png", *flags, *masks)
    run(folder / "image.png", folder / "mask.png", "--out", folder / "out.png", *SMOOTH, "--data")
    run(folder / "image.png", folder / "mask.png", "--out", folder / "out.png", *SMOOTH, "--normal-map")
    (_, mask, chosen, options), (_, _, _, data), (_, _, _, normal_map) = calls
    np.testing.assert_array_equal(mask, hole()[::-1, :, 0] > 0)
    np.testing.assert_array_equal(options["source_mask"], ~mask)
    np.testing.assert_array_equal(options["barriers"], mask[::-1])
    assert (chosen.split, chosen.sub_bands, chosen.tileable, chosen.order) == ("manual", 3, True, "scanline")
    assert (options["is_color"], options["normal_channels"], options["keep_stages"]) == (True, (), False)
    assert (data["is_color"], data["normal_channels"]) == (False, ())
    assert (normal_map["is_color"], normal_map["normal_channels"]) == (False, (0,))


def test_all_maps_of_a_material_are_restored_together(folder, calls):
    height, normals = write_image(folder / "height.exr", texture(np.float32, 1)), write_image(folder / "normals.png", texture(np.uint16))
    given = ("--maps", height, "--maps-out", folder / "h.exr", "--normals", normals, "--normals-out", folder / "n.png")
    run(folder / "image.png", folder / "mask.png", "--out", folder / "out.png", *SMOOTH, *given)
    image, _, _, options = calls[0]
    assert (image.shape[2], options["further_maps"], options["normal_channels"]) == (7, (3, 4), (4,))
    assert_restored(folder / "image.png", folder / "out.png")
    assert_restored(height, folder / "h.exr")
    restored, kept = read_image(folder / "n.png")[0], np.ones((SIZE, SIZE), bool)
    kept[HOLE] = False
    assert np.array_equal(restored[kept], texture(np.uint16)[kept])
    assert np.linalg.norm(2.0 * restored[HOLE] / 65535.0 - 1.0, axis=2) == pytest.approx(1.0, abs=1e-3)


def test_wrong_further_maps_are_refused(folder):
    small, out = write_image(folder / "small.png", texture()[:30]), folder / "out.png"
    start = (folder / "image.png", folder / "mask.png", "--out", out, *SMOOTH, "--maps", small)
    with pytest.raises(ImageError, match=r"40 x 30 pixels and .* 40 x 40; they must have the same size"):
        run(*start, "--maps-out", folder / "small-out.png")
    with pytest.raises(SettingsError, match="--maps and --maps-out must name as many files"):
        run(*start)
    with pytest.raises(FileError):
        run(*start, "--maps-out", out)
    assert not out.exists()


def test_float_data_is_used_as_stored(folder, calls):
    stored = texture(np.float32, 1)
    write_image(folder / "a.exr", stored)
    run(folder / "a.exr", folder / "mask.png", "--out", folder / "out.exr", *SMOOTH, "--data")
    run(folder / "a.exr", folder / "mask.png", "--out", folder / "out.exr", *SMOOTH)
    np.testing.assert_array_equal(calls[0][0], stored[::-1])
    assert (calls[1][0] != stored[::-1]).mean() > 0.9  # encoded for display


@pytest.mark.parametrize(
    ("flags", "split", "sub_bands"),
    [((), "auto", 4), (("--split", "diffusion"), "diffusion", 4), (("--sub-bands", "0"), "manual", 0)],
)
def test_a_number_of_sub_bands_selects_the_manual_split(flags, split, sub_bands):
    parsed = restore.read_settings(restore.build_parser().parse_args(["a.png", "b.png", "--out", "c.png", *flags]))
    assert (parsed.split, parsed.sub_bands) == (split, sub_bands)


@pytest.mark.slow
def test_stages_and_the_curve(folder):
    outputs = ("--stages", folder / "stages", "--curve", folder / "curve.png", "--report", folder / "report.json")
    run(folder / "image.png", folder / "mask.png", "--out", folder / "out.png", *outputs)
    names = {path.name for path in (folder / "stages").iterdir()}
    assert names == {"first_fill.png", "low.png", "low_filled.png", "high.png", "high_filled.png"}
    high, low = (read_image(folder / "stages" / f"{name}.png")[0] / 255.0 for name in ("high_filled", "low_filled"))
    assert abs(high.mean() - 0.5) < 0.02
    difference = np.abs(low + high - 0.5 - read_image(folder / "out.png")[0] / 255.0)
    assert (difference <= 2.5 / 255).mean() > 0.98  # but where the sum was clipped
    assert read_image(folder / "curve.png")[0].std() > 5
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert report["kappa"] >= 0 and {"read", "kappa", "texture", "write", "total"} <= report["seconds"].keys()


@pytest.mark.parametrize(
    ("pattern", "numbers", "out"),
    [
        ("tex.<UDIM>.png", ("1001", "1002", "1011"), "out.<UDIM>.exr"),
        ("frame_###.png", ("001", "020", "1000"), "out_#.png"),
    ],
)
def test_tiles_and_frames(folder, pattern, numbers, out):
    placeholder = "<UDIM>" if "<" in pattern else "###"
    for number in (*numbers, "0", "x"):
        write_image(folder / pattern.replace(placeholder, number), texture())
        write_image(folder / f"mask-{pattern}".replace(placeholder, number), hole() if number != numbers[1] else 0 * hole())
    report = folder / "report.json"
    summary = run(folder / pattern, folder / f"mask-{pattern}", "--out", folder / out, *SMOOTH, "--report", report)
    assert summary == "Restored 160 pixels in 2 holes of 3 images."
    written = sorted(path.name for path in folder.glob("out*"))
    assert written == sorted(out.replace("<UDIM>", number).replace("#", str(int(number))) for number in numbers)
    if out.endswith(".png"):
        assert_restored(folder / "frame_1000.png", folder / "out_1000.png")
        np.testing.assert_array_equal(read_image(folder / "out_20.png")[0], texture())  # nothing was missing there
    images = json.loads(report.read_text(encoding="utf-8"))["images"]
    assert [image["masked_pixels"] for image in images] == [80, 0, 80]


def test_one_mask_for_all_frames_and_stages_by_number(folder):
    for number in (1, 2):
        write_image(folder / f"f{number}.png", texture())
    flags = ("--sub-bands", "1", "--pyramid-levels", "1", "--stages", folder / "stages")
    assert "2 images" in run(folder / "f#.png", folder / "mask.png", "--out", folder / "o#.png", *flags)
    assert {"0001_low.png", "0002_low.png"} <= {path.name for path in (folder / "stages").iterdir()}


def test_a_number_sign_in_a_name_is_no_placeholder_where_the_file_exists(folder):
    write_image(folder / "a#1.png", texture())
    run(folder / "a#1.png", folder / "mask.png", "--out", folder / "out#.png", *SMOOTH)
    assert_restored(folder / "a#1.png", folder / "out#.png")


def test_an_error_in_the_last_frame_writes_no_frame(folder):
    for number in (1, 2):
        write_image(folder / f"f{number}.png", texture())
    (folder / "f2.png").write_bytes((folder / "f1.png").read_bytes()[:900])
    before = sorted(folder.iterdir())
    with pytest.raises(FileError, match=r"f2\.png.*damaged"):
        run(folder / "f#.png", folder / "mask.png", "--out", folder / "new" / "o#.png", *SMOOTH)
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    ("image", "mask", "flags", "error_type", "text"),
    [
        ("none.png", "mask.png", (), FileError, "none.png"),
        ("image.png", "none.png", (), FileError, "none.png"),
        ("image.png", "small.png", (), ImageError, "8 x 9 pixels"),
        ("image.png", "image.png", ("--barriers", "small.png"), ImageError, 'barrier mask "'),
        ("image.png", "black.png", (), ImageError, "No pixel is masked"),
        ("image.png", "white.png", (), ImageError, "Every pixel is masked"),
        ("image.png", "nan.exr", (), ImageError, "NaN"),
        ("nan.exr", "mask.png", (), ImageError, "NaN"),
        ("image.png", "alpha", (), ImageError, "no alpha"),
        ("image.png", "#123456", (), ImageError, "No pixel is masked"),
        ("image.png", "#12345", (), FileError, "does not exist"),
        ("image.png", "", (), FileError, "empty"),
        ("image.png", "mask.png", ("--out", "x.gif"), FileError, "--out"),
        ("image.png", "mask.png", ("--curve", "x.jpg"), FileError, "--curve"),
        ("image.png", "mask.png", ("--curve", "x.png", "--sub-bands", "3"), SettingsError, "--curve"),
        ("image.png", "mask.png", ("--sub-bands", "most"), SettingsError, "--sub-bands"),
        ("image.png", "mask.png", ("--sub-bands", "-1"), SettingsError, "--sub-bands"),
        ("image.png", "mask.png", ("--sub-bands=--",), SettingsError, "--sub-bands"),
        ("image.png", "mask.png", ("--color-tolerance=--",), SettingsError, "--color-tolerance"),
        ("black.png", "mask.png", ("--normal-map",), ImageError, "--normal-map"),
        ("image.png", "mask.png", ("--pyramid-levels", "6"), SettingsError, "--pyramid-levels"),
        ("image.png", "mask.png", ("--color-tolerance", "much"), SettingsError, "--color-tolerance"),
        ("image.png", "mask.png", ("--stages", "image.png"), FileError, "image.png"),
        ("f#.png", "mask.png", ("--out", "x#.png"), FileError, "No file matches"),
        ("i#age.<UDIM>.png", "mask.png", (), FileError, "several placeholders"),
    ],
)
def test_invalid_input_is_a_one_line_error_and_writes_nothing(folder, image, mask, flags, error_type, text):
    write_image(folder / "small.png", np.zeros((9, 8, 1), np.uint8))
    write_image(folder / "black.png", 0 * hole())
    write_image(folder / "white.png", 0 * hole() + 255)
    write_image(folder / "nan.exr", np.where(hole() > 0, 1.0, np.nan).astype(np.float32))
    before = {path: path.read_bytes() for path in folder.iterdir()}
    mask = folder / mask if mask.endswith((".png", ".exr")) else mask
    flags = [folder / flag if flag.endswith((".png", ".jpg", ".gif")) else flag for flag in flags]
    with pytest.raises(error_type) as caught:
        run(folder / image, mask, "--out", folder / "new" / "out.png", *flags)
    assert text in str(caught.value) and "\n" not in str(caught.value) and str(caught.value).endswith(".")
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    "flags",
    [
        ("--out", "image.png"),
        ("--out", "mask.png"),
        ("--out", "out.png", "--curve", "out.png"),
        ("--out", "out.png", "--report", "image.png"),
        ("--out", "stages/first_fill.png", "--stages", "stages"),
    ],
)
def test_outputs_replace_neither_each_other_nor_the_inputs(folder, flags):
    before = {path: path.read_bytes() for path in folder.iterdir()}
    smooth = () if "--curve" in flags else SMOOTH
    with pytest.raises(FileError, match=r"same file|in the folder of --stages"):
        run(folder / "image.png", folder / "mask.png", *(flag if flag.startswith("--") else folder / flag for flag in flags), *smooth)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_several_images_need_the_placeholder_in_the_output(folder):
    write_image(folder / "f1.png", texture())
    with pytest.raises(FileError, match="put # into its name"):
        run(folder / "f#.png", folder / "mask.png", "--out", folder / "out.png")


def test_cancelling_leaves_nothing(folder, monkeypatch):
    before = sorted(folder.rglob("*"))
    line = command_line.ProgressLine()

    def cancel(progress: Progress) -> None:
        if progress.fraction > 0.3:
            raise KeyboardInterrupt

    monkeypatch.setattr(line, "show", cancel)
    with pytest.raises(KeyboardInterrupt):
        restore.main([str(folder / "image.png"), str(folder / "mask.png"), "--out", str(folder / "out.png"), "--sub-bands", "2"], line)
    assert sorted(folder.rglob("*")) == before


@pytest.mark.slow
def test_the_exit_code_and_the_one_line_of_a_truncated_file(folder):
    content = (folder / "image.png").read_bytes()
    (folder / "image.png").write_bytes(content[: len(content) // 2])
    command = [sys.executable, str(SCRIPT), str(folder / "image.png"), str(folder / "mask.png"), "--out", str(folder / "out.png")]
    variables = {name: value for name, value in os.environ.items() if name != "OCIO"}  # set by Blender in this process; it would print it
    result = subprocess.run(command, capture_output=True, encoding="utf-8", check=False, env=variables)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.count("\n") == 1 and "damaged or truncated" in result.stderr


@pytest.mark.parametrize(
    "name", ["a.png", pytest.param("a.tif", marks=pytest.mark.exhaustive), pytest.param("a.jpg", marks=pytest.mark.exhaustive), "a.exr"]
)
@given(data=st.data())
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_images_are_restored_or_refused_in_one_sentence(folder, name, data):
    stored = texture(np.float16 if name == "a.exr" else np.uint8)
    content = write_image(folder / f"valid-{name}", stored, {"Compression": "jpeg:90"} if name == "a.jpg" else {}).read_bytes()
    (folder / name).write_bytes(data.draw(strategies.damaged(content)))
    try:
        run(folder / name, folder / "mask.png", "--out", folder / "out.png", *SMOOTH)
    except FarfieldError as error:
        assert str(error).endswith(".") and "\n" not in str(error)
    assert not list(folder.glob(".farfield*"))
