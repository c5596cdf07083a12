"""kr.lab.investigate and `kreisel investigate`: verdicts on maps with a known answer, pages, and bad input."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.lab import growth, integrals, investigation, questions
from kreisel.lab.investigation import investigate, typical
from kreisel.lab.subject import subject
from kreisel.system import REGISTRY
from support import docs_tool

F = Fraction
SHORT = {"steps": 2000}


def array(*entries: object) -> np.ndarray:
    out = np.empty(len(entries), dtype=object)
    out[:] = entries
    return out


def henon(x, *, a, b):
    return array(1 + x[1] - a * x[0] * x[0], b * x[0])


def mcmillan(x, *, a):
    return array(x[1], a * x[1] / (1 + x[1] * x[1]) - x[0])


def qrt(x):  # of Quispel, Roberts and Thompson, asymmetric: two reflections that share a pencil of biquadratics
    y = (1 - x[1]) / x[0]
    return array(y, (2 + y) / x[1])


def test_an_integrable_map_of_the_registry() -> None:
    found = investigate("lagrange-top", **SHORT)
    assert found.verdict == "integrable"
    assert [found[q].answer for q in ("Poisson", "volume", "reversible", "Lax pair")] == ["yes"] * 3 + ["complete"]
    assert abs(float(found["order"].answer) - 1) < 0.15
    assert found["integrals"].evidence.endswith("3 m1^2 - m1 a2 + 3 m2^2 + m2 a1 + 6 a3")
    assert "integrable" in str(found) and "deg" in str(found)


def test_an_implicit_map_in_floats() -> None:
    found = investigate("euler-top", **SHORT)
    assert found.verdict == "integrable" and found.reason.endswith("in floats")
    assert abs(float(found["order"].answer) - 2) < 0.15
    assert found["degree growth"].answer == "does not apply"


@pytest.mark.parametrize("control", docs_tool("investigated").controls(), ids=lambda control: control[0])
def test_negative_controls(control) -> None:
    _, what, options = control
    found = investigate(what, **options, steps=4000)
    assert found.verdict == "not integrable"
    assert found["Poisson"].answer == ("no bracket found" if "Euler" in control[0] else "yes")


def test_plane_maps() -> None:
    found = investigate(mcmillan, names=("x", "y"), a=F(3, 2), **SHORT)
    assert found.verdict == "integrable" and "(y, x)" in found["reversible"].evidence
    found = investigate(henon, names=("x", "y"), a=F(7, 5), b=F(3, 10), start=lambda draw: draw((2,)) / 9, **SHORT)
    assert found.verdict == "not integrable" and "0.693147" in found["degree growth"].answer
    assert found["Poisson"].answer == "no bracket found"


def test_a_step_on_the_group() -> None:
    from kreisel.system.clebsch import SYSTEM

    def own(M, P, *, b, eps):
        return SYSTEM.map.step(M, P, b=b, eps=eps)

    found = investigate(own, n=3, b=(1, 2, 4), **SHORT)
    assert found.verdict == "integrable" and found["Lax pair"].answer == "none stated"


def spoiled(name: str):
    """A discretization with one thing wrong keeps the verdict from being given."""
    model = typical(REGISTRY[name])
    system = model.system

    def step(m, a, *, p, eps):
        new = system.map.step(m, a, p=p, eps=eps)
        return new[0] + eps**3 / 64 * (a[0] * a[0]) * (new[0] - m), new[1]

    return replace(system, name="spoiled", map=replace(system.map, step=step))(**model.params)


def test_the_lax_pair_of_another_map_carries_nothing() -> None:
    found = investigate(spoiled("lagrange-top"), **SHORT)
    assert found.verdict != "integrable"
    assert found["Lax pair"].answer == "no Lax pair of this map"


def test_evidence_that_contradicts_itself_is_undecided(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "growth", lambda *_: growth.fitted_growth(tuple(2**k for k in range(9))))
    found = investigate("lagrange-top", **SHORT)
    assert found.verdict == "undecided" and "contradicts" in found.reason


@pytest.mark.parametrize(
    ("third", "verdict"),
    [
        (lambda x, y, z: z, "integrable"),
        (lambda x, y, z: -z, "integrable"),
        (lambda x, y, z: 2 * z, "linear"),
        (lambda x, y, z: z + x * x, "undecided"),
        (lambda x, y, z: 2 * z + x * y, "undecided"),
    ],
)
def test_a_map_that_permutes_leaves(third, verdict: str) -> None:
    """{x, y} = 1 is preserved and x^2 + y^2 kept, but the leaves z = const go to others; z^2 brings them back."""

    def step(x):
        return np.array([(3 * x[0] - 4 * x[1]) / 5, (4 * x[0] + 3 * x[1]) / 5, third(*x)], dtype=object)

    found = investigate(step, names=("x", "y", "z"), **SHORT)
    assert found.verdict == verdict
    assert ("permute" in found.reason) == (verdict == "undecided")


def test_the_rule_needs_all_of_its_parts() -> None:
    """Mutants of the rule's own inputs: no bracket, too few integrals, integrals not in involution."""
    liouville = questions.liouville
    what = subject(kr.LagrangeTop(p=(0, 0, 1)), eps=F(1, 3))
    found = integrals.integrals(what, 2)
    assert liouville(what, what.tensor, found, 0).enough
    assert not liouville(what, what.tensor, found[:3], 0).enough
    m = [f for f in integrals.integrals(replace(what, step=lambda x, **k: x), 1)][:2]
    assert not liouville(what, what.tensor, m, 0).enough


