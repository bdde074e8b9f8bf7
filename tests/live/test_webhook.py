"""Changes posted to a server of the test, which answers, fails, hangs up or does not exist."""

from __future__ import annotations

import base64
import io
import json
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from toy_plants import readings, tanks

from fusion_sfdia.cli.main import main
from fusion_sfdia.live import webhook
from fusion_sfdia.live.webhook import FIRST, LONGEST, TRIES, Webhook
from fusion_sfdia.logs.csv_log import write_log

PATIENCE = 60  # s, after which the test fails instead of hanging


class Endpoint:
    """Keeps what is posted to it; `answers` are given in turn, then 204; 0 hangs up."""

    def __init__(self) -> None:
        self.posted: list[tuple[str, str, dict[str, str]]] = []
        self.answers: list[int] = []
        self.open = threading.Event()  # before which nothing is answered
        self.open.set()
        self.asked = threading.Semaphore(0)
        kept = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"])).decode()
                kept.asked.release()
                assert kept.open.wait(PATIENCE)
                answer = kept.answers.pop(0) if kept.answers else 204
                if not answer:
                    return self.connection.close()
                kept.posted.append((self.path, body, dict(self.headers)))
                self.send_response(answer)
                self.send_header("Location", "/elsewhere")
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, format: str, *arguments: Any) -> None:
                """Nothing."""

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}"
        threading.Thread(target=self.server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()

    @property
    def bodies(self) -> list[str]:
        return [body for _, body, _ in self.posted]


@pytest.fixture
def endpoint() -> Iterator[Endpoint]:
    found = Endpoint()
    yield found
    found.open.set()
    found.server.shutdown()
    found.server.server_close()


def test_lines_are_posted_in_order_with_the_token(endpoint: Endpoint) -> None:
    with Webhook(f"{endpoint.url}/hook?x=1", pytest.fail, token="secret", allow_plain=True) as hook:
        for k in range(20):
            hook.post(json.dumps({"id": k, "unit": "°C"}, ensure_ascii=False))
    assert [json.loads(b) for b in endpoint.bodies] == [{"id": k, "unit": "°C"} for k in range(20)]
    path, _, headers = endpoint.posted[0]
    assert path == "/hook?x=1" and headers["Authorization"] == "Bearer secret"
    assert headers["Content-Type"] == "application/json; charset=utf-8"


def test_failures_are_tried_again_after_doubled_pauses_and_reported_once(endpoint: Endpoint) -> None:
    endpoint.answers = [500, 429, 0, 503, 500, 500, 500, 503]
    said: list[str] = []
    pauses: list[float] = []
    with Webhook(f"{endpoint.url}/private", said.append, pause=pauses.append) as hook:
        hook.post("1")
        hook.post("2")
    assert endpoint.bodies[-2:] == ["1", "2"] and set(endpoint.bodies[:-1]) == {"1"}
    assert pauses == [min(FIRST * 2**k, LONGEST) for k in range(8)]
    assert said == [
        f"webhook {endpoint.url}: answer 500; tried again after 1 s to 60 s",
        f"webhook {endpoint.url}: works again",
    ]


def test_what_the_server_refuses_or_sends_elsewhere_is_lost_and_counted(endpoint: Endpoint) -> None:
    said: list[str] = []
    endpoint.answers = [404, 302, *[500] * TRIES]
    with Webhook(endpoint.url, said.append, pause=lambda s: None) as hook:
        for line in "1234":
            hook.post(line)
    assert endpoint.bodies == ["1", "2", *["3"] * TRIES, "4"] and {path for path, _, _ in endpoint.posted} == {"/"}
    assert sum("1 change was not taken and lost" in line for line in said) == 3


def test_of_too_many_lines_the_oldest_are_lost(endpoint: Endpoint, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(webhook, "QUEUED", 3)
    endpoint.open.clear()
    said: list[str] = []
    with Webhook(endpoint.url, said.append) as hook:
        hook.post("0")
        assert endpoint.asked.acquire(timeout=PATIENCE)  # it is under way
        for k in range(1, 7):
            hook.post(str(k))
        endpoint.open.set()
    assert endpoint.bodies == ["0", "4", "5", "6"]
    assert said == [f"webhook {endpoint.url}: 3 changes were not taken and lost"]


def test_a_server_that_does_not_answer_delays_the_end_by_a_stated_time_only(
    endpoint: Endpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(webhook, "FLUSH", 0.0)
    endpoint.server.shutdown()
    endpoint.server.server_close()  # nothing listens
    said: list[str] = []
    failed = threading.Event()
    with Webhook(endpoint.url, lambda line: (said.append(line), failed.set())) as hook:
        for line in "123":
            hook.post(line)
        assert failed.wait(PATIENCE)
    hook.thread.join(PATIENCE)  # it gives up although it was in its pause of a second
    assert not hook.thread.is_alive()
    assert said == [
        f"webhook {endpoint.url}: no answer, ConnectionRefusedError; tried again after 1 s to 60 s",
        f"webhook {endpoint.url}: 3 changes were not taken and lost",
    ]


def test_no_message_has_a_password_a_token_or_a_path(endpoint: Endpoint) -> None:
    said: list[str] = []
    secret = endpoint.url.replace("//", "//user:p%40ss@")
    endpoint.answers = [500, 400]
    with Webhook(f"{secret}/T000/B000?key=k", said.append, allow_plain=True, pause=lambda s: None) as hook:
        hook.post("1")
    assert endpoint.posted[0][2]["Authorization"] == f"Basic {base64.b64encode(b'user:p@ss').decode()}"
    assert len(said) == 2 and not any(word in line for line in said for word in ("user", "p%40ss", "p@ss", "T000", "key"))
    for url, more, message in (
        ("https://user:pass@host/x", {"token": "t"}, "a user and password, and there is a token"),
        ("http://user:pass@host/x", {}, "without encryption.*use https://"),
        ("http://host/x", {"token": "t"}, "without encryption"),
        ("https://host/x", {"token": "pass@\n"}, "expected printable ASCII"),
        *(
            (url, {}, "--webhook is no address")
            for url in ("host", "ftp://a:pass@b", "https://", "https://a:x/pass", "https://a /", "https://a/é")
        ),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            Webhook(url, said.append, **more)
        assert "pass@" not in str(caught.value) and "/pass" not in str(caught.value)


def test_the_command_posts_the_lines_that_it_writes(
    endpoint: Endpoint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    t, _, y, u = readings(tanks(), 60, 1, seed=1)
    y = y[:, 0].copy()
    y[30:, 0] += 0.5
    write_log(tmp_path / "log.csv", tanks(), t, y, u[:, 0])
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO((tmp_path / "log.csv").read_bytes())))
    monkeypatch.setenv("HOOK", "secret")
    command = ["watch", "--plant", "two-tanks", "--detector", "loo-chi2", "--webhook", endpoint.url]
    assert main([*command, "--webhook-token", "HOOK"]) == 2 and "without encryption" in capsys.readouterr().err
    assert main([*command, "--webhook-token", "HOOK", "--allow-plain-password", "--samples"]) == 0
    out, err = capsys.readouterr()
    lines = [line for line in out.splitlines() if '"event": "sample"' not in line]
    assert endpoint.bodies == lines and len(lines) > 1 and "secret" not in out + err
    assert {headers["Authorization"] for _, _, headers in endpoint.posted} == {"Bearer secret"}
    assert (
        main([*command, "--webhook-token", "NONE"]) == 2 and "names no variable of the environment" in capsys.readouterr().err
    )
    assert main([*command[:-2], "--webhook-token", "HOOK"]) == 2 and "needs --webhook" in capsys.readouterr().err
