"""Bad input: exit code 2, one message with what was expected, what it got and the fix; never a traceback."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from sizes import full
from support import configuration

GOOD = configuration("dt = 0.05\nsteps = 100", 'path = "run.zarr"')
TOP = kr.LagrangeTop(p=(0, 0, 1))
BODY = kr.Clebsch(b=(1, 2, 3))
STATE = TOP.state(m=(1, 0, 0), a=(1, 0, 0))
NAN_MATRIX = "[[0.0, nan, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]"
# (what to replace, by what, words of the message)
CASES = [
    ('"lagrange-top"', '"lagrange-tap"', ["lagrange-tap", "Did you mean 'lagrange-top'"]),
    ('name = "lagrange-top"', "", ["needs `name", "kreisel systems"]),
    ("[system]", "[sistem]", ["sistem", "Did you mean 'system'"]),
    ('[output]\npath = "run.zarr"', "", ["[output]", "got nothing"]),
    ("p = [0.0, 0.0, 1.0]", "", ["needs the parameter p", "gravity"]),
    ("p = [0.0, 0.0, 1.0]", "p = [0, 0, 1]\nq = 3", ["got 'q'", "parameters p, alpha"]),
    ("p = [0.0, 0.0, 1.0]", "p = [0.0, 1.0]", ["n >= 3"]),
    ("p = [0.0, 0.0, 1.0]", 'p = "up"', ["real values", "up"]),
    ("p = [0.0, 0.0, 1.0]", "p = [0.0, [1.0], 1.0]", ["ragged"]),
    ("p = [0.0, 0.0, 1.0]", "p = [0.0, 0.0, nan]", ["finite", "NaN"]),
    ("p = [0.0, 0.0, 1.0]", "p = [0.0, 0.0, 1.0]\nalpha = 0", ["alpha", "must not be 0"]),
    ("p = [0.0, 0.0, 1.0]", "p = [0.0, 0.0, 1.0, 0.0]", ["n = 4"]),
    ("m = [0.1, 0.2, 1.5]", "", ["needs m"]),
    ("m = [0.1, 0.2, 1.5]", "m = [0.1, 0.2, 1.5]\nb = [1]", ["got 'b'", "m, a"]),
    ("m = [0.1, 0.2, 1.5]", "m = [0.1, 0.2]", ["skew matrix", "axial vector", "(2,)"]),
    ("m = [0.1, 0.2, 1.5]", "m = [[0, 1, 0], [1, 0, 0], [0, 0, 0]]", ["may be a skew matrix", "up to 2"]),
    ("m = [0.1, 0.2, 1.5]", f"m = {NAN_MATRIX}", ["finite"]),
    ("a = [0.6, 0.0, 0.8]", "a = [0.6, 0.0, inf]", ["finite"]),
    ("a = [0.6, 0.0, 0.8]", "a = [0.6, 0.0]", ["n = 3 values"]),
    ("a = [0.6, 0.0, 0.8]", "a = [0.6, 0.0, 0.8]\norientation = [2.0, 0, 0, 0]", ["length 1"]),
    ("a = [0.6, 0.0, 0.8]", "a = [0.6, 0, 0.8]\norientation = [[1,0,0],[0,1,0],[0,0,-1]]", ["determinant +1"]),
    ("a = [0.6, 0.0, 0.8]", "a = [0.6, 0, 0.8]\norientation = [1, 2]", ["rotation matrix"]),
    ("a = [0.6, 0.0, 0.8]", f"a = [0.6, 0, 0.8]\norientation = {10**400}", ["rotation matrix"]),
    ("dt = 0.05", "dt = 0.0", ["dt must be"]),
    ("dt = 0.05", "dt = -1.0", ["dt must be", "reverse"]),
    ("dt = 0.05", "dt = nan", ["dt must be"]),
    ("dt = 0.05", 'dt = "fast"', ["[run] dt must be a positive number", "'fast'"]),
    ("dt = 0.05", "", ["needs dt"]),
    ("steps = 100", "steps = 0", ["steps must be an integer"]),
    ("steps = 100", "steps = 10.5", ["steps"]),
    ("steps = 100", "steps = 100\nevery = 0", ["every must be an integer"]),
    ("steps = 100", "steps = 100\nevery = 101", ["more than steps"]),
    ("steps = 100", "steps = 100\nevry = 2", ["evry", "Did you mean 'every'"]),
    ("steps = 100", 'steps = 100\nmethod = "sures"', ["sures", "Did you mean 'suris'"]),
    ("steps = 100", "steps = 100\norder = 3", ["order=3"]),
    ("steps = 100", 'steps = 100\nmethod = "dop853"\norder = 4', ["expected one of its orders (8), got order=4"]),
    ("[system]", "[system", ["not valid TOML"]),
    ("steps = 100", "steps = 100\nsteps = 100", ["not valid TOML", "The key is there twice; remove one."]),
    ('name = "lagrange-top"', 'name = ""', ["[system] needs `name", "got ''"]),
    ("steps = 100", "steps = 99999999999999999999", ["steps must be an integer from 1 to"]),
    ("steps = 100", 'steps = "100"', ["steps must be an integer", "'100'"]),
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


def as_a_process(folder: Path, *args: str) -> subprocess.CompletedProcess[str]:
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


def test_command_line_as_a_process(tmp_path: Path, kreisel: Any) -> None:
    (tmp_path / "run.toml").write_text(GOOD)
    good = as_a_process(tmp_path, "run", "run.toml", "--json")
    assert good.returncode == 0, good.stderr
    assert '"integral": "energy"' in good.stdout
    assert good.stderr == ""
    assert (tmp_path / "run.png").stat().st_size > 10_000
    again = as_a_process(tmp_path, "run", "run.toml")
    assert (again.returncode, again.stdout) == (2, "")
    assert "--overwrite" in again.stderr
    assert kreisel("check", "run.zarr").returncode == 0
    assert kreisel("plot", "run.zarr", "-o", "x.pdf").returncode == 0
    assert kreisel("plot", "run.zarr", "-o", "x.xyz").returncode == 2
    missing = kreisel("run", "nowhere.toml")
    assert (missing.returncode, "nowhere.toml" in missing.stderr) == (2, True)
    assert kreisel("run", ".").returncode == 2
    assert kreisel("check", "nowhere.zarr").returncode == 2
    assert kreisel("systems", "clebsh").returncode == 2
    listing = kreisel("systems")
    assert all(name in listing.stdout for name in kr.systems())
    assert "The spectrum is complete" in kreisel("systems", "clebsch").stdout


def test_binary_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from kreisel.cli.configuration import read

    (tmp_path / "run.toml").write_bytes(bytes(range(256)))
    with pytest.raises(kr.InputError, match="UTF-8"):
        read(tmp_path / "run.toml")


def test_a_byte_order_mark_as_editors_of_windows_write_it(tmp_path: Path) -> None:
    from kreisel.cli.configuration import read

    text = '[system]\nname = "euler-top"\nJ = [1, 2, 3]\n[state]\nM = [1, 2, 3]\n[run]\ndt = 0.1\nsteps = 1\n'
    text += '[output]\npath = "run.zarr"\n'
    (tmp_path / "run.toml").write_text(text, encoding="utf-8-sig")
    assert read(tmp_path / "run.toml") is not None


def test_names_of_systems_and_bodies_are_listed_once(kreisel: Any) -> None:
    names = kreisel("new", "nosuch").stderr.split("There are:")[1].rstrip(".\n").split(",")
    assert len(names) == len({name.strip() for name in names})


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
        (lambda: kr.HeavyTop(J=(1, -2, 3), A=(0, 0, 1)), "No body has the principal moments"),
        (lambda: kr.HeavyTop(J=[[1, 2, 0], [0, 1, 0], [0, 0, 1]], A=(0, 0, 1)), "symmetric"),
        (lambda: kr.HeavyTop(J=np.ones((3, 2)), A=(0, 0, 1)), "square"),
        (lambda: kr.Neumann(b=(1, 2, 3)).state(x=(1, 1, 0), q=(0, 0, 1)), "must lie on"),
        (lambda: kr.Neumann(b=(1, 2, 3)).state(x=(1, 0, 0), q=(1, 0, 1)), "must lie on"),
        (lambda: kr.LagrangeTop(p=(0, 0, 1)).state(m=np.ones((4, 4)), a=(0, 0, 1)), "skew matrix"),
        (lambda: kr.LagrangeTop(p=(0, 0, 1)).state(m=np.ones((4, 3)), a=np.ones((5, 3))), "batch axes"),
        (lambda: kr.LagrangeTop(p=np.ones((2, 2, 3))), "batch axes"),
        (lambda: kr.LagrangeTop(p=np.ones((2, 3)), alpha=np.ones(3)), r"do not fit: p \(2,\), alpha \(3,\)"),
        (lambda: kr.simulate(TOP, BODY.state(M=(1, 0, 0), P=(1, 0, 0)), dt=1, steps=1), "components m, a"),
        (lambda: kr.simulate(kr.LagrangeTop(p=(0, 0, 0, 1)), STATE, dt=1, steps=1), "n = 4"),
        (
            lambda: kr.plot(
                kr.simulate(TOP, STATE, dt=0.1, steps=1),
                compare=kr.simulate(BODY, {"M": (1, 0, 0), "P": (1, 0, 0)}, dt=0.1, steps=1),
            ),
            "a run with the variables",
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
            "expected a system with an explicit map, got kirchhoff",
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
    with pytest.raises(kr.InputError, match=r"expected dt < 1, got 1"):
        kr.simulate(body, state, dt=1.0, steps=1, method="suris")
    assert np.isfinite(kr.simulate(body, state, dt=0.99, steps=100, method="suris").M.values).all()


def test_a_run_that_blows_up_says_where(top: object) -> None:
    with np.errstate(all="ignore"), pytest.raises(kr.RunError, match="no longer finite"):
        kr.simulate(top, top.state(m=(1e200, 0, 0), a=(0.6, 0, 0.8)), dt=1.0, steps=10)


def test_tops_that_make_no_sense() -> None:
    with pytest.raises(kr.InputError, match="No body has the principal moments"):
        kr.EulerTop(J=(1, 2, -0.5))
    with pytest.raises(kr.InputError, match="integer from 3 on"):
        kr.KovalevskayaTop(n=2.5)
    with pytest.raises(kr.InputError, match="integer from 3 on"):
        kr.RatiuTop(n=2, a=1, b=1, chi=1)
    with pytest.raises(kr.InputError, match="must be symmetric"):
        kr.QuadraticPotential(J=(1, 2, 3)).state(M=(1, 0, 0), P=np.triu(np.ones((3, 3))))
    body = kr.QuadraticPotential(J=(1, 2, 3))
    with pytest.raises(kr.InputError, match=r"expected a step below 0\.5, got"):  # eps^2 P < 1
        kr.simulate(body, body.state(M=(0, 0, 0), P=4 * np.eye(3)), dt=0.6, steps=1)


class Unprintable:
    """Its repr raises, as that of a class of the user's may."""

    def __repr__(self) -> str:
        raise RuntimeError("no repr")


