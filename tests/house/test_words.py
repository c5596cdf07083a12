"""Plain English: constructions that a reader has to translate are counted, and their number only falls."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

import kreisel as kr
from support import ROOT

SOURCE = Path(kr.__file__).parent
PATTERNS = {  # what is counted: what to write in its place
    r"^(What|The same)\b": "the noun first",
    r"\b(those|that) of\b|\b(is|are) ones?\b": "the noun again",
    r"\bwhere (it|there|a|an|the|none|no|one|they) (is|are|has|have)\b|\bNone where\b": "if, when",
    r"(?:^|[.:;] )Of (?:a|such|what|these|those|this|them)\b": "the subject first",
    r"\bnumbers\b": "values, entries, coordinates, floats",
    r"(?<!half-)\bturns?\b": "rotates, rotation",
    r"\b(its|their|your|user's|one's) own\b": "separate, user-defined, or nothing",
    r"\b(takes|take)\b": "accepts, requires, needs",
    r"\bwhole\b": "complete, integer",
    r"\b(says|said|told)\b": "states, reports",
    r"\b(stands?|stood)\b": "is, is stored",
    r"\bbeside\b": "next to, in addition to",
    r"\b(alone|by itself|on its own)\b": "only, separately",
    r"(?<!there )\bis no (?!longer|more)\w": "is not a",
    r"\b(put back|goes on|go on|so many|as it is)\b": "projected, resumes, n, unchanged",
}
NOUNS = {r"\b[wW]hat (is|are|was|it|they|a|an|the|each|has)\b": "the noun: values, results, terms"}  # in code only
FILLERS = frozenset(
    "each everything found given here known less made more one other own part rest stuff such "
    "there thing this those what whole both".split()
)  # names that do not tell what they hold
NAMED_BY_USERS = {  # parameters and methods of the interface
    ("checkcases/catalogue.py", "given"),  # case.given()
    ("lab/brackets.py", "more"),  # kr.lab.lax(more=)
    ("runs/run_record.py", "what"),  # kr.cite(what)
}
OF_A_STEP = {  # the record `Part`: a function that kernels call in order
    ("graph/recording.py", "part"),
    ("kernels/adjoint.py", "part"),
    ("kernels/cpu.py", "part"),
    ("kernels/jax_numbers.py", "part"),
    ("kernels/large/forms.py", "part"),
}
ARCHIVES = {(f"{name}.py", "part") for name in ("storage/archive", "storage/run_archive", "sweeps/store")}  # NAME.part
CEILINGS = {"docs": 74, "messages": 26, "docstrings": 180, "benchmarks": 38}


def prose_of_page(text: str) -> list[str]:
    """The lines of a page outside code, comments and formulas."""
    text = re.sub(r"^```.*?^```|<!--.*?-->", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"`[^`]*`|\$[^$]*\$|\]\([^)]*\)", "", text)
    return [line for line in text.splitlines() if not line.startswith("    ")]


def words_of_code(text: str) -> tuple[list[str], list[str]]:
    """Docstrings and comments, and the other texts of a module, which are messages for the most part."""
    prose, messages, before = list[str](), list[str](), ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            prose.append(token.string.lstrip("# "))
        elif token.type == getattr(tokenize, "FSTRING_MIDDLE", None):  # from Python 3.12 on
            messages.append(re.sub(r"`[^`]*`", "", token.string))
        elif token.type == tokenize.STRING:
            content = re.sub(r"`[^`]*`|\{[^{}]*\}", "", token.string.strip("rbfRBF").strip("\"'"))
            (prose if token.string.endswith('"""') and before in "\n:" else messages).append(content)
        if token.type not in (tokenize.NL, tokenize.COMMENT, tokenize.INDENT, tokenize.DEDENT):
            before = token.string if token.type != tokenize.NEWLINE else "\n"
    return prose, messages


def counts(texts: list[str], patterns: dict[str, str] = PATTERNS) -> dict[str, int]:
    joined = "\n".join(texts)
    return {pattern: len(re.findall(pattern, joined, re.MULTILINE)) for pattern in patterns}


