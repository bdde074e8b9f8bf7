"""Settings of the site, which `make docs` builds from this folder: pages with code run when it is built."""

from __future__ import annotations

import json
import os
import re
import sys
from base64 import b64decode
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any

import nbclient
from jupyter_cache import get_cache
from jupyter_cache.executors import utils
from sphinx.application import Sphinx
from sphinx.util.logging import getLogger

import fusion_sfdia

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path.append(str(HERE))
from links import HOSTS, wrong_links  # noqa: E402

# pages run commands and copy files of docs/examples
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ["DOCS_EXAMPLES"] = str(HERE / "examples")
os.environ["DOCS_RESULTS"] = str(HERE / "results")
os.environ["DOCS_HELPERS"] = str(ROOT / "tests" / "helpers")
os.environ["COLUMNS"] = "100"
os.environ["TTY_COMPATIBLE"] = "0"  # no progress bars of commands
os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"

project = "fusion-sfdia"
author = "fusion-sfdia authors"
version = release = fusion_sfdia.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "sphinx_design"]
exclude_patterns = ["_build", "README.md", "results/README.md", "examples", "paper", "**.ipynb_checkpoints"]
suppress_warnings = ["myst.header"]  # a generated page goes from its title to the third level

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 4

# each page in its own kernel and an empty folder; what ran before and has not changed comes from the cache
nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE / "_build" / "cache")
get_cache(nb_execution_cache_path).get_cache_limit()  # makes its tables, before two processes would at once
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300  # s a cell, also on a busy machine
nb_execution_excludepatterns = ["notebooks/*"]  # they carry their outputs, which a test compares with a fresh run
nb_render_markdown_format = "myst"  # tables that a cell makes
utils.executenb = partial(nbclient.execute, coalesce_streams=True)  # else what a command prints is cut into pieces
nb_ipywidgets_js: dict[str, dict[str, str]] = {}

default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_preserve_defaults = True
maximum_signature_line_length = 90
python_use_unqualified_type_names = True
napoleon_google_docstring = False
napoleon_use_param = napoleon_use_rtype = False  # types are words: (K, N) is no class to link to
napoleon_custom_sections = [("Attributes", "params_style")]  # of settings and results, beside their signature
toc_object_entries_show_parents = "hide"

html_theme = "pydata_sphinx_theme"
html_title = project
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "show_toc_level": 2,
    "header_links_before_dropdown": 6,
    "navbar_align": "left",
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_sidebars = {"whats-new": [], "contributing": []}
copyright = author

nitpicky = True  # a reference in a page or a docstring that leads nowhere is a warning, but for these:
nitpick_ignore_regex = [
    (r"py:obj", r".*"),  # backticks in a docstring: a link where they name something public, else a parameter, a field, a file
    (r"py:class", r"(numpy|filterpy|collections|pathlib|datetime)\..*"),  # other projects have inventories only on the network
    (r"py:class", r"fusion_sfdia\.\w+\..*"),  # types of fields that the text of their class describes
    (r"py:class", r"\w+"),  # the same, and aliases, in annotations that Python does not evaluate
    (r"py:exc", r"\w+"),  # in sections Raises, whose names have no module
]
linkcheck_allowed_redirects = {rf"https://{re.escape(host)}.*": r"https://.*" for host in HOSTS}
linkcheck_timeout = 30  # s

logger = getLogger(__name__)
OUTSIDE = re.compile(r"\[([^\]\n]+)\]\(((?:\.\./)+[^)#\s]*)(#[^)\s]*)?\)")
NOTEBOOK = re.compile(r"\[([^\]]+)\]\((\w+)\.ipynb\)")
CODE = re.compile(r"(`[^`]*`)")
NDARRAY = re.compile(r"~?numpy\.ndarray\[tuple\[~?typing\.Any, \.\.\.\], ~?numpy\.dtype\[~?typing\.Any\]\]")
LISTS = ("Parameters", "Attributes", "Returns", "Yields", "Raises", "Warns")
MARKUP = re.compile(r"([*|]|(?<=\w)_(?!\w))")