OPTIONS = {"dt": 0.1, "steps": 3}
ODD = [np.array([1, 2]), np.array([]), [], {}, 10**5000, Unprintable(), object(), b"x", 1j, True]


NAMES = ("order", "method", "engine", "tol", "every", "dt", "steps", "path")
ODD_VALUES = [
    (k, name) for k, value in enumerate(ODD) for name in NAMES if value is not True or name not in ("every", "dt")
]


@pytest.mark.parametrize(("number", "name"), ODD_VALUES)
def test_values_of_any_kind(name: str, number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    value = ODD[number]
    with pytest.raises(kr.InputError) as error:
        kr.simulate(TOP, STATE, **{**OPTIONS, name: value})
    assert len(str(error.value)) < 1501
    assert str(error.value).isprintable()
    assert not list(tmp_path.iterdir())


def test_whole_numbers_of_numpy_are_whole_numbers(tmp_path: Path) -> None:
    plain = kr.simulate(TOP, STATE, order=4, every=1, **OPTIONS)
    other = kr.simulate(TOP, STATE, order=np.int64(4), every=np.int32(1), path=tmp_path / "run.zarr", **OPTIONS)
    assert other.attrs["options"] == plain.attrs["options"]
    assert (other.a.values == plain.a.values).all()


def test_a_home_folder_is_expanded_and_none_to_replace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home"
    home.mkdir()
    (home / "thesis.tex").write_text("x")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(tmp_path)
    kr.simulate(TOP, STATE, path="~/run.zarr", **OPTIONS)
    assert kr.open_run(home / "run.zarr").sizes["time"] == 4
    for act in (
        lambda: kr.simulate(TOP, STATE, path="~", overwrite=True, **OPTIONS),
        lambda: kr.sweep(
            TOP, STATE, kr.Design(together={"system.alpha": [1.0]}), path="~", overwrite=True, workers=0, **OPTIONS
        ),
    ):
        with pytest.raises(kr.InputError, match=r"needs a name .*got '~'"):
            act()
    assert sorted(p.name for p in home.iterdir()) == ["run.zarr", "thesis.tex"]
    assert [p.name for p in tmp_path.iterdir()] == ["home"]


@pytest.mark.parametrize("n", [60000, 2**63 - 1, 1e300])
def test_an_n_that_no_memory_holds(n: float) -> None:
    for make in (lambda: kr.KovalevskayaTop(n=n), lambda: kr.RatiuTop(n=n, a=1, b=1, chi=1)):
        with pytest.raises(kr.InputError, match=r"expected n of at most 4,096, got"):
            make()
    for make in (lambda v: kr.LagrangeTop(p=v), lambda v: kr.Neumann(b=v), lambda v: kr.EulerTop(J=v)):
        with pytest.raises(kr.InputError, match=r"expected n of at most 4,096, got 60,000"):
            make(np.ones(60000))


def test_an_archive_that_claims_a_large_n(tmp_path: Path, kreisel: Any) -> None:
    top = kr.KovalevskayaTop(n=3)
    path = tmp_path / "run.zarr"
    kr.simulate(top, {"M": (1, 0, 0), "P": (0, 0, 1), "Q": (1, 0, 0)}, path=path, **OPTIONS)
    meta = path / "zarr.json"
    text = meta.read_text()
    assert '{\\"n\\": 3.0' in text
    meta.write_text(text.replace('{\\"n\\": 3.0', '{\\"n\\": 60000.0'))
    out = kreisel("check", "run.zarr")
    assert out.returncode in (1, 2)
    assert "Traceback" not in out.stderr
    assert "4,096" in out.stderr or "changed" in out.stdout


@pytest.mark.parametrize("digits", ["9" * 5000, "0x" + "f" * 5000])
def test_whole_numbers_that_python_does_not_print(
    digits: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for old in ("steps = 100", "dt = 0.05", "p = [0.0, 0.0, 1.0]", "a = [0.6, 0.0, 0.8]"):
        key = old.split(" = ")[0]
        new = f"{key} = [0.0, 0.0, {digits}]" if "[" in old else f"{key} = {digits}"
        code, message = run_in_process(tmp_path, GOOD.replace(old, new), monkeypatch, capsys)
        assert code == 2
        assert message.startswith("kreisel: ")
        assert len(message) < 1600


def test_messages_are_brief_and_printable() -> None:
    from kreisel.errors import brief, shown

    assert shown("x" * 5000).startswith("'xxx")
    assert len(shown("x" * 5000)) <= 100
    assert shown(Unprintable()) == "a value of type Unprintable"
    assert shown(10**5000) == "a value of type int of 16,610 bits"
    assert brief("a\x1b[2Jb\nc\x07\udcff") == "a\\x1b[2Jb c\\x07\\udcff"
    error = kr.InputError("expected " + "x" * 9000 + "\x1b fix")
    assert len(str(error)) == 1500
    assert str(error).endswith("\\x1b fix")
    assert str(kr.InputError(str(error))) == str(error)  # as it is pickled


def test_control_characters_of_an_archive_do_not_reach_the_terminal(tmp_path: Path, kreisel: Any) -> None:
    kr.simulate(TOP, STATE, path=tmp_path / "run.zarr", **OPTIONS)
    meta = tmp_path / "run.zarr" / "zarr.json"
    text = meta.read_text()
    assert '"title": "' in text
    evil = "\\u001b]0;x\\u0007\\u001b[2J" + "y" * 9000
    meta.write_text(text.replace('"title": "', f'"title": "{evil}').replace('"lagrange-top"', f'"{evil}"'))
    for command in (["check", "run.zarr"], ["resume", "run.zarr", "--extend", "9"], ["plot", "run.zarr"]):
        out = kreisel(*command)
        printed = out.stdout + out.stderr
        assert "Traceback" not in printed
        assert all(c.isprintable() or c == "\n" for c in printed), printed
        assert all(len(line) < 1600 for line in printed.splitlines())


def test_arguments_without_their_names() -> None:
    with pytest.raises(kr.InputError, match=r"lagrange-top: expected arguments by name, p=\.\.\., alpha=\.\.\.; got"):
        kr.LagrangeTop((0, 0, 1))
    with pytest.raises(kr.InputError, match=r"lagrange-top: expected arguments by name, m=\.\.\., a=\.\.\.; got"):
        TOP.state((1, 0, 0), (0, 0, 1))


def no_runs() -> dict[str, object]:
    import xarray as xr

    run = kr.simulate(TOP, STATE, **OPTIONS)
    return {
        "None": None,
        "a list": [1, 2],
        "a path": "run.zarr",
        "an empty Dataset": xr.Dataset(),
        "no time": run.drop_vars([name for name in run.variables if "time" in run[name].dims]),
    }


@pytest.mark.parametrize("kind", ["None", "a list", "a path", "an empty Dataset", "no time"])
@pytest.mark.parametrize(
    "act", ["drift", "plot", "view", "failures", "events", "frequencies", "euler_angles", "compare"]
)
def test_what_is_no_run(kind: str, act: str) -> None:
    what, run = no_runs()[kind], kr.simulate(TOP, STATE, **OPTIONS)
    acts = {
        "drift": kr.drift,
        "plot": kr.plot,
        "view": kr.view,
        "failures": kr.failures,
        "events": lambda what: kr.analysis.events(what, "a[2]"),
        "frequencies": lambda what: kr.analysis.frequencies(what, "a[2]"),
        "euler_angles": kr.analysis.euler_angles,
        "compare": lambda what: kr.analysis.compare(run, what),
    }
    with pytest.raises(kr.InputError):
        acts[act](what)


@pytest.mark.parametrize("what", [None, [1, 2], 3])
def test_what_cannot_be_exported(what: object, tmp_path: Path) -> None:
    with pytest.raises(kr.InputError, match="expected the path of an archive or a Dataset"):
        kr.export(what, tmp_path / "run.nc")


@pytest.mark.parametrize("command", [["check"], ["view"], ["plot"], ["resume"], ["run"], ["plot", "run.zarr", "-o"]])
def test_a_name_that_no_file_system_takes(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from kreisel import cli

    monkeypatch.chdir(tmp_path)
    kr.simulate(TOP, STATE, path="run.zarr", **OPTIONS)
    monkeypatch.setattr(sys, "argv", ["kreisel", *command, "x" * 5000])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    message = capsys.readouterr().err
    assert (stopped.value.code, message.startswith("kreisel: ")) == (2, True)
    assert len(message) < 1600
    assert os.listdir(tmp_path) == ["run.zarr"]


@pytest.mark.parametrize("name", ["n", "degree", "iterates", "steps", "seed"])
@pytest.mark.parametrize(
    "value",
    [-1, 1.5, "auto", [1], np.array([1, 2]), 10**5000, float("nan"), Unprintable()],
    ids=lambda v: type(v).__name__,
)
def test_an_investigation_of_anything(name: str, value: object) -> None:
    with pytest.raises(kr.InputError, match=f"{name} must be an integer from"):
        kr.lab.investigate("lagrange-top", **{name: value})


def test_analysis_of_anything() -> None:
    run, analysis = kr.simulate(TOP, STATE, dt=0.1, steps=50), kr.analysis
    for value in ("x", [1, 2], np.array([1.0, 2.0]), float("nan"), 10**5000, {}):
        for act in (
            lambda v: analysis.events(run, "a[2]", v),
            lambda v: analysis.events(run, "a[2]", rising=v),
            lambda v: analysis.frequencies(run, "a[2]", lines=v),
            lambda v: analysis.frequencies(run, "a[2]", power=v),
            lambda v: analysis.return_map(run, "a[2]", "a[0]", 0.1, returns=v),
        ):
            with pytest.raises(kr.InputError):
                act(value)


@pytest.mark.parametrize(
    "path", [[], 3, None, b"run.zarr", "x" * 5000, "~", "", "/", "a\0b", "..", {"a": 1}, np.arange(3), "\ud800"]
)
def test_paths_of_any_kind(path: Any, top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = kr.simulate(top, x0, dt=0.1, steps=3)
    for act in (
        lambda: kr.open_run(path),
        lambda: kr.resume(path),
        lambda: None if path is None else kr.simulate(top, x0, dt=0.1, steps=3, path=path, overwrite=True),
        lambda: kr.sweep(
            top, x0, kr.Design(together={"system.alpha": [1.0]}), dt=0.1, steps=3, path=path, overwrite=True, workers=0
        ),
        lambda: kr.export(run, path),
        lambda: kr.view(run).save(path),
    ):
        try:
            assert act() is None
        except (kr.InputError, kr.RunError) as error:
            assert 20 < len(str(error)) < 1600
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "make",
    [
        lambda: kr.RatiuBitop(a=1.3, b=1.8, chi12=-1.7e308, chi34=1.2),
        lambda: kr.RatiuBitop(a=2.0, b=5e-324, chi12=0.5, chi34=0.1),
        lambda: kr.ClebschBody(J=(1.0e308, 1.6e308, 1.7e308)),
        lambda: kr.HessAppelrot(a=1.0, k=1.0, x=1e300, z=1.0),
    ],
)
@pytest.mark.filterwarnings("error")
def test_parameters_whose_constants_leave_the_range_of_doubles(make: Any) -> None:
    with pytest.raises(kr.InputError, match="whose products and ratios a double can hold"):
        make()


@pytest.mark.filterwarnings("error")
def test_parameters_whose_squares_overflow_end_a_run_with_one_message() -> None:
    top = kr.SymmetricTop(A=(0.3, 0.5, 1e300))
    with pytest.raises((kr.InputError, kr.RunError)):
        kr.simulate(top, top.state(M=(0.1, 0.2, 1.5), P=(0.6, 0, 0.8)), dt=0.1, steps=5)


@pytest.mark.filterwarnings("error")
def test_a_page_of_numbers_beyond_single_precision(top: Any, x0: Any) -> None:
    with np.errstate(all="ignore"):
        run = kr.simulate(top, x0, dt=0.1, steps=20).map(lambda v: v * 1e100, keep_attrs=True)
    with pytest.raises(kr.InputError, match="below 3e38"):
        kr.view(run)
    for factor in (1e160, np.inf):
        with np.errstate(all="ignore"), pytest.raises(kr.InputError, match="finite and below"):
            kr.plot(run.map(lambda v, factor=factor: v * factor, keep_attrs=True))
    with pytest.raises(kr.InputError, match="is finite"):
        kr.view(run.map(lambda v: v * np.nan, keep_attrs=True))
    for lane in (2, -1, [], "x"):
        with pytest.raises(kr.InputError, match="lane"):
            kr.view(kr.simulate(top, top.state(m=[x0["m"]] * 2, a=x0["a"]), dt=0.1, steps=5), lane=lane)


def shows(run: Any) -> str:
    """A run as a notebook shows it."""
    return repr(run.kreisel) + run.kreisel._repr_html_()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, np.zeros((0, 3))) for name in ("title", "method", "options", "parameters", "equations", "references")),
        *(("parameters", value) for value in (True, {"p": [0, 0, 1]}, None)),
        *(("options", value) for value in ("[1]", "NaN", '{"order": "x"}', '{"order": ["2"]}')),
        *(("dt", value) for value in (0, -0.1, np.nan, "0.1", None)),
        *(("steps", value) for value in (1.5, "3", [3])),
        ("n", "3"),
        ("frame", np.array(["rest", "rest"])),
    ],
)
@pytest.mark.parametrize("act", [kr.cite, kr.drift, kr.plot, kr.view, shows, kr.analysis.rates])
def test_attributes_that_are_none_of_a_run(act: Any, name: str, value: Any) -> None:
    run = kr.simulate(TOP, STATE, **OPTIONS).assign_attrs({name: value})
    if name == "options" and isinstance(value, str) and act is not kr.cite:  # it alone needs them
        act(run)
        return
    with pytest.raises(kr.InputError, match=r"expected the attributes|expected an integer|expected an object"):
        act(run)


