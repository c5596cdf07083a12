"""Bad input: exit code 2, one message with what was expected, what came and the fix; never a traceback."""

from __future__ import annotations

import errno
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import kreisel as kr

GOOD = """
[system]
name = "lagrange-top"
p = [0.0, 0.0, 1.0]
[state]
m = [0.1, 0.2, 1.5]
a = [0.6, 0.0, 0.8]
[run]
dt = 0.05
steps = 100
[output]
path = "run.zarr"
"""
TOP = kr.LagrangeTop(p=(0, 0, 1))
BODY = kr.Clebsch(b=(1, 2, 3))
STATE = TOP.state(m=(1, 0, 0), a=(1, 0, 0))
NAN_MATRIX = "[[0.0, nan, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]"
# (what to replace, by what, words of the message)
CASES = [
    ('"lagrange-top"', '"lagrange-tap"', ["lagrange-tap", "Did you mean 'lagrange-top'"]),
    ('name = "lagrange-top"', "", ["needs `name", "kreisel systems"]),
    ("[system]", "[sistem]", ["sistem", "Did you mean 'system'"]),
    ('[output]\npath = "run.zarr"', "", ["[output]", "nothing came"]),
    ("p = [0.0, 0.0, 1.0]", "", ["needs the parameter p", "gravity"]),
    ("p = [0.0, 0.0, 1.0]", "p = [0, 0, 1]\nq = 3", ["'q' came", "parameters p, alpha"]),
    ("p = [0.0, 0.0, 1.0]", "p = [0.0, 1.0]", ["n >= 3"]),
    ("p = [0.0, 0.0, 1.0]", 'p = "up"', ["real numbers", "up"]),
    ("p = [0.0, 0.0, 1.0]", "p = [0.0, [1.0], 1.0]", ["ragged"]),
    ("p = [0.0, 0.0, 1.0]", "p = [0.0, 0.0, nan]", ["finite", "NaN"]),
    ("p = [0.0, 0.0, 1.0]", "p = [0.0, 0.0, 1.0]\nalpha = 0", ["alpha", "must not be 0"]),
    ("p = [0.0, 0.0, 1.0]", "p = [0.0, 0.0, 1.0, 0.0]", ["n = 4"]),
    ("m = [0.1, 0.2, 1.5]", "", ["needs m"]),
    ("m = [0.1, 0.2, 1.5]", "m = [0.1, 0.2, 1.5]\nb = [1]", ["'b' came", "m, a"]),
    ("m = [0.1, 0.2, 1.5]", "m = [0.1, 0.2]", ["skew matrix", "axial vector", "(2,)"]),
    ("m = [0.1, 0.2, 1.5]", "m = [[0, 1, 0], [1, 0, 0], [0, 0, 0]]", ["must be skew", "up to 2"]),
    ("m = [0.1, 0.2, 1.5]", f"m = {NAN_MATRIX}", ["finite"]),
    ("a = [0.6, 0.0, 0.8]", "a = [0.6, 0.0, inf]", ["finite"]),
    ("a = [0.6, 0.0, 0.8]", "a = [0.6, 0.0]", ["n = 3 numbers"]),
    ("a = [0.6, 0.0, 0.8]", "a = [0.6, 0.0, 0.8]\norientation = [2.0, 0, 0, 0]", ["length 1"]),
    ("a = [0.6, 0.0, 0.8]", "a = [0.6, 0, 0.8]\norientation = [[1,0,0],[0,1,0],[0,0,-1]]", ["determinant +1"]),
    ("a = [0.6, 0.0, 0.8]", "a = [0.6, 0, 0.8]\norientation = [1, 2]", ["rotation matrix"]),
    ("a = [0.6, 0.0, 0.8]", f"a = [0.6, 0, 0.8]\norientation = {10**400}", ["rotation matrix"]),
    ("dt = 0.05", "dt = 0.0", ["dt must be positive"]),
    ("dt = 0.05", "dt = -1.0", ["dt must be positive", "reverse"]),
    ("dt = 0.05", "dt = nan", ["dt must be positive"]),
    ("dt = 0.05", 'dt = "fast"', ["dt", "float"]),
    ("dt = 0.05", "", ["needs dt"]),
    ("steps = 100", "steps = 0", ["steps must be a whole number"]),
    ("steps = 100", "steps = 10.5", ["steps"]),
    ("steps = 100", "steps = 100\nevery = 0", ["every must be a whole number"]),
    ("steps = 100", "steps = 100\nevery = 101", ["more than steps"]),
    ("steps = 100", "steps = 100\nevry = 2", ["evry", "Did you mean 'every'"]),
    ("steps = 100", 'steps = 100\nmethod = "sures"', ["sures", "Did you mean 'suris'"]),
    ("steps = 100", "steps = 100\norder = 3", ["order=3"]),
    ("steps = 100", 'steps = 100\nmethod = "dop853"\norder = 4', ["order 8 only"]),
    ("[system]", "[system", ["not valid TOML"]),
    ("steps = 100", "steps = 99999999999999999999", ["out of reach"]),
    ("steps = 100", 'steps = "100"', ["int", "steps"]),
    ("dt = 0.05", "dt = 1e308", ["out of reach"]),
    ("dt = 0.05", "dt = 1e-320", ["at least"]),
    ("a = [0.6, 0.0, 0.8]", "a = [0, 0, 0]", ["zero vector"]),
    ("m = [0.1, 0.2, 1.5]", "m = [1.2e154, 0, 0]", ["not finite", "overflow"]),
    ("m = [0.1, 0.2, 1.5]", "m = [1e308, 1e308, 1e308]", ["no longer finite"]),
    ('path = "run.zarr"', 'path = "."', ["must name"]),
    ('path = "run.zarr"', 'path = ""', ["must name"]),
    ('path = "run.zarr"', 'path = "\\u0000"', ["must name"]),
    ('path = "run.zarr"', 'path = "run.zarr"\nfigure = "run.txt"', ["must end in"]),
    ("[run]", "run = 3\n[state.x]", ["[run]"]),
]


