"""The documentation as a site: `make docs` builds it into build/docs."""

from pathlib import Path

import fastcollide
from docutils import nodes
from fastcollide.scene_text import new_scene

GENERATED = Path(__file__).parent / "generated"

project = "FastCollide"
author = "FastCollide contributors"
copyright = author
version = release = fastcollide.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_click"]
exclude_patterns = ["generated"]
nitpicky = True
# Types of other libraries; their documentation is not asked, so that the build needs no network.
nitpick_ignore_regex = [
    (r"py:.*", r"(numpy|np|collections|pathlib|os|typing|PIL)\..*"),
    (r"py:class", r"NDArray.*|ArrayLike"),
    (r"py:exc", r"OSError"),
]

myst_enable_extensions = ["html_image"]
myst_heading_anchors = 3
myst_links_external_new_tab = False

smartquotes = False  # "wall" and --test are to be typed as they stand
default_role = "literal"  # of `single backticks` in docstrings
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {"ArrayLike": "ArrayLike", "NDArray": "NDArray"}
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
python_maximum_signature_line_length = 100
toc_object_entries = False

html_theme = "furo"
html_title = "FastCollide"
html_show_sphinx = False
html_copy_source = False

# Pages outside docs/ are links in the tree of the sources, and pages of the site.
ABOVE = {
    "../ARCHITECTURE.md": "architecture.md",
    "../CONTRIBUTING.md": "contributing.md",
    "../CHANGELOG.md": "changelog.md",
    "../README.md": "index.md",
}


def link_to_pages(app, name, source):
    for above, page in ABOVE.items():
        source[0] = source[0].replace(f"]({above}", f"]({page}")


def draw_dashes(app, doctree):
    """The two hyphens that Sphinx puts behind the name of an argument."""
    for text in list(doctree.findall(nodes.Text)):
        if text == " -- ":
            text.parent.replace(text, nodes.Text(" – "))


def setup(app):
    GENERATED.mkdir(exist_ok=True)
    (GENERATED / "scene.toml").write_text(new_scene(), encoding="utf-8")
    app.connect("source-read", link_to_pages)
    app.connect("doctree-read", draw_dashes)
