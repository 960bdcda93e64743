"""Configuration of the documentation site: `make docs`."""

import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

from site_pages import write_pages  # noqa: E402

project = "manip"
copyright = "manip contributors"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
root_doc = "index"
exclude_patterns = ["own_task", "own_algorithm"]

# Markdown: anchors as GitHub writes them.
myst_heading_anchors = 4
myst_enable_extensions = ["deflist"]

# Docstrings: Google style, with code in single backticks.
default_role = "code"
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_mock_imports = ["stable_baselines3"]
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_class_signature = "separated"
napoleon_use_ivar = True
napoleon_use_rtype = False
python_maximum_signature_line_length = 88

html_theme = "furo"
html_title = "manip"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False


def links_in_site(app: object, document: str, source: list[str]) -> None:
    """Point links to the README, which GitHub shows, to the site's first page."""
    if not document.startswith("generated/"):
        source[0] = source[0].replace("](../README.md", "](index.md")


def skip_fields(
    app: object, what: str, name: str, obj: object, skip: bool, options: object
) -> bool | None:
    """Leave out what a NamedTuple adds: the class's docstring describes its fields."""
    added = (obj.__doc__ or "").startswith("Alias for field number")
    return True if added or name == "__new__" else None


def setup(app: object) -> None:
    """Write the generated pages, then let Sphinx read all of them."""
    write_pages(DOCS / "generated")
    app.connect("source-read", links_in_site)  # type: ignore[attr-defined]
    app.connect("autodoc-skip-member", skip_fields)  # type: ignore[attr-defined]
