"""Faults: each kind checked by hand, the published definitions sample by sample, random draws, files, bad input."""

from __future__ import annotations

import re

import numpy as np
import pytest
from toy_plants import chain, tanks

from fusion_sfdia.diagnosis.fault_draws import PRESETS, FaultRange, draw_apart, draw_faults
from fusion_sfdia.diagnosis.fault_effects import apply_faults
from fusion_sfdia.diagnosis.faults import FAULT_KINDS, Fault, load_faults

T = np.arange(1, 11) * 1.0  # s, the chain's dt
Y = np.arange(10.0)[:, None] + np.array([100.0, 200.0, 300.0])


def faulted(*faults, y=Y, rng=None, **options):
    return apply_faults(chain(3), T, y, list(faults), rng, **options)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (Fault("s0", "bias", 3.0, 2.0, 5.0), [100, 101, 107, 108, 104, 105, 106, 107, 108, 109]),
        (Fault("s0", "bias", 9.0, magnitude=-1.0), [100, 101, 102, 103, 104, 105, 106, 107, 107, 108]),
        (Fault("s0", "drift", 3.0, 4.0, 6.0, rise=3.0), [100, 101, 104, 107, 110, 111, 106, 107, 108, 109]),
        (Fault("s0", "drift", 3.0, 2.0, 6.0), [100, 101, 105, 109, 104, 105, 106, 107, 108, 109]),
        (Fault("s0", "scale", 3.0, 2.0, 0.5), [100, 101, 51, 51.5, 104, 105, 106, 107, 108, 109]),
        (Fault("s0", "freeze", 3.0, 2.0), [100, 101, 101, 101, 104, 105, 106, 107, 108, 109]),
        (Fault("s0", "replay", 5.0, 5.0, period=2.0), [100, 101, 102, 103, 102, 103, 102, 103, 102, 109]),
        (Fault("s0", "replay", 3.0, 3.0), [100, 101, 100, 101, 100, 105, 106, 107, 108, 109]),  # 3 s, of which 2 are there
        (Fault("s0", "dropout", 3.0, 2.0), [100, 101, np.nan, np.nan, 104, 105, 106, 107, 108, 109]),
        (Fault("s0", "bias", 3.0, 2.0, 0.1, relative=True), [100, 101, 112.2, 113.2, 104, 105, 106, 107, 108, 109]),
    ],
)
def test_each_kind_by_hand(fault, expected):
    found = faulted(fault)
    np.testing.assert_allclose(found.y[:, 0], expected, rtol=1e-14)
    np.testing.assert_array_equal(found.y[:, 1:], Y[:, 1:])
    np.testing.assert_array_equal(found.size, found.y - Y)
    active = (T >= fault.onset) & (T < fault.onset + fault.length)
    np.testing.assert_array_equal(found.active, active[:, None] & np.array([True, False, False]))


def test_healthy_readings_stay_as_they_are():
    before = Y.copy()
    found = faulted(Fault("s1", "bias", 2.0, magnitude=1.0))
    np.testing.assert_array_equal(Y, before)
    assert not faulted().active.any()
    assert found.active.any()


@pytest.mark.parametrize("strength", ["strong", "weak"])
def test_published_faults_sample_by_sample(strength):
    """Shaheen 2024, sec. IV-B, with M samples for 0 <= k - m < M: bias b; drift b (k - m + 1)/M, then b for K samples."""
    low, high = {"strong": (0.6, 0.9), "weak": (0.2, 0.4)}[strength]
    plant = tanks()  # dt 5 s
    t = np.arange(1, 101) * plant.dt
    y = np.tile([1.0, 0.8, 6e-4, 5e-4], (100, 1)) * (1 + 0.01 * np.sin(t))[:, None]
    for seed in range(40):
        for kind in ("bias", "drift"):
            (fault,) = draw_faults(f"{strength}-{kind}", plant, seed, window=(50.0, 200.0), quantity="level")
            found = apply_faults(plant, t, y, [fault])
            i = plant.sensor_index(fault.sensor)
            m = int(np.argmax(found.active[:, i]))
            assert t[m] == pytest.approx(fault.onset)
            size = found.size[m:, i]
            b = fault.magnitude * y[m, i]
            assert low <= abs(fault.magnitude) <= high
            active = int(found.active[:, i].sum())
            if kind == "bias":
                assert 10 <= active <= 20
                expected = np.full(active, b)
            else:
                M = round(fault.rise / plant.dt)
                K = active - M
                assert 10 <= M <= 20 and 10 <= K <= 20
                expected = np.concatenate([b * np.arange(1, M + 1) / M, np.full(K, b)])
            np.testing.assert_allclose(size[:active], expected, rtol=1e-9)
            assert not size[active:].any()


