"""The demo writes its files, rejects invalid input, and its Markdown page agrees with its report."""

import json
from dataclasses import replace

import pytest

pytest.importorskip("bpy")

import bpy

from lib import command_line, demo_photos
from lib.demo_report import to_markdown
from mesh_files import CUBE


@pytest.mark.once
@pytest.mark.slow
@pytest.mark.usefixtures("few_samples", "coarse_packing")
def test_the_demo_writes_scenes_sheets_and_report(extension, tmp_path, monkeypatch):
    import demo

    quick = demo.QUICK
    preset = replace(
        quick,
        samples=2,
        relighting=replace(quick.relighting, bake=replace(quick.relighting.bake, views_per_side=2, executor="serial"), frames=3, samples=2),
        forest_width=64,
        forest_samples=1,
        photos=replace(quick.photos, photograph_width=200, samples=1, texture_size=256, view_pixels=64, subdivisions=0),
        terrain=replace(quick.terrain, size=65, width=64, samples=1),
        levels=replace(quick.levels, segments=12),
    )
    monkeypatch.setattr(demo, "QUICK", preset)
    create_model = demo_photos.create_model

    def create_model_with_uvs(subdivisions):
        """Farfield would take much longer for its UV map than for everything else."""
        model = create_model(subdivisions)
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_all(action="SELECT")
        bpy.ops.uv.smart_project()
        bpy.ops.object.mode_set(mode="OBJECT")
        return model

    monkeypatch.setattr(demo_photos, "create_model", create_model_with_uvs)
    mesh = tmp_path / "würfel.obj"
    mesh.write_text(CUBE, encoding="utf-8")
    out = tmp_path / "out folder"
    result = demo.main(["--quick", "--input", str(mesh), "--out", str(out)], command_line.ProgressLine())
    assert "\n" not in result and "12 triangles as 6 quads" in result and str(out) in result
    sheets = ["contact-sheet.png", "forest.png", "photos.png", "relighting.png", "terrain.png", "texmesh.png"]
    scenes = ["demo.blend", "forest.blend", "photos.blend", "texmesh.blend"]
    assert sorted(path.name for path in out.iterdir()) == sorted([*sheets, *scenes, "report.json", "report.md", "terrain"])
    assert all((out / name).read_bytes().startswith(b"\x89PNG") for name in sheets)
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["source_triangles"] == 12
    assert [level["quads"] for level in report["levels"]] == [6]  # Coarser levels of a cube save nothing.
    comparison = report["levels"][0]["comparison"]
    assert len(comparison["views"]) == 6
    assert comparison["mean_alpha_iou"] > 0.95
    relighting = report["relighting"]
    assert relighting["renders"] == 2 * relighting["views"]
    assert not relighting["upper_hemisphere"], "the mesh of a user may be visible from below"
    assert set(relighting["scores"]) == {"relightable", "PBR maps", "octahedral impostor"}
    assert relighting["scores"]["relightable"]["alpha_iou"] > 0.8
    assert report["forest"]["trees"] == 1000
    assert report["photos"]["cameras"] == 8
    assert all(view["psnr"] > 24.0 for view in report["photos"]["views"])
    assert report["terrain"]["samples"] == 65**2
    assert all(500 < count < 2 * 64**2 for count in report["terrain"]["triangles"])
    assert report["texmesh"]["triangles"] > report["texmesh"]["levels"][0]["triangles"]
    assert "12 triangles as 6 quads" in (out / "report.md").read_text(encoding="utf-8")


def test_a_missing_input_is_named_and_nothing_is_written(extension, tmp_path):
    import demo
    from farfield.addon.core.errors import FileError

    with pytest.raises(FileError, match=r"none\.obj"):
        demo.main(["--quick", "--input", str(tmp_path / "none.obj"), "--out", str(tmp_path / "out")], command_line.ProgressLine())
    assert not (tmp_path / "out").exists()


def test_the_page_lists_every_level_and_view():
    view = {"direction": [0.6, 0.0, 0.8], "ssim": 0.9, "alpha_iou": 0.95}
    comparison = {"mean_ssim": 0.9, "mean_alpha_iou": 0.95, "render_setup": "one Sun light", "views": [view]}
    fine = {"error": 0.01, "quads": 1234, "texels": 5678, "switch_distance": 12.5, "comparison": comparison}
    coarse = {"error": 0.02, "quads": 99, "texels": 100, "switch_distance": None}
    page = to_markdown("A ball", {"levels": [fine, coarse], "seconds": {"capture": 1.25}, "peak_memory_mb": 512.0})
    assert page.startswith("# A ball\n")
    assert "| 0 | 0.01 | 1,234 | 5,678 | 12.5 | 0.900 | 0.950 |" in page
    assert "| 1 | 0.02 | 99 | 100 | never | not compared | not compared |" in page
    assert "| 0.60, 0.00, 0.80 | 0.900 | 0.950 |" in page


def test_the_page_describes_bake_and_comparison():
    scores = {
        "relightable": {"psnr": 27.25, "ssim": 0.91, "alpha_iou": 0.88},
        "PBR maps": {"psnr": 24.0, "ssim": 0.85, "alpha_iou": 0.83},
    }
    relighting = {
        "level": 1,
        "views": 36,
        "upper_hemisphere": True,
        "samples": 4,
        "renders": 612,
        "bare_render_seconds": 61.5,
        "raw_bytes": 400_000_000,
        "compressed_bytes": 2_000_000,
        "pairs": 8,
        "scores": scores,
        "seconds": {"capture": 33.0},
    }
    forest = {"trees": 1000, "hours": ["morning", "noon", "evening"]}
    page = to_markdown("A tree", {"levels": [], "seconds": {}, "peak_memory_mb": 1.0, "relighting": relighting, "forest": forest})
    assert "36 views above the horizon: 612 renders" in page
    assert "2.00 MB in addition to the PBR maps" in page
    assert "| relightable | 27.2 | 0.910 | 0.880 |" in page and "| PBR maps | 24.0 |" in page
    assert "](relighting.png)" in page and "](forest.png)" in page
    assert "1,000 instances in forest.blend, animated from morning to evening" in page
