"""Figures of the analyses, and the style: readable on both papers, apart for the colour-blind."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib import animation
from matplotlib.font_manager import findfont
from PIL import Image
from scipy import ndimage

import kreisel as kr
from kreisel import analysis
from kreisel.analysis.frequencies import lines_of
from kreisel.lab import exact
from kreisel.runs.geometry import presented
from kreisel.storage.opening import open_lanes
from kreisel.system import REGISTRY
from kreisel.viewer import charts
from kreisel.viewer.plots import sweep_figure
from kreisel.viewer.style import THEMES
from support import ROOT

PLANES = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


@pytest.fixture(scope="module")
def run():
    top = kr.LagrangeTop(p=(0, 0, 1))
    return kr.simulate(top, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, dt=0.05, steps=2000, progress=False)


def test_a_sweep_shows_the_entry_that_varies_most(tmp_path):
    """A matrix in so(4), whose last entry, of the diagonal, is 0."""
    start = np.triu([[0, 1, 2, 3], [0, 0, 1, 2], [0, 0, 0, 1], [0, 0, 0, 0]]) / 3.0
    body = kr.EulerTop(J=(1.0, 2.0, 3.0, 4.0))
    design = kr.Design(together={"system.J[0]": [1.0, 1.1]})
    options = {"dt": 0.1, "steps": 20, "workers": 0, "path": tmp_path / "sweep.zarr"}
    swept = kr.sweep(body, {"M": start - start.T}, design, **options)
    widest = np.abs(swept.M_max.values - swept.M_min.values).sum(0)
    place = np.argwhere(widest == widest.max())[0]
    labels = [axes.get_ylabel() for axes in sweep_figure(swept).axes]
    assert f"M[{place[0]}, {place[1]}]: max - min" in labels and place[0] != place[1]


def test_a_sweep_of_a_body_is_drawn_in_si(tmp_path):
    """The title is of the body, axes and panels have units, and drifts in joule are relative as others are."""
    top = kr.physical.Gyroscope.flat(mass="100 g", axial_moment="360 g cm^2", lever="3 cm")
    options = {"dt": "0.2 ms", "t_end": "0.05 s", "workers": 0, "save": ("drift", "extremes", "frequencies")}
    over = {"mass": ["100 g", "1e9 g"], "spin": ["3000 rpm", "6000 rpm"]}
    kr.sweep(top, {"tilt": "20 deg"}, over=over, path=tmp_path / "s.zarr", **options)
    swept = presented(open_lanes(tmp_path / "s.zarr"))
    figure = sweep_figure(swept)
    assert figure.get_suptitle() == "Gyroscope: sweep of 4 lanes"
    panels = {axes.get_title(): axes for axes in figure.axes if axes.get_title()}
    assert [re.sub(r"^\w+\[\d\]", "v", title) for title in panels] == [
        *("v: max - min (kg m^2/s)", "v: frequency (rad/s)", "largest drift, relative")
    ]
    for axes in panels.values():
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("body.mass (kg)", "state.spin (rad/s)")
        assert axes.dataLim.ymin < 3000 * np.pi / 30 < 6000 * np.pi / 30 < axes.dataLim.ymax
    assert panels["largest drift, relative"].collections[0].get_array().max() < 1e-12 < swept.energy_drift.max()
    assert sweep_figure(swept, "energy_drift").axes[0].get_title() == "energy_drift (J)"


def test_a_title_counts_one_step():
    top = kr.LagrangeTop(p=(0, 0, 1))
    run = kr.simulate(top, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, dt=0.05, steps=1, progress=False)
    assert kr.plot(run).get_suptitle().endswith("1 step of 0.05") and " 1 step of 0.05>" in repr(run.kreisel)


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
    with pytest.raises(kr.InputError, match=r"theme: expected .* Did you mean 'dark'"):
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
    state = model.system.space.point(4, draw)
    x0 = model.state(**dict(zip(model.system.space.letters, state, strict=True)))
    run = kr.simulate(model, x0, dt=0.01, steps=4)
    lines = kr.plot(run).axes[0].lines
    assert [line.get_label() for line in lines] == [f"$M_{{{j}{k}}}$" for j in range(1, 5) for k in range(j + 1, 5)]
    assert all((line.get_ydata() == run.M.values[:, j, k]).all() for line, (j, k) in zip(lines, PLANES, strict=True))


# -- kr.plot ------------------------------------------------------------------------------------------------------


def test_no_curve_is_hidden_and_what_never_changes_is_named(run):
    """A strip for each family, all of one scale; the families are those of kr.drift."""
    figure = kr.plot(run)
    strips = {axes.texts[0].get_text(): axes for axes in figure.subfigs[1].axes}
    still = figure.subfigs[1].texts[-1].get_text() if len(figure.subfigs[1].texts) else ""
    table = kr.drift(run).query("conserved")
    families = {str(name).partition("[")[0] for name in table.index}
    changed = {str(name).partition("[")[0] for name, row in table.iterrows() if row.max_change > 0}
    assert set(strips) == changed and all(name in still for name in families - changed)
    assert len({axes.get_ylim() for axes in strips.values()}) == 1
    for axes in strips.values():
        assert len(axes.lines) == 2 and np.nanmax(axes.lines[0].get_ydata()) < axes.get_ylim()[1]


def test_the_picture_says_what_it_shows(run):
    sphere = kr.plot(run).subfigs[0].axes[0]
    assert {text.get_text() for text in sphere.get_legend().get_texts()} == {"tip of $a$", "start"}
    assert {"x", "y", "z", "gravity"} <= {text.get_text() for text in sphere.texts}
    top = kr.LagrangeTop(p=(0, 0, 1))
    x0 = top.state(m=np.outer((1, 1.3, 1.6, 2), (0.1, 0.2, 1.5)), a=(0.6, 0, 0.8))
    many = kr.plot(kr.simulate(top, x0, dt=0.05, steps=100, progress=False))
    legend = [text.get_text() for text in many.subfigs[0].axes[0].get_legend().get_texts()]
    assert legend == ["lane 0", "lane 1", "lane 2", "lane 3", "start"] and "4 lanes" in many.get_suptitle()


def test_beyond_three_dimensions_the_whole_run_is_shown():
    four = kr.LagrangeTop(p=(0, 0, 0, 1))
    m = np.triu(np.ones((4, 4)), 1)
    run = kr.simulate(four, four.state(m=m - m.T, a=(0.6, 0, 0, 0.8)), dt=0.05, steps=1000, progress=False)
    first, whole = kr.plot(run).subfigs[0].axes
    assert len(first.lines) == 4 and "to time 50" in whole.get_title()
    assert len(whole.lines[0].get_xdata()) == 1001 and whole.get_legend().get_texts()[0].get_text() == "start"


@pytest.mark.parametrize("size", [1e-30, 1.0, 1e30])
def test_small_and_large_bodies_are_drawn_alike(size):
    """The momentum moves by 0.15 of its length from row to row, and by 1.5: a line, and dots."""
    body = kr.physical.FreeBody(np.array((1.0, 2.0, 2.5)) * size)
    run = kr.simulate(body, body.state((1.0, 2.0, 0.3)), dt=0.1, t_end=20, progress=False)
    for rows, word in ((run, "to 20 s"), (run.isel(time=slice(None, None, 10)), "saved states")):
        assert kr.plot(rows).subfigs[0].axes[0].get_title().endswith(word)
    lines = analysis.frequencies(run, "momentum[1]", 3)
    (axes,) = lines.plot().axes
    low, high = axes.get_ylim()
    assert 0 < low < abs(lines.amplitude).min() < abs(lines.amplitude).max() < high
    slower = kr.simulate(body, body.state((1.0, 2.0, 0.3)), dt=0.1, t_end=20, method="midpoint", progress=False)
    compared = analysis.compare(run, slower)
    dots = [line.get_xdata() for line in compared.plot().axes[1].lines]
    changes = compared.drift[["first", "second"]].to_numpy().T
    assert np.array_equal(np.array(dots)[changes > 0], changes[changes > 0])


def test_a_constant_is_drawn_in_its_size():
    lines = lines_of(np.arange(400) * 0.1, 3 + np.cos(np.arange(400) * 0.2), 2)
    spectrum = drawn(lines.plot())[0]
    assert spectrum[0] == pytest.approx([0, 3], rel=1e-3) and spectrum[5:, 1].max() == pytest.approx(1, rel=0.2)


def test_a_figure_for_a_journal(run, tmp_path):
    figure = kr.plot(run, style="journal")
    assert figure.get_figwidth() * 25.4 == pytest.approx(183) and figure.get_suptitle() == ""
    figure.savefig(tmp_path / "a.pdf")
    assert b"/Type0" in (tmp_path / "a.pdf").read_bytes() or b"/TrueType" in (tmp_path / "a.pdf").read_bytes()
    figure.savefig(tmp_path / "a.svg")
    axes = figure.subfigs[1].axes[0]
    assert axes.xaxis.label.get_size() == 8 and "STIX" in findfont(axes.texts[0].get_fontproperties())
    with pytest.raises(kr.InputError, match=r"style: expected .* Did you mean 'journal'"):
        kr.plot(run, style="jurnal")
    for ignored in ({"target": "sun"}, {"axis": (0, 0, 1)}):
        with pytest.raises(kr.InputError, match="axis, target: expected a run of a satellite"):
            kr.plot(run, **ignored)


def test_figures_show_themselves(run):
    for figure in (kr.plot(run), charts.plot_series(analysis.rates(run))):
        shown = figure._repr_mimebundle_()
        assert set(shown) == {"image/png", "text/plain"} and shown["image/png"].startswith(b"\x89PNG")


# -- films --------------------------------------------------------------------------------------------------------


def test_a_film_shows_the_motion(run, tmp_path):
    view = kr.view(kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), run.isel(time=0), dt=0.05, steps=100, progress=False))
    view.movie(tmp_path / "a.gif", seconds=0.2, fps=10)
    with Image.open(view.movie(tmp_path / "a.gif", seconds=0.4, fps=10)) as film:  # replaces a film of Kreisel's
        assert film.n_frames == 4 and film.info["duration"] == 100
        pictures = []
        for number in range(film.n_frames):
            film.seek(number)
            pictures.append(np.array(film.convert("L"), dtype=float))
    moved = [np.mean(abs(a - b) > 40) for a, b in pairwise(pictures)]
    assert min(moved) > 1e-3  # the body and its tip, not the words alone
    assert max(moved) < 0.3


def test_a_film_of_a_box_shows_each_side_in_one_piece(tmp_path):
    box = kr.physical.FreeBody.box(mass=1, sides=(0.3, 0.2, 0.1))
    start = box.state((0, 0, 1.0), attitude=(np.cos(0.25), 0, 0, np.sin(0.25)))
    view = kr.view(kr.simulate(box, start, dt=0.05, t_end=1, progress=False))
    with Image.open(view.movie(tmp_path / "box.gif", seconds=0.2, fps=10)) as film:
        red, _, blue = np.moveaxis(np.array(film.convert("RGB"), dtype=float), -1, 0)
    pieces = np.bincount(ndimage.label(blue - red > 30)[0].ravel())[1:]
    assert (pieces > 30).sum() == 1 and pieces.max() > 1000


def test_an_mp4_replaces_one_of_kreisel_only(run, tmp_path, monkeypatch):
    """As a .gif does.  ffmpeg is played by a writer of the first box of its files; ffmpeg 9.0 reads the marked ones."""

    class Ffmpeg(animation.AbstractMovieWriter):
        def setup(self, figure, outfile, dpi=None):
            Path(outfile).write_bytes(b"\0\0\0 ftypisom" + bytes(20))

        def grab_frame(self, **_):
            pass

        def finish(self):
            pass

    monkeypatch.setattr(animation.writers, "is_available", lambda name: True)
    monkeypatch.setattr(animation, "FFMpegWriter", Ffmpeg)
    for _ in range(2):
        kr.view(run).movie(tmp_path / "a.mp4", seconds=0.2, fps=10)
    (tmp_path / "mine.mp4").write_bytes((tmp_path / "a.mp4").read_bytes()[:32])
    with pytest.raises(kr.InputError, match=r"mine\.mp4 is unchanged"):
        kr.view(run).movie(tmp_path / "mine.mp4", seconds=0.2, fps=10)


def test_an_interrupted_film_is_not_encoded(run, tmp_path, monkeypatch):
    """Ctrl-C and SIGTERM end it at once: matplotlib would encode all pictures so far, for minutes."""
    encoded = []

    def interrupted(self, **_):
        raise KeyboardInterrupt

    monkeypatch.setattr(animation.PillowWriter, "grab_frame", interrupted)
    monkeypatch.setattr(animation.PillowWriter, "finish", lambda self: encoded.append(self))
    with pytest.raises(KeyboardInterrupt):
        kr.view(run).movie(tmp_path / "a.gif", seconds=0.2, fps=10)
    assert not encoded and not list(tmp_path.iterdir())


def test_films_that_cannot_be(run, tmp_path):
    with pytest.raises(kr.InputError, match=r"speed must be a positive number, .* got -1\.$"):
        kr.view(run).movie(tmp_path / "a.gif", speed=-1)
    with pytest.raises(kr.InputError, match=r"ends in \.gif or \.mp4"):
        kr.view(run).movie(tmp_path / "a.avi")
    far = kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), run.isel(time=0), dt=2.0, steps=10, progress=False)
    with pytest.raises(kr.InputError, match="too far apart"):
        kr.view(far).movie(tmp_path / "a.gif")
    with pytest.raises(kr.InputError, match="seconds"):
        kr.view(run).movie(tmp_path / "a.gif", seconds=-1)
    with pytest.raises(kr.InputError, match="seconds: expected at most 100 for fps = 20, got 1e"):
        kr.view(run).movie(tmp_path / "a.gif", seconds=1e9)
    with pytest.raises(kr.InputError, match="no argument 'loop'"):
        kr.view(run).movie(tmp_path / "a.gif", loop=True)
    Image.new("L", (2, 2)).save(tmp_path / "mine.gif")
    with pytest.raises(kr.InputError, match=r"mine\.gif is unchanged"):
        kr.view(run).movie(tmp_path / "mine.gif")
