"""Links of the built site: within it the file and the anchor exist, outside the address is of a host that is named here.

A build has no network, so that no address outside is visited; `make links` does that.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from urllib.parse import unquote, urlsplit

HOSTS = ("semver.org",)
LINK = re.compile(r"""<(?:a|img|link|script|source)\b[^>]*?\b(?:href|src)="([^"]*)\"""")
ANCHOR = re.compile(r"""<[a-zA-Z][^>]*?\bid="([^"]*)\"""")


def wrong_links(pages: Iterable[Path]) -> list[str]:
    """A sentence for each link of the pages (HTML files) that leads nowhere, or out of the site to a host that is not named."""
    return [wrong for page in pages for link in LINK.findall(text_of(page)) if (wrong := wrong_link(page, link))]


def wrong_link(page: Path, link: str) -> str:
    """What is wrong with a link of a page; "" where nothing is."""
    try:
        parts = urlsplit(link)
    except ValueError as error:
        return f"{page.name}: {link} is no address: {error}"
    if parts.scheme or parts.netloc:
        if parts.scheme in ("data", "mailto") or (parts.scheme == "https" and parts.netloc in HOSTS):
            return ""
        return f"{page.name}: {link} leads out of the site; expected https and a host of docs/links.py: {', '.join(HOSTS)}"
    target = page.parent / unquote(parts.path) if parts.path else page
    if not target.is_file():
        return f"{page.name}: {link} is no file of the site"
    if parts.fragment and target.suffix == ".html" and unquote(parts.fragment) not in anchors_of(target):
        return f"{page.name}: {link} names no anchor of {target.name}"
    return ""


@cache
def text_of(page: Path) -> str:
    """The page as it is written; read once."""
    return page.read_text(encoding="utf-8")


@cache
def anchors_of(page: Path) -> frozenset[str]:
    """The anchors of a page."""
    return frozenset(ANCHOR.findall(text_of(page)))