@pytest.mark.parametrize("name", ["references", "source", "method", "options"])
def test_a_run_to_cite_without_an_attribute(name: str) -> None:
    run = kr.simulate(TOP, STATE, **OPTIONS)
    del run.attrs[name]
    with pytest.raises(kr.InputError, match=rf"expected .* got .*{name}"):
        kr.cite(run)


@pytest.mark.filterwarnings("error")
def test_figures_of_a_single_row(top: Any, x0: Any, tmp_path: Path) -> None:
    run = kr.simulate(top, x0, dt=0.1, steps=20)
    for here, other in ((run, run.isel(time=[0])), (run.isel(time=[0]), run), (run.isel(time=[0]), None)):
        kr.plot(here, compare=other).savefig(tmp_path / "run.png")
    kr.plot(run.isel(time=slice(None, None, -1))).savefig(tmp_path / "run.png")
    kr.view(run.isel(time=[0])).save(tmp_path / "run.html")
    assert all((tmp_path / name).stat().st_size > 1000 for name in ("run.png", "run.html"))


def test_a_page_of_half_a_character(top: Any, x0: Any, tmp_path: Path) -> None:
    run = kr.simulate(top, x0, dt=0.1, steps=20)
    kr.view(run.assign_attrs(title="a\ud800", equations="b\udfff")).save(tmp_path / "run.html")
    assert "a\\ud800" in (tmp_path / "run.html").read_text()


