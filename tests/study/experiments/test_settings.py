"""Settings of all scenarios against senseless values: each is refused in a line, or stands for work that can be done."""

from __future__ import annotations

import pytest

from fusion_sfdia.study.experiments.parts import part_name
from fusion_sfdia.study.experiments.scenario import adjust
from fusion_sfdia.study.scenarios import SCENARIOS, scenario

SENSELESS = (  # for any setting
    "-1", "-0.5", "0.0000000001", "1e308", "1e-308", "1e400", "nan", "inf", "-inf", "99999999999999999999", "1_0", "１２",
    "-99999999999999999999", "9" * 5000, "x" * 5000, "\0", "a,b", "1,1", "-1,1", "lit,lit", "[1]", "1;2", "0x10", "none",
    "15,99999999999999999999", "nan,1", "maybe",
)  # fmt: skip
EMPTY = ("", " ", ",", ",,")
OTHERS = ("0", "1", "2", "0.5", "true", " 3 ", "1000000")  # for some
SETTINGS = [(name, key) for name in SCENARIOS for key in scenario(name).settings]


@pytest.mark.parametrize(("name", "key"), SETTINGS, ids=str)
def test_a_senseless_value_is_refused(name: str, key: str) -> None:
    chosen = scenario(name)
    for text in (*SENSELESS, *(() if key in chosen.optional else EMPTY)):
        with pytest.raises(ValueError, match=r"expected|expected|known") as caught:
            chosen.tasks(adjust(chosen, {key: text}), 1)
        assert len(str(caught.value)) < 700, "it echoes the whole value"


@pytest.mark.parametrize(("name", "key"), SETTINGS, ids=str)
def test_any_other_value_is_refused_or_is_work(name: str, key: str) -> None:
    chosen = scenario(name)
    for text in (*EMPTY, *OTHERS):
        try:
            tasks = chosen.tasks(adjust(chosen, {key: text}), 1)
        except ValueError:
            continue
        assert tasks and len({part_name(chosen.work, task) for task in tasks}) == len(tasks)


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_defaults_keep_their_own_bounds(name: str) -> None:
    chosen = scenario(name)
    for settings in (chosen.settings, {**chosen.settings, **chosen.full}):
        texts = {k: ",".join(map(str, v)) if isinstance(v, tuple) else str(v) for k, v in settings.items()}
        comma = {k for k, v in settings.items() if isinstance(v, tuple) and any("," in str(part) for part in v)}
        texts = {k: text for k, text in texts.items() if k not in comma}
        assert adjust(chosen, texts) == {**chosen.settings, **{k: settings[k] for k in texts}}
    assert set(chosen.bounds) | set(chosen.optional) <= set(chosen.settings)
