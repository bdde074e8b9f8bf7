"""Changes posted to an address of the web, from a thread of their own, so that the watch never waits for it."""

from __future__ import annotations

import base64
import threading
from collections import deque
from collections.abc import Callable
from http.client import HTTPException
from types import TracebackType
from typing import Any
from urllib.error import HTTPError
from urllib.parse import unquote, urlsplit, urlunsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from fusion_sfdia.live.security import require_encrypted

QUEUED = 1000  # lines that wait at most; the oldest is lost first
FLUSH = 5.0  # s at the end for what waits
ANSWER = 4.0  # s within which an answer is expected
FIRST, LONGEST = 1.0, 60.0  # s before the second try, doubled with each further one, at most
TRIES = 10  # for a line that is answered by an error of the server
PASSING = (408, 425, 429)  # answers besides those from 500 on after which a line is tried again


class _NoRedirect(HTTPRedirectHandler):
    """An answer that sends a post elsewhere is an error: urllib would go there with a GET, and with the token."""

    def redirect_request(self, *_: Any) -> None:
        return None


class Webhook:
    """Within its block, lines of JSON are posted to a URL, one a request, in their order.

    url: http:// or https://; a user and a password in it are sent as basic authentication. token: sent as "Authorization:
    Bearer". say: called with a line where the connection is lost or made again, and where lines are lost; it names the host
    alone, as a path may be a secret, too. Without an answer a line is tried again and again, after `FIRST` seconds and doubled
    pauses up to `LONGEST`; with an answer from 500 on, or of `PASSING`, `TRIES` times; any other answer but success loses it.
    At the end of the block what waits has `FLUSH` seconds. pause: waits for so many seconds. ValueError for another URL, for
    both kinds of authentication, for a token that is no text of a header, and for a password or token without encryption,
    unless `allow_plain` accepts that.
    """

    def __init__(
        self,
        url: str,
        say: Callable[[str], object],
        *,
        token: str | None = None,
        allow_plain: bool = False,
        pause: Callable[[float], object] | None = None,
    ) -> None:
        self.say, self.pause = say, pause or self._pause
        self.url, self.name, password = _parts(url)
        if password is not None and token is not None:
            raise ValueError("--webhook has a user and password, and there is a token; give one of them")
        if token is not None and not (token.isascii() and token.isprintable()):
            raise ValueError("the token of --webhook has characters that a header cannot have; expected printable ASCII")
        require_encrypted((password or token) is not None, self.url.startswith("https:"), allow_plain, "use https://")
        self.headers = {"Content-Type": "application/json; charset=utf-8", "User-Agent": "fusion-sfdia"}
        if password is not None:
            self.headers["Authorization"] = f"Basic {base64.b64encode(password.encode()).decode()}"
        if token is not None:
            self.headers["Authorization"] = f"Bearer {token}"
        self.opener = build_opener(_NoRedirect)
        self.waiting: deque[str] = deque()
        self.news = threading.Condition()
        self.lost, self.is_up, self.under_way, self.ending, self.given_up = 0, True, False, False, False
        self.why = ""  # the last change was lost
        self.thread = threading.Thread(target=self._run, daemon=True)

    def post(self, line: str) -> None:
        """Queue a line; of too many the oldest is lost."""
        with self.news:
            if len(self.waiting) >= QUEUED:
                self.waiting.popleft()
                self.lost += 1
            self.waiting.append(line)
            self.news.notify_all()

    def __enter__(self) -> Webhook:
        self.thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with self.news:
            self.ending = True
            self.news.notify_all()
        self.thread.join(FLUSH)
        with self.news:
            self.given_up = True
            self.lost += len(self.waiting) + self.under_way
            self.waiting.clear()
            self.news.notify_all()
        self._say_lost()

    def _run(self) -> None:
        while (line := self._next()) is not None:
            self._send(line)
            self._say_lost()

    def _next(self) -> str | None:
        """The next line, waited for; None at the end."""
        with self.news:
            self.under_way = False
            self.news.wait_for(lambda: self.waiting or self.ending)
            if not self.waiting:
                return None
            self.under_way = True
            return self.waiting.popleft()

    def _send(self, line: str) -> None:
        """Try until the line is taken, or lost."""
        wait, tries = FIRST, 0
        while not self.given_up:
            try:
                with self.opener.open(Request(self.url, line.encode(), self.headers), timeout=ANSWER):
                    if not self.is_up:
                        self.say(f"webhook {self.name}: works again")
                    self.is_up = True
                    return
            except HTTPError as error:
                error.close()
                tries += 1
                why, again = f"answer {error.code}", (error.code >= 500 or error.code in PASSING) and tries < TRIES
            except (OSError, HTTPException) as error:
                why, again = f"no answer, {type(getattr(error, 'reason', error)).__name__}", True
            if not again:
                with self.news:
                    self.lost += not self.given_up  # then it is counted already
                    self.why = f" ({why})"
                return
            if self.is_up:
                self.say(f"webhook {self.name}: {why}; tried again after {FIRST:g} s to {LONGEST:g} s")
            self.is_up = False
            self.pause(wait)
            wait = min(2 * wait, LONGEST)

    def _say_lost(self) -> None:
        with self.news:
            (lost, self.lost), (why, self.why) = (self.lost, 0), (self.why, "")
        if lost:
            self.say(f"webhook {self.name}: {lost} change{'s were' if lost > 1 else ' was'} not taken and lost{why}")

    def _pause(self, seconds: float) -> None:
        """Wait, until the end begins, or is over where it has begun."""
        with self.news:
            before = self.ending
            self.news.wait_for(lambda: self.given_up or self.ending is not before, seconds)


def _parts(url: str) -> tuple[str, str, str | None]:
    """The URL without user and password, its host for messages, and "user:password", None without; ValueError for no URL."""
    try:
        found = urlsplit(url)
        host, port = found.hostname, found.port
        (host or "").encode("idna")  # as the request will be
    except ValueError:
        host, port, found = None, None, urlsplit("")
    if found.scheme not in ("http", "https") or not host or found.fragment or not all("!" <= c <= "~" for c in url):
        raise ValueError("--webhook is no address to which a change can be posted; expected https://host/path")
    at = f"[{host}]" if ":" in host else host
    place = at if port is None else f"{at}:{port}"
    user, password = (None if part is None else unquote(part) for part in (found.username, found.password))
    known = None if user is None else f"{user}:{password or ''}"
    return urlunsplit((found.scheme, place, found.path, found.query, "")), f"{found.scheme}://{place}", known
