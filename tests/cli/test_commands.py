"""What the commands share: --set, --version, completion, ~, time said apart, estimates, room on the disk."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer

import kreisel as kr
from kreisel import cli
from kreisel.cli.configuration import changed
from kreisel.runs import planning
from kreisel.runs.planning import make_plan
from support import configuration

GOOD = configuration("dt = 0.05\nsteps = 100", 'path = "run.zarr"')
TOP = kr.LagrangeTop(p=(0, 0, 1))
X0 = TOP.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))


class Usage(NamedTuple):
    """As shutil says it."""

    total: int
    used: int
    free: int


class Commands:
    """Calls of the command line in a folder."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
        self.folder, self._patch, self._capsys = folder, patch, capsys
        patch.chdir(folder)
        (folder / "run.toml").write_text(GOOD)

    def __call__(self, *words: str) -> tuple[int, str, str]:
        self._patch.setattr("sys.argv", ["kreisel", *words])
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        printed = self._capsys.readouterr()
        return int(stopped.value.code or 0), printed.out, printed.err


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Commands:
    return Commands(tmp_path, monkeypatch, capsys)


def test_set(command: Commands) -> None:
    words = [
        "--set",
        "run.dt=0.01",
        "--set",
        "run.steps=2e2",
        "--set",
        "system.p=[0, 0, 2]",
        "--set",
        "run.method=suris",
    ]
    code, out, _ = command("run", "run.toml", "--no-figure", "--json", *words)
    summary = json.loads(out)
    assert code == 0 and (summary["dt"], summary["steps"], summary["method"]) == (0.01, 200, "suris")
    assert kr.open_run("run.zarr").kreisel.model.params["p"].tolist() == [0, 0, 2]
    assert (command.folder / "run.toml").read_text() == GOOD


def test_values_of_set() -> None:
    table = tomllib.loads("[sweep.grid]\nsystem.alpha = [1, 2]")
    changed(table, ["sweep.grid.state.m[2]=[1.0, 2.0]", "sweep.draws = 3", "output.path=~/x.zarr", "run.t_end=1_0.5"])
    assert table["sweep"]["grid"] == {"system": {"alpha": [1, 2]}, "state.m[2]": [1.0, 2.0]}
    assert table["sweep"]["draws"] == 3 and table["output"]["path"] == "~/x.zarr" and table["run"]["t_end"] == 10.5


def test_a_run_of_a_file_with_a_controller_is_resumed_by_its_file(command: Commands) -> None:
    """The archive holds no law; with the file of the run the rows are those of one long run, with another not."""
    (command.folder / "bdot.toml").write_text(
        '[body]\nkind = "satellite"\nunits = 3\n[body.orbit]\naltitude = "500 km"\n[body.control]\nkind = "bdot"\n'
        'gain = "1e-4 N m s"\nevery = "2 s"\n[state]\nspin = [0.1, 0.2, 0.1]\n[run]\ndt = "2 s"\nsteps = 10\n'
        '[output]\npath = "short.zarr"\n'
    )
    more = ("--set", "run.steps=20", "--set", "output.path=long.zarr")
    assert command("run", "bdot.toml", "--no-figure")[0] == command("run", "bdot.toml", "--no-figure", *more)[0] == 0
    resumed, file = ("resume", "short.zarr", "--extend", "20"), ("--config", "bdot.toml")
    for words, said in (
        ((), "its TOML file to `kreisel resume --config`"),
        (("--set", "run.steps=20"), "--set: expected the file that it changes"),
        ((*file, "--set", "body.control.gain='2e-4 N m s'"), "gain = 0.0001, got gain = 0.0002"),
    ):
        code, _, complaint = command(*resumed, *words)
        assert code == 2 and said in complaint.replace("\n", " ")
    assert command(*resumed, *file)[0] == 0
    assert kr.open_run("short.zarr").attitude.values.tobytes() == kr.open_run("long.zarr").attitude.values.tobytes()