def kreisel(folder: Path, *args: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from kreisel.cli import main; main()", *args]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)


def run_in_process(
    folder: Path, text: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> tuple[int, str]:
    from kreisel import cli

    (folder / "run.toml").write_text(text)
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["kreisel", "run", "run.toml", "--no-figure"])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return int(stopped.value.code or 0), capsys.readouterr().err


@pytest.mark.parametrize(("old", "new", "words"), CASES, ids=[new or f"no {old}" for old, new, _ in CASES])
def test_bad_configuration(
    old: str,
    new: str,
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert old in GOOD
    code, message = run_in_process(tmp_path, GOOD.replace(old, new), monkeypatch, capsys)
    assert code == 2
    assert message.startswith("kreisel: ")
    assert "Traceback" not in message
    for word in words:
        assert word in message, message
    assert [p.name for p in tmp_path.iterdir()] == ["run.toml"]


def test_good_configuration_passes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_in_process(tmp_path, GOOD, monkeypatch, capsys)[0] == 0
    assert (tmp_path / "run.zarr").is_dir()


def test_command_line_as_a_process(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text(GOOD)
    good = kreisel(tmp_path, "run", "run.toml", "--json")
    assert good.returncode == 0, good.stderr
    assert '"integral": "energy"' in good.stdout
    assert good.stderr == ""
    assert (tmp_path / "run.png").stat().st_size > 10_000
    again = kreisel(tmp_path, "run", "run.toml")
    assert (again.returncode, again.stdout) == (2, "")
    assert "--overwrite" in again.stderr
    assert kreisel(tmp_path, "check", "run.zarr").returncode == 0
    assert kreisel(tmp_path, "plot", "run.zarr", "-o", "x.pdf").returncode == 0
    assert kreisel(tmp_path, "plot", "run.zarr", "-o", "x.xyz").returncode == 2
    missing = kreisel(tmp_path, "run", "nowhere.toml")
    assert (missing.returncode, "nowhere.toml" in missing.stderr) == (2, True)
    assert kreisel(tmp_path, "run", ".").returncode == 2
    assert kreisel(tmp_path, "check", "nowhere.zarr").returncode == 2
    assert kreisel(tmp_path, "systems", "clebsh").returncode == 2
    listing = kreisel(tmp_path, "systems")
    assert all(name in listing.stdout for name in kr.systems())
    for name in kr.systems():
        record = kreisel(tmp_path, "systems", name).stdout if name == "clebsch" else "Poisson"
        assert record


def test_binary_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from kreisel.runs.config import read

    (tmp_path / "run.toml").write_bytes(bytes(range(256)))
    with pytest.raises(kr.InputError, match="UTF-8"):
        read(tmp_path / "run.toml")


def test_folder_without_permission(tmp_path: Path, top: object, x0: object, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **options: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("zarr.create_group", refuse)  # the superuser, as in containers, is refused nothing
    with pytest.raises(kr.RunError, match="may write"):
        kr.simulate(top, x0, dt=0.1, steps=1, path=tmp_path / "run.zarr")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: kr.LagrangeTopMoving(A=(0, 0, 0)), "zero vector"),
        (lambda: kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0), "must not be 0"),
        (lambda: kr.SymmetricTop(A=(0, 0, 0)), "zero vector"),
        (lambda: kr.ClebschGeneral(a=(1, 1, 2), b=(1, 2, 3)), "distinct"),
        (lambda: kr.ClebschGeneral(a=(1, 2, 3), b=(1, 2, 3, 4)), "same R\\^n"),
        (lambda: kr.Kirchhoff(C=(1, 2, 3), B=(1, 2, 3)), "inverse moment of the plane"),
        (lambda: kr.HeavyTop(J=(1, -2, 3), A=(0, 0, 1)), "J_j \\+ J_k > 0"),
        (lambda: kr.HeavyTop(J=[[1, 2, 0], [0, 1, 0], [0, 0, 1]], A=(0, 0, 1)), "symmetric"),
        (lambda: kr.HeavyTop(J=np.ones((3, 2)), A=(0, 0, 1)), "square"),
        (lambda: kr.Neumann(b=(1, 2, 3)).state(x=(1, 1, 0), q=(0, 0, 1)), "must lie on"),
        (lambda: kr.Neumann(b=(1, 2, 3)).state(x=(1, 0, 0), q=(1, 0, 1)), "must lie on"),
        (lambda: kr.LagrangeTop(p=(0, 0, 1)).state(m=np.ones((4, 4)), a=(0, 0, 1)), "skew matrix"),
        (lambda: kr.LagrangeTop(p=(0, 0, 1)).state(m=np.ones((4, 3)), a=np.ones((5, 3))), "batch axes"),
        (lambda: kr.LagrangeTop(p=np.ones((2, 2, 3))), "batch axis"),
        (lambda: kr.LagrangeTop(p=np.ones((2, 3)), alpha=np.ones(3)), r"do not fit: p \(2,\), alpha \(3,\)"),
        (lambda: kr.simulate(TOP, BODY.state(M=(1, 0, 0), P=(1, 0, 0)), dt=1, steps=1), "components m, a"),
        (lambda: kr.simulate(kr.LagrangeTop(p=(0, 0, 0, 1)), STATE, dt=1, steps=1), "n = 4"),
        (
            lambda: kr.plot(
                kr.simulate(TOP, STATE, dt=0.1, steps=1),
                compare=kr.simulate(BODY, {"M": (1, 0, 0), "P": (1, 0, 0)}, dt=0.1, steps=1),
            ),
            "Runs of one system",
        ),
        (lambda: kr.simulate(TOP, TOP.state(m=np.ones((0, 3)), a=np.ones((0, 3))), dt=1, steps=1), "one lane"),
        (lambda: kr.simulate(TOP, TOP.state(m=(1, 0, 0), a=(1, 0, 0)), dt=1, steps=1, path="."), "needs a name"),
        (lambda: kr.simulate("top", {}, dt=1, steps=1), "system with its parameters"),
        (lambda: kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), (1, 2), dt=1, steps=1), "system.state"),
        (
            lambda: kr.simulate(
                kr.Kirchhoff(C=np.ones((3, 3)), B=(1, 2, 3)),
                {"M": (1, 0, 0), "P": (0, 1, 0)},
                dt=1,
                steps=1,
                method="suris",
            ),
            "No integrable",
        ),
        (
            lambda: kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), {"m": (1, 0, 0), "a": (0, 1, 0)}, dt=1e-3, steps=10**13),
            "memory",
        ),
    ],
)
def test_bad_calls(make: object, words: str) -> None:
    with pytest.raises(kr.InputError, match=words):
        make()


