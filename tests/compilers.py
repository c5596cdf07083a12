"""Programs of other languages, compiled and run."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

STRICT = ["-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"]
COMMANDS = {  # {} is the source; what is run then, unless the first command runs it
    "gcc": (["gcc", "-std=c99", *STRICT, "{}", "-o", "main", "-lm"], ["./main"]),
    "clang": (["clang", "-std=c99", *STRICT, "{}", "-o", "main", "-lm"], ["./main"]),
    "g++": (["g++", "-std=c++17", *STRICT, "{}", "-o", "main"], ["./main"]),
    "rustc": (["rustc", "--edition=2021", "-O", "-D", "warnings", "{}", "-o", "main"], ["./main"]),
    "mcs": (["mcs", "-warnaserror", "-optimize+", "-out:main.exe", "{}"], ["mono", "main.exe"]),
    "node": (["node", "{}"], []),
}


def program(name: str) -> str:
    """Its path; the test is skipped without it."""
    found = shutil.which(name) or shutil.which(name, path=str(Path.home() / ".cargo" / "bin"))
    if found is None and name == "node":
        pytest.skip("no Node")
    if found is None:
        pytest.skip(f"no compiler: {name}")
    return found


def output(compiler: str, folder: Path, source: str, *arguments: str) -> str:
    """What the program of a source file in a folder prints."""
    text = ""
    compiling, running = COMMANDS[compiler]
    for command in (compiling, [*running, *arguments]) if running else ([*compiling, *arguments],):
        words = [word.replace("{}", source) for word in command]
        words[0] = words[0] if words[0].startswith("./") else program(words[0])
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        text = done.stdout
    return text
