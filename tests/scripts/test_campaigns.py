"""Campaigns notice broken promises, repeat their cases, and go on after a crash."""

import json
import subprocess
import sys
from pathlib import Path
from random import Random

import bpy
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lib import environment

sys.path.append(str(environment.ROOT / "benchmarks"))

import campaign_batches
import campaign_checks
import campaign_runs
import campaign_scenes
import campaign_values
from campaign_checks import OLD_CONTENT

import random_inputs
import strategies
from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.clipbox.terrains.formulas import Formula
from farfield.addon.core.errors import SettingsError
from farfield.addon.core.settings import check, describe

FUZZ = environment.ROOT / "benchmarks" / "campaign_fuzz.py"


def kinds(problems: list[campaign_checks.Problem]) -> list[str]:
    return [problem.kind for problem in problems]


def test_equal_seeds_give_equal_cases():
    for make in (random_inputs.random_name, random_inputs.random_mesh, random_inputs.random_formula, random_inputs.bad_value):
        values = [[make(Random(f"{seed}")) for seed in range(30)] for _ in range(2)]
        assert values[0] == values[1] and len({repr(value) for value in values[0]}) > 5
    flags = [[campaign_values.random_flags(Random(f"{seed}"), "clipbox") for seed in range(30)] for _ in range(2)]
    assert flags[0] == flags[1]


@given(strategies.meshes())
def test_meshes_can_be_written_and_read(mesh):
    count = len(mesh.vertices)
    assert all(len(face) >= 3 and set(face) <= set(range(count)) for face in mesh.faces)
    assert mesh.to_obj().count(b"\nv ") == count
    assert len(mesh.to_ply().split(b"end_header\n")[1].splitlines()) == count + len(mesh.faces)


@given(strategies.formulas())
@settings(max_examples=200)
def test_formulas_are_compiled_or_refused_in_one_sentence(text):
    try:
        Formula(text)
    except SettingsError as error:
        assert str(error).endswith(".")


@given(st.data())
def test_valid_values_are_valid(data):
    for description in describe(ClipboxSettings):
        value = data.draw(strategies.values(description))
        if isinstance(value, str):
            check(description, description.parse(value))


@given(strategies.damaged(b"ply\nformat ascii 1.0\nelement vertex 12\n"), strategies.bad_values(), strategies.names())
def test_other_strategies_give_text(content, value, name):
    assert isinstance(content, bytes) and isinstance(value, str) and name.encode("utf-8")


@pytest.mark.parametrize(
    ("code", "stderr", "expected"),
    [
        (0, "", []),
        (0, "Skipped: Cube (no faces).\n", []),
        (2, "Skipped: Cube (no faces).\nThere is no file.\n", []),
        (0, "--gamma is not used with --no-exposure.\n", []),
        (130, "Cancelled.\n", []),
        (2, "libpng error: IDAT: CRC error\nThe image is damaged.\n", []),
        (
            2,
            "ImageInput::read_image() failed: PNG read error\nPNG library error\nIMB_load_image_from_memory: unknown\nIt is damaged.\n",
            [],
        ),
        (0, 'find_node component: Could not find ID OBA\nFailed to add relation "Metaball"\n\nTrace:\n\n1        Object         A\n', []),
        (0, "a warning\n", ["1 lines on stderr with exit code 0"]),
        (2, "", ["0 lines on stderr with exit code 2"]),
        (2, "two\nlines\n", ["2 lines on stderr with exit code 2"]),
        (1, "failed because of a defect of Farfield.\n", ["defect"]),
        (1, 'Traceback (most recent call last):\n  File "x"\nValueError: x\n', ["traceback"]),
        (-11, "", ["exit code -11"]),
    ],
)
def test_messages(code, stderr, expected):
    assert kinds(campaign_checks.check_messages(code, "", stderr, interrupted=True)) == expected


def test_collections_that_would_contain_themselves_are_not_instanced(empty_scene, monkeypatch):
    """Blender refuses the link with an error."""
    outer, inner = (bpy.data.collections.new(name) for name in ("Outer", "Inner"))
    bpy.context.scene.collection.children.link(outer)
    outer.children.link(inner)
    monkeypatch.setattr(campaign_scenes, "OTHER_TYPES", ("INSTANCE",))
    for seed in range(20):
        item = campaign_scenes._add_other_object(Random(seed), inner)
        assert item.instance_collection is None and item.name in inner.objects