# -- pages and the command ----------------------------------------------------------------------------


def test_the_page_needs_nothing_else(tmp_path: Path) -> None:
    found = investigate(mcmillan, names=("x", "y"), a=F(3, 2), **SHORT)
    found.save(tmp_path / "deep" / "page.html")
    html = (tmp_path / "deep" / "page.html").read_text(encoding="utf-8")
    assert "<script" not in html and not re.search(r"(src|href)=", html) and "default-src 'none'" in html
    assert "integrable" in html and html.count("<circle") == len(found.degrees) - 1
    odd = replace(found, name="<b>&", about="<i>")
    assert "<b>" not in odd.html and "&lt;b&gt;&amp;" in odd.html
    (tmp_path / "taken.html").mkdir()
    for name, said in (("taken.html", "unchanged"), ("page.txt", r"ends in \.html, got 'page\.txt'")):
        with pytest.raises(kr.InputError, match=said):
            found.save(tmp_path / name)


OWN = """
import numpy as np
names = ("x", "y")
constants = {"a": 2}
def step(x, *, a):  # Lyness
    out = np.empty(2, dtype=object)
    out[:] = [x[1], (a + x[1]) / x[0]]
    return out
"""


def test_the_command(tmp_path: Path, kreisel: Any) -> None:
    (tmp_path / "own.py").write_text(OWN)
    out = kreisel("investigate", str(tmp_path / "own.py"), "--steps", "1000", "--html", str(tmp_path / "p.html"))
    assert out.returncode == 0, out.stderr
    assert "integrable: 1 independent integral on leaves" in out.stdout and (tmp_path / "p.html").is_file()
    out = kreisel(
        "investigate",
        "lagrange-top",
        "--set",
        "alpha=2",
        "--eps",
        "1/2",
        "--steps",
        "1000",
        "--json",
        "--iterates",
        "6",
    )
    printed = json.loads(out.stdout)
    assert printed["verdict"] == "integrable" and printed["degrees"][:4] == [1, 3, 9, 19]
    assert "alpha = 2" in printed["about"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["lagrange-tap"], "Did you mean 'lagrange-top'"),
        (["heavy-top"], "no map to investigate"),
        (["nowhere.py"], "No file nowhere.py"),
        ([], "Name a system"),
        (["clebsch", "--set", "b"], "--set needs"),
        (["clebsch", "--set", "q=3"], "got 'q'"),
        (["clebsch", "--set", "n=4"], "got n, which the investigation has as a setting"),
        (["clebsch", "--eps", "fast"], "'fast'"),
        (["clebsch", "--steps", "5"], "steps must be"),
    ],
)
def test_bad_commands(words: list[str], message: str, kreisel: Any) -> None:
    out = kreisel("investigate", *words)
    assert out.returncode == 2 and message in out.stderr and "Traceback" not in out.stderr


def test_bad_files(tmp_path: Path) -> None:
    for text, message in (
        ("x = 1", "got 0"),
        ("def step(x):\n    return x", "Say where the step lives"),
        ("names = ('x', 'y')\ndef step(x):\n    return [x[0] ** 0.5, x[1]]", "rational"),
        ("1/0", "line 1: ZeroDivisionError"),
        ("names = ('x', 'y')\ndef step(x):\n    return [x[0] / (x[1] - x[1]), x[1]]", "divides by 0"),
    ):
        (tmp_path / "own.py").write_text(text)
        with pytest.raises(kr.InputError, match=re.escape(message)):
            investigation.investigate_file(tmp_path / "own.py")


