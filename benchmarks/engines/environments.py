"""An environment for each engine, under .venv-engines: a virtual environment or a folder of node modules."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
ROOT = HERE.parent.parent / ".venv-engines"
PINS = HERE / "pins.toml"
INSTALL = 600  # s

__all__ = ["adapter", "command", "install", "pins"]


def pins() -> dict[str, list[str]]:
    """Name of an environment -> the packages in it with their versions."""
    return tomllib.loads(PINS.read_text(encoding="utf-8")) if PINS.exists() else {}


def adapter(engine: dict[str, Any]) -> Path:
    """The engine's adapter."""
    return HERE / "adapters" / f"with_{engine['adapter']}"


def command(engine: dict[str, Any]) -> tuple[list[str], Path]:
    """The command that runs the engine's adapter, and the folder to run it in, where engines write their logs.

    Modules of JavaScript are looked for from the file that imports them, so that adapters are copied to the folder.
    """
    script, folder = adapter(engine), ROOT / engine["name"]
    folder.mkdir(parents=True, exist_ok=True)
    if engine["index"] == "npm":
        for file in (script, script.with_name("wire.mjs")):
            shutil.copyfile(file, folder / file.name)
        return ["node", script.name], folder
    python = sys.executable if engine["index"] == "here" else str(folder / "bin" / "python")
    return [python, "-B", str(script)], folder


def install(engine: dict[str, Any], fresh: bool = False) -> str:
    """Installs the packages of pins.toml, or, fresh, the requirements of the engine; returns the packages.

    Raises `RuntimeError` with the reason.
    """
    if engine["index"] == "here":
        return ""
    name = engine["name"]
    wanted = engine["packages"] if fresh or name not in pins() else pins()[name]
    folder, stamp = ROOT / name, ROOT / name / ".installed"
    text = "\n".join(wanted)
    if stamp.exists() and stamp.read_text(encoding="utf-8") == text:
        return text
    folder.mkdir(parents=True, exist_ok=True)
    if engine["index"] == "npm":
        (folder / "package.json").write_text('{"private": true, "type": "module"}\n', encoding="utf-8")
        options = ["--no-audit", "--no-fund", "--no-save", "--ignore-scripts", "--no-package-lock"]
        _call(["npm", "install", "--silent", *options, *wanted], folder)
    else:
        _call([sys.executable, "-m", "venv", str(folder)], folder)
        pip = [str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        sources = [f"--no-binary={package}" for package in engine.get("from_source", ())]
        _call([*pip, "--only-binary=:all:", *sources, *wanted], folder)
    stamp.write_text(text, encoding="utf-8")
    return text


def listed(engine: dict[str, Any]) -> list[str]:
    """The packages of an environment that is installed, with their versions."""
    folder = ROOT / engine["name"]
    if engine["index"] == "npm":
        found = json.loads(_call(["npm", "ls", "--all", "--json"], folder))
        packages: dict[str, str] = {}
        queue = [found.get("dependencies", {})]
        while queue:
            for name, record in queue.pop().items():
                if "version" in record:
                    packages[name] = record["version"]
                queue.append(record.get("dependencies", {}))
        return [f"{name}@{version}" for name, version in sorted(packages.items())]
    freeze = _call([str(folder / "bin" / "python"), "-m", "pip", "freeze", "--disable-pip-version-check"], folder)
    return sorted(line for line in freeze.splitlines() if "==" in line)


def _call(words: list[str], folder: Path) -> str:
    try:
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=INSTALL, check=False)
    except FileNotFoundError:
        raise RuntimeError(f"{words[0]} is missing") from None
    except subprocess.TimeoutExpired:
        raise RuntimeError(f"not installed within {INSTALL} s") from None
    if done.returncode:
        lines = [line for line in (done.stderr or done.stdout).splitlines() if line.strip()]
        errors = [line for line in lines if "error" in line.lower()]
        raise RuntimeError((errors or lines or ["no reason was given"])[-1].strip()[:200])
    return done.stdout
