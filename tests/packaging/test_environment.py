"""Environments: made once, made again when the lock changes or making was cut short, never over something else."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import environment

LOCK = next(lock for lock in environment.LOCKS if lock.python == sys.version_info[:2])
SCRIPT = """
import environment, json, sys
environment.ensure()
print(json.dumps({"prefix": sys.prefix, "arguments": sys.argv[1:]}))
sys.exit(7)
"""


@pytest.fixture
def project(tmp_path) -> Path:
    """A checkout in small: the script that makes environments, and a lock that asks for no package."""
    root = tmp_path / "Ein Wald 樹"
    (root / "scripts").mkdir(parents=True)
    shutil.copy2(environment.ROOT / "scripts" / "environment.py", root / "scripts")
    (root / "scripts" / "job.py").write_text(SCRIPT, encoding="utf-8")
    (root / "requirements").mkdir()
    (root / "requirements" / LOCK.path.name).write_text("# no packages\n", encoding="utf-8")
    return root


def run(project: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("FARFIELD_")}
    settings = {"FARFIELD_VENV": str(project / "Umgebungen"), "PYTHONUTF8": "1"} | variables
    command = [sys.executable, str(project / "scripts" / "job.py"), *arguments]
    return subprocess.run(command, capture_output=True, encoding="utf-8", env=clean | settings, timeout=300, check=False)


def standing(project: Path) -> Path:
    return project / "Umgebungen" / LOCK.name


@pytest.mark.slow
def test_a_script_restarts_in_its_environment_with_its_arguments(project):
    first = run(project, "--out", "a folder/Füße.blend", "")
    assert first.returncode == 7, first.stderr
    answer = json.loads(first.stdout)
    assert Path(answer["prefix"]).resolve() == standing(project).resolve()
    assert answer["arguments"] == ["--out", "a folder/Füße.blend", ""]

    left_by_user = standing(project) / "note.txt"
    left_by_user.write_text("still here")
    assert run(project).returncode == 7
    assert left_by_user.exists(), "an environment that stands is not made again"

    lock = project / "requirements" / LOCK.path.name
    lock.write_text("# still no packages\n", encoding="utf-8")
    assert run(project).returncode == 7
    assert not left_by_user.exists(), "a changed lock makes the environment again"
    assert (standing(project) / environment.STAMP).read_text() == hashlib.sha256(lock.read_bytes()).hexdigest()


@pytest.mark.slow
def test_an_environment_that_was_cut_short_is_made_again(project):
    standing(project).mkdir(parents=True)
    (standing(project) / environment.STAMP).write_text(environment.UNFINISHED)
    (standing(project) / "half").write_text("")
    assert run(project).returncode == 7
    assert not (standing(project) / "half").exists()


@pytest.mark.slow
def test_nothing_is_left_of_an_environment_whose_packages_cannot_be_had(project):
    lock = project / "requirements" / LOCK.path.name
    lock.write_text("colorama==0.4.6 --hash=sha256:" + "0" * 64 + "\n", encoding="utf-8")
    outcome = run(project, PIP_NO_INDEX="1", PIP_FIND_LINKS=str(project))
    assert outcome.returncode == 2
    assert "could not be installed" in outcome.stderr
    assert not standing(project).exists()


def test_a_folder_of_somebody_else_is_left_alone(project):
    standing(project).mkdir(parents=True)
    (standing(project) / "thesis.txt").write_text("years of work")
    outcome = run(project)
    assert outcome.returncode == 2
    assert "did not make" in outcome.stderr
    assert (standing(project) / "thesis.txt").read_text() == "years of work"


def test_an_unknown_blender_is_refused(project):
    outcome = run(project, FARFIELD_BPY="2.79")
    assert outcome.returncode == 2
    assert outcome.stderr.strip() == 'FARFIELD_BPY is "2.79"; it must be one of 4.5, 5.0, 5.2.'


def test_an_environment_that_holds_everything_is_used_as_it_is(project):
    pytest.importorskip("bpy")
    outcome = run(project, FARFIELD_VENV="")
    assert Path(json.loads(outcome.stdout)["prefix"]) == Path(sys.prefix)


def test_python_of_another_version_is_never_taken(monkeypatch):
    monkeypatch.setattr(environment, "_candidates", lambda _: [[sys.executable]])
    assert environment.interpreter((2, 7)) is None


def test_locks_are_exact_hashed_and_agree_on_what_the_zip_brings():
    zipped = pins(environment.ROOT / "requirements" / "wheels.txt")
    assert set(zipped) == {"scipy", "xatlas", "fast-simplification", "threadpoolctl", "tifffile"}
    for lock in environment.LOCKS:
        pinned = pins(lock.path)
        assert pinned["bpy"].startswith(lock.blender + ".")
        assert set(pinned) >= {"numpy", "pytest", "hypothesis", "ruff"}
        assert {name: pinned[name] for name in zipped} == zipped


def pins(path: Path) -> dict[str, str]:
    """Version by package of a lock file, after checking that each carries hashes and nothing but a name is given."""
    found = {}
    for entry in path.read_text(encoding="utf-8").replace("\\\n", " ").splitlines():
        if entry.startswith("#"):
            continue
        pin, *rest = entry.split()
        name, version = pin.split("==")
        hashes = [word for word in rest if word.startswith("--hash=sha256:")]
        assert hashes and all(len(word) == len("--hash=sha256:") + 64 for word in hashes), entry
        assert "://" not in entry and " @ " not in entry
        found[name] = version
    return found
