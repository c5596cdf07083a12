"""An FMU (FMI 3.0, co-simulation) of a free body: torque in, attitude and angular velocity out, in SI units.

[Modelica Association, Functional Mock-up Interface Specification 3.0, 2022]
"""

from __future__ import annotations

import hashlib
import io
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from importlib import resources
from pathlib import Path

from kreisel.algebra import Array

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-shared", "-fPIC", "-std=c99", "-O2", "-ffp-contract=off")
LIBRARIES = {"linux": ".so", "darwin": ".dylib"}
MACHINES = {"arm64": "aarch64", "AMD64": "x86_64"}
EPOCH = (1980, 1, 1, 0, 0, 0)  # of the files in an archive: the same bytes each time
INPUT = 'causality="input" variability="continuous"'
OUTPUT = 'causality="output" variability="continuous" initial="exact"'
PARAMETER = 'causality="parameter" variability="fixed" initial="exact"'
VARIABLES = (  # name, components, attributes of FMI, meaning
    ("torque", ".x .y .z", f'{INPUT} unit="N.m"', "torque along the body axes, constant within a communication step"),
    ("attitude", ".w .x .y .z", OUTPUT, "unit quaternion, body axes to space"),
    ("angular_velocity", ".x .y .z", f'{OUTPUT} unit="rad/s"', "angular velocity along the body axes"),
    ("inertia", ".xx .yy .zz .yz .zx .xy", f'{PARAMETER} unit="kg.m2"', "inertia tensor about the centre of mass"),
    ("step", "", f'{PARAMETER} unit="s"', "longest step within a communication step"),
)
FLOAT = '    <Float64 name="{}" valueReference="{}" {} start="{!r}" description="{}"/>'.format


def fmu(name: str, header: str, inertia: Array, dt: float) -> bytes:
    """The archive: a description, sources in C, and a library if a C compiler is installed (Linux, macOS).

    header   the file of C of a free body with this name
    inertia  the default tensor (3, 3), kg m^2;  dt the default of the longest step, s
    """
    tensor = inertia[[0, 1, 2, 1, 2, 0], [0, 1, 2, 2, 0, 1]].tolist()
    start = [0.0, *[0.0] * 3, 1.0, *[0.0] * 6, *tensor, dt]
    words = {"name": name, "title": "Free rigid body", "start": ", ".join(map(repr, start))}
    words["token"] = hashlib.sha256((header + words["start"]).encode()).hexdigest()
    entries = [(f"{group}{k}", *about) for group, parts, *about in VARIABLES for k in parts.split() or [""]]
    numbered = list(enumerate(entries, 1))
    words["variables"] = "\n".join(FLOAT(x, k, about, start[k], meaning) for k, (x, about, meaning) in numbered)
    words["outputs"] = "\n".join(f'    <Output valueReference="{k}"/>' for k, x in numbered if OUTPUT in x[1])
    sources = {f"{name}.c": _filled("fmu.c", words), f"{name}.h": header}
    files = {
        "modelDescription.xml": _filled("fmu.xml", words).encode(),
        "sources/buildDescription.xml": _filled("build.xml", words).encode(),
        **{f"sources/{path}": text.encode() for path, text in sources.items()},
        **_compiled(name, sources),
    }
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as z:
        for path, content in files.items():
            z.writestr(zipfile.ZipInfo(path, EPOCH), content, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def _filled(template: str, words: dict[str, str]) -> str:
    text = resources.files("kreisel.languages").joinpath("templates", template).read_text(encoding="utf-8")
    for word, value in words.items():
        text = text.replace(f"@{word}@", value)
    return text


def _compiled(name: str, sources: dict[str, str]) -> dict[str, bytes]:
    compiler, suffix = next(filter(None, map(shutil.which, COMPILERS)), None), LIBRARIES.get(sys.platform)
    if compiler is None or suffix is None:
        return {}
    machine, library = MACHINES.get(platform.machine(), platform.machine()), f"{name}{suffix}"
    with tempfile.TemporaryDirectory() as folder:
        for path, text in sources.items():
            Path(folder, path).write_text(text, encoding="utf-8")
        command = [compiler, *FLAGS, f"{name}.c", "-o", library, "-lm"]
        if subprocess.run(command, cwd=folder, capture_output=True, check=False, timeout=120).returncode:
            return {}
        return {f"binaries/{machine}-{sys.platform}/{library}": Path(folder, library).read_bytes()}