def test_draws_are_uniform_over_sizes_lengths_signs_sensors_and_onsets():
    """2000 draws; a mean of n uniform numbers of width w has the standard error w / sqrt(12 n); four are allowed."""
    plant, rng, n = chain(5), np.random.default_rng(0), 2000
    faults = [draw_faults("weak-drift", plant, rng, window=(20.0, 60.0))[0] for _ in range(n)]
    sizes = np.array([f.magnitude for f in faults])
    assert abs(np.mean(np.abs(sizes)) - 0.3) < 4 * 0.2 / np.sqrt(12 * n)
    assert abs(np.mean(sizes > 0) - 0.5) < 4 * 0.5 / np.sqrt(n)
    rises, holds = np.array([f.rise for f in faults]), np.array([f.length - f.rise for f in faults])
    for lengths in (rises, holds):
        assert set(np.round(lengths).astype(int)) == set(range(10, 21))
        assert abs(lengths.mean() - 15) < 4 * 11 / np.sqrt(12 * n)
    assert abs(np.corrcoef(rises, holds)[0, 1]) < 4 / np.sqrt(n)  # M and K are independent
    counts = np.unique([f.sensor for f in faults], return_counts=True)[1]
    assert counts.size == 5 and np.all(np.abs(counts - n / 5) < 4 * np.sqrt(n * 0.2 * 0.8))
    onsets = np.array([f.onset for f in faults])
    assert (onsets.min(), onsets.max()) == (20.0, 60.0)


def test_draws_never_hit_a_sensor_twice_unless_asked():
    plant = chain(4)
    for seed in range(20):
        assert len({f.sensor for f in draw_faults("weak-bias", plant, seed, window=(1, 5), count=4)}) == 4
    numbers = {len(draw_faults("weak-bias", plant, seed, window=(1, 5), count=(1, 3))) for seed in range(40)}
    assert numbers == {1, 2, 3}
    assert len(draw_faults("weak-bias", plant, 0, window=(1, 5), count=9, repeat=True)) == 9
    with pytest.raises(ValueError, match="5 faults on 4 sensors"):
        draw_faults("weak-bias", plant, 0, window=(1, 5), count=5)


def test_draws_of_several_kinds_in_sigmas():
    plant = tanks()
    ranges = [FaultRange("bias", (3, 5), "sigmas", signed=False), FaultRange("freeze"), FaultRange("noise", (1, 1), "absolute")]
    drawn = [f for seed in range(60) for f in draw_faults(ranges, plant, seed, window=(50, 100), quantity="flow")]
    assert {f.kind for f in drawn} == {"bias", "freeze", "noise"}
    assert {f.sensor for f in drawn} == {"q12", "q2"}
    assert all(3 * 6e-6 <= f.magnitude <= 5 * 6e-6 and not f.relative for f in drawn if f.kind == "bias")


def test_same_seed_same_faults():
    plant = chain(6)
    assert draw_faults("strong-bias", plant, 5, window=(1, 9), count=3) == draw_faults(
        "strong-bias", plant, 5, window=(1, 9), count=3
    )
    assert draw_faults("strong-bias", plant, 5, window=(1, 9), count=3) != draw_faults(
        "strong-bias", plant, 6, window=(1, 9), count=3
    )


def test_several_faults_on_one_sensor_act_in_order():
    bias, scale = Fault("s0", "bias", 3.0, 2.0, 5.0), Fault("s0", "scale", 3.0, 2.0, 2.0)
    assert faulted(bias, scale).y[2, 0] == (102 + 5) * 2
    assert faulted(scale, bias).y[2, 0] == 102 * 2 + 5
    frozen = faulted(Fault("s0", "dropout", 2.0, 1.0), Fault("s0", "freeze", 3.0, 2.0))
    np.testing.assert_array_equal(frozen.y[1:4, 0], [np.nan, 100, 100])  # the last reading there was
    for kind in ("freeze", "replay"):
        assert faulted(Fault("s0", kind, 1.0, 3.0)).y[2, 0] == 100  # from the first sample on: the first reading