def test_version_and_completion(command: Commands, monkeypatch: pytest.MonkeyPatch) -> None:
    code, out, _ = command("--version")
    assert code == 0 and out.startswith(f"kreisel {kr.__version__} (Python 3.") and "llvmlite" in out
    monkeypatch.setenv(
        "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1"
    )  # Typer's own, for tests: no shell to look for
    code, out, _ = command("--show-completion", "bash")
    assert code == 0 and "complete" in out
    commands: Any = typer.main.get_command(cli.app)
    for word, begun, name in (
        ("systems", "cle", "clebsch-body"),
        ("methods", "mid", "midpoint"),
        ("new", "gyro", "gyroscope"),
        ("checkcase", "tumb", "tumbling-brick"),
    ):
        subject = commands.commands[word]
        context = subject.make_context(word, [], resilient_parsing=True)
        names = [item.value for item in subject.params[0].shell_complete(context, begun)]
        assert name in names and all(each.startswith(begun) for each in names)


def test_home(command: Commands, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(command.folder))
    assert command("run", "~/run.toml", "--no-figure", "--set", "output.path=~/here.zarr")[0] == 0
    assert (command.folder / "here.zarr").is_dir()
    for words in (
        ["check", "~/here.zarr"],
        ["plot", "~/here.zarr", "-o", "~/p.png"],
        ["export", "~/here.zarr", "~/e.csv"],
        ["new", "clebsch", "-o", "~/c.toml"],
    ):
        assert command(*words)[0] == 0
    assert {"p.png", "e.csv", "c.toml"} <= {p.name for p in command.folder.iterdir()}


def test_an_orbit_around_the_sun_is_exported_with_its_frame_and_centre(command: Commands) -> None:
    body = kr.physical.Asteroid.toutatis()
    kr.simulate(body, body.state((1e-5, 0, 1e-6)), dt="1 h", steps=2, path=command.folder / "a.zarr")
    words = "export", "a.zarr", "a.oem", "--epoch", "2026-03-20", "--frame", "ICRF"
    code, _, message = command(*words)
    assert code == 2 and "--center SUN), got frame" in message
    assert command(*words, "--center", "SUN")[0] == 0
    assert "CENTER_NAME = SUN\nREF_FRAME = ICRF\n" in (command.folder / "a.oem").read_text()
    named = "--name", "TOUTATIS", "--identifier", "4179", "--originator", "ME", "--time-system", "TDB"
    assert command(*words, "--center", "SUN", *named, "--overwrite")[0] == 0
    for line in ("OBJECT_NAME = TOUTATIS", "OBJECT_ID = 4179", "ORIGINATOR = ME", "TIME_SYSTEM = TDB"):
        assert line in (command.folder / "a.oem").read_text()
    code, _, message = command(*words, "--center", "SUN", "--time-unit", "60", "--spacecraft", "-9", "--overwrite")
    assert code == 2 and "time_unit: expected none" in message


def test_figures_and_pages_are_replaced_where_it_was_said(command: Commands) -> None:
    assert command("run", "run.toml")[0] == 0
    before = (command.folder / "run.png").stat().st_mtime_ns
    for words in (["plot", "run.zarr"], ["view", "run.zarr"]):
        command(*words)
        code, _, message = command(*words)
        assert code == 2 and "exists already" in message and "--overwrite" in message
        assert (command.folder / "run.png").stat().st_mtime_ns == before
        assert command(*words, "--overwrite")[0] == 0
        before = (command.folder / "run.png").stat().st_mtime_ns
    (command.folder / "mine.png").write_bytes(b"mine")
    assert command("plot", "run.zarr", "-o", "mine.png", "--overwrite")[0] == 2
    assert (command.folder / "mine.png").read_bytes() == b"mine"


