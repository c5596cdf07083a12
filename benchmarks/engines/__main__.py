"""The scorecard: the check cases of a spinning body run by many engines, against the exact motion.

    python benchmarks/engines               every engine; make engines
    python benchmarks/engines mujoco rapier these only, the others keep their results
    python benchmarks/engines --fresh NAME  the newest versions, which are written into pins.toml

Each engine runs in a separate environment, under .venv-engines; each run of it is a separate process, which the
adapter in adapters/ makes from a job (adapters/wire.py) and which ends after --limit seconds.  Writes
results/engines.json after every engine.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import environments
import scorecard

from kreisel.bench import machine

HERE = Path(__file__).parent
RESULT = HERE.parent / "results" / "engines.json"
SINGLE = 1e-4  # rad, below which errors of attitude in single precision are rounding's; in double:
DOUBLE = 1e-10


def engines() -> list[dict[str, Any]]:
    """The engines of engines.toml."""
    catalogue = tomllib.loads((HERE / "engines.toml").read_text(encoding="utf-8"))
    return [{"name": name, **record} for name, record in catalogue.items()]


def run(engine: dict[str, Any], job: dict[str, Any], limit: float) -> dict[str, Any]:
    """One run of one job, graded."""
    body = next(body for body in scorecard.BODIES if body.name == job["case"])
    row = {"setting": job["setting"], "case": body.name, "dt": job["dt"]}
    words, folder = environments.command(engine)
    ours = (
        {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p.endswith("src"))} if engine["index"] == "here" else {}
    )
    # One thread, and no graphics card: what runs is the processor's part of each engine.
    quiet = {
        "OMP_NUM_THREADS": "1",
        "CUDA_VISIBLE_DEVICES": "",
        "JAX_PLATFORMS": "cpu",
        "JAX_ENABLE_X64": "1",
        "PYTHONPATH": "",
        **ours,
    }
    try:
        done = subprocess.run(
            words, cwd=folder, input=json.dumps(job), capture_output=True, text=True, timeout=limit, check=False,
            env={**os.environ, **quiet},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {**row, "failed": f"not done within {limit:g} s"}
    try:
        answered = scorecard.answer(done.stdout)
    except ValueError:
        lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        errors = [line for line in lines if "Error" in line or "error" in line]
        return {**row, "failed": (errors or lines or ["no answer"])[-1][:200]}
    graded = scorecard.grade(body, answered)
    return {**row, **answered.about, **graded, "seconds": answered.about["seconds"]}


def measure(engine: dict[str, Any], limit: float, fresh: bool) -> dict[str, Any]:
    """All runs of an engine, or why there are none."""
    record: dict[str, Any] = {"date": datetime.datetime.now(datetime.UTC).date().isoformat()}
    try:
        environments.install(engine, fresh)
    except RuntimeError as reason:
        return {**record, "tried": engine["packages"], "not_installed": str(reason)}
    rows: list[dict[str, Any]] = []
    for setting in engine["settings"]:
        for body in scorecard.BODIES:
            if body.name not in engine.get("cases", [body.name]):
                continue
            if body.given()["arm"] is not None and not setting.get("pivot", engine.get("pivot", True)):
                continue
            step = setting.get("step", engine.get("step"))
            runs = scorecard.jobs(body, step, setting["name"], engine["package"])
            for job in runs if engine.get("finer", True) else runs[:1]:
                rows.append(run(engine, job, limit))
                print(engine["name"], {k: v for k, v in rows[-1].items() if k not in ("end", "summary")}, flush=True)
    for row in rows:
        record |= {key: row.pop(key) for key in ("version", "summary") if key in row}
    floor = SINGLE if engine.get("single") else DOUBLE
    return {**record, "orders": orders(rows, floor), "rows": [rounded(row) for row in rows]}


def orders(rows: list[dict[str, Any]], floor: float) -> dict[str, float | None]:
    """Setting -> order measured."""
    found = {}
    for setting in dict.fromkeys(row["setting"] for row in rows):
        runs = [row for row in rows if row["setting"] == setting and row["case"] == scorecard.HALVED]
        if len(runs) > 1:
            found[setting] = scorecard.order(runs[0], runs[1], floor)
    return found


def rounded(row: dict[str, Any]) -> dict[str, Any]:
    """Errors and times to three digits; the attitude at the end, kept for the picture, to six."""
    out = {}
    for key, value in row.items():
        if key == "end":
            if row["case"] == scorecard.HALVED:
                out[key] = [round(x, 6) for x in value]
        else:
            out[key] = float(f"{value:.3g}") if isinstance(value, float) and key != "dt" else value
    return out


def text(result: dict[str, Any]) -> str:
    """The result as JSON, a run in a line."""
    lines = json.dumps(result, indent=1).splitlines()
    out: list[str] = []
    depth = 5  # spaces in front of a key of a run
    for line in lines:
        inner = len(line) - len(line.lstrip())
        if inner >= depth and out:
            out[-1] += ("" if out[-1].endswith(("{", "[")) else " ") + line.strip()
        elif inner == depth - 1 and line.strip() in ("}", "},") and out:
            out[-1] += line.strip()
        else:
            out.append(line)
    return "\n".join(out) + "\n"


def save(name: str, record: dict[str, Any]) -> None:
    """The record of one engine, merged with the other records in the order of the catalogue."""
    result = json.loads(RESULT.read_text(encoding="utf-8")) if RESULT.exists() else {"engines": {}}
    found = {**result["engines"], name: record}
    ordered = {e["name"]: found[e["name"]] for e in engines() if e["name"] in found}
    RESULT.write_text(text({"machine": machine(), "engines": ordered}), encoding="utf-8")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("names", nargs="*", metavar="NAME", help="engines; default: all")
    options.add_argument("--limit", type=float, default=120.0, help="seconds of a run")
    options.add_argument("--fresh", action="store_true", help="install the newest versions and write pins.toml")
    arguments = options.parse_args()
    catalogue = engines()
    unknown = {*arguments.names} - {engine["name"] for engine in catalogue}
    if unknown:
        options.error(f"expected names of engines.toml, got {', '.join(sorted(unknown))}")
    for engine in catalogue:
        if arguments.names and engine["name"] not in arguments.names:
            continue
        record = measure(engine, arguments.limit, arguments.fresh)
        if arguments.fresh and "rows" in record and engine["index"] != "here":
            pinned = {**environments.pins(), engine["name"]: environments.listed(engine)}
            lines = [f"{json.dumps(name)} = {json.dumps(packages)}" for name, packages in sorted(pinned.items())]
            environments.PINS.write_text("\n".join(lines) + "\n", encoding="utf-8")
        save(engine["name"], record)


if __name__ == "__main__":
    main()