def test_a_run_that_was_not_cancelled_must_not_say_so():
    assert kinds(campaign_checks.check_messages(130, "", "Cancelled.\n", interrupted=False)) == ["exit code 130"]


def test_changes_after_a_refusal_are_noticed(tmp_path):
    (tmp_path / "out.blend").write_bytes(OLD_CONTENT)
    before = campaign_checks.read_state(tmp_path)
    assert campaign_checks.check_files(2, before, campaign_checks.read_state(tmp_path), ["out.blend"], None) == []
    (tmp_path / "out.blend").write_bytes(b"half a file")
    (tmp_path / ".farfield-0123").mkdir()
    (tmp_path / "new.png").write_bytes(b"")
    found = campaign_checks.check_files(2, before, campaign_checks.read_state(tmp_path), ["out.blend"], None)
    assert sorted(kinds(found)) == ["changed although the exit code is 2", "left behind", "new file although the exit code is 2"]


def test_a_cancelled_run_may_leave_complete_outputs(tmp_path):
    """Ctrl+C between two outputs keeps the first: a bake takes hours, an export minutes."""
    before = campaign_checks.read_state(tmp_path)
    (tmp_path / "out.json").write_bytes(b"{}")
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "a.json").write_bytes(b"{")
    (tmp_path / "other.json").write_bytes(b"{}")
    after, outputs = campaign_checks.read_state(tmp_path), ["out.json", "images", "missing.json"]
    assert [problem.text for problem in campaign_checks.check_files(130, before, after, outputs, None)] == ["other.json"]
    written = campaign_checks.check_written(tmp_path, before, after, outputs)
    assert [(problem.kind, problem.text) for problem in written] == [("output not complete", "a.json")]
    assert campaign_checks.check_written(tmp_path, after, after, outputs) == []


def test_a_run_that_fails_may_leave_the_outputs_that_its_message_names(tmp_path):
    before = campaign_checks.read_state(tmp_path)
    outputs = ["new/out.blend", "export.btf", "r.json"]
    (tmp_path / "new").mkdir()
    for name in ("new/out.blend", "export_L0.btf", "r.json"):
        (tmp_path / name).write_bytes(b"{}")
    after = campaign_checks.read_state(tmp_path)

    def find_unexpected(message: str) -> list[str]:
        saved = campaign_checks.find_saved(f"Skipped: A.\n{message}\n", outputs)
        return [problem.text for problem in campaign_checks.check_files(2, before, after, outputs, None, saved)]

    assert find_unexpected("The disk is full.") == ["export_L0.btf", "new", "new/out.blend", "r.json"]
    assert find_unexpected(f'The disk is full. Already saved: "{tmp_path}/new/out.blend".') == ["export_L0.btf", "r.json"]
    assert find_unexpected('The disk is full. Already saved: "new/out.blend", "/a/export_L0.btf".') == ["r.json"]
    assert find_unexpected('The disk is full. Already saved: "a", "b", "c" and 2 more.') == []


@pytest.mark.exhaustive
def test_the_processes_of_a_campaign_find_their_modules():
    """They are started as scripts, without the search path of the tests."""
    command = f"import sys; sys.path.insert(0, {str(FUZZ.parent)!r}); import campaign_disk, campaign_session, campaign_worker"
    outcome = subprocess.run([sys.executable, "-c", command], capture_output=True, encoding="utf-8", cwd=FUZZ.anchor, check=False)
    assert outcome.returncode == 0, outcome.stderr


def test_a_changed_input_is_noticed_but_not_an_output(tmp_path):
    for name in ("in.obj", "out.obj"):
        (tmp_path / name).write_bytes(b"v 0 0 0\n")
    before = campaign_checks.read_state(tmp_path)
    for name in ("in.obj", "out.obj", "out.mtl"):
        (tmp_path / name).write_bytes(b"v 1 0 0\n")
    found = campaign_checks.check_files(0, before, campaign_checks.read_state(tmp_path), ["out.obj"], None)
    assert [(problem.kind, problem.text) for problem in found] == [("input changed", "in.obj")]


