"""Formulas as MathML, converted from LaTeX as the pages are built: drawn without a script or a network."""

from __future__ import annotations

from docutils import nodes
from math_core import LatexError, LatexToMathML
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

_converter = LatexToMathML(fancy_error=False)
_log = logging.getLogger(__name__)


def to_mathml(latex: str, display: bool) -> str:
    """MathML of a formula; one with a number (``\\tag``) is an equation.

    Raises
    ------
    LatexError
        When the formula holds what the converter does not know.
    """
    if r"\tag" in latex:
        latex = rf"\begin{{equation}}{latex}\end{{equation}}"
    return _converter.convert_with_local_state(latex.strip(), displaystyle=display)


def _written(translator: HTML5Translator, node: nodes.Node, tag: str, display: bool) -> None:
    try:
        formula = to_mathml(node.astext(), display)
    except LatexError as error:
        _log.warning("no MathML for %r: %s", node.astext(), error, location=node)
        formula = translator.encode(node.astext())
    translator.body.append(f'<{tag} class="math notranslate">{formula}</{tag}>')
    raise nodes.SkipNode


def _inline(translator: HTML5Translator, node: nodes.math) -> None:
    _written(translator, node, "span", display=False)


def _block(translator: HTML5Translator, node: nodes.math_block) -> None:
    _written(translator, node, "div", display=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Make the renderer known; `html_math_renderer` chooses it."""
    app.add_html_math_renderer("mathml", inline_renderers=(_inline, None), block_renderers=(_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