ON_GROUP = """
from kreisel.algebra import act, cayley_act, wedge
n, frame = 3, "rest"
constants = {"p": (0, 0, 1)}
def step(m, a, *, p, eps):
    m = m + eps * wedge(a, p)
    return m, cayley_act(eps / 2 * m, a)
"""
IN_PLANE = """
names = ("x", "y")
constants = {"k": 1}
def step(x, *, k, eps):
    v = x[1] - eps * k * x[0]
    return x[0] + eps * v, v
"""


@pytest.mark.parametrize(
    ("text", "order", "reversible"),
    [
        (ON_GROUP + "def flow(m, a, *, p):\n    return wedge(a, p), act(m, a)\n", 1, "unknown"),
        (ON_GROUP + "def involution(m, a, *, p, eps):\n    return -(m + eps * wedge(a, p)), a\n", None, "yes"),
        (IN_PLANE + "def flow(x, *, k):\n    return x[1], -k * x[0]\n", 1, "yes"),
        (IN_PLANE + "def flow(x):\n    return [2 * x[1], -x[0]]\n", "not consistent", "yes"),
        (IN_PLANE + "def involution(x, *, k, eps):\n    return x[0], eps * k * x[0] - x[1]\n", None, "yes"),
    ],
)
def test_all_functions_of_a_file_take_the_state_as_the_step(text, order, reversible, tmp_path) -> None:
    (tmp_path / "own.py").write_text(text)
    found = investigation.investigate_file(tmp_path / "own.py", iterates=3, steps=1000, degree=1)
    answer = found["order"].answer
    if isinstance(order, int):
        assert abs(float(answer) - order) < 0.15
    else:
        assert answer == (order or "no flow stated")
    assert found["reversible"].answer == reversible


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ON_GROUP + "def flow(x):\n    return x\n", "expected flow(M, P)"),
        (ON_GROUP + "def flow(m, a):\n    return m\n", "flow: expected M and P, of the shapes (3, 3), (3,)"),
        (ON_GROUP + "def flow(m, a):\n    return oops\n", "flow failed: NameError"),
        (ON_GROUP + "def flow(m, a, *, q):\n    return m, a\n", "needs q by keyword"),
        (ON_GROUP + "def lax(m, lam):\n    return m\n", "expected lax(M, P, lam)"),
        (ON_GROUP + "def tensor(m, a):\n    return 0\n", "tensor: expected none on e*(3)"),
        (ON_GROUP + "def step(m, a):\n    return m\n", "step: expected M and P"),
        (IN_PLANE + "def flow(M, P):\n    return M\n", "expected flow(x)"),
        (IN_PLANE + "def flow(x):\n    return x[0], x[1], 0\n", "flow: expected an array of the shape (2,)"),
        (IN_PLANE + "def flow(x):\n    return 1 / 0, x[0]\n", "flow failed: ZeroDivisionError"),
        (IN_PLANE + "flow = 3\n", "flow: expected a function of the state"),
        (IN_PLANE + "def tensor(x):\n    return 0, 1\n", "tensor: expected an array of the shape (2, 2)"),
        (IN_PLANE + "def step(x, y):\n    return x\n", "needs y by keyword"),
        (IN_PLANE + "def step(x):\n    return oops\n", "step failed: NameError"),
        (IN_PLANE + "constants = 3\n", "constants: expected names and values"),
        (IN_PLANE + "constants = {'n': 3}\n", "expected parameters, got n"),
        (IN_PLANE + "names = 3\n", "names: expected names of the coordinates"),
    ],
)
def test_other_functions_of_a_file_are_refused(text, message, tmp_path) -> None:
    (tmp_path / "own.py").write_text(text)
    with pytest.raises(kr.InputError, match=re.escape(message)):
        investigation.investigate_file(tmp_path / "own.py", iterates=3, steps=1000, degree=1)


def test_bad_calls() -> None:
    with pytest.raises(kr.InputError, match="model"):
        investigate(3)
    with pytest.raises(kr.InputError, match="by keyword"):
        investigate(lambda M, P, *, c, eps: (M, P), n=3)
    with pytest.raises(kr.InputError, match="A model has its parameters"):
        investigate(kr.Clebsch(b=(1, 2, 4)), a=1)
    with pytest.raises(kr.InputError, match="frame"):
        investigate(lambda M, P: (M, P), n=3, frame="space")


def test_a_bracket_of_the_plane_has_no_casimirs() -> None:
    """x'/x = y/x and y'/y = y/x + 5, so y/x goes up by 5: {x, y} = x^2 is preserved, of rank 2; nothing permutes."""
    report = investigate(lambda x: array(x[1], x[1] * (x[1] / x[0] + 5)), names=("x", "y"), **SHORT)
    assert report["Poisson"].answer == "yes"
    assert report.verdict == "undecided"
    assert report.reason.startswith("neither enough integrals")