@pytest.mark.parametrize(
    ("name", "complete", "truncated"),
    [
        ("a.json", b"{}", b"{"),
        ("a.png", b"\x89PNG\r\n\x1a\n\x00\x00\x00\x00IEND\xaeB`\x82", b"\x89PNG\r\n\x1a\n"),
        ("a.glb", b"glTF\x02\0\0\0\x0c\0\0\0", b"glTF\x02\0\0\0\xff\0\0\0"),
        (
            "a.ply",
            b"ply\nelement vertex 1\nelement face 1\nend_header\n" + bytes(49),
            b"ply\nelement vertex 1\nelement face 1\nend_header\n",
        ),
        ("a.obj", b"v 0 0 0\n", b"v 0 0"),
    ],
)
def test_truncated_outputs_are_noticed(tmp_path, name, complete, truncated):
    path = tmp_path / name
    assert kinds(campaign_checks.check_output(path)) == ["output missing"]
    path.write_bytes(complete)
    assert campaign_checks.check_output(path) == []
    for content in (truncated, OLD_CONTENT):
        path.write_bytes(content)
        assert kinds(campaign_checks.check_output(path)) == ["output not complete"]


def test_equal_problems_have_equal_signatures():
    first, second = (campaign_checks.Problem("defect", f'No "{name}" in line {line}.') for name, line in (("Cube", 3), ("Ball", 17)))
    assert first.signature == second.signature != campaign_checks.Problem("defect", "Another.").signature


WORKER = """
import json, os, signal, sys, time
given = json.load(open(sys.argv[1]))
with open(given["log"], "a", buffering=1) as log:
    for case in given["cases"]:
        log.write(json.dumps({"case": case, "event": "start"}) + "\\n")
        log.write(json.dumps({"case": case, "event": "step", "step": "step of %d" % case}) + "\\n")
        if case == 1:
            os.kill(os.getpid(), signal.SIGSEGV)
        if case == 3:
            time.sleep(100)
        log.write(json.dumps({"case": case, "event": "end", "kind": "script", "problems": []}) + "\\n")
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="signals of POSIX")
def test_a_crash_and_a_hang_cost_one_case_each(tmp_path, monkeypatch):
    worker = tmp_path / "worker.py"
    worker.write_text(WORKER, encoding="utf-8")
    monkeypatch.setattr(campaign_batches, "WORKER", worker)
    monkeypatch.setattr(campaign_batches, "DUMP_SECONDS", 0.0)
    options = campaign_batches.BatchOptions(seed=0, sandbox=tmp_path / "sandbox", case_seconds=1.0, memory_gb=8.0, keep=False)
    results = list(campaign_batches.run_cases("unwrap", range(5), options, lambda: None))
    assert [(result["case"], result["kind"]) for result in results] == [
        (0, "script"), (1, "crash"), (2, "script"), (3, "slow"), (4, "script"),
    ]  # fmt: skip
    assert "SIGSEGV" in results[1]["problems"][0][1] and results[1]["steps"] == ["step of 1"]


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="process groups of POSIX")
def test_a_stopped_campaign_leaves_no_process(tmp_path):
    def stop(_: str) -> None:
        if process.living_members():
            raise KeyboardInterrupt

    campaign = campaign_runs.Campaign(tmp_path, end=1e12, show=stop, seed=0)
    with pytest.raises(KeyboardInterrupt), campaign.start([sys.executable, "-c", "import time; time.sleep(100)"]) as process:
        while True:
            campaign.check("waiting")
    assert process.living_members() == [] and process.poll() is not None


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.once
def test_a_campaign_prints_what_it_did(tmp_path):
    report = tmp_path / "report.json"
    command = [sys.executable, str(FUZZ), "--tool", "clipbox", "--case", "3", "--seed", "1", "--report", str(report)]
    outcome = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    assert outcome.returncode == 0, outcome.stderr
    results = json.loads(outcome.stdout)
    assert results == json.loads(report.read_text(encoding="utf-8")) and results["seed"] == 1
    assert results["tools"]["clipbox"]["cases"] == 1
