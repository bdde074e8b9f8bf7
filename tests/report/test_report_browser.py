"""The report in a browser: nothing is fetched, nothing fails, tables sort and filter, it fits a phone, it follows the dark."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from matplotlib.figure import Figure as Drawing
from toy_plants import readings, tanks
from toy_scenario import TOY

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.diagnose import DiagnosisWarning, diagnose_run
from fusion_sfdia.plant.log import Log
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.log_page import About, write_page
from fusion_sfdia.report.plots import panels
from fusion_sfdia.study.comparison.figures import heat
from fusion_sfdia.study.experiments.runner import run_scenarios
from fusion_sfdia.study.experiments.scenario import Arrays, Settings, Task

webdriver = pytest.importorskip("selenium.webdriver", reason="needs the optional package selenium")
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
if not (CHROMIUM and DRIVER):
    pytest.skip("needs a browser: chromium and chromedriver on the path", allow_module_level=True)

QUIET = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-dev-shm-usage")
READING = "[id$='-panel0-1'] > path"  # after the line of what is expected
OFFLINE = ("--disable-background-networking", "--disable-component-update", "--disable-sync")


def long_summary(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """The toy's summary with its rows for five quantities, and a figure of a comparison's kinds."""
    found = TOY.summarise(settings, results)
    rows = [replace(r, quantity=f"q{i}", value=r.value + i) for i in range(5) for r in found.rows]
    return replace(found, rows=rows, figures=[Figure("kinds", "Kinds", "", kinds, "kinds")])


def kinds() -> Drawing:
    """Curves, numbers on colours, and bars."""
    figure, (curves, numbers, lying) = panels(["curves", "numbers", "lying"], columns=3, width=11.5)
    curves.plot([1e-3, 0.1, 1.0], [0.0, 0.5, 1.0], drawstyle="steps-post", label="ours")
    curves.set(xscale="log", xlim=(1e-3, 1.0), ylim=(-0.02, 1.02), xlabel="false-alarm probability")
    heat(numbers, np.array([[0.5, 0.25], [0.125, np.nan]]), ["a", "b"], ["x", "y"])
    lying.barh([0, 1], [0.25, 0.5], label="missed")
    lying.set_yticks([0, 1], ["limits", "pca"])
    return figure


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    folder = tmp_path_factory.mktemp("browser")
    run_scenarios([replace(TOY, summarise=long_summary)], folder / "report", workers=1, seeds=20)
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in (*QUIET, *OFFLINE, f"--user-data-dir={folder / 'profile'}", "--window-size=1200,900"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    try:
        driver.get((folder / "report" / "report.html").as_uri())
        yield driver
    finally:
        driver.quit()


def test_curves_cells_and_bars_of_a_comparison_are_read(browser: Any) -> None:
    """With the pointer, and with keys, which go on to the next panel; curves alone are zoomed."""
    paper = browser.find_element("css selector", ".paper")
    svg, says = paper.find_element("css selector", "svg"), browser.find_element("css selector", "output")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", paper)
    data = json.loads(paper.get_attribute("data-plot"))
    box = {p["title"]: p["box"] for group in data["groups"] for p in group["panels"]}
    _, _, width, height = map(float, svg.get_dom_attribute("viewBox").split())

    def at(title: str, across: float, down: float) -> webdriver.ActionChains:
        left, top, right, bottom = box[title]
        x, y = (left + across * (right - left)) / width - 0.5, (top + down * (bottom - top)) / height - 0.5
        return webdriver.ActionChains(browser).move_to_element_with_offset(
            svg, round(x * svg.size["width"]), round(y * svg.size["height"])
        )

    at("curves", 0.5, 0.5).perform()
    assert re.fullmatch(r"curves: false-alarm probability 0\.03\d+: ours 0", says.text)
    at("numbers", 0.75, 0.25).perform()
    assert says.text == "numbers: y: a: 0.25"
    at("numbers", 0.75, 0.25).click_and_hold().move_by_offset(-40, 0).release().perform()
    assert "zoomed" not in paper.get_attribute("class")
    at("lying", 0.5, 0.2).perform()
    assert says.text == "lying: pca: missed 0.5"
    at("curves", 0.6, 0.5).click_and_hold().move_by_offset(40, 0).release().perform()
    assert "zoomed" in paper.get_attribute("class")

    browser.execute_script("arguments[0].focus()", paper)
    readouts = []
    for key in ("ESCAPE", "END", "ARROW_RIGHT", "ARROW_DOWN", "ARROW_RIGHT", "ARROW_RIGHT"):
        webdriver.ActionChains(browser).send_keys(getattr(webdriver.Keys, key)).perform()
        readouts.append(says.text)
    assert "zoomed" not in paper.get_attribute("class") and readouts[0].startswith("Point at the picture")
    assert readouts[1:] == [
        "curves: false-alarm probability 1: ours 1",
        "numbers: x: a: 0.50",
        "numbers: x: b: 0.12",
        "numbers: y: b",
        "lying: limits: missed 0.25",
    ]
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


def column(browser: Any, index: int) -> list[str]:
    return browser.execute_script(
        "const table = document.querySelector('details table');"
        "return [...table.tBodies[0].rows].filter(r => !r.hidden).map(r => r.cells[arguments[0]].textContent)",
        index,
    )


def test_nothing_is_fetched_and_nothing_fails(browser: Any) -> None:
    assert [entry for entry in browser.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")] == []
    fetched = browser.execute_script("return performance.getEntriesByType('resource').map(e => e.name)")
    assert fetched == []


def test_tables_sort_by_their_numbers(browser: Any) -> None:
    header = "document.querySelector('details table').tHead.rows[0].cells[5]"
    browser.execute_script("document.querySelector('details').open = true")
    for direction in ("descending", "ascending"):
        browser.execute_async_script(
            "const done = arguments[0]; const table = document.querySelector('details table');"
            f"table.addEventListener('sort-end', () => done(), {{once: true}}); {header}.click();"
        )
        assert browser.execute_script(f"return {header}.getAttribute('aria-sort')") == direction
        values = [float(v) for v in column(browser, 5) if v != "undefined"]
        assert values == sorted(values, reverse=direction == "descending") and len(values) > 1
        assert column(browser, 5)[-1] == "undefined"  # what is no number stands last either way


def test_tables_filter_by_words(browser: Any) -> None:
    before = column(browser, 1)
    field = "document.querySelector('details .filter')"
    enter = f"const field = {field}; field.value = arguments[0]; field.dispatchEvent(new Event('input'));"
    browser.execute_script(enter, "Q3 mean")
    assert 0 < len(column(browser, 1)) < len(before)
    browser.execute_script(enter, "nothing-has-this-word")
    assert column(browser, 1) == []
    browser.execute_script(enter, "")
    assert sorted(column(browser, 1)) == sorted(before)


def test_it_fits_a_phone(browser: Any) -> None:
    phone = {"width": 360, "height": 740, "deviceScaleFactor": 2, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    assert browser.execute_script("return document.documentElement.scrollWidth <= window.innerWidth")
    assert browser.execute_script("return window.innerWidth") == phone["width"]
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_follows_the_light(browser: Any, scheme: str) -> None:
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    text, page = browser.execute_script("const s = getComputedStyle(document.body); return [s.color, s.backgroundColor]")
    luminance = [relative_luminance(colour) for colour in (text, page)]
    assert (luminance[1] > 0.5) == (scheme == "light")
    assert (max(luminance) + 0.05) / (min(luminance) + 0.05) >= 7  # WCAG 2.2, 1.4.6: enhanced contrast


def relative_luminance(colour: str) -> float:
    """Of "rgb(r, g, b)", as WCAG 2.2 defines it."""
    channels = [int(v) / 255 for v in colour[4:-1].split(",")]
    linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in channels]
    return sum(w * v for w, v in zip((0.2126, 0.7152, 0.0722), linear, strict=True))


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The address of the report of a log whose third sensor, q12, has a bias from 155 s on."""
    plant, path = tanks(), tmp_path_factory.mktemp("diagnosis") / "report.html"
    t, _, y, u = readings(plant, 60, 1, seed=0)
    y = y[:, 0] + 20 * plant.sensor_sigma * np.outer(t > 150, np.arange(4) == 2)
    clock = Clock(datetime(2026, 3, 1, 23, 58, tzinfo=timezone(timedelta(hours=1))))
    found = diagnose_run(LeaveOneOutBank(plant), Log(t, y, u[:, 0]), clock=clock)
    write_page(path, plant, y, found, About("a-log-with-a-name-that-is-longer-than-a-phone-is-wide.csv", "loo"))
    return path.as_uri()


