"""What a run says about missing programs before its first test."""

from programs import INSTALLERS, PROGRAMS, TESTS, Program, describe_missing


def test_a_missing_program_is_named_with_its_tests_and_one_command(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: "/usr/bin/dnf" if name == "dnf" else None)
    programs = [program._replace(find=lambda: None) for program in PROGRAMS]
    lines = list(describe_missing([TESTS], programs))
    assert [program.name in line for program, line in zip(programs, lines, strict=True)] == [True] * 4
    assert "test_page_in_browser.py" in lines[0] and lines[0].endswith("To run them: sudo dnf install chromium")
    assert "javascript" in lines[1] and lines[1].endswith("sudo dnf install nodejs")
    assert "test_site.py" in lines[3] and lines[3].endswith("python3 scripts/build_docs.py")
    assert "test_flip.py" in lines[2] and lines[2].endswith("python3 scripts/reference_tools.py")


def test_nothing_is_said_of_programs_that_exist_or_that_no_chosen_test_needs():
    missing, found = (Program("A", lambda result=result: result, "describe_missing", 1, "") for result in (None, "/bin/a"))
    assert list(describe_missing([TESTS], [found])) == []
    assert list(describe_missing([TESTS / "geometry"], [missing])) == []
    assert len(list(describe_missing([TESTS / "scripts"], [missing]))) == 1


def test_without_a_package_manager_the_program_is_named(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda _: None)
    assert PROGRAMS[0].installation().startswith("install Chromium")
    assert {len(names) for names in INSTALLERS.values()} == {3}
