"""Signature matrices: derived from the structure against the printed ones, combinations of faults, errors."""

from __future__ import annotations

import numpy as np
import pytest
from engine_signatures import (
    AGENTS,
    COMPUTED,
    COMPUTED_AS_IN_THE_TABLES,
    K22_CERTAIN,
    K22_LOCAL,
    K22_TABLE_3,
    K24_CERTAIN,
    K24_LOCAL,
    K24_TABLE_IV,
    SENSOR_OF,
    SENSORS,
    VARIABLES,
    parse,
)

from fusion_sfdia.derivatives.equation import argument_names
from fusion_sfdia.detectors.adaptive_thresholds.signatures import (
    Agent,
    SignatureMatrix,
    combinations,
    global_signatures,
    local_signatures,
    masks,
    members,
    sensors_read,
    signature_matrix,
)


def differences(found: SignatureMatrix, printed: dict[str, dict[str, str]]) -> dict[tuple[str, str], tuple[str, str]]:
    """{(row, sensor): (found, printed)} where they differ."""
    assert set(found.rows) == set(printed)
    pairs = {(row, s): (found.entries[row][s], printed[row].get(s, "0")) for row in found.rows for s in found.sensors}
    return {where: pair for where, pair in pairs.items() if pair[0] != pair[1]}


def derived(certain: dict, computed: dict) -> SignatureMatrix:
    return local_signatures(sensors_read(VARIABLES, SENSOR_OF, computed, known=("u",)), certain, SENSORS)


@pytest.mark.parametrize(("certain", "printed"), [(K24_CERTAIN, K24_LOCAL), (K22_CERTAIN, K22_LOCAL)], ids=["K24", "K22"])
def test_the_printed_tables_follow_from_the_simplified_structure(certain, printed):
    assert differences(derived(certain, COMPUTED_AS_IN_THE_TABLES), printed) == {}


@pytest.mark.parametrize(("certain", "printed"), [(K24_CERTAIN, K24_LOCAL), (K22_CERTAIN, K22_LOCAL)], ids=["K24", "K22"])
def test_the_full_structure_differs_in_three_entries(certain, printed):
    assert differences(derived(certain, COMPUTED), printed) == {
        # K24 (31), (32) use X_cv, which K24 makes a function of n_fe and so of the torque; (30) omits z3(2), K22 (6) has it
        ("E(2,1)", "f3(2)"): ("*", "0"),
        ("E(2,2)", "f3(2)"): ("*", "0"),
        # (43) lets the turbine's efficiency depend on x(4); Table II has no such entry
        ("E(3,3)", "f1(4)"): ("*", "0"),
    }


def test_the_papers_differ_from_each_other_in_two_entries():
    k24, k22 = (signature_matrix(table, SENSORS) for table in (K24_LOCAL, K22_LOCAL))
    assert differences(k24, k22.entries) == {("E(3,1)", "f2(3)"): ("*", "1"), ("E(4,1)", "f2(4)"): ("*", "1")}


@pytest.mark.parametrize("computed", [COMPUTED, COMPUTED_AS_IN_THE_TABLES])
@pytest.mark.parametrize("printed", [K24_TABLE_IV, K22_TABLE_3])
def test_the_global_matrix_is_the_printed_one(computed, printed):
    """The three entries above have no effect: the sensor is the agent's own, or read by another of its modules."""
    assert differences(global_signatures(derived(K24_CERTAIN, computed), AGENTS), parse(printed)) == {}


# the project's own engine: its names for the variables, and the equation of each module
NAMES = dict(
    zip(
        "fuel p_cylinder T_cylinder torque p_receiver T_receiver T_turbine p_charge T_charge T_compressor".split(),
        SENSORS,
        strict=True,
    )
)
PREDICTIONS = {
    "E(1,1)": ("fuel", "fuel_inflow"),
    "E(2,1)": ("p_cylinder", "cylinder_pressure"),
    "E(2,2)": ("T_cylinder", "cylinder_temperature"),
    "E(2,3)": ("torque", "shaft_torque"),
    "E(3,1)": ("p_receiver", "receiver_inflow"),
    "E(3,2)": ("T_receiver", "receiver_temperature"),
    "E(3,3)": ("T_turbine", "turbine_temperature"),
    "E(4,1)": ("p_charge", "charge_inflow"),
    "E(4,2)": ("T_charge", "charge_temperature"),
    "E(4,3)": ("T_compressor", "compressor_temperature"),
}


def engine_signatures(suffix: str = "") -> SignatureMatrix:
    equations = pytest.importorskip("fusion_sfdia.models.marine_engine.equations")
    named = {
        module: (variable, *argument_names(getattr(equations, name + suffix, None) or getattr(equations, name)))
        for module, (variable, name) in PREDICTIONS.items()
    }
    return local_signatures(sensors_read(named, NAMES, known=("fuel_setting", "c")), K24_CERTAIN, SENSORS)


def test_the_engine_model_has_the_structure_of_the_papers_equations():
    """K24's tables take the heat release at nominal speed; the turbine's efficiency still depends on x(4), (43)."""
    turbine = {("E(3,3)", "f1(4)"): ("*", "0")}
    speed = {("E(2,1)", "f3(2)"): ("*", "0"), ("E(2,2)", "f3(2)"): ("*", "0")}
    assert differences(engine_signatures(), K24_LOCAL) == turbine | speed
    assert differences(engine_signatures("_nominal"), K24_LOCAL) == turbine
    assert differences(global_signatures(engine_signatures(), AGENTS), parse(K24_TABLE_IV)) == {}


