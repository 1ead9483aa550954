"""`scripts/bench.py` runs benchmarks and puts their ratios on one page."""

import json
import platform
import sys

import pytest

import bench
from lib import environment
from lib.benchmark_ratios import Ratio, find_ratios

pytestmark = pytest.mark.once


def test_ratios_are_found_by_their_names():
    report = {
        "seed": 3,
        "disks": {
            "a": {"l2_over_slim": 0.5, "seconds": 4.0, "slim": {"l2": 2.0}},
            "b": {"l2_over_slim": 2.0, "is_met": True, "max_ratio": 1.2},
        },
        "levels": [{"ratios": {"mean": {"best": "other", "ratio": 0.25}}}, {"ratios": {"flip": 4.0, "none": None}}],
    }
    report["images"] = {"a": {"cloud": {"flip": 0.1, "psnr": 30.0}, "decimate": {"flip": 0.4, "psnr": 20.0}}, "b": {"cloud": 3}}
    assert find_ratios(report) == [
        Ratio("disks", "l2_over_slim", 2, pytest.approx(1.0), 0.5, 2.0),
        Ratio("levels", "ratio", 1, 0.25, 0.25, 0.25),
        Ratio("levels", "ratios", 1, 4.0, 4.0, 4.0),
        Ratio("images", "flip_over_decimate", 1, 0.25, 0.25, 0.25),
    ]


def test_all_benchmarks_belong_to_a_tool_or_to_another_benchmark():
    listed = {script for scripts in bench.BENCHMARKS.values() for script in scripts}
    existing = {path.name for path in bench.FOLDER.glob("bench_*.py")}
    started_by_others = {"bench_btf_eevee.py"}
    assert listed | started_by_others == existing
    assert set(bench.BENCHMARKS) == {path.parent.name for path in (environment.ROOT / "addon" / "core").glob("*/settings.py")}


def test_the_page_has_ratios_and_what_was_skipped_or_failed():
    ratio = Ratio("disks", "l2_over_slim", 2, 1.0, 0.5, 2.0)
    outcomes = [
        bench.Outcome("bench_a.py", "--only disks", 4.0, [ratio], "", ["extraction (no tool)"]),
        bench.Outcome("bench_b.py", "", 1.0, [], "No room.", []),
    ]
    page = bench.write_page(outcomes)
    assert "## a\n`bench_a.py --only disks`, 4 s." in page and "| disks | l2_over_slim | 2 | 1 | 0.5 | 2 |" in page
    assert "Skipped: extraction (no tool)." in page and "**Failed**: No room." in page
    assert " cores, " in page and f"Python {platform.python_version()}, bpy " in page


@pytest.mark.slow
def test_a_short_benchmark_runs_and_one_that_fails_is_named(tmp_path, monkeypatch):
    short = {"clipbox": {"bench_clipbox.py": "--only extraction --repeats 1"}, "bdam": {"bench_bdam.py": "--only nothing"}}
    monkeypatch.setattr(bench, "BENCHMARKS", short)
    monkeypatch.setattr(sys, "argv", ["bench.py", "--out", str(tmp_path)])
    assert bench.main() == 1
    page = (tmp_path / "index.md").read_text(encoding="utf-8")
    assert "extraction" in json.loads((tmp_path / "bench_clipbox.json").read_text(encoding="utf-8"))
    assert "[bench_clipbox.json](bench_clipbox.json)" in page and "**Failed**" in page and "'nothing'" in page