def test_relative_size_is_of_the_noise_free_signal_and_keeps_its_sign():
    signal = np.full_like(Y, -50.0)
    found = faulted(Fault("s0", "bias", 3.0, 2.0, 0.1, relative=True), signal=signal)
    np.testing.assert_allclose(found.size[2:4, 0], 5.0, rtol=1e-12)


def test_noise_and_spikes_have_the_stated_size():
    """Standard errors of a standard deviation, 1/sqrt(2n), and of a share; four are allowed."""
    n = 20_000
    t, y = np.arange(1, n + 1) * 1.0, np.zeros((n, 3))
    noisy = apply_faults(chain(3), t, y, [Fault("s0", "noise", 1.0, magnitude=2.0)], 1).size[:, 0]
    assert abs(noisy.std() / 2 - 1) < 4 / np.sqrt(2 * n)
    spikes = apply_faults(chain(3), t, y, [Fault("s0", "spikes", 1.0, magnitude=7.0, probability=0.1)], 1)
    assert set(spikes.size[:, 0]) == {-7.0, 0.0, 7.0}
    assert abs(np.mean(spikes.size[:, 0] != 0) - 0.1) < 4 * np.sqrt(0.09 / n)
    assert spikes.active[:, 0].all()  # the fault is there between its spikes, too
    gaps = apply_faults(chain(3), t, y, [Fault("s0", "dropout", 1.0, probability=0.3)], 1)
    assert abs(np.isnan(gaps.y[:, 0]).mean() - 0.3) < 4 * np.sqrt(0.21 / n)


def test_a_batch_takes_one_list_or_one_each_and_seeds_make_runs_independent_of_the_others():
    y = np.broadcast_to(Y[:, None], (10, 4, 3))
    noise = Fault("s0", "noise", 3.0, 4.0, 2.0)
    common = faulted(noise, y=y, rng=[7, 8, 9, 10])
    assert np.unique(common.size[4, :, 0]).size == 4
    alone = faulted(noise, rng=[9], y=y[:, :1])
    np.testing.assert_array_equal(alone.y[:, 0], common.y[:, 2])
    np.testing.assert_array_equal(faulted(noise, rng=9).y, alone.y[:, 0])
    each = apply_faults(chain(3), T, y, [[noise], [], [Fault("s2", "bias", 1.0, magnitude=1.0)], [noise]], 3)
    np.testing.assert_array_equal(each.active.any(axis=0), [[1, 0, 0], [0, 0, 0], [0, 0, 1], [1, 0, 0]])
    square = apply_faults(chain(3), T, y.reshape(10, 2, 2, 3), [[noise], [], [], []], 3)
    np.testing.assert_array_equal(square.y.reshape(10, 4, 3)[:, 0], each.y[:, 0])
    with pytest.raises(ValueError, match="2 lists of faults for 4 elements"):
        apply_faults(chain(3), T, y, [[noise], []], 3)
    with pytest.raises(ValueError, match="2 seeds for 4 elements"):
        faulted(noise, y=y, rng=[1, 2])


