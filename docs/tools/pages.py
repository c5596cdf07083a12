"""What `make docs` does before Sphinx: execute the code on the pages, compare what it prints, generate pages.

    python docs/tools/pages.py [PAGE ...]

The blocks ```python of a page are one script, run in an empty folder with warnings as errors.  A block ```text right
after one shows what it prints; numbers there may differ in the sixth digit, and at round-off (1e-9) altogether.
A comment <!-- python ... --> is run and not shown; <!-- not run: WHY --> before a block leaves it out.
Pictures and .html that a page saves go to generated/figures/PAGE-NAME and can be shown from there; NAME.live.html goes
to live/ of the site.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import multiprocessing
import os
import re
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).parent.parent
FIGURES, LIVE = DOCS / "generated" / "figures", DOCS / "generated" / "extra" / "live"
FENCE = re.compile(r"^(?:```|<!-- )(\w+)\n(.*?)^(?:```|-->)$", re.MULTILINE | re.DOTALL)
SKIPPED = re.compile(r"<!-- not run: \S.*? -->\s*\Z")
NUMBER = re.compile(r"[-+]?\d[\d,_]*\.?\d*(?:[eE][-+]?\d+)?")
RELATIVE, ROUNDOFF = 1e-5, 1e-9


@dataclass(frozen=True)
class Block:
    """Python code of a page, the line where it begins, and what it is said to print (None: nothing is shown)."""

    code: str
    line: int
    shown: str | None


def blocks(text: str) -> list[Block]:
    """The executed blocks of a page."""
    fences = list(FENCE.finditer(text))
    out = []
    for here, after in itertools.pairwise([*fences, None]):
        if here[1] != "python" or SKIPPED.search(text[: here.start()]):
            continue
        follows = after is not None and after[1] == "text" and not text[here.end() : after.start()].strip()
        out.append(Block(here[2], text[: here.start()].count("\n") + 2, after[2] if follows else None))
    return out


def same(printed: str, shown: str) -> bool:
    """Whether two texts are the same but for spaces, last digits of numbers, and what is round-off."""

    def parts(text: str) -> tuple[list[str], list[float]]:
        return NUMBER.sub("#", text).split(), [float(n.replace(",", "").replace("_", "")) for n in NUMBER.findall(text)]

    (words, numbers), (others, claimed) = parts(printed), parts(shown)
    close = (abs(x - y) <= max(RELATIVE * abs(y), ROUNDOFF) for x, y in zip(numbers, claimed, strict=False))
    return words == others and len(numbers) == len(claimed) and all(close)


def execute(page: Path) -> list[str]:
    """Run the code of a page; the complaints."""
    os.environ.setdefault("MPLBACKEND", "agg")
    found = blocks(page.read_text(encoding="utf-8"))
    names: dict[str, object] = {"__name__": "__main__"}
    complaints = []
    with tempfile.TemporaryDirectory() as scratch, contextlib.chdir(scratch), warnings.catch_warnings():
        warnings.simplefilter("error")
        for block in found:
            printed = io.StringIO()
            try:
                with contextlib.redirect_stdout(printed):
                    code = compile("\n" * (block.line - 1) + block.code, str(page), "exec")
                    exec(code, names)
            except Exception:
                complaints.append(f"{page}:{block.line}: {traceback.format_exc(limit=-2)}")
                break
            if block.shown is not None and not same(printed.getvalue(), block.shown):
                complaints.append(
                    f"{page}:{block.line}: it prints\n{printed.getvalue()}but the page says\n{block.shown}"
                )
        for made in sorted(p for kind in ("*.png", "*.html") for p in Path(scratch).glob(kind)):
            live = made.name.endswith(".live.html")
            target = LIVE / made.name if live else FIGURES / f"{page.stem}-{made.name}"
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(made, target)
    return complaints


def task(name: str) -> tuple[str, float, list[str]]:
    """One piece of work, by name: a page, or a generator of pages."""
    begun = time.perf_counter()
    try:
        if name.endswith(".md"):
            message = execute(Path(name))
        else:
            __import__(name).write(DOCS)
            message = []
    except Exception:
        message = [f"{name}: {traceback.format_exc()}"]
    return name, time.perf_counter() - begun, message


def main(asked: list[str]) -> int:
    """Do all, two pieces at a time; the exit code."""
    pages = sorted(str(page) for page in DOCS.glob("*.md") if blocks(page.read_text(encoding="utf-8")))
    work = asked or ["systems", "methods", "gallery", "performance", "playground", *pages]
    if not asked:
        shutil.rmtree(DOCS / "generated", ignore_errors=True)
    failed = False
    with multiprocessing.get_context("spawn").Pool(2, maxtasksperchild=1) as pool:
        for name, seconds, complaints in pool.imap_unordered(task, work):
            print(f"{seconds:6.1f} s  {name}", flush=True)
            failed |= bool(complaints)
            print("".join(complaints), end="", file=sys.stderr, flush=True)
        if not asked and not failed:  # with the pictures that the pages have made
            _, _, complaints = pool.apply(task, ("notebooks",))
            failed |= bool(complaints)
            print("".join(complaints), end="", file=sys.stderr, flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