def links_outside(app: Sphinx, page: str, source: list[str]) -> None:
    """Links to folders of the repository become their text: a site cannot show a folder. Links of notebooks, which are beside
    `docs` in the repository and within it on the site, begin at the top of the site.
    """
    if page.startswith("notebooks/"):
        source[0] = NOTEBOOK.sub(r"{doc}`\1 </notebooks/\2>`", source[0].replace("](../docs/", "](/"))
        return
    here = (HERE / page).parent

    def shown(link: re.Match[str]) -> str:
        target = here / link[2]
        return link[1] if target.is_dir() or target.resolve() == ROOT / "README.md" else link[0]

    source[0] = OUTSIDE.sub(shown, source[0])


def as_restructured_text(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Docstrings are plain text with sections: an indented block after a colon is shown as it is, stars and bars are no markup,
    and the names of parameters before a colon are code. Runs before napoleon makes lists of the sections.
    """
    try:
        names = "|".join(map(re.escape, signature(obj).parameters))
    except (TypeError, ValueError):
        names = ""
    described = re.compile(rf"(?<![\w`.])((?:{names})(?:, (?:{names}))*):(?=\s|$)") if names else None
    if what == "property" and lines:
        lines[0] = f": {lines[0]}"  # what stands before the first colon is its type for napoleon: here there is none
    section = ""
    for k, line in enumerate(lines):
        if k + 1 < len(lines) and re.fullmatch("-{3,}", lines[k + 1]):
            section = line
        in_list = section in LISTS
        if section == "Examples" or (in_list and not line.startswith(" ")):
            continue  # code, or a name and its type
        indented = line.startswith("        " if in_list else "    ")
        if not indented:
            parts = CODE.split(line)
            line = "".join(p if p.startswith("`") else MARKUP.sub(r"\\\1", p) for p in parts)
            lines[k] = described.sub(r"``\1``:", line) if described else line
        if line.endswith(":") and not indented and [x[:4] for x in lines[k + 1 : k + 3]] == ["", "    "]:
            lines[k] += ":"


def readable(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, arguments: str | None, result: str | None
) -> tuple[str | None, str | None]:
    """A signature with `ndarray` in place of its generic form, as shapes are in the text, and with `...` for a default that a
    dataclass makes anew: `<factory>` is no Python, and the whole signature would be shown as it is.
    """
    arguments, result = (part and NDARRAY.sub("~numpy.ndarray", part) for part in (arguments, result))
    return arguments and arguments.replace("<factory>", "..."), result


def skipped(app: Sphinx, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Fields of a NamedTuple are described in the text of their class."""
    return True if type(obj).__name__ == "_tuplegetter" else None


def thumbnails(app: Sphinx) -> None:
    """The first figure of each notebook, for the gallery."""
    folder = HERE / "_build" / "thumbnails"
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        outputs = [o for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] for o in cell.get("outputs", [])]
        picture = next(o["data"]["image/png"] for o in outputs if "image/png" in o.get("data", {}))
        (folder / f"{path.stem}.png").write_bytes(b64decode("".join(picture)))


def check_links(app: Sphinx, exception: Exception | None) -> None:
    """Each link of the pages leads to a file and an anchor of the site, or to a known host; a warning for each other one."""
    if exception is None and app.builder.name == "html":
        for wrong in wrong_links(Path(app.outdir) / app.builder.get_target_uri(page) for page in sorted(app.env.found_docs)):
            logger.warning(wrong)


def setup(app: Sphinx) -> None:
    """Connect the functions above to the events of a build."""
    app.connect("builder-inited", thumbnails)
    app.connect("source-read", links_outside)
    app.connect("autodoc-process-docstring", as_restructured_text, priority=400)
    app.connect("autodoc-process-signature", readable)
    app.connect("autodoc-skip-member", skipped)
    app.connect("build-finished", check_links)
