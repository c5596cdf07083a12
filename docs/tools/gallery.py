"""The gallery: for each script in examples/gallery its docstring, its code and the picture that it writes.

The pictures are those of docs/gallery, which `make gallery` makes by running every script in full (minutes).  One that
is missing is made here, by the script with KREISEL_SMALL set.

    python docs/tools/gallery.py [NAME ...]     # make gallery
"""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

INTRODUCTION = """# Gallery

Each picture comes from one script of `examples/gallery`, which you can run without changes.
`make gallery` runs them all."""

SUBJECTS = {
    "Tops and gyroscopes": (
        "nutation",
        "sleeping_top",
        "million_turns",
        "bicycle_wheel",
        "bearing_friction",
        "driven_top",
        "rotating_field",
    ),
    "Free bodies and satellites": (
        "tennis_racket",
        "free_bodies",
        "gravity_gradient",
        "satellite_to_rest",
        "hyperion",
        "fit_observations",
    ),
    "Bodies in fluids": ("dropped_disc", "kirchhoff_body", "compressible_fluid"),
    "Integrable systems": (
        "kovalevskaya_tori",
        "named_bodies",
        "neumann_caustics",
        "three_neumanns",
        "hess_appelrot",
        "quadratic_field",
        "moser_veselov",
        "lax_spectra",
    ),
    "Higher dimensions and chains": ("higher_dimensions", "bitop", "coupled_tops"),
    "Chaos, frequencies, ensembles": (
        "chaotic_section",
        "integrable_neighbours",
        "unequal_top",
        "frequency_map",
        "ensemble_density",
        "work_precision",
    ),
}


def write(docs: Path) -> None:
    """generated/gallery/*.md with pictures."""
    root = docs.resolve().parent
    scripts = sorted((root / "examples" / "gallery").glob("[!_]*.py"))
    folder = docs / "generated" / "gallery"
    if not scripts:
        return
    folder.mkdir(parents=True, exist_ok=True)
    cards = {}
    for script in scripts:
        picture = _picture(script, docs)
        shutil.copyfile(picture, folder / picture.name)
        source = script.read_text(encoding="utf-8")
        title, _, rest = (ast.get_docstring(ast.parse(source)) or script.stem).partition("\n")
        title = title.rstrip(".")
        code = source.split('"""', 2)[2].lstrip() if source.startswith('"""') else source
        page = f"# {title}\n\n{rest.strip()}\n\n![{title}]({picture.name})\n\n`examples/gallery/{script.name}`\n\n"
        (folder / f"{script.stem}.md").write_text(f"{page}```python\n{code}```\n", encoding="utf-8")
        card = f":::{{figure}} {picture.name}\n:target: {script.stem}.html\n:alt: {title}\n\n{title}\n:::"
        cards[script.stem] = card
    unsorted = set(cards) ^ {name for names in SUBJECTS.values() for name in names}
    if unsorted:
        raise ValueError(f"SUBJECTS and the scripts of the gallery differ in {', '.join(sorted(unsorted))}")
    text = [INTRODUCTION]
    for subject, names in SUBJECTS.items():
        cells = "\n\n".join(cards[name] for name in names)
        text.append(f"## {subject}\n\n::::{{container}} gallery\n{cells}\n::::")
    text.append(
        "```{toctree}\n:hidden:\n\n" + "\n".join(name for names in SUBJECTS.values() for name in names) + "\n```\n"
    )
    (folder / "index.md").write_text("\n\n".join(text), encoding="utf-8")


def _picture(script: Path, docs: Path) -> Path:
    """The one picture of a script."""
    picture = docs / "gallery" / f"{script.stem}.png"
    return (
        picture if picture.exists() else run(script, docs.resolve().parent / "out" / "gallery", {"KREISEL_SMALL": "1"})
    )


def run(script: Path, out: Path, environment: dict[str, str]) -> Path:
    """Run a script in a folder; its picture."""
    out.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "MPLBACKEND": "agg", **environment}
    subprocess.run([sys.executable, str(script)], cwd=out, check=True, env=environment, stdout=subprocess.DEVNULL)
    return out / f"{script.stem}.png"


WIDTH, COLOURS = 1200, 128


def keep(picture: Path, folder: Path) -> None:
    """A picture made small enough to be kept with the sources."""
    from PIL import Image

    image = Image.open(picture).convert("RGB")
    image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    folder.mkdir(exist_ok=True)
    image.quantize(COLOURS).save(folder / picture.name, optimize=True)


def main(names: list[str]) -> int:
    """Make the pictures of docs/gallery; how many scripts failed."""
    docs = Path(__file__).parent.parent
    root, failed = docs.resolve().parent, []
    for script in sorted((root / "examples" / "gallery").glob("[!_]*.py")):
        if names and script.stem not in names:
            continue
        begun = time.perf_counter()
        try:
            keep(run(script, root / "out" / "gallery", {}), docs / "gallery")
        except subprocess.CalledProcessError:  # it has said why
            failed.append(script.stem)
        state = "failed" if script.stem in failed else ""
        print(f"{time.perf_counter() - begun:6.1f} s  {script.stem}  {state}", flush=True)
    return len(failed)


if __name__ == "__main__":
    sys.exit(min(1, main(sys.argv[1:])))
