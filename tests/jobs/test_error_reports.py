"""Errors of operators become one sentence: bad input as it is, missing memory, and defects with the place of their log."""

import re
from pathlib import Path

import pytest

from farfield.addon.core.errors import Cancelled, GeometryError
from farfield.addon.core.messages import single_line
from farfield.addon.operators.error_reports import report_message, reports_errors


class Operator:
    """Has the parts of a Blender operator that reports use."""

    bl_label = "Build Something"

    def __init__(self, error: Exception | None = None) -> None:
        self.error = error
        self.reports: list[tuple[set[str], str]] = []

    def report(self, types: set[str], message: str) -> None:
        self.reports.append((types, message))

    @reports_errors
    def execute(self, context) -> set[str]:
        if self.error is not None:
            raise self.error
        return {"FINISHED"}

    @reports_errors
    def invoke(self, context, event) -> set[str]:
        return self.execute(context)


def run(error: Exception | None) -> tuple[set[str], list[tuple[set[str], str]]]:
    operator = Operator(error)
    return operator.invoke(None, None), operator.reports


def test_without_an_error_nothing_is_reported():
    assert run(None) == ({"FINISHED"}, [])


def test_blender_sees_the_arguments_that_it_passes():
    assert Operator.execute.__code__.co_argcount == 2 and Operator.invoke.__code__.co_argcount == 3


def test_bad_input_is_reported_as_it_is():
    assert run(GeometryError("No faces; add some.")) == ({"CANCELLED"}, [({"ERROR"}, "No faces; add some.")])


@pytest.mark.parametrize("character", ["\n", "\r", "\t", "\v", "\f", "\0", "\x1b", "\x7f", "\x85", "\u2028", "\u2029"])
def test_names_do_not_break_lines(character):
    text = f'"a{character}樹" has no faces.'
    assert single_line(text) == '"a 樹" has no faces.'
    assert run(GeometryError(text))[1] == [({"ERROR"}, '"a 樹" has no faces.')]
    operator = Operator()
    report_message(operator, text, "WARNING")
    assert operator.reports == [({"WARNING"}, '"a 樹" has no faces.')]


def test_bytes_that_are_no_text_can_be_reported():
    """Blender and Python both return names that are not UTF-8 with lone surrogates, which cannot be encoded."""
    name = b"h\xe9".decode(errors="surrogateescape")
    _, [(_, message)] = run(GeometryError(f'"{name}" has no faces.'))
    assert message.encode() == '"h\ufffd" has no faces.'.encode()
    assert single_line("樹 🌲 \u202e %s") == "樹 🌲 \u202e %s"


def test_cancelling_is_not_an_error():
    assert run(Cancelled("Cancelled; nothing was changed.")) == ({"CANCELLED"}, [({"INFO"}, "Cancelled; nothing was changed.")])


def test_missing_memory_is_bad_input():
    _, [(types, message)] = run(MemoryError())
    assert types == {"ERROR"} and "memory" in message and "defect" not in message


def test_a_missing_wheel_is_named():
    """Blender of a Linux distribution may have a Python for which the zip has none."""
    _, [(types, message)] = run(ModuleNotFoundError("No module named 'PIL'", name="PIL"))
    assert types == {"ERROR"} and "needs the module PIL" in message and "defect" not in message
    _, [(_, message)] = run(ModuleNotFoundError("No module named 'x'", name="x"))
    assert "defect" in message


@pytest.mark.parametrize("error", [ZeroDivisionError("division\nby zero"), KeyError("name"), RuntimeError()])
def test_a_defect_is_one_sentence_and_its_log_has_the_traceback(error):
    result, [(types, message)] = run(error)
    assert result == {"CANCELLED"} and types == {"ERROR"}
    assert "defect" in message and "\n" not in message and "Build Something" in message
    log = Path(re.search(r'"([^"]+\.log)"', message)[1])
    content = log.read_text(encoding="utf-8")
    assert "Traceback" in content and type(error).__name__ in content and "Blender" in content
    log.unlink()