def test_the_report_of_a_diagnosis_fits_a_phone_and_fetches_nothing(browser: Any, diagnosis: str) -> None:
    phone = {"width": 360, "height": 740, "deviceScaleFactor": 2, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    browser.get(diagnosis)
    assert browser.execute_script("return document.documentElement.scrollWidth <= window.innerWidth")
    assert browser.execute_script("return performance.getEntriesByType('resource').length") == 0
    near = browser.execute_script("return document.querySelector('.near svg').getBoundingClientRect().width")
    assert 280 < near < 360  # as wide as the screen, not to be scrolled
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_every_figure_works_also_of_a_sensor_without_readings(browser: Any, tmp_path: Path) -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 60, 1, seed=0)
    y = y[:, 0] + 20 * plant.sensor_sigma * np.outer(t > 150, np.arange(4) == 2)
    y[:, 0] = np.nan
    with pytest.warns(DiagnosisWarning, match="l1"):
        found = diagnose_run(LeaveOneOutBank(plant), Log(t, y, u[:, 0]))
    write_page(tmp_path / "report.html", plant, y, replace(found, after=None), About("log.csv", "loo"))
    browser.get((tmp_path / "report.html").as_uri())
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
    count = "return document.querySelectorAll('%s').length"
    assert browser.execute_script(count % ".tools") == browser.execute_script(count % "[data-plot]") > 1


