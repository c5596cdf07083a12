"""Figures of the analyses, and the style: readable on both papers, apart for the colour-blind."""

from __future__ import annotations

import re

import numpy as np
import pytest

import kreisel as kr
from kreisel import analysis
from kreisel.lab import exact
from kreisel.system import REGISTRY
from kreisel.viewer import charts
from kreisel.viewer.style import THEMES
from support import ROOT

PLANES = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


@pytest.fixture(scope="module")
def run():
    top = kr.LagrangeTop(p=(0, 0, 1))
    return kr.simulate(top, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, dt=0.05, steps=2000, progress=False)


def drawn(figure):
    """All that is drawn, as arrays x, y."""
    return [np.array(line.get_xydata(), dtype=float) for axes in figure.axes for line in axes.lines]


@pytest.mark.parametrize("theme", THEMES)
def test_every_analysis_has_its_figure(run, theme, tmp_path):
    found = analysis.events(run, "a[2]", 0.5)
    cut = analysis.section(run, "a[2]", 0.5)
    other = kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, dt=0.1, steps=1000)
    figures = {
        "series": charts.plot_series(analysis.rates(run), theme=theme),
        "events": charts.plot_events(run, found, "a[2]", theme=theme),
        "section": charts.plot_section(cut, "a[0]", "a[1]", theme=theme),
        "returns": charts.plot_return_map(analysis.return_map(run, "a[2]", "a[0]", 0.5), theme=theme),
        "lines": analysis.frequencies(run, "a[0]", 3).plot(theme=theme),
        "comparison": analysis.compare(run, other).plot(theme=theme),
        "plot": kr.plot(run, theme=theme),
    }
    for name, figure in figures.items():
        figure.savefig(tmp_path / f"{name}.png", dpi=50)
        assert figure.get_facecolor()[:3] == pytest.approx(rgb(THEMES[theme].paper)), name
    assert np.allclose(np.sort(drawn(figures["section"])[0], 0), np.sort(cut.a.values[:, :2], 0))
    assert len(drawn(figures["events"])[2]) + len(drawn(figures["events"])[3]) == found.sizes["event"]
    assert np.allclose(drawn(figures["series"])[0][:, 1], analysis.rates(run).tilt)


def test_bad_themes_and_data_are_refused(run):
    with pytest.raises(kr.InputError, match=r"theme must be .* Did you mean 'dark'"):
        kr.plot(run, theme="darc")
    with pytest.raises(kr.InputError, match="along time"):
        charts.plot_series(analysis.power_spectrum(run, "a[2]"))


def rgb(colour: str) -> np.ndarray:
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255


def linear(colour: str) -> np.ndarray:
    c = rgb(colour)
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def contrast(one: str, two: str) -> float:
    """WCAG 2.2: (L1 + 0.05)/(L2 + 0.05)."""
    low, high = sorted(linear(c) @ (0.2126, 0.7152, 0.0722) for c in (one, two))
    return (high + 0.05) / (low + 0.05)


# Vienot, Brettel and Mollon 1999: linear RGB as a protanope and a deuteranope see it
BLIND = {
    "protan": np.array([[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]]),
    "deutan": np.array([[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]]),
}


def lab(linear_rgb: np.ndarray) -> np.ndarray:
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ linear_rgb
    t = xyz / (0.9505, 1.0, 1.089)
    f = np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def in_the_dark(c: str) -> str:
    """A colour of a light figure on a dark page: CSS's invert(share) hue-rotate(180deg)."""
    css = (ROOT / "docs" / "static" / "kreisel.css").read_text(encoding="utf-8")
    (share,) = set(re.findall(r"filter: invert\(([0-9.]+)\) hue-rotate\(180deg\)", css))
    turn = np.array([[-0.574, 1.430, 0.144], [0.426, 0.430, 0.144], [0.426, 1.430, -0.856]])
    rgb = np.array([int(c[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    out = np.clip(turn @ (rgb * (1 - float(share)) + (1 - rgb) * float(share)), 0, 1)
    return "#" + "".join(f"{round(255 * v):02x}" for v in out)


@pytest.mark.parametrize("name", [*THEMES, "light, in the dark"])
def test_the_colours_are_readable_and_apart(name):
    theme = THEMES[name.partition(",")[0]]
    shown = in_the_dark if "in the dark" in name else str
    ink, paper, faint, *colours = map(shown, (theme.ink, theme.paper, theme.faint, *theme.colours))
    assert contrast(ink, paper) >= 12
    assert contrast(faint, paper) >= 3
    assert min(contrast(c, paper) for c in colours) >= 2.1
    for matrix in (np.eye(3), *BLIND.values()):
        seen = [lab(np.clip(matrix @ linear(c), 0, 1)) for c in colours]
        gaps = [np.linalg.norm(a - b) for i, a in enumerate(seen) for b in seen[:i]]
        assert min(gaps) > 9


@pytest.mark.parametrize("name", ["ratiu-bitop", "quadratic-potential"])
def test_a_matrix_is_drawn_by_its_entries(name):
    draw = exact.float_random(np.random.default_rng(1))
    model = exact.random_model(REGISTRY[name], 4, draw)
    state = exact.random_state(model.system.space, 4, draw)
    x0 = model.state(**dict(zip(model.system.space.letters, state, strict=True)))
    run = kr.simulate(model, x0, dt=0.01, steps=4)
    lines = kr.plot(run).axes[0].lines
    assert [line.get_label() for line in lines] == [f"$M_{{{j}{k}}}$" for j in range(1, 5) for k in range(j + 1, 5)]
    assert all((line.get_ydata() == run.M.values[:, j, k]).all() for line, (j, k) in zip(lines, PLANES, strict=True))