def test_samples_on_an_edge_are_on_it_in_spite_of_rounding():
    plant = tanks()
    t = np.arange(1, 2001) * 0.1
    y = np.zeros((2000, 4))
    for m, length in ((3, 7), (700, 30), (1234, 11)):
        found = apply_faults(plant, t, y, [Fault("l1", "bias", m * 0.1, length * 0.1, 1.0)])
        np.testing.assert_array_equal(np.flatnonzero(found.active[:, 0]), np.arange(m - 1, m - 1 + length))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"kind": "wobble"}, "unknown fault kind 'wobble'; known: bias"),
        ({"kind": ["bias"]}, "unknown fault kind"),
        ({"onset": np.inf}, "onset is inf"),
        ({"onset": "soon"}, "onset is 'soon'; expected a number"),
        ({"length": -1.0}, "length is -1.0"),
        ({"length": np.nan}, "length is nan"),
        ({"magnitude": np.nan}, "magnitude is nan"),
        ({"magnitude": 0.0}, "no fault"),
        ({"magnitude": True}, "expected a number"),
        ({"relative": 1}, "expected true or false"),
        ({"rise": 3.0}, "belongs to a drift"),
        ({"kind": "drift", "rise": -3.0}, "positive number of seconds"),
        ({"kind": "drift", "length": np.inf}, "neither rise nor length"),
        ({"kind": "freeze"}, "no magnitude"),
        ({"period": 3.0}, "belongs to a replay"),
        ({"kind": "replay", "magnitude": 0.0, "period": 0.0}, "positive number of seconds"),
        ({"kind": "replay", "magnitude": 0.0, "length": np.inf}, "neither period nor length"),
        ({"kind": "scale", "relative": True}, "a factor already"),
        ({"kind": "noise", "magnitude": -1.0}, "expected a positive size"),
        ({"probability": 0.5}, "only for spikes and dropouts"),
        ({"kind": "spikes", "probability": 0.0}, "probability is 0.0"),
    ],
)
def test_what_a_fault_cannot_be(fields, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        Fault(**({"sensor": "s0", "kind": "bias", "onset": 1.0, "length": 2.0, "magnitude": 1.0} | fields))


def test_faults_that_do_not_fit_the_readings():
    with pytest.raises(ValueError, match="unknown sensor 's9'"):
        faulted(Fault("s9", "bias", 1.0, magnitude=1.0))
    with pytest.raises(ValueError, match="covers no sample of 1 to 10 s"):
        faulted(Fault("s0", "bias", 11.0, magnitude=1.0))
    with pytest.raises(ValueError, match="is random; pass rng"):
        faulted(Fault("s0", "noise", 1.0, magnitude=1.0))
    with pytest.raises(ValueError, match="do not fit"):
        apply_faults(chain(4), T, Y, [])
    with pytest.raises(ValueError, match="signal has shape"):
        faulted(signal=Y[1:])
    with pytest.raises(ValueError, match=r"scale of sensor 's0' by 1e\+308 is no finite reading"):
        apply_faults(chain(3), T, Y + 100.0, [Fault("s0", "scale", 1.0, magnitude=1e308)])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: draw_faults("mild-bias", chain(3), 0, window=(1, 2)), "presets: strong-bias"),
        (lambda: draw_faults([], chain(3), 0, window=(1, 2)), "none given"),
        (lambda: draw_faults("weak-bias", tanks(), 0, window=(1, 9), quantity="heat"), "known: level, flow"),
        (lambda: draw_faults("weak-bias", tanks(), 0, window=(1, 4)), "no multiple of dt = 5 s"),
        (lambda: draw_faults("weak-bias", chain(3), 0, window=(1, 2), count=0), "at least 1"),
        (lambda: FaultRange("bias", (2, 1)), "0 < low <= high"),
        (lambda: FaultRange("bias", (1, 2), "percent"), "known: absolute, relative, sigmas"),
        (lambda: FaultRange("bias", (1, 2), hold=(1, 2)), "only a drift holds"),
        (lambda: FaultRange("bias", (1, 2), length=(0, 2)), "whole samples"),
        (lambda: FaultRange("wobble"), "unknown fault kind"),
    ],
)
def test_draws_that_cannot_be(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_registries_describe_every_entry():
    assert list(PRESETS) == ["strong-bias", "strong-drift", "weak-bias", "weak-drift"]
    assert all(r.description for r in PRESETS.values())
    assert all(FAULT_KINDS.values())


def test_every_kind_can_be_applied_and_drawn():
    for kind in FAULT_KINDS:
        size = (0.0, 0.0) if kind in ("freeze", "dropout", "replay") else (2.0, 3.0)
        (fault,) = draw_faults(FaultRange(kind, size, length=(3, 3)), chain(3), 1, window=(2, 4))
        assert faulted(fault, rng=0).active.sum() == 3


def test_fault_file(tmp_path):
    path = tmp_path / "faults.toml"
    path.write_text(
        '[[fault]]\nsensor = "l1"\nkind = "drift"\nonset = 60\nlength = 50.0\nmagnitude = -0.2\nrelative = true\nrise = 20.0\n'
        '[[fault]]\nsensor = "q2"\nkind = "dropout"\nonset = 0.0\n'
    )
    assert load_faults(path, tanks()) == [
        Fault("l1", "drift", 60, 50.0, -0.2, relative=True, rise=20.0),
        Fault("q2", "dropout", 0.0),
    ]


def table(**entries):
    return "[[fault]]\n" + "".join(
        f"{key} = {value}\n" for key, value in ({"sensor": '"l1"', "kind": '"bias"'} | entries).items()
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"no \[\[fault\]\] tables"),
        ("fault = 3", r"no \[\[fault\]\] tables"),
        ("fault = [1, 2]", r"no \[\[fault\]\] tables"),
        ("[[faults]]", "unknown entries faults"),
        ("[[fault]\n", "not a TOML file"),
        (table(onset=1.0, amplitude=2.0), "fault 1: unknown key amplitude; the keys are"),
        (table(), "fault 1: no onset"),
        (table(onset=1, magnitude=1) + table(onset=1, sensor='"l9"'), "fault 2: unknown sensor 'l9'"),
        (table(onset=1, sensor='["l1"]'), "fault 1: unknown sensor"),
        (table(onset=1, magnitude='"big"'), r"fault 1: .* magnitude is 'big'; expected a number"),
        (table(onset="2020-01-01", magnitude=1), r"fault 1: .* onset is"),
        (table(onset=1, magnitude="nan"), r"fault 1: .* magnitude is nan"),
        (table(onset=1, magnitude="9" * 400), r"fault 1: .* magnitude is too large; expected a number below 1e308"),
        (table(onset="0x" + "f" * 5000, magnitude=1), r"fault 1: .* onset is too large"),
        (table(onset=1, magnitude="9" * 5000), "not a TOML file"),
        ("a = " + "[" * 10_000, "not a TOML file"),
    ],
)
def test_fault_files_that_are_wrong(tmp_path, text, message):
    path = tmp_path / "faults.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        load_faults(path, tanks())
    assert str(path) in str(caught.value)


