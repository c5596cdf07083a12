"""The gallery: for each script in examples/gallery its docstring, its code and the picture that it writes.

The pictures are those in out/gallery, where `make examples` leaves them; one that is missing or older than its script
is made here.
"""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

INTRODUCTION = """# Gallery

Each picture is made by one script of `examples/gallery`, which runs as it stands."""


def write(docs: Path) -> None:
    """generated/gallery/*.md with pictures."""
    root = docs.resolve().parent
    scripts = sorted((root / "examples" / "gallery").glob("[!_]*.py"))
    folder = docs / "generated" / "gallery"
    if not scripts:
        return
    folder.mkdir(parents=True, exist_ok=True)
    cards, names = [], []
    for script in scripts:
        picture = _picture(script, root / "out" / "gallery")
        shutil.copyfile(picture, folder / picture.name)
        source = script.read_text(encoding="utf-8")
        title, _, rest = (ast.get_docstring(ast.parse(source)) or script.stem).partition("\n")
        title = title.rstrip(".")
        code = source.split('"""', 2)[2].lstrip() if source.startswith('"""') else source
        page = f"# {title}\n\n{rest.strip()}\n\n![{title}]({picture.name})\n\n`examples/gallery/{script.name}`\n\n"
        (folder / f"{script.stem}.md").write_text(f"{page}```python\n{code}```\n", encoding="utf-8")
        cards.append(f":::{{figure}} {picture.name}\n:target: {script.stem}.html\n:alt: {title}\n\n{title}\n:::")
        names.append(script.stem)
    cells = "\n\n".join(cards)
    entries = "\n".join(names)
    (folder / "index.md").write_text(
        f"{INTRODUCTION}\n\n::::{{container}} gallery\n{cells}\n::::\n\n```{{toctree}}\n:hidden:\n\n{entries}\n```\n",
        encoding="utf-8",
    )


def _picture(script: Path, out: Path) -> Path:
    """The one picture of a script."""
    out.mkdir(parents=True, exist_ok=True)
    picture = out / f"{script.stem}.png"
    if not picture.exists() or picture.stat().st_mtime < script.stat().st_mtime:
        environment = {**os.environ, "MPLBACKEND": "agg"}
        subprocess.run([sys.executable, str(script)], cwd=out, check=True, env=environment, stdout=subprocess.DEVNULL)
    return picture
