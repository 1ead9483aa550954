"""Every command of the checkout starts and says what it does."""

import subprocess
import sys
from pathlib import Path

import pytest

import environment

COMMANDS = [
    path
    for folder in ("benchmarks", "docs", "scripts")
    for path in sorted((environment.ROOT / folder).glob("*.py"))
    if "command_line.run(main)" in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_it_starts_and_says_what_it_does(command: Path):
    outcome = subprocess.run([sys.executable, command, "--help"], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    assert "usage:" in outcome.stdout