# Their flows are against Taylor series in tests/exact/test_conjugate.py.
BY_TAYLOR = (
    "clebsch-general goryachev-chaplygin kovalevskaya-gyrostat kovalevskaya-top-e3 manakov-top quadratic-potential "
    "rubanovskii steklov-lyapunov"
).split()


@pytest.mark.parametrize("name", [*(name for name in kr.systems() if name not in BY_TAYLOR), *full(*BY_TAYLOR)])
def test_the_exact_flow_is_known_or_refused(name: str) -> None:
    """Records that are made from others have their closed forms only where these are theirs."""
    from kreisel.lab import exact
    from kreisel.system import find

    draw = exact.float_random(np.random.default_rng(1))
    model = exact.random_model(find(name), find(name).n or 3, draw)
    state = dict(zip(model.system.space.letters, model.system.space.point(model.n, draw), strict=True))
    try:
        run = kr.simulate(model, state, dt=0.1, steps=10, method="exact")
    except kr.InputError:
        return
    reference = kr.simulate(model, state, dt=0.1, steps=10, method="dop853")
    for letter in state:
        np.testing.assert_allclose(run[letter].values, reference[letter].values, atol=1e-7)


def test_numbers_of_other_kinds_are_floats_or_refused() -> None:
    from datetime import timedelta
    from decimal import Decimal

    assert kr.LagrangeTop(p=(0, 0, Decimal("0.5"))).params["p"].dtype == np.float64
    for wrong in (timedelta(1), Decimal("1e400")):
        with pytest.raises(kr.InputError):
            kr.RatiuBitop(a=1.0, b=2.0, chi12=wrong)


