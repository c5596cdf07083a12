"""Styles of figures: one for screens, which the page has too, light or dark, and one for journals.

The first is colour-blind-safe (Okabe and Ito), with vector-friendly fonts; the second is 183 mm wide, 8 points,
a serif face, with fonts kept as TrueType in PDF.

The colours are in the order of use.  On dark paper blue is lightened and black becomes white; every colour has a
contrast of at least 2.1 to its paper (lines), the ink of text 12.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from kreisel.errors import require_one_of


@dataclass(frozen=True)
class Theme:
    """Colours of a figure: text and frames, paper, grid, background lines, and series in order."""

    ink: str
    paper: str
    grid: str
    faint: str
    colours: tuple[str, ...]
    sequence: str  # a colour map of even lightness that begins near the paper
    extra: tuple[tuple[str, Any], ...] = ()  # settings of matplotlib for a style

    def colour(self, number: int) -> str:
        """The colour of a series, from 0 on; after the last, the first again."""
        return self.colours[number % len(self.colours)]

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
            **dict(self.extra),
        }


SHAPE: dict[str, Any] = {
    **dict.fromkeys(("font.size", "axes.labelsize"), 9),
    **dict.fromkeys(("legend.fontsize", "xtick.labelsize", "ytick.labelsize"), 8),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right", "legend.frameon"), False),
    **{"axes.titlesize": 10, "axes.linewidth": 0.7, "grid.linewidth": 0.5, "lines.linewidth": 1.0, "axes.grid": True},
    **{"figure.dpi": 120, "savefig.dpi": 200, "svg.fonttype": "none"},
}
LIGHT = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"
DARK = "#56B4E9", "#E69F00", "#009E73", "#CC79A7", "#F0E442", "#D55E00", "#ffffff"
THEMES = {
    "light": Theme("#111111", "#ffffff", "#d8d8d8", "#8a8a8a", LIGHT, "Blues"),
    "dark": Theme("#f0f0f0", "#16181d", "#3a3e46", "#8f949c", DARK, "cividis"),
}
STYLES: dict[str, dict[str, Any]] = {
    "house": {},
    "journal": {
        "font.family": ["STIXGeneral", "DejaVu Serif"],  # by name: the figure may be saved in another style
        "mathtext.fontset": "stix",
        **dict.fromkeys(("font.size", "axes.titlesize", "axes.labelsize", "figure.titlesize"), 8),
        **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 7),
        **dict.fromkeys(("xtick.direction", "ytick.direction"), "in"),
        **{"axes.grid": False, "axes.spines.top": True, "axes.spines.right": True, "axes.linewidth": 0.5},
        **{"savefig.dpi": 600, "pdf.fonttype": 42, "ps.fonttype": 42},
    },
}
WIDTHS = {"house": 9.2, "journal": 183 / 25.4}  # inches


def theme_of(name: str, style: str = "house") -> Theme:
    """The theme "light" or "dark" in the style "house" or "journal".  Raises `InputError`."""
    require_one_of(THEMES, name, "theme")
    require_one_of(STYLES, style, "style")
    return replace(THEMES[name], extra=tuple(STYLES[style].items()))
