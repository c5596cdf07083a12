"""Formulas as MathML, which browsers draw by themselves: no script, no font and no server of others."""

import re

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

FENCE = re.compile(r"<mo(?: class=\"math(?:open|close)\")?>([⟨⟩|{}])</mo>")

MATRIX = re.compile(r"<mo>\(</mo>\s*<mtable>(.*?)</mtable>\s*<mo>\)</mo>", re.DOTALL)  # brackets by the style sheet


def mathml(tex, block=False):
    """A formula; bars and brackets keep their height, and a prime is a superscript."""
    markup = tex2mathml(re.sub(r"'", r"^{\\prime}", tex), as_block=block)
    markup = MATRIX.sub(r'<mtable class="matrix">\1</mtable>', markup)
    return FENCE.sub(r'<mo stretchy="false" lspace="0" rspace="0">\1</mo>', markup)


def _draw(self, node, block):
    tex = node.astext().strip()
    if block and ("\\\\" in tex or "&" in tex) and "\\begin" not in tex:
        tex = f"\\begin{{aligned}}{tex}\\end{{aligned}}"
    markup = mathml(tex, block)
    self.body.append(f'<div class="math">{markup}</div>' if block else markup)
    raise nodes.SkipNode


def setup(app):
    """The renderer "mathml" of `html_math_renderer`."""
    inline = (lambda self, node: _draw(self, node, False), None)
    app.add_html_math_renderer("mathml", inline, (lambda self, node: _draw(self, node, True), None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
