"""The tennis racket after an hour: the wing nut of the check cases for 3,600 s, in five engines and in Kreisel.

    python benchmarks/engines/hour.py

Each engine has the setting that its documentation calls the more accurate, and the step of its users.  Writes
results/hour.json: for each the part of the momentum along the middle axis over the last minute, the attitude in the
last seconds, and the energy and the momentum, relative to those of the start, once a minute.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import environments
import numpy as np
import scorecard

import kreisel as kr

RESULT = Path(__file__).parent.parent / "results" / "hour.json"
ENGINES = {"mujoco": "RK4", "jolt": "gyroscopic", "physx": "gyroscopic", "ammo": "2", "rapier": "default"}
DEFAULT = ("mujoco", "Euler")  # its default setting, of which only the end is kept
HOUR, LAST, FILM, ROWS = 3600.0, 60.0, 9.0, 20  # s; s; s; rows a second
LIMIT = 1200.0  # s
BODY = next(body for body in scorecard.BODIES if body.name == "wing-nut")


def job(engine: dict[str, Any], setting: str) -> dict[str, Any]:
    """The job of the protocol for an hour, a row for each picture."""
    by = max(1, round(1 / (ROWS * engine["step"])))
    dt = 1 / (ROWS * by)
    task = scorecard.job(BODY, 0.01, setting, engine["package"])
    return task | {"dt": dt, "steps": round(HOUR * ROWS) * by, "every": by}


def measured(text: str) -> dict[str, Any]:
    """Values for the picture, from an adapter's answer."""
    answered = scorecard.answer(text)
    inertia = np.diag(scorecard.job(BODY, 0.01, "", "")["inertia"])
    return numbers(answered.attitude, answered.rates, inertia) | {"version": answered.about["version"]}


def numbers(attitude: Any, rates: Any, inertia: Any) -> dict[str, Any]:
    """Energy and momentum once a minute, relative; near the end the middle momentum, attitudes."""
    momentum = rates * inertia
    energy, length = (rates * momentum).sum(1), np.linalg.norm(momentum, axis=1)
    last = slice(1 - round(LAST * ROWS), None, 2)
    return {
        "energy": [float(f"{e:.12g}") for e in energy[:: 60 * ROWS] / energy[0]],
        "momentum": [float(f"{e:.12g}") for e in length[:: 60 * ROWS] / length[0]],
        "middle": [float(f"{e:.3g}") for e in (momentum[:, 1] / length)[last]],
        "attitude": np.round(attitude[-round(FILM * ROWS) :], 3).tolist(),
    }


PROGRAM = """#include "rock.h"
#include <stdio.h>
int main(void) {{
    const double I[3] = {{{inertia}}}, w[3] = {{{rates}}};
    rock_constants c;
    rock_state s = {{{{0, 0, 0}}, {{1, 0, 0, 0}}}};
    rock_prepare(&c, I, 1.0 / 60);
    for (int i = 0; i < 3; i++) s.M[i] = I[i] * w[i];
    for (int k = 0; k <= {rows}; k++) {{
        for (int i = 0; i < 4; i++) printf("%.17g,", s.g[i]);
        printf("%.17g,%.17g,%.17g\\n", s.M[0] / I[0], s.M[1] / I[1], s.M[2] / I[2]);
        rock_advance(&c, &s, {steps});
    }}
    return 0;
}}
"""


def by_file() -> dict[str, Any]:
    """The hour by the file in C, 60 steps a second."""
    task = scorecard.job(BODY, 0.01, "", "")
    inertia, rates = np.diag(task["inertia"]).tolist(), task["angular_velocity"]
    words = {"inertia": ", ".join(map(repr, inertia)), "rates": ", ".join(map(repr, rates))}
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "rock.h").write_text(kr.code(kr.physical.FreeBody(inertia), name="rock"), encoding="utf-8")
        program = PROGRAM.format(rows=round(HOUR * ROWS), steps=60 // ROWS, **words)
        Path(folder, "main.c").write_text(program, encoding="utf-8")
        flags = ["-std=c99", "-O2", "-ffp-contract=off"]
        subprocess.run(["gcc", *flags, "main.c", "-o", "main", "-lm"], cwd=folder, check=True)
        text = subprocess.run(["./main"], cwd=folder, check=True, capture_output=True, text=True).stdout
    rows = np.array([line.split(",") for line in text.split()], float)
    return numbers(rows[:, :4], rows[:, 4:], np.array(inertia)) | {"version": kr.__version__}


if __name__ == "__main__":
    catalogue = tomllib.loads((environments.HERE / "engines.toml").read_text(encoding="utf-8"))
    out = {}
    for name, setting in (*ENGINES.items(), DEFAULT):
        engine = {"name": name, **catalogue[name]}
        environments.install(engine)
        words, folder = environments.command(engine)
        task = job(engine, setting)
        done = subprocess.run(
            words, cwd=folder, input=json.dumps(task), capture_output=True, text=True, timeout=LIMIT, check=False,
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": ""},
        )  # fmt: skip
        if (name, setting) == DEFAULT:
            answered = scorecard.answer(done.stdout)
            out[name]["default_not_finite_s"] = float(answered.times[~np.isfinite(answered.rates).all(1)][0])
            continue
        label = next(e["label"] for e in engine["settings"] if e["name"] == setting)
        out[name] = {"title": engine["title"], "setting": label, "dt": task["dt"], **measured(done.stdout)}
        print(name, task["dt"], out[name]["energy"][::20], out[name]["momentum"][::20], flush=True)
    out["kreisel"] = {"title": "Kreisel", "setting": "file in C", "dt": 1 / 60, **by_file()}
    print("kreisel", out["kreisel"]["energy"][-1] - 1, out["kreisel"]["momentum"][-1] - 1)
    lines = [f" {json.dumps(name)}: {json.dumps(record)}" for name, record in out.items()]
    RESULT.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