def test_with_a_constant_slip_modules_read_fewer_sensors():
    """They read the torque for the slip alone; the pressures and the charge temperature they need elsewhere too."""
    freed = {where for where, pair in differences(engine_signatures("_constant"), engine_signatures().entries).items()}
    assert freed == {("E(3,2)", "f3(2)"), ("E(4,1)", "f3(2)"), ("E(4,3)", "f3(2)")}


def test_entries_and_text():
    m = signature_matrix({"r1": {"a": "1", "c": "*"}, "r2": {"b": "*", "a": "0"}}, ("a", "b", "c"))
    assert m.entries == {"r1": {"a": "1", "b": "0", "c": "*"}, "r2": {"a": "0", "b": "*", "c": "0"}}
    assert str(m).splitlines() == ["    a  b  c", "r1  1  0  *", "r2  0  *  0"]
    assert m.possible_masks.tolist() == [0b101, 0b010] and m.certain_masks.tolist() == [0b001, 0]


def test_masks_are_little_endian_at_any_width():
    rng = np.random.default_rng(0)
    for n in (1, 7, 8, 9, 10, 63, 64):
        chosen = rng.random((3, 5, n)) < 0.5
        expected = [[sum(1 << j for j in range(n) if row[j]) for row in block] for block in chosen]
        assert masks(chosen).tolist() == expected
        np.testing.assert_array_equal(members(masks(chosen), n), chosen)


def test_the_signature_of_a_combination_is_the_disjunction():
    m = signature_matrix(K24_LOCAL, SENSORS)
    every = combinations(10)
    assert every.size == 1023 and every[0] == 1 and every[-1] == 1023
    possible, certain = m.columns(every)
    assert possible.shape == certain.shape == (1023, 10)
    for mask in (1, 0b0000011000, 0b0100010001, 1023):
        faults = [s for j, s in enumerate(SENSORS) if mask >> j & 1]
        for i, row in enumerate(m.rows):
            single = {m.entries[row][s] for s in faults}
            combined = "1" if "1" in single else "*" if "*" in single else "0"
            assert (possible[mask - 1, i], certain[mask - 1, i]) == (combined != "0", combined == "1")


def test_columns_grow_with_the_faults():
    m = signature_matrix(K24_LOCAL, SENSORS)
    rng = np.random.default_rng(1)
    some = rng.integers(1, 1024, 500).astype(np.uint64)
    more = some | rng.integers(1, 1024, 500).astype(np.uint64)
    for less_shown, more_shown in zip(m.columns(some), m.columns(more), strict=True):
        assert not np.any(less_shown & ~more_shown)


def test_a_computed_variable_reads_the_sensors_of_its_arguments():
    reads = sensors_read({"m": ("a", "q")}, {"a": "Sa", "b": "Sb", "q": "Sq"}, {"q": ("b", "p")}, known=("p",))
    assert reads == {"m": {"Sa", "Sb"}}
    assert sensors_read({"m": ("a", "q")}, {"a": "Sa", "q": "Sq"}) == {"m": {"Sa", "Sq"}}


def test_errors_state_the_cure():
    with pytest.raises(ValueError, match="flow has no sensor; add it"):
        sensors_read({"m": ("flow",)}, {})
    with pytest.raises(ValueError, match="has a cycle: p <- q <- p"):
        sensors_read({"m": ("p",)}, {}, {"p": ("q",), "q": ("p",)})
    with pytest.raises(ValueError, match="m has c; the sensors are a, b"):
        signature_matrix({"m": {"c": "*"}}, ("a", "b"))
    with pytest.raises(ValueError, match=r"entries \['x'\]; expected '0', '1'"):
        signature_matrix({"m": {"a": "x"}}, ("a",))
    with pytest.raises(ValueError, match="m2: no sensor"):
        signature_matrix({"m1": {"a": "*"}, "m2": {}}, ("a",))
    with pytest.raises(ValueError, match="0 rows; expected 1 to 64"):
        signature_matrix({}, ("a",))
    with pytest.raises(ValueError, match="65 sensors"):
        signature_matrix({"m": {"s0": "*"}}, [f"s{i}" for i in range(65)])
    with pytest.raises(ValueError, match="repeat a name"):
        signature_matrix({"m": {"a": "*"}}, ("a", "a"))
    with pytest.raises(ValueError, match=r"certain\['m'\] has b"):
        local_signatures({"m": {"a"}}, {"m": {"b"}}, ("a", "b"))
    with pytest.raises(ValueError, match="certain but not possible"):
        SignatureMatrix(("m",), ("a", "b"), np.array([[True, False]]), np.array([[False, True]]))
    with pytest.raises(ValueError, match=r"possible is int64 .*expected bool"):
        SignatureMatrix(("m",), ("a",), np.ones((1, 1), int), np.ones((1, 1), bool))
    two = signature_matrix({"m": {"a": "*"}, "n": {"b": "*"}}, ("a", "b"))
    with pytest.raises(ValueError, match=r"agents have the modules \['m'\]; expected each of \['m', 'n'\] once"):
        global_signatures(two, {"1": Agent(("m",), ("a", "b"))})
    with pytest.raises(ValueError, match=r"agents have the sensors \['a'\]"):
        global_signatures(two, {"1": Agent(("m", "n"), ("a",))})
    with pytest.raises(ValueError, match="21 sensors have 2097151 combinations"):
        combinations(21)
    with pytest.raises(ValueError, match="which typo does not read; add it to reads"):
        local_signatures({"m": {"a"}}, {"typo": {"a"}}, ("a",))
