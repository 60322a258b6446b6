"""Settings of the documentation site: `make docs` builds it from `docs/`."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

project = "cspace-sampler"
author = "the authors of cspace-sampler"
project_copyright = author
version = release = version_of(project)

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "extension",
]
root_doc = "index"
source_suffix = {".md": "markdown", ".myst": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["examples", "images", "site/static", "site/templates", "gallery/*.py", "gallery/*.ipynb"]
exclude_patterns += ["gallery/sg_execution_times.rst", "sg_execution_times.rst"]
templates_path = ["templates"]
language = "en"
nitpicky = True
# The reference names what users touch; types of other packages, and those within, are words.
nitpick_ignore_regex = [("py:.*", ".*")]

myst_heading_anchors = 4
myst_links_external_new_tab = False
# The pages are plain Markdown; no more than tables and links beyond CommonMark.
myst_enable_extensions: list[str] = []

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_preserve_defaults = True
autodoc_mock_imports: list[str] = []

sphinx_gallery_conf = {
    "examples_dirs": [str(HERE.parent / "examples")],
    "gallery_dirs": [str(HERE.parent / "gallery")],
    "filename_pattern": r"/plot_",
    "within_subsection_order": "FileNameSortKey",
    "show_memory": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_signature": False,
}

html_theme = "furo"
html_title = f"cspace-sampler {version}"
html_static_path = ["static"]
html_favicon = "static/favicon.svg"
html_css_files = ["site.css"]
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False
html_domain_indices = False
html_theme_options = {
    "navigation_with_keys": True,
    "light_css_variables": {"font-stack": "system-ui, sans-serif"},
}
# Many pages are documents of one topic; the table of contents on the right shows two levels.
toc_object_entries = False

# Outside links lead to other people's servers: `make docs` follows links between the pages, and
# `sphinx-build -b linkcheck` these as well where the internet can be reached.
linkcheck_ignore = [r"http://127\.0\.0\.1", r"http://localhost"]
