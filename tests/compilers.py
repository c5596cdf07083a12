"""Programs of other languages, compiled and run."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

STRICT = ["-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"]
COMMANDS = {  # what is run then, unless it runs the source itself
    "gcc": (["gcc", "-std=c99", *STRICT, "-o", "main"], ["-lm"], ["./main"]),
    "clang": (["clang", "-std=c99", *STRICT, "-o", "main"], ["-lm"], ["./main"]),
    "g++": (["g++", "-std=c++17", *STRICT, "-o", "main"], [], ["./main"]),
    "clang++": (["clang++", "-std=c++17", *STRICT, "-o", "main"], [], ["./main"]),
    "g++ for CUDA": (["g++", "-std=c++17", *STRICT, "-D__host__=", "-D__device__=", "-o", "main"], [], ["./main"]),
    "rustc": (["rustc", "--edition=2021", "-O", "-D", "warnings", "-o", "main"], [], ["./main"]),
    "mcs": (["mcs", "-warnaserror", "-optimize+", "-out:main.exe"], [], ["mono", "main.exe"]),
    "node": (["node"], [], []),
    "python": ([sys.executable], [], []),
    "julia": (["julia", "--startup-file=no"], [], []),
    "godot": (["godot", "--headless", "--no-header", "--quit-after", "1", "--script"], [], []),
}


def program(name: str) -> str:
    """Its path; the test is skipped without it."""
    found = shutil.which(name) or shutil.which(name, path=str(Path.home() / ".cargo" / "bin"))
    if found is None and name == "node":
        pytest.skip("no Node")
    if found is None:
        pytest.skip(f"no compiler: {name}")
    return found


def run(folder: Path, words: Sequence[str]) -> str:
    """What a program prints in a folder, which it has to leave with the status 0."""
    first = words[0] if words[0].startswith("./") else program(words[0])
    done = subprocess.run([first, *words[1:]], cwd=folder, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def output(compiler: str, folder: Path, *sources: str) -> str:
    """What the program of source files in a folder prints."""
    before, behind, then = COMMANDS[compiler]
    printed = run(folder, [*before, *sources, *behind])
    return run(folder, then) if then else printed


def syntax_errors(language: str, source: str) -> list[int]:
    """The lines that the grammar of a language does not read."""
    tree_sitter, grammar = pytest.importorskip("tree_sitter"), pytest.importorskip(f"tree_sitter_{language}")
    tree = tree_sitter.Parser(tree_sitter.Language(grammar.language())).parse(source.encode())
    found, todo = [], [tree.root_node]
    while todo:
        node = todo.pop()
        todo += node.children
        found += [node.start_point[0]] if node.type == "ERROR" or node.is_missing else []
    return found