def test_the_time_is_said_apart(command: Commands) -> None:
    code, out, _ = command("run", "run.toml", "--no-figure", "--json")
    summary = json.loads(out)
    parts = summary["seconds_of_kernels"], summary["seconds_of_steps"]
    assert code == 0 and all(part >= 0 for part in parts) and sum(parts) <= summary["seconds"] + 0.01
    _, out, _ = command("run", "run.toml", "--no-figure", "--overwrite")
    assert "compile or load" in out and "100 steps of 0.05 -> run.zarr" in out


def test_a_step_that_does_not_divide_the_time_is_said(command: Commands) -> None:
    text = (command.folder / "run.toml").read_text(encoding="utf-8")
    assert "steps = 100" in text
    (command.folder / "until.toml").write_text(text.replace("steps = 100", "t_end = 0.98"), encoding="utf-8")
    _, out, _ = command("run", "until.toml", "--no-figure")
    assert "20 steps of 0.049 (asked for: dt = 0.05, of which t_end is not a multiple) -> run.zarr" in out
    _, out, _ = command("run", "until.toml", "--no-figure", "--overwrite", "--json")
    assert (json.loads(out)["dt"], json.loads(out)["asked_dt"]) == (0.049, 0.05)
    code, _, message = command("run", "until.toml", "--overwrite", "--set", "run.asked_dt=0.05")
    assert code == 2 and "has the key 'asked_dt'" in message


def test_the_size_of_an_archive_is_as_estimated(tmp_path: Path) -> None:
    settings: dict[str, Any] = {"dt": 0.05, "steps": 40_000}
    likely, least = planning.bytes_of(make_plan(TOP, X0, **settings))
    kr.simulate(TOP, X0, **settings, path=tmp_path / "run.zarr")
    files = (f for f in (tmp_path / "run.zarr").rglob("*") if f.is_file() and "engine" not in f.parts)
    assert least < sum(f.stat().st_size for f in files) < 1.5 * likely


def test_a_figure_that_cannot_be_saved_leaves_no_output(command: Commands) -> None:
    (command.folder / "file").touch()
    code, out, message = command("run", "run.toml", "--json", "--set", "output.figure=file/run.png")
    assert (code, out) == (2, "") and "file/run.png could not be written" in message
    assert (command.folder / "run.zarr").is_dir()


def test_no_room_on_the_disk(command: Commands, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(10**6, 10**6 - 1000, 1000))
    code, _, message = command("run", "run.toml", "--no-figure")
    assert code == 2 and "got 1e+03 bytes" not in message and "free, got 1 KB" in message and "every" in message
    sweep = ["--set", "sweep.grid.system.alpha=[0.5, 1.0]", "--workers", "0", "--set", "sweep.save=['trajectories']"]
    code, _, message = command("sweep", "run.toml", *sweep)
    assert code == 2 and "free, got 1 KB" in message
    assert [p.name for p in command.folder.iterdir()] == ["run.toml"]


def test_a_long_run_is_estimated_before_it_begins(command: Commands, monkeypatch: pytest.MonkeyPatch) -> None:
    from kreisel.cli import runs

    monkeypatch.setattr(runs, "MAY_BE_LONG", 1)
    assert "Ctrl-C stops it" not in command("run", "run.toml", "--no-figure")[2]
    monkeypatch.setattr(runs, "LONG_SECONDS", 0.0)
    code, _, message = command("run", "run.toml", "--no-figure", "--overwrite")
    assert code == 0 and message.startswith("about ") and "on disk" in message and "kreisel resume run.zarr" in message
    plan = make_plan(TOP, X0, dt=0.05, steps=10**9, every=1000)
    found = planning.estimate(plan, command.folder)
    assert (
        1 < found.seconds < 10_000 and 5e7 < found.bytes < 2e8
    )  # 30 ns a step; 10^6 rows of 136 bytes, most of them alike


def test_help_has_the_keys_of_a_sweep(command: Commands) -> None:
    out = command("sweep", "--help")[1]
    assert all(word in out for word in ("[sweep.grid]", "[sweep.random]", "loguniform", "draws = 50", "--set"))
