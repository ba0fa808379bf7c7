"""Configuration of the site: ``make docs``. Its pages are the Markdown files of the repository and a made reference."""

import importlib.metadata
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

project = "offtrack"
release = importlib.metadata.version("offtrack")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "reference"]
root_doc = "docs/index"
include_patterns = ["*.md", "docs/*.md", "docs/**/*.md", "[a-z]*/README.md"]
exclude_patterns = [".venv", "build", "runs", "tests", "**/__pycache__"]
html_theme = "furo"
html_title = "offtrack"
html_theme_options = {
    name: {"color-brand-primary": colour, "color-brand-content": colour}
    for name, colour in (("light_css_variables", "#1f5f99"), ("dark_css_variables", "#7db7ea"))
}
html_static_path, html_css_files = [str(ROOT / "docs/static")], ["site.css"]
html_copy_source = False
html_math_renderer = "mathml"  # shown without a script and without a network
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
autodoc_default_options = {"members": True}
autodoc_typehints = "none"
autodoc_member_order = "bysource"
