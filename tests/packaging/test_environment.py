"""Environments: created once, recreated when the lock changes or the creation was interrupted, never over other files."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from lib import environment

LOCK = next(lock for lock in environment.LOCKS if lock.python == sys.version_info[:2])
SCRIPT = """
import json, sys
from lib import environment
environment.ensure()
print(json.dumps({"prefix": sys.prefix, "arguments": sys.argv[1:]}))
sys.exit(7)
"""


pytestmark = pytest.mark.once


@pytest.fixture
def project(tmp_path) -> Path:
    """A minimal checkout: the script that creates environments, and a lock without packages."""
    root = tmp_path / "Ein Wald 樹"
    for path in (Path("scripts", "lib", "environment.py"), Path("addon", "core", "bundled_modules.py")):
        (root / path).parent.mkdir(parents=True)
        shutil.copy2(environment.ROOT / path, root / path)
    (root / "scripts" / "job.py").write_text(SCRIPT, encoding="utf-8")
    (root / "requirements").mkdir()
    (root / "requirements" / LOCK.path.name).write_text("# no packages\n", encoding="utf-8")
    return root


def run(project: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess:
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("FARFIELD_")}
    settings = {"FARFIELD_VENV": str(project / "Umgebungen"), "PYTHONUTF8": "1"} | variables
    command = [sys.executable, str(project / "scripts" / "job.py"), *arguments]
    return subprocess.run(command, capture_output=True, encoding="utf-8", env=inherited | settings, timeout=300, check=False)


def environment_folder(project: Path) -> Path:
    return project / "Umgebungen" / LOCK.name


def leave_unfinished(folder: Path) -> None:
    """Write what a creation leaves that was interrupted."""
    folder.mkdir(parents=True)
    (folder / environment.STAMP_FILE).write_text(environment.UNFINISHED)
    (folder / "partial").write_text("")


def test_a_valid_environment_is_used_as_it_is(project):
    folder, lock = environment_folder(project), project / "requirements" / LOCK.path.name
    venv.create(folder, with_pip=False)
    (folder / environment.STAMP_FILE).write_text(hashlib.sha256(lock.read_bytes()).hexdigest())
    user_file = folder / "note.txt"
    user_file.write_text("still here")
    outcome = run(project, "--out", "a folder/Füße.blend", "")
    assert outcome.returncode == 7, outcome.stderr
    assert user_file.exists(), "a valid environment is not recreated"
    result = json.loads(outcome.stdout)
    assert Path(result["prefix"]).resolve() == folder.resolve()
    assert result["arguments"] == ["--out", "a folder/Füße.blend", ""]


@pytest.mark.slow
@pytest.mark.parametrize("stamp", ["old", pytest.param(environment.UNFINISHED, marks=pytest.mark.exhaustive)])
def test_an_environment_without_its_packages_is_created_again_and_removed_if_that_fails(project, stamp):
    folder, lock = environment_folder(project), project / "requirements" / LOCK.path.name
    leave_unfinished(folder)
    (folder / environment.STAMP_FILE).write_text(stamp)
    lock.write_text("colorama==0.4.6 --hash=sha256:" + "0" * 64 + "\n", encoding="utf-8")
    outcome = run(project, PIP_NO_INDEX="1", PIP_FIND_LINKS=str(project))
    assert outcome.returncode == 2 and "could not be installed" in outcome.stderr
    assert not folder.exists(), "an environment without its packages is removed"


@pytest.mark.slow
@pytest.mark.exhaustive
def test_an_interrupted_environment_is_created_again(project):
    folder = environment_folder(project)
    leave_unfinished(folder)
    assert run(project).returncode == 7
    assert not (folder / "partial").exists()
    assert (folder / environment.STAMP_FILE).read_text() == hashlib.sha256(
        (project / "requirements" / LOCK.path.name).read_bytes()
    ).hexdigest()


def test_a_folder_with_other_files_is_left_unchanged(project):
    environment_folder(project).mkdir(parents=True)
    (environment_folder(project) / "thesis.txt").write_text("years of work")
    outcome = run(project)
    assert outcome.returncode == 2
    assert "did not create" in outcome.stderr
    assert (environment_folder(project) / "thesis.txt").read_text() == "years of work"


def test_an_unknown_blender_version_is_rejected(project):
    outcome = run(project, FARFIELD_BPY="2.79")
    assert outcome.returncode == 2
    assert outcome.stderr.strip() == 'FARFIELD_BPY is "2.79"; it must be one of 4.5, 5.0, 5.2.'


def test_a_user_environment_with_all_packages_is_used(project):
    pytest.importorskip("bpy")
    outcome = run(project, FARFIELD_VENV="")
    assert Path(json.loads(outcome.stdout)["prefix"]) == Path(sys.prefix)


def test_a_python_of_another_version_is_never_used(monkeypatch):
    monkeypatch.setattr(environment, "_python_commands", lambda _: [[sys.executable]])
    assert environment.find_interpreter((2, 7)) is None


def test_locks_are_exact_hashed_and_agree_with_the_zip():
    bundled = pins(environment.ROOT / "requirements" / "wheels.txt")
    assert set(bundled) == {"scipy", "xatlas", "fast-simplification", "threadpoolctl", "tifffile", "pillow", "meshopt"}
    for lock in environment.LOCKS:
        versions = pins(lock.path)
        assert versions["bpy"].startswith(lock.blender + ".")
        assert set(versions) >= {"numpy", "pytest", "hypothesis", "ruff"}
        assert {name: versions[name] for name in bundled} == bundled


def pins(path: Path) -> dict[str, str]:
    """Return the versions by package of a lock file, after checking that every package has hashes and no URL."""
    versions = {}
    for entry in path.read_text(encoding="utf-8").replace("\\\n", " ").splitlines():
        if entry.startswith("#"):
            continue
        pin, *rest = entry.split()
        name, version = pin.split("==")
        hashes = [argument for argument in rest if argument.startswith("--hash=sha256:")]
        assert hashes and all(len(argument) == len("--hash=sha256:") + 64 for argument in hashes), entry
        assert "://" not in entry and " @ " not in entry
        versions[name] = version
    return versions


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="other systems have no folder that nobody can write to")
def test_a_temporary_folder_that_cannot_be_written_to_is_not_handed_to_blender(tmp_path):
    code = "\n".join(
        [
            "import os, sys",
            f"sys.path.insert(0, {str(environment.ROOT / 'scripts')!r})",
            "from lib import environment",
            "environment.ensure(exits_on_signals=True)",
            "print(os.environ['TMPDIR'])",
        ]
    )
    for folder in ("/proc", str(tmp_path)):
        variables = {name: value for name, value in os.environ.items() if name not in ("TEMP", "TMP")} | {"TMPDIR": folder}
        outcome = subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True, check=True)
        assert (outcome.stdout.strip() == folder) == (folder == str(tmp_path))


@pytest.mark.skipif(os.name == "nt", reason="Windows sends no signals to one process")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_before_blender_is_imported_ends_the_script(name):
    """Blender prints exceptions of its add-ons and goes on, as this loop does with an exception of the default handler."""
    code = "\n".join(
        [
            "import sys, time",
            f"sys.path.insert(0, {str(environment.ROOT / 'scripts')!r})",
            "from lib import environment",
            "environment.ensure(exits_on_signals=True)",
            "print('ready', flush=True)",
            "while True:",
            "    try:",
            "        time.sleep(10)",
            "    except KeyboardInterrupt:",
            "        print('lost', flush=True)",
        ]
    )
    number = getattr(signal, name)
    inherited = signal.signal(number, signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL)
    try:
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    finally:
        signal.signal(number, inherited)
    with process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        assert (process.wait(20), process.stdout.read(), process.stderr.read()) == (130, "", "Cancelled.\n")