def test_a_figure_is_read_and_zoomed(browser: Any, diagnosis: str) -> None:
    browser.get(diagnosis)
    action_chains = webdriver.ActionChains
    paper = browser.find_element("css selector", ".near .paper")
    svg, says = paper.find_element("css selector", "svg"), browser.find_element("css selector", ".near output")
    reading = paper.find_element("css selector", READING)
    browser.execute_script("arguments[0].scrollIntoView()", paper)
    box, whole = svg.rect, reading.get_attribute("d")
    action_chains(browser).move_to_element(svg).perform()
    assert re.fullmatch(r"2026-03-02 00:0\d:\d[05]: expected \S+ m3/s, reading \S+ m3/s, difference \S+ m3/s", says.text)
    across = box["width"] // 5
    action_chains(browser).move_to_element(svg).click_and_hold().move_by_offset(across, 0).release().perform()
    assert "zoomed" in paper.get_attribute("class") and reading.get_attribute("d") != whole
    action_chains(browser).double_click(svg).perform()
    assert "zoomed" not in paper.get_attribute("class") and reading.get_attribute("d") == whole

    keys = webdriver.Keys
    browser.execute_script("arguments[0].focus()", paper)
    readouts = []
    for key in (keys.HOME, keys.ARROW_RIGHT, keys.ARROW_RIGHT, keys.ARROW_LEFT, keys.END):
        action_chains(browser).send_keys(key).perform()
        readouts.append(says.text.split(": ")[0])
    assert readouts == [*sorted(readouts[:3]), readouts[1], "2026-03-02 00:03:00"] and len(set(readouts)) == 4
    action_chains(browser).send_keys("++").perform()
    assert "zoomed" in paper.get_attribute("class")
    assert "23:5" in readouts[0] and readouts[0] not in paper.text
    action_chains(browser).send_keys(keys.ESCAPE).perform()
    assert "zoomed" not in paper.get_attribute("class") and says.text.startswith("Point at the picture")
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The address of the report of five days about the night in which summer time begins."""
    plant, path = tanks(), tmp_path_factory.mktemp("nights") / "report.html"
    t, _, y, u = readings(plant, 60, 1, seed=0)
    y = y[:, 0] + 20 * plant.sensor_sigma * np.outer(t > 150, np.arange(4) == 2)
    found = diagnose_run(LeaveOneOutBank(plant), Log(t, y, u[:, 0]))
    clock = Clock(datetime(2026, 3, 27, 18, tzinfo=ZoneInfo("Europe/Amsterdam")))
    events = tuple(replace(e, start=1440 * e.start, end=1440 * e.end) for e in found.events)
    write_page(path, plant, y, replace(found, t=1440 * t, events=events, clock=clock), About("log.csv", "loo"))
    return path.as_uri()


def test_ticks_stand_where_the_clock_of_the_zone_shows_them(browser: Any, nights: str) -> None:
    """Midnight is that of the zone, and after the night of 29 March its ticks are an hour less apart from it."""
    browser.get(nights)
    ticks = "return ticks({ends: arguments[0], log: false}, arguments[1], arguments[2])"
    offsets = browser.execute_script("return JSON.parse(document.querySelector('.whole .paper').dataset.plot).offsets")
    change = datetime(2026, 3, 29, 1, tzinfo=UTC).timestamp()
    assert [offset for _, offset in offsets] == [3600, 7200] and offsets[1][0] == change
    zone, time = ZoneInfo("Europe/Amsterdam"), [change - 50 * 3600, change + 50 * 3600]
    for view, count, form in (([0, 1], 4, "%m-%d"), ([0.4, 0.6], 4, "%H:%M"), ([0.48, 0.52], 4, "%H:%M")):
        found = browser.execute_script(ticks, time, view, offsets)
        moments = [datetime.fromtimestamp(round(time[0] + part * (time[1] - time[0])), zone) for part, _ in found]
        assert len(found) >= count - 1 and [text for _, text in found] == [f"{moment:{form}}" for moment in moments]
        assert all(moment.minute == 0 and (form != "%m-%d" or moment.hour == 0) for moment in moments)


def test_a_figure_is_moved_and_zoomed_by_touch(browser: Any, diagnosis: str) -> None:
    browser.get(diagnosis)
    browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 2})
    try:
        touched(browser)
    finally:
        browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})


def touched(browser: Any) -> None:
    paper = browser.find_element("css selector", ".near .paper")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", paper)
    x, y, width = browser.execute_script(
        "const b = arguments[0].getBoundingClientRect(); return [b.x, b.y + 150, b.width]", paper
    )
    reading = paper.find_element("css selector", READING)
    says = browser.find_element("css selector", ".near output")

    def touch(kind: str, *shares: float) -> None:
        points = [{"x": x + share * width, "y": y, "id": k} for k, share in enumerate(shares)]
        browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})

    def ends() -> tuple[float, float]:
        """Where the line begins and ends: it is as wide as the zoom is large."""
        path = re.findall(r"[ML]\s*(\S+)", reading.get_attribute("d"))
        return float(path[0]), float(path[-1])

    def moved(*steps: tuple[float, ...]) -> None:
        touch("Start", *steps[0])
        for step in steps[1:]:
            touch("Move", *step)
        touch("End")

    whole = ends()
    moved((0.5,), (0.5,))  # a touch reads
    assert re.fullmatch(r"2026-03-02 00:0\d:\d[05]: expected .*", says.text) and ends() == whole
    moved((0.3,), (0.5,), (0.7,))  # there is nothing to move yet
    assert ends() == whole
    moved((0.45, 0.65), (0.4, 0.7), (0.35, 0.75))  # two fingers, twice as far from each other in the end
    zoomed = ends()
    assert (zoomed[1] - zoomed[0]) / (whole[1] - whole[0]) == pytest.approx(2, rel=0.02)
    moved((0.6,), (0.55,), (0.5,))
    shifted = ends()
    assert shifted[1] - shifted[0] == pytest.approx(zoomed[1] - zoomed[0], abs=0.1) and shifted[0] < zoomed[0] - 10
    moved((0.35, 0.75), (0.45, 0.65), (0.49, 0.61))
    assert ends() == whole and "zoomed" not in paper.get_attribute("class")
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