def test_clebsch_pole_is_refused_with_the_largest_step() -> None:
    body = kr.Clebsch(b=(1, 2, -1))
    state = body.state(M=(0.1, 0, 0), P=(0, 0, 2))
    with pytest.raises(kr.InputError, match=r"dt < 1 is safe"):
        kr.simulate(body, state, dt=1.0, steps=1, method="suris")
    assert np.isfinite(kr.simulate(body, state, dt=0.99, steps=100, method="suris").M.values).all()


def test_a_run_that_blows_up_says_where(top: object) -> None:
    with np.errstate(all="ignore"), pytest.raises(kr.RunError, match="no longer finite"):
        kr.simulate(top, top.state(m=(1e200, 0, 0), a=(0.6, 0, 0.8)), dt=1.0, steps=10)


def test_tops_that_make_no_sense() -> None:
    with pytest.raises(kr.InputError, match="positive"):
        kr.EulerTop(J=(1, 2, -0.5))
    with pytest.raises(kr.InputError, match="whole number from 3 on"):
        kr.KovalevskayaTop(n=2.5)
    with pytest.raises(kr.InputError, match="whole number from 3 on"):
        kr.RatiuTop(n=2, a=1, b=1, chi=1)
    with pytest.raises(kr.InputError, match="must be symmetric"):
        kr.QuadraticPotential(J=(1, 2, 3)).state(M=(1, 0, 0), P=np.triu(np.ones((3, 3))))
    body = kr.QuadraticPotential(J=(1, 2, 3))
    with pytest.raises(kr.InputError, match=r"steps up to 0\.5 have one"):  # eps^2 P < 1
        kr.simulate(body, body.state(M=(0, 0, 0), P=4 * np.eye(3)), dt=0.6, steps=1)
