"""The examples in docs/python-api.md run and do what the page says."""

import re
import runpy

import bpy
import numpy as np
import pytest

from farfield.addon.operators.documentation import TOOLS
from lib import environment

update_tables = runpy.run_path(str(environment.ROOT / "docs" / "tables.py"))["update_tables"]
PAGE = (environment.ROOT / "docs" / "python-api.md").read_text(encoding="utf-8")
EXAMPLES = dict(re.findall(r"```python\n# example: (\w+)\n(.*?)```", PAGE, re.DOTALL))


def run(name: str) -> dict:
    namespace = {}
    exec(compile(EXAMPLES[name], f"python-api.md, {name}", "exec"), namespace)
    return namespace


def test_every_example_of_the_page_is_run_here():
    assert PAGE.count("```python") == len(EXAMPLES)
    assert set(EXAMPLES) == {"operators", "progress", *TOOLS}


def test_examples_use_what_tools_export():
    assert not re.findall(rf"from farfield\.addon\.core\.(?:{'|'.join(TOOLS)})\.[\w.]+ import", PAGE)


def test_the_table_lists_every_registered_operator_and_a_button_for_each(extension):
    rows = dict(re.findall(r"^\| `bpy\.ops\.farfield\.(\w+)` \| [^|]+ \| ([^|]+) \|$", PAGE, re.MULTILINE))
    assert set(rows) == set(dir(bpy.ops.farfield)) - {"cancel_job", "clear_cache", "details", "finish_job"}, "run `python3 docs/tables.py`"
    assert not [name for name, buttons in rows.items() if buttons == "none"]
    assert update_tables(PAGE) == PAGE


@pytest.mark.slow
def test_operators(empty_scene, capsys):
    cloud = run("operators")["cloud"]
    assert [level["farfield_level"] for level in cloud.objects] == [0, 1]
    assert "Sphere Cloud L0" in capsys.readouterr().out


def test_levels_from_near_to_far():
    found = [(level.triangles, level.pixel_size) for level in run("distance")["levels"]]
    assert found == [(20_000, 0.0), (6_000, 0.01), (1_500, 0.03), (80, 0.2)]


def test_a_box_as_a_library_user_builds_it():
    level = run("billboards")["cloud"].levels[0]
    assert len(level.quads) == 6
    assert level.error == pytest.approx(0.03)


def test_the_estimate_of_a_bake():
    estimate = run("btf")["estimate"]
    assert estimate.renders >= 2 * 36 and estimate.seconds > 0.0 and 0 < estimate.final_bytes < estimate.raw_bytes


def test_unwrapping_a_bump():
    result = run("unwrap")["result"]
    assert result.corner_uvs.shape == (242, 3, 2)
    assert result.metrics.flips == 0 and 1.0 <= result.metrics.l2 < 1.2


def test_a_texture_from_two_photographs():
    texture = run("photos")["texture"]
    gray = 0.5 + 0.2 * (2.0 * (np.arange(64) + 0.5) / 64 - 1.0)
    assert not texture.holes[1:-1, 1:-1].any() and np.abs(texture.colors - gray[:, None]).max() < 0.03


def test_restoring_stripes():
    example = run("restore")
    stripes, result, mask = example["stripes"], example["result"], example["mask"]
    assert np.array_equal(result.pixels[~mask], example["image"][~mask])
    ideal = np.where(example["columns"] // 6 % 2, 0.45, 0.55)
    assert np.abs(result.pixels[..., 0] - ideal)[mask].mean() < 1.3 * np.abs(stripes - ideal)[mask].mean()


def test_levels_of_a_textured_bump():
    levels = run("texmesh")["chain"].levels
    counts, sizes = [len(level.mesh.triangles) for level in levels], [level.pixel_size for level in levels]
    assert counts == pytest.approx([512, 256, 128], rel=0.02) and sizes == sorted(sizes) and sizes[0] == 0.0


@pytest.mark.slow
def test_a_package_of_three_levels():
    package = run("packages")["package"]
    assert package.report.levels == pytest.approx([512, 256, 128], rel=0.02)
    assert all(package.contents.values())


def test_heights_of_an_inclined_plane():
    example = run("bdam")
    (first, second), (normal, _) = example["heights"], example["normals"]
    assert second - first == pytest.approx(0.25 * 10.0 - 0.125 * 4.0, abs=0.02)  # rows grow towards the south
    assert normal == pytest.approx(np.array([-0.25, 0.125, 1.0]) / np.linalg.norm([0.25, 0.125, 1.0]), abs=1e-3)


def test_a_terrain_around_a_viewer():
    example = run("clipbox")
    assert len(example["mesh"].triangles) > 0 and 0 < example["step"].changed_count < example["first"].changed_count


def test_progress(capsys):
    run("progress")
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["0% Adding 0", "20% Adding 1", "40% Adding 2", "60% Adding 3", "80% Adding 4", "10"]
