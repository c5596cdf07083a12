"""One style for all figures and the page: colour-blind-safe (Okabe and Ito), light or dark, vector-friendly fonts.

The order of the colours is that of use.  On dark paper blue is lightened and black becomes white; every colour has a
contrast of at least 2.1 to its paper (lines), the ink of text 12.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from kreisel.errors import InputError, hint, shown


@dataclass(frozen=True)
class Theme:
    """Colours of a figure: text and frames, paper, grid, background lines, and series in order."""

    ink: str
    paper: str
    grid: str
    faint: str
    colours: tuple[str, ...]
    sequence: str  # a colour map of even lightness that begins near the paper

    @property
    def rc(self) -> dict[str, Any]:
        """Settings of matplotlib."""
        from cycler import cycler

        inks = ("axes.edgecolor", "axes.labelcolor", "text.color", "xtick.color", "ytick.color")
        papers = ("figure.facecolor", "axes.facecolor", "savefig.facecolor")
        return {
            **SHAPE,
            **dict.fromkeys(inks, self.ink),
            **dict.fromkeys(papers, self.paper),
            "grid.color": self.grid,
            "axes.prop_cycle": cycler(color=self.colours),
            "image.cmap": self.sequence,
        }


SHAPE: dict[str, Any] = {
    "figure.dpi": 120,
    "savefig.dpi": 200,
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.labelsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.0,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "svg.fonttype": "none",
}
THEMES = {
    "light": Theme(
        ink="#111111",
        paper="#ffffff",
        grid="#d8d8d8",
        faint="#8a8a8a",
        colours=("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"),
        sequence="Blues",
    ),
    "dark": Theme(
        ink="#f0f0f0",
        paper="#16181d",
        grid="#3a3e46",
        faint="#8f949c",
        colours=("#56B4E9", "#E69F00", "#009E73", "#CC79A7", "#F0E442", "#D55E00", "#ffffff"),
        sequence="cividis",
    ),
}


def theme_of(name: str) -> Theme:
    """The theme "light" or "dark".  Raises `InputError`."""
    if not isinstance(name, str) or name not in THEMES:
        raise InputError(f"theme must be {' or '.join(map(repr, THEMES))}, got {shown(name)}.{hint(name, THEMES)}")
    return THEMES[name]
