"""Logs of defects."""

import os
import stat
import tempfile

from farfield.addon.core.files.defect_log import defect_message, write_defect_log


def failure():
    """An error with a traceback and a message of two lines."""
    try:
        raise KeyError("first\nsecond")
    except KeyError as error:
        return error


def test_the_log_has_the_traceback_and_is_private():
    log = write_defect_log("Bake/Textures", failure(), ["Blender 5.0"])
    text = log.read_text(encoding="utf-8")
    assert "Traceback" in text and "Blender 5.0" in text and "in failure" in text and "Bake/Textures" in text
    assert os.name == "nt" or stat.S_IMODE(log.stat().st_mode) == 0o600
    log.unlink()


def test_the_message_is_one_sentence():
    error = failure()
    log = write_defect_log("x.py", error)
    message = defect_message("x.py", error, log)
    assert "defect" in message and str(log) in message and "\n" not in message and message.endswith(".")
    log.unlink()


def test_without_a_place_for_the_log(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    error = failure()
    assert write_defect_log("x.py", error) is None
    assert "could not be written" in defect_message("x.py", error, None)
