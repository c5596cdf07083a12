"""The reference of the command line: what each command prints of itself."""

from __future__ import annotations

import os
import re
from pathlib import Path

import typer
from typer.testing import CliRunner

from kreisel.cli import app

WIDTH = 92  # columns of a block of code on the page


def write(docs: Path) -> None:
    """generated/commands.md, which cli.md includes."""
    os.environ["COLUMNS"] = str(WIDTH)  # read when Rich first asks for it
    parts = []
    for name, command in typer.main.get_command(app).commands.items():
        if not command.hidden:
            parts.append(f"## kreisel {name}\n\n```text\n{_help(name)}\n```")
    (docs / "generated").mkdir(exist_ok=True)
    (docs / "generated" / "commands.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def _help(name: str) -> str:
    shown = CliRunner().invoke(app, [name, "--help"], env={"NO_COLOR": "1", "TERM": "dumb"}, prog_name="kreisel")
    if shown.exit_code:
        raise RuntimeError(shown.output)
    text = re.sub(r"\x1b\[[0-9;]*m", "", shown.stdout)
    return "\n".join(line.rstrip() for line in text.strip("\n").splitlines())
