"""The page of the documentation whose tops run in the browser."""

from __future__ import annotations

import importlib
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import browser
from support import DOCS


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The page, made in a folder of its own."""
    monkeypatch.syspath_prepend(str(DOCS / "tools"))
    shutil.copytree(DOCS / "static", tmp_path / "static")
    importlib.import_module("playground").write(tmp_path)
    return tmp_path / "generated" / "extra" / "live" / "playground.html"


def test_its_flow_is_that_of_its_step(page: Path) -> None:
    """A short step of the classical method beside it, with the same right-hand side, ends in the same state."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no Node")
    (script,) = re.findall(r"<script>\n(.*?)</script>", page.read_text(encoding="utf-8"), re.DOTALL)
    code = """
for (const [name, h] of [["top", 4], ["body", 12]]) {
  const s = SYSTEMS[name];
  s.CONSTANTS[h] = 0.002;
  const x = Float64Array.from(s.START), body = new s.Body();
  for (let i = 0; i < 50; i++) { body.advance(1); rungeKutta(x, 0.002, s.flow); }
  console.log(JSON.stringify([Array.from(body.observe().slice(0, x.length)), Array.from(x)]));
}"""
    run = {"input": script + code, "check": True, "capture_output": True, "text": True, "timeout": 120}
    out = subprocess.run([node, "-"], **run).stdout
    for line in out.splitlines():
        ours, theirs = json.loads(line)
        assert max(abs(a - b) for a, b in zip(ours, theirs, strict=True)) < 1e-11
        assert ours != theirs


@pytest.mark.skipif(browser.find() is None, reason=f"no browser: none of {', '.join(browser.NAMES)}")
def test_it_runs_without_a_network(page: Path) -> None:
    window = browser.Browser()
    try:
        window.open(page.as_uri())
        window.wait("typeof now !== 'undefined' && now.steps >= 400")
        window.run("document.getElementById('dt').value = 0.3")
        for name in ("body", "top"):
            window.run(f"document.getElementById('system').value = '{name}'; start()")
            window.wait(f"now.name === '{name}' && now.steps >= 200")
            ours, theirs = (float(window.run(f"document.getElementById('{i}').textContent")) for i in ("map", "rk"))
            assert ours < 1e-12 < 1e-11 < theirs
        window.run("document.getElementById('pause').click()")
        steps = window.run("now.steps")
        assert window.run("new Promise(done => setTimeout(() => done(now.steps), 300))") == steps
        for width in (390, 1200):  # a telephone, and a desk
            window.ask(
                "Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=2, mobile=width < 400
            )
            window.wait(f"window.innerWidth === {width}")
            assert window.run("document.body.scrollWidth <= window.innerWidth")
            beside = window.run(
                "['sphere', 'chart'].map(id => document.getElementById(id).getBoundingClientRect().top).join(' ')"
            ).split()
            assert (beside[0] == beside[1]) is (width > 400)
        window.run("const s = document.getElementById('pace'); s.value = 3; s.dispatchEvent(new Event('input'))")
        window.run("document.getElementById('pause').click()")
        window.wait(f"now.steps >= {steps} + 3000 && now.steps % 1000 === {steps % 1000}")
        assert window.run("Math.max(...now.paths.map(p => p.length)) <= 3000")
        assert float(window.run("document.getElementById('map').textContent")) < 1e-12
        assert window.complaints == []
        assert window.requests == [page.as_uri()]
    finally:
        window.close()
