"""One order of findings wherever they are shown: sensors, the process, what is undecided; the state is that of the first."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from process_bank import ProcessBank
from toy_plants import readings, tanks

from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.live.page import POLL, LivePage
from fusion_sfdia.live.saving import SavedWatch
from fusion_sfdia.live.status import Status
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.report.document import as_json
from fusion_sfdia.report.log_page import About
from fusion_sfdia.report.log_report import as_text
from fusion_sfdia.report.log_units import LogUnits

PLANT = tanks()
T, _, Y, U = readings(PLANT, 40, 1, seed=0)
OFF = Y[:, 0] + PLANT.sensor_sigma * (20 * np.outer(T > 100, np.arange(4) == 2) + 40 * np.outer(T > 150, np.arange(4) == 0))
BANK = replace(ProcessBank(PLANT, accept=(9, 10**6), doubt=(35, 10**6), between=(3, 5), false_alarm=1e-6))
LISTED = re.compile(r'<li value="(\d)" class="(\w+)">.*?<p>(.*?)</p>', re.DOTALL)


def test_findings_have_one_order_on_every_page_and_in_every_file(tmp_path: Path) -> None:
    found = diagnose(BANK, T, OFF, U[:, 0])
    assert [(e.kind, e.hypothesis) for e in found.findings] == [  # the larger sensor fault first
        ("sensor", "l1"), ("sensor", "q12"), ("process", "outlet"), ("undecided", "q2 or error of inflow"),
    ]  # fmt: skip
    sentences = [found.sentence(e) for e in found.findings]
    assert found.state == "sensor" and found.verdict.startswith("sensors ") and found.headline.startswith("2 faulty sensors, ")
    assert [line.strip() for line in as_text(found, "bank").splitlines()[1:5]] == sentences
    document = json.loads(as_json(found, LogUnits(PLANT, ()), LoadedLog(found.log, found.clock, ()), About("a log", "bank")))
    assert (document["state"], [e["text"] for e in document["events"]]) == ("sensor", sentences)
    page = html.unescape(found.report(tmp_path / "report.html").read_text(encoding="utf-8"))
    assert [text for *_, text in LISTED.findall(page)] == sentences


def test_a_live_page_lists_what_acts_first_in_that_order_and_its_lamp_names_the_sensors() -> None:
    now = [0.0]
    watch = Watch(BANK, refused=print)
    status = Status(watch)
    page, saved = LivePage(watch, status, now=lambda: now[0]), SavedWatch(watch, lambda line: None, status=status)
    saved.takers.append(page.taken)
    saved.outlets.append(lambda change, line: page.changed(change))
    samples = [s for t, y, u in zip(T, OFF, U[:, 0], strict=True) for s in saved.update(float(t), y, u)]
    assert samples[-1].verdict == "sensor"  # of the row, too
    parts = page.parts()
    kinds = [kind for _, kind, _ in LISTED.findall(parts["findings"])]
    assert kinds == ["sensor", "sensor", "process", "undecided"] and "Over" not in parts["findings"]
    assert "<strong>Check function: q2</strong>" in parts["state"]  # by NE 107 above what l1 and q12 are, which are named, too
    assert re.findall("</b> (.*?):", parts["state"]) == ["q2", "l1", "q12"]
    own = next(i for i, e in page.events.items() if e.hypothesis == "l1")
    page.events[own], now[0] = replace(page.events[own], open=False), POLL
    acting, over = page.parts()["findings"].split("<h3>Over</h3>")
    assert [kind for _, kind, _ in LISTED.findall(acting)] == ["sensor", "process", "undecided"]
    assert [(number, kind) for number, kind, _ in LISTED.findall(over)] == [("4", "sensor")]


@pytest.mark.parametrize("times", [4, 5, 9])
def test_what_happens_again_and_again_is_told_three_times_and_counted(times: int) -> None:
    found = diagnose(BANK, T, OFF, U[:, 0])
    one = next(e for e in found.events if e.kind == "sensor")
    spikes = tuple(replace(one, fault="spikes", start=10.0 * k, end=10.0 * k + 5.0, open=False) for k in range(times))
    found = replace(found, events=spikes)
    told = [line.strip() for line in as_text(found, "bank").splitlines() if line.startswith("  ")]
    sentences = [found.sentence(e) for e in found.findings]
    more = f"The same happened {times - 3} times more between 30 s and {10 * times - 5} s: they are in events.csv."
    assert told == (sentences if times == 4 else [*sentences[:3], more])