def test_a_fault_file_that_is_no_text(tmp_path):
    path = tmp_path / "faults.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="not a TOML file"):
        load_faults(path, tanks())


def test_faults_drawn_for_a_log_are_apart_and_within_it():
    plant = tanks()
    faults = draw_apart([("weak-drift", "level"), ("strong-bias", "flow"), ("weak-bias", "level")], plant, 70, 3)
    assert len({f.sensor for f in faults}) == 3
    assert all(31 * plant.dt <= f.onset and f.onset + f.length <= 71 * plant.dt for f in faults)
    assert draw_apart([], plant, 1, 0) == []
    with pytest.raises(ValueError, match=r"30 readings have no room .* ask for at least 70, or place the faults in a file"):
        draw_apart([("weak-bias", None)], plant, 30, 0)
    with pytest.raises(ValueError, match="all 2 sensors of level are faulty already; draw fewer"):
        draw_apart([("weak-bias", "level")] * 3, plant, 70, 0)
    with pytest.raises(ValueError, match="unknown quantity 'levle'"):
        draw_apart([("weak-bias", "levle")], plant, 70, 0)


@pytest.mark.parametrize(
    ("missing", "expected"),
    [([], 4.0), ([3], 3.0), ([2, 3, 4], 2.0), ([0, 1, 2, 3], 5.0), ([0, 1, 2, 3, 4, 5, 6], 8.0)],
)
def test_a_relative_fault_without_a_reading_at_its_onset_refers_to_the_last_known_one(
    missing: list[int], expected: float
) -> None:
    """Readings 1, 2, .. 9, the onset at the fourth, and of those known the last until it, or the first after it."""
    plant = chain(1)
    t = np.arange(1.0, 10.0)
    y = t[:, None].copy()
    y[missing] = np.nan
    found = apply_faults(plant, t, y, [Fault("s0", "bias", onset=4.0, magnitude=-0.5, relative=True)])
    known = np.isfinite(y[3:, 0])
    np.testing.assert_allclose(found.size[3:, 0][known], -0.5 * expected, rtol=1e-12)
    assert np.isnan(found.y[missing]).all()
    true = apply_faults(plant, t, y, [Fault("s0", "bias", onset=4.0, magnitude=-0.5, relative=True)], signal=t[:, None])
    np.testing.assert_allclose(true.size[3:, 0][known], -2.0, rtol=1e-12)  # the signal, where it is given
    with pytest.raises(ValueError, match="relative to a sensor that was never read; pass signal"):
        apply_faults(plant, t, np.full_like(y, np.nan), [Fault("s0", "bias", onset=4.0, magnitude=-0.5, relative=True)])
