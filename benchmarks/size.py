"""Size: lines of the source code by kind, and how much of it repeats.

    python benchmarks/size.py [FOLDER ...]      # other packages, for comparison

statements  lines if each statement, definition and import had one line, without docstrings, comments and blank lines
formatted   lines of these statements as the formatter writes them, at 120 columns and with the blank lines it asks for;
            with the docstrings, what no other way of writing the same statements goes below
repeated    lines of these in sequences of statements that occur twice, names, attributes and constants aside, and that
            a function would shorten; moving repetitions into functions saves fewer lines than this
nodes       of the syntax tree, without docstrings
compressed  bytes by LZMA of the code without docstrings and comments; code that repeats has few for a node
"""

from __future__ import annotations

import ast
import lzma
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from cases import parser, write

SOURCE = Path(__file__).parents[1] / "src" / "kreisel"
ROOMS = {"all": ["."], "graph, kernels, exact, languages": ["graph", "kernels", "exact", "languages"]}
ROOMS |= {"kernels/large": ["kernels/large"]}
DOCUMENTED = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef
MOST_STATEMENTS = 60  # of a sequence, at one level of indentation


def formatted(codes: Sequence[str]) -> list[str]:
    """Code as ruff formats it."""
    with tempfile.TemporaryDirectory() as folder:
        for number, code in enumerate(codes):
            Path(folder, f"f{number}.py").write_text(code + "\n", encoding="utf-8")
        command = sys.executable, "-m", "ruff", "format", "--quiet", "--isolated", "--line-length", "120", folder
        subprocess.run(command, check=True)
        return [file.read_text(encoding="utf-8") for file in sorted(Path(folder).iterdir())]


def structure(node: ast.AST) -> str:
    """A syntax tree without its names, attributes and constants."""
    return f"{type(node).__name__}({','.join(map(structure, ast.iter_child_nodes(node)))})"


def sequences(code: str) -> Iterator[tuple[tuple[int, ...], int, int]]:
    """The structures of all sequences of statements that follow each other, and their first and last lines."""
    for node in ast.walk(ast.parse(code)):
        for field in ("body", "orelse", "finalbody"):
            statements = getattr(node, field, None)
            if not isinstance(statements, list):  # of a lambda or a conditional expression
                continue
            statements = [s for s in statements if not isinstance(s, ast.Import | ast.ImportFrom)]
            structures = [hash(structure(s)) for s in statements]
            for start in range(len(statements)):
                for end in range(start + 1, min(start + MOST_STATEMENTS, len(statements)) + 1):
                    last = statements[end - 1]
                    yield tuple(structures[start:end]), statements[start].lineno, last.end_lineno or last.lineno


def repeated(codes: Sequence[str]) -> int:
    """Lines in sequences of equal structure, of which a function, called in each place, would leave fewer."""
    places = defaultdict(list)
    for number, code in enumerate(codes):
        for structures, first, last in sequences(code):
            places[structures, last - first + 1].append((number, first, last))
    lines = set()
    for (_, height), occurrences in places.items():
        if len(occurrences) * height > height + 1 + len(occurrences):  # one definition of its lines, a call in each
            lines |= {(number, line) for number, first, last in occurrences for line in range(first, last + 1)}
    return len(lines)


def size(folders: Sequence[Path]) -> dict[str, Any]:
    """Counts of the Python files in folders."""
    files = sorted(file for folder in folders for file in folder.rglob("*.py"))
    texts, codes, docstrings, nodes = [], [], 0, 0
    for file in files:
        texts.append(file.read_text(encoding="utf-8"))
        tree = ast.parse(texts[-1])
        for node in ast.walk(tree):
            if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
                first, *others = node.body
                docstrings += (first.end_lineno or first.lineno) - first.lineno + 1
                node.body = others or [ast.Pass()]
        nodes += sum(1 for _ in ast.walk(tree))
        codes.append(ast.unparse(tree))
    lines = [line.strip() for text in texts for line in text.splitlines()]
    layout = formatted(codes)
    compressed = len(lzma.compress("\n".join(codes).encode(), preset=9 | lzma.PRESET_EXTREME))
    return {
        "files": len(files),
        "lines": len(lines),
        "statements": sum(bool(line.strip()) for code in codes for line in code.splitlines()),
        "formatted": sum(len(code.splitlines()) for code in layout),
        "repeated": repeated(layout),
        "docstrings": docstrings,
        "blank": lines.count(""),
        "comments": sum(line.startswith("#") for line in lines),
        "nodes per line": round(nodes / len(lines), 2),
        "compressed bytes per line": round(compressed / len(lines), 2),
        "compressed bytes per node": round(compressed / nodes, 3),
    }


def main() -> None:
    options = parser(__doc__, "size")
    options.add_argument("folders", nargs="*", type=Path, help="packages to compare with")
    chosen = options.parse_args()
    result = {name: size([SOURCE / room for room in rooms]) for name, rooms in ROOMS.items()}
    result |= {folder.name: size([folder]) for folder in chosen.folders}
    if chosen.folders:
        result["these packages together"] = size(chosen.folders)
    for name, counts in result.items():
        print(f"\n{name}\n  " + ", ".join(f"{key} {count:,}" for key, count in counts.items()))
    write(result, chosen.output)


if __name__ == "__main__":
    main()
