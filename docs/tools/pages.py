"""What `make docs` does before Sphinx: execute the code on the pages, compare what it prints, generate pages.

    python docs/tools/pages.py [--again] [NAME ...]

The blocks ```python of a page are one script, run in an empty folder with warnings as errors.  A block ```text right
after one shows what it prints; numbers there may differ in the sixth digit, and at round-off (1e-9) altogether.
A comment <!-- python ... --> is run and not shown; <!-- not run: WHY --> before a block leaves it out.
Pictures and .html that a page saves go to generated/figures/PAGE-NAME and can be shown from there; NAME.live.html goes
to live/ of the site.

Each piece of work (a page, a system, a generator) runs in a process of its own, forked from one that has imported the
libraries.  What was made from the same page by the same sources and versions is not made again: see `key`.  In a fresh
clone, as in CI, all of it runs; `--again` runs all of it anywhere.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import importlib.metadata
import io
import itertools
import json
import multiprocessing
import os
import re
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

DOCS = Path(__file__).parent.parent
MADE = DOCS / "generated"
FIGURES, LIVE, DONE = MADE / "figures", MADE / "extra" / "live", MADE / "done.json"
GENERATORS = ("methods", "gallery", "performance", "playground", "commands", "checkcases", "engines")
LONG = {
    name: 10.0 for name in ("rebound.md", "tutorial-lagrangian.md", "spin-chains.md", "guide-disc.md", "reduction.md")
}
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


def task(name: str) -> tuple[str, float, float, list[str]]:
    """One piece of work, by name: a page, a system or a generator; clock and processor seconds, complaints."""
    begun, used = time.perf_counter(), _processor()
    try:
        if name.endswith(".md"):
            message = execute(DOCS / name)
        else:
            module, _, part = name.partition("/")
            __import__(module).write(DOCS, *([part] if part else []))
            message = []
    except Exception:
        message = [f"{name}: {traceback.format_exc()}"]
    return name, time.perf_counter() - begun, _processor() - used, message


def _processor() -> float:
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in usage)


@cache
def _sources() -> str:
    """A hash of the package, of what makes pages, and of the versions of what is installed."""
    root = DOCS.resolve().parent
    folders = ("src/kreisel", "docs/tools", "docs/gallery", "docs/static", "examples/gallery")
    folders += ("benchmarks/results", "benchmarks/engines")
    files = sorted(p for folder in folders for p in (root / folder).rglob("*") if p.is_file() and p.suffix != ".pyc")
    files += [root / "benchmarks" / name for name in ("tables.py", "history.py", "history.jsonl")]
    versions = sorted(f"{each.name} {each.version}" for each in importlib.metadata.distributions())
    found = hashlib.sha256(repr((sys.version, versions)).encode())
    for file in files:
        found.update(repr((str(file.relative_to(root)), hashlib.sha256(file.read_bytes()).hexdigest())).encode())
    return found.hexdigest()


def key(name: str) -> str:
    """What the outcome of a piece of work depends on, hashed."""
    text = (DOCS / name).read_bytes() if name.endswith(".md") else b""
    return hashlib.sha256(f"{_sources()} {name} ".encode() + text).hexdigest()


def everything() -> list[str]:
    """The names of all pieces of work."""
    from kreisel.system import REGISTRY

    pages = [page.name for page in sorted(DOCS.glob("*.md")) if blocks(page.read_text(encoding="utf-8"))]
    return [*(f"systems/{name}" for name in REGISTRY), "systems", *GENERATORS, *pages]


def do(work: Iterable[str], done: dict[str, list]) -> bool:
    """Do all, two pieces at a time, the longest first by what they took before; whether all is right."""
    context = multiprocessing.get_context("forkserver")
    here, others = str(Path(__file__).parent), os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(
        [here, others] if others else [here]
    )  # the server's own path is Python's
    context.set_forkserver_preload(["preload"])
    right = True
    keys = {name: key(name) for name in work}  # before: a page may be edited while others run
    order = sorted(keys, key=lambda name: -done.get(name, ["", LONG.get(name, 3.0)])[1])
    with context.Pool(2, maxtasksperchild=1) as pool:
        for name, seconds, processor, complaints in pool.imap_unordered(task, order):
            print(f"{seconds:6.1f} s  {processor:6.1f} s of processor  {name}", flush=True)
            print("".join(complaints), end="", file=sys.stderr, flush=True)
            done[name] = ["" if complaints else keys[name], processor]
            right &= not complaints
    MADE.mkdir(exist_ok=True)
    DONE.write_text(json.dumps(done), encoding="utf-8")
    return right


def main() -> int:
    """Do what is asked for, or what is not done yet; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--again", action="store_true", help="all of it, also what is there")
    parser.add_argument("names", nargs="*", help="pages and generators; all of them if none is named")
    options = parser.parse_args()
    os.environ.setdefault("MPLBACKEND", "agg")
    if options.again:
        shutil.rmtree(MADE, ignore_errors=True)
    done = json.loads(DONE.read_text(encoding="utf-8")) if DONE.is_file() else {}
    if options.names:
        return int(not do([Path(name).name if name.endswith(".md") else name for name in options.names], done))
    work = everything()
    if not set(done) <= set(work):  # a page is gone: what it made would stay
        shutil.rmtree(MADE, ignore_errors=True)
        done = {}
    right = do([name for name in work if done.get(name, [""])[0] != key(name)], done)
    if right:  # with the pictures that the pages have made
        __import__("notebooks").write(DOCS)
    return int(not right)


if __name__ == "__main__":
    sys.exit(main())
