"""A worker without Blender runs a module of the extension in a process of its own, and passes on its exit code or error."""

import json
import subprocess
import sys

import pytest

from farfield.addon.core.jobs.core_worker import ERROR_KEY, EXIT_ERROR, EXIT_EXCEPTION, core_command

MODULE = "tests.jobs.sample_tasks"


def run(*arguments: str, module: str = MODULE) -> subprocess.CompletedProcess:
    return subprocess.run(core_command(module, list(arguments)), capture_output=True, text=True, encoding="utf-8", check=False)


@pytest.mark.parametrize("code", [0, 7])
def test_arguments_and_exit_code_are_passed_on(code):
    outcome = run(str(code), "--flag", 'two "words"', "")
    assert (outcome.returncode, outcome.stdout, outcome.stderr) == (code, '--flag two "words" \n', "")


def test_an_error_is_a_line_on_stderr():
    outcome = run("error")
    assert outcome.returncode == EXIT_ERROR
    assert json.loads(outcome.stderr) == {ERROR_KEY: "Kein Platz für „alle“."}


def test_another_exception_prints_its_traceback():
    outcome = run(module="addon.core.no_such_module")
    assert outcome.returncode == EXIT_EXCEPTION and "ModuleNotFoundError" in outcome.stderr.splitlines()[-1]


def test_packages_of_the_extension_are_found_where_python_has_none(tmp_path):
    """Blender's own Python has no folder of its extensions."""
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "only_there.py").write_text("")
    program, *flags, script, module, folders, _ = core_command(MODULE, [""])
    assert json.loads(folders)
    probe = ["-c", f"import sys; sys.argv = {[script, module, json.dumps([str(folder)]), '0']!r}; import runpy\n"]
    probe[1] += f"try: runpy.run_path({script!r}, run_name='__main__')\nexcept SystemExit: import only_there; print(sys.path[-1])"
    outcome = subprocess.run([program, *flags, *probe], capture_output=True, text=True, check=False)
    assert outcome.stdout.splitlines()[-1] == str(folder), outcome.stderr


def test_no_module_beside_the_script_hides_another_one():
    program, *flags, script, _, _ = core_command(MODULE, [])
    assert program == sys.executable and script.endswith("core_worker_start.py") and "-P" in flags