@pytest.mark.parametrize(
    ("model", "state"),
    [
        (kr.EulerTop(J=(1.0, 5e-324, 2.1)), {"M": (0.6, -0.5, -0.7)}),
        (kr.NeumannVeselov(b=(1.2, -0.7, -1.2)), {"x": (1, 0, 0), "q": (0, -9.4e299, 2.4e299)}),
    ],
)
@pytest.mark.filterwarnings("error")
def test_products_that_leave_the_range_of_doubles_before_the_first_step(model: Any, state: Any) -> None:
    with pytest.raises((kr.InputError, kr.RunError)):
        kr.simulate(model, state, dt=0.05, steps=5, method="veselov")


@pytest.mark.parametrize(
    "call",
    [
        lambda: kr.Steklov(b=(1.0,), nu=1.0),
        lambda: kr.Lyapunov(b=[[0.0]], nu=1.0),
    ],
)
def test_sizes_and_slowness(call: Any) -> None:
    with pytest.raises(kr.InputError, match=r"expected"):
        call()


def test_turns_beyond_the_doubles() -> None:
    top = kr.LagrangeTop(p=(1.1, -0.4, -0.8), alpha=5e-324)
    with pytest.raises((kr.InputError, kr.RunError)):
        x0 = top.state(m=(0.5, 1.0, 0.9), a=(0.6, 0.4, 0.7))
        kr.simulate(top, x0, dt=0.02, steps=5, order=4, orientation=(1, 0, 0, 0))


@pytest.mark.parametrize("command", ["check", "plot", "view", "resume", "export"])
def test_kreisel_itself_says_what_cannot_be_read(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not the library of the command line, in a frame and words of its own."""
    from kreisel import cli

    (tmp_path / "run.zarr").mkdir()
    monkeypatch.setattr("os.access", lambda *_, **__: False)
    more = ["f.nc"] if command == "export" else []
    monkeypatch.setattr(sys, "argv", ["kreisel", command, str(tmp_path / "run.zarr"), *more])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    err = capsys.readouterr().err
    assert ended.value.code == 2 and err.startswith("kreisel: ") and "not readable" not in err