def fillers(text: str) -> set[str]:
    """The names among `FILLERS` that a module binds; the operand `other` of an operator is Python's convention."""
    tree = ast.parse(text)
    operators = [f for f in ast.walk(tree) if isinstance(f, ast.FunctionDef) and re.fullmatch(r"__\w+__", f.name)]
    operands = {id(x) for f in operators for x in ast.walk(f) if getattr(x, "arg", getattr(x, "id", "")) == "other"}
    names = set[str]()
    for node in ast.walk(tree):
        match node:
            case _ if id(node) in operands:
                pass
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                names.add(name)
            case ast.arg(arg=name) | ast.FunctionDef(name=name) | ast.ExceptHandler(name=str(name)):
                names.add(name)
    return {name for name in names if name.lstrip("_") in FILLERS}


@cache
def collected() -> dict[str, list[str]]:
    pages = [*(ROOT / "docs").glob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    pages = [page for page in pages if page.name not in ("verified.md", "changelog.md") and "registry" not in page.name]
    texts = {"docs": [line for page in pages for line in prose_of_page(page.read_text(encoding="utf-8"))]}
    code = [words_of_code(path.read_text(encoding="utf-8")) for path in SOURCE.rglob("*.py")]
    scripts = [words_of_code(path.read_text(encoding="utf-8")) for path in (ROOT / "benchmarks").rglob("*.py")]
    texts["benchmarks"] = [text for prose, _ in scripts for text in prose]
    texts["docstrings"] = [text for prose, _ in code for text in prose]
    texts["messages"] = [text for _, messages in code for text in messages if " " in text]
    return texts


@pytest.mark.parametrize("kind", CEILINGS)
def test_constructions_that_need_a_second_reading_only_fall(kind: str) -> None:
    patterns = PATTERNS if kind == "docs" else PATTERNS | NOUNS
    number = counts(collected()[kind], patterns)
    total = sum(number.values())
    listed = "\n".join(f"{count:5} {pattern}  ->  {patterns[pattern]}" for pattern, count in number.items())
    assert total <= CEILINGS[kind], f"{kind}: {total}, {CEILINGS[kind]} allowed. Rewrite some of\n{listed}"
    assert total > 0.9 * CEILINGS[kind] - 10, f"{kind}: lower the ceiling to {total}"


def test_the_patterns_are_seen_outside_code_only() -> None:
    page = "Of a run it takes the whole.\n\n```python\ntakes = whole\n```\n\n    takes whole\n\n"
    page += "`takes` says $whole$ [a](takes)\n"
    assert sum(counts(prose_of_page(page)).values()) == 4
    prose, messages = words_of_code('"""The same run."""\nx = f"it says {x!r} beside"  # what stands here\n')
    assert [sum(counts(texts).values()) for texts in (prose, messages)] == [2, 2]


def test_names_tell_what_they_hold() -> None:
    """A name is a noun of the field, so that a line can be read without the lines above."""
    bound = {
        (path.relative_to(SOURCE).as_posix(), name)
        for path in SOURCE.rglob("*.py")
        for name in fillers(path.read_text(encoding="utf-8"))
    }
    allowed = NAMED_BY_USERS | OF_A_STEP | ARCHIVES
    assert not bound - allowed, f"rename to what it holds: {sorted(bound - allowed)}"
    assert not allowed - bound, f"no longer bound, delete them from the list: {sorted(allowed - bound)}"


BINDINGS = (
    "{} = 1|{}: int = 1|self.{} = 1|for {} in x: pass|[x for {} in y]|with x as {}: pass|if {} := x: pass|"
    "def f({}): pass|def f(**{}): pass|def {}(): pass|lambda {}: x|class A:\n    {}: int"
)


@pytest.mark.parametrize("text", BINDINGS.split("|"))
def test_a_binding_of_a_filler_is_seen(text: str) -> None:
    for name in FILLERS:
        assert fillers(text.format(name)) == {name} and fillers(text.format(f"_{name}")) == {f"_{name}"}
    assert fillers(text.format("state")) == set()
    assert fillers("def __eq__(self, other): other = f(other); return self.x == other") == set()
