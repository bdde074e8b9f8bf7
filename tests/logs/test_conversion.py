"""Units as logs have them, against conversions known by definition; what is refused names what to state, and that is right."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_sfdia.logs.conversion import Conversion, conversion

# definitions: SI brochure (9th edition), NIST SP 811 (2008), appendix B.8; ISO 80000 for the British thermal unit
INCH, POUND, GRAVITY, ATM = 0.0254, 0.45359237, 9.80665, 101325.0
FOOT, LBF, KGF = 12 * INCH, POUND * GRAVITY, GRAVITY
GALLON, BARREL = 231 * INCH**3, 42 * 231 * INCH**3
PSI = LBF / INCH**2
KNOT, MILE = 1852 / 3600, 1609.344
TURN = 2 * math.pi
BTU, HP, PS = 1055.056, 550 * FOOT * LBF, 75 * KGF
WATER, MERCURY = 9806.65, 133322.387415  # Pa, of a metre
H, D = 3600.0, 86400.0
DEGREE = math.pi / 180

FACTORS: dict[tuple[str, str], float] = {
    (unit, target): factor
    for target, texts in {
        "m": {
            1e-3: "mm|millimeter|Millimetres|ｍｍ|[mm]|(mm)",
            1e-2: "cm|CM",
            1e3: "km|KM|Km",
            1e-6: "um|µm|μm|micron|Microns",
            INCH: "in|in.|inch|Inch|ins|inches|IN",
            FOOT: "ft|feet|Feet|FT|ft.",
            1e-9: "nm",
            1: "meter|metres|Meter",
            1852: "NM|nmi",
            MILE: "mile|miles|mi",
            INCH / 1000: "mil|mils|thou",
            3 * FOOT: "yd",
        },
        "m2": {1e-4: "cm2|cm²|cm^2|sq.cm", INCH**2: "in2|sq. in.|square inch", FOOT**2: "ft2|sqft|sq ft|sq. ft.", 1e-6: "mm2"},
        "m3": {
            1e-3: "l|L|litre|Liters|ltr|dm3",
            BARREL: "bbl|BBL|bbls|stb",
            GALLON: "gal|gals|Gal",
            1e-6: "cc|cm3|ml|mL|ccm",
            FOOT**3: "ft3|cuft|cf",
            1: "m³|m^3|m**3|㎥",
        },
        "m/s": {
            1: "m s-1|m.s-1|m s^-1|m/sec|m*s-1|m·s⁻¹|m s⁻¹|mps|m per s",
            KNOT: "kn|kt|kts|knot|Knots|KTS",
            1 / 3.6: "km/h|km/hr|kmh|kph|km h-1|km/H|KM/H|KMH|km per hour",
            MILE / H: "mph|MPH|mile/h",
            FOOT / 60: "ft/min|fpm|FPM",
            FOOT: "ft/s|fps",
            1e-3: "mm/s|mm s-1",
            INCH: "in/s|ips",
        },
        "m/s2": {GRAVITY: "g|G|gn", 1e-3 * GRAVITY: "mg", 1: "m s-2|m/s²|m/s^2|m/s/s|m.s-2|m s**-2", 0.01: "cm/s2"},
        "m3/s": {
            1 / H: "m3/h|m³/h|m^3/h|m3/hr|m3 h-1|m³·h⁻¹|cmh|CMH|m3/H|㎥/h|m3 per hour|cubic meter per hour",
            1: "m3 s-1|m3.s-1|cumec",
            1e-3 / 60: "l/min|L/min|lpm|LPM|l/Min|liter/min|ltr/min|L/MIN",
            1e-3: "l/s|L/S|lps",
            1e-3 / H: "l/h|lph",
            GALLON / 60: "gpm|GPM|gal/min|USGPM|Gpm|US gpm|US gal/min|U.S. gal/min",
            GALLON / D: "gpd|gal/d",
            FOOT**3 / 60: "cfm|CFM|ft3/min|ACFM|cuft/min|cu ft/min|cu. ft./min|cubic feet per minute",
            BARREL / D: "bbl/d|bbl/day|bpd|BPD|BOPD|stb/d|bbl/D|BBL/D",
            1e6 * GALLON / D: "MGD|mgd",
            1e-6 / 60: "ml/min|mL/min|cc/min|ccm",
            1000 * BARREL / D: "kbbl/d|kbd",
            4.54609e-3 / 60: "igpm|imp gal/min|Imp. gal/min",
        },
        "kg/s": {
            1 / H: "kg/h|kg/hr|kg h-1|kg.h-1|Kg/h|KG/H|kg/Hr",
            1000 / H: "t/h|T/h|tph|TPH|t/hr|tonne/h|t h-1",
            POUND / H: "lb/hr|lb/h|lbs/hr|pph|lbm/h|LB/HR",
            1000 / D: "t/d|tpd|t/day",
            1e-3: "g/s",
            1000 * POUND / H: "klb/h|klb/hr|kpph",
            1e6 * POUND / H: "MMlb/h",
        },
        "kg/(m2 s)": {1: "kg m-2 s-1|kg/m2/s|kg/m2 s|kg/(m².s)|kg.m-2.s-1|kg/m2-s"},
        "W/m2": {1: "W m-2|W/m²|W.m-2", 1000: "kW/m2", BTU / H / FOOT**2: "BTU/h/ft2|Btu/(h ft2)|Btu/h-ft2"},
        "W/(m2 K)": {1: ("W m-2 K-1|W/m2K|W/m²K|W/m2/K|W/m2-K|W/m2 K|W/(m2.K)|W/(m2 °C)|W/m2/degC")},
        "J/(kg K)": {1000: "kJ/kgK|kJ/kg/K|kJ/kg K|kJ/kg-K|kJ/(kg °C)|kJ kg-1 K-1"},
        "K/s": {1: "degC/s|°C/s|K s-1", 1 / 60: "K/min|degC/min|°C/min|C/min", 5 / 9 / 60: "degF/min|°F/min|F/min"},
        "Pa": {
            1e5: "bar|Bar|BAR|bara|bar a|bar(a)|BARA|bar_a|bar abs",
            1e3: "kPa|KPa|kpa|KPA|Kpa|kPa abs|kPaA",
            1e6: "MPa|MPaA",
            100: "mbar|hPa|mb|HPa|mbar(a)",
            PSI: "psi|PSI|psia|PSIA|lbf/in2|psi(a)|psid|PSID|lb/in2",
            1: "pascal|PA|N/m2|N m-2",
            KGF * 1e4: "kgf/cm2|kg/cm2|kg/cm²|ksc|at|ata|kg/cm2a|kg/cm^2|kp/cm2",
            ATM: "atm|ATM",
            WATER / 1000: "mmH2O|mmWC|mm H2O|mm w.c.|mmWG|mmWS|mm of water|mmAq|mmH₂O",
            WATER: "mWC|mH2O|m w.c.|mWS",
            WATER * INCH: ("inH2O|in. w.c.|in H2O|inWC|in.H2O|INWC|iwc|inches of water|inches w.c.|in wg"),
            WATER * FOOT: "ftH2O|ft H2O|ftWC",
            MERCURY / 1000: "mmHg|mm Hg|MMHG|mm of mercury",
            MERCURY * INCH: "inHg|in. Hg|InHg|in Hg",
            ATM / 760: "torr|Torr|TORR",
            LBF / FOOT**2: "psf|lbf/ft2",
        },
        "W/(m K)": {1: "W/mK|W/m.K|W/m/K|W m-1 K-1"},
        "Pa s": {1e-3: "CP|cP|mPa s|mPa.s|mPa·s|mPas|cp|cps", 0.1: "P", 1: "Pa.s|Pa·s|Pas|kg/(m s)|kg m-1 s-1"},
        "m2/s": {1e-6: "cSt|mm2/s|CST|cst"},
        "N": {1e3: "kN|KN", KGF: "kgf|kp", LBF: "lbf|LBF", 10: "daN"},
        "N m": {
            1: "Nm|N-m|N·m|N.m|N*m|N⋅m|J|NM|newton meter|Nm ",
            1e3: "kNm|kN m|kN-m|kN.m|KNM",
            1e-3: "mNm|Nmm|N mm|N.mm",
            FOOT * LBF: "ft-lb|ft lbf|ft.lb|ft lb|lbf ft|lbf-ft|lb-ft|ft·lbf",
            INCH * LBF: "in-lb|lbf in|in lbf|in.lb|lb-in",
            KGF: "kgf m|kg m|kg-m|kgf.m|kgm",
        },
        "W": {
            1e3: "kW|KW|kw|Kw|kVA|kVAr|kvar|kWh/h|kJ/s|KVA",
            1e6: "MW|MVA",
            1e-3: "mW",
            HP: "hp|HP|Hp|bhp",
            PS: "PS|CV|ch",
            BTU / H: "BTU/h|Btu/hr|btu/h|BTUH|BTU/HR",
            4184 / H: "kcal/h|kcal/hr",
            1e6 * BTU / H: "MMBtu/h|MMBTU/hr|mmbtu/h",
            1000 * BTU / H: "kBtu/h|MBH",
            12000 * BTU / H: "TR|RT",
        },
        "J": {3.6e6: "kWh|KWH|kWhr|kW h|kW-h|kW.h", 1e3: "kJ|KJ", 4184: "kcal", BTU: "BTU|btu"},
        "rad/s": {
            TURN / 60: "rpm|RPM|Rpm|r/min|U/min|rev/min|r.min-1|Upm|revs/min|tr/min",
            TURN: "rps|rev/s|r/s",
            DEGREE: "deg/s|°/s|degrees/s|deg s-1|DEG/S",
            1: "rad s-1|RAD/S",
        },
        "rad": {DEGREE: "deg|°|degrees|degree|Deg|DEG|˚|deg.", 1e-3: "mrad", TURN: "rev|revolution"},
        "1/s": {
            1 / 60: "min-1|1/min|/min|min^-1|min⁻¹|per min",
            1: "s-1|Hz|/s|1/sec|HZ|hz",
            1 / H: "h-1|1/h",
            1e3: "kHz|KHz|KHZ",
        },
        "1": {
            0.01: ("%|percent|pct|PCT|％|Percent|[%]|%RH|% RH|vol%|%vol|mol%|wt%|% open|%O2|per cent|RH%"),
            1e-6: "ppm|PPM|ppmv|mg/kg|ppm(v)",
            1e-9: "ppb",
            1e-3: "‰|g/kg|permille",
            1: "-|[-]|--|unitless|kg/kg|m/m|–|p.u.",
        },
        "s": {
            1: "sec|Sec|SEC|second|seconds|secs",
            60: "min|mins|Min|MIN|minutes",
            H: "h|hr|hrs|Hr|hours|H",
            1e-3: "ms|msec|millisecond",
            D: "d|day|days|D",
            1e-6: "us|µs|usec|μs",
        },
        "A": {1: "A|Amps|amps|amp|Amp|Adc|Aac|A rms|ampere", 1e-3: "mA|mAdc|mA DC", 1e3: "kA|KA", 1e-6: "uA|µA", 1e-12: "pA"},
        "V": {1: "Volts|volts|volt|Vdc|VDC|V DC|Vac|V rms|VAC", 1e-3: "mV|mVdc", 1e3: "kV|KV"},
        "C": {1: "coulomb|A s|As|C", 3600: "Ah", 3.6: "mAh"},
        "F": {1e-6: "uF|µF", 1e-12: "pF"},
        "ohm": {1: "Ω|Ohm|OHM|Ω|ohms", 1e3: "kΩ|kOhm|kohm"},
        "S/m": {1e-4: "uS/cm|µS/cm|μS/cm|umho/cm", 0.1: "mS/cm", 1e8: "MS/cm", 1e-3: "mS/m"},
        "S": {1: "mho|siemens", 1e-3: "mS", 1e6: "MS"},
        "T": {1e-3: "mT", 1e-4: "G|gauss|Gauss"},
        "kg": {1: "Kg|KG|kilogram", 1e-3: "g|gram", 1000: "t|T|tonne|Tonnes|te", POUND: "lb|lbs|LB|lbm", 1e-6: "mg"},
        "kg/m3": {1: "kg m-3|g/l|kg/m³|g/L", 1000: "g/cm3|g/cc|kg/l|t/m3", POUND / FOOT**3: "lb/ft3|pcf"},
        "mol/m3": {1000: "mol/l|M|mol/L|kmol/m3", 1: "mmol/l"},
        "mol/s": {1000 / H: "kmol/h|kmol/hr", 453.59237 / H: "lbmol/h|lbmol/hr"},
        "H": {1e-12: "pH", 1e-3: "mH"},
        "Nm3/s": {
            1 / H: ("Nm3/h|Nm³/h|Nm3/hr|m3(N)/h|Nm^3/h|nm3/h|NM3/H|NCMH|norm. m3/h|m3N/h|mn3/h|m_N^3/h"),
            1000 / H: "kNm3/h",
            1e-3 / 60: "Nl/min|NL/min|NLPM|ln/min",
        },
        "Sm3/s": {1 / H: "Sm3/h|Sm³/h|sm3/h|SM3/H|SCMH|std m3/h|m3(S)/h"},
        "scfh": {60: "scfm|SCFM|scf/min", 1e6 / 24: "MMSCFD|MMscf/d|mmscfd", 1e3 / 24: "MSCFD|kscf/d"},
        "slpm": {1e-3: "sccm|SCCM", 1: "SLM|sl/min"},
        "dB": {1: "dB|[dB]"},
    }.items()
    for factor, listed in texts.items()
    for unit in listed.split("|")
}
AFFINE: dict[tuple[str, str], tuple[float, float]] = {
    (unit, target): (factor, offset)
    for target, rows in {
        "K": [
            (
                1,
                273.15,
                (
                    "degC|C|deg C|Deg C|DegC|degrees C|degree_C|Celsius|ºC|℃|oC|°C|° C|˚C|[C]|DEGC|"
                    "degC.|deg. C|deg_C|c|celsius|degree Celsius|Degrees Celsius|Cel|C°|(°C)|degs C|"
                    "centigrade|Celcius|DEG C|℃ "
                ),
            ),
            (5 / 9, 459.67 * 5 / 9, "degF|F|°F|deg F|DegF|oF|fahrenheit|Degrees F|℉"),
            (1, 0, "K|kelvin|Kelvin|degK|°K|deg K|K"),
            (5 / 9, 0, "degR|°R|R"),
            (1, 0, "delta_degC|Δ°C|ΔK"),
            (1e-3, 0, "mK"),
        ],
        "degC": [(1, -273.15, "K"), (5 / 9, -32 * 5 / 9, "F|degF"), (1, 0, "C|°C|Celsius")],
        "C": [(1, 0, "degC|°C"), (1, -273.15, "K"), (5 / 9, -32 * 5 / 9, "F|°F")],
        "°F": [(1.8, 32, "C|degC"), (1, 0, "F|degF")],
        "Pa": [
            (1e5, ATM, ("barg|bar(g)|bar g|Barg|BARG|bar_g|bar-g|bar gauge|bar(G)|BAR(G)|bar [g]")),
            (PSI, ATM, "psig|PSIG|psi(g)|psi g|PSI gauge"),
            (1e3, ATM, "kPag|kPa(g)|KPAG|kPa g"),
            (1e6, ATM, "MPaG|MPag|MPa(g)"),
            (100, ATM, "mbarg|mbar(g)|hPa(g)"),
            (KGF * 1e4, ATM, "kg/cm2g|kg/cm2(g)|kgf/cm2g|kg/cm² g"),
            (WATER * INCH, ATM, "inH2O(g)|in. w.c. gauge"),
            (1, ATM, "Pa(g)"),
        ],
        "barg": [(1, 0, "bar(g)|BARG"), (PSI / 1e5, 0, "psig"), (1, -ATM / 1e5, "bar|bara"), (1e-5, -ATM / 1e5, "Pa")],
    }.items()
    for factor, offset, listed in rows
    for unit in listed.split("|")
}


@pytest.mark.parametrize(("unit", "target"), FACTORS)
def test_a_factor_is_that_of_the_definition(unit: str, target: str) -> None:
    factor, offset = conversion(unit, target)
    assert factor == pytest.approx(FACTORS[unit, target], rel=1e-12)
    assert offset == 0


@pytest.mark.parametrize(("unit", "target"), AFFINE)
def test_an_offset_is_that_of_the_definition(unit: str, target: str) -> None:
    assert conversion(unit, target) == pytest.approx(AFFINE[unit, target], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(("unit", "target"), [key for key in FACTORS if key[1] != "dB"])
def test_a_plant_may_have_its_unit_in_the_same_spelling(unit: str, target: str) -> None:
    """The other direction: the sensor or signal is in the unit, the column in the target."""
    factor, offset = conversion(target, unit)
    assert factor == pytest.approx(1 / FACTORS[unit, target], rel=1e-12)
    assert offset == 0


AIR, NORMAL, STANDARD, AT = (
    0.0289652,
    101325 / (8.314462618 * 273.15),
    101325 / (8.314462618 * 288.15),
    293.15 / 5e5 * 8.314462618,
)
SCF = 101325 / (8.314462618 * 288.706) * FOOT**3  # mol
REFUSED: dict[tuple[str, str], tuple[str, float, float]] = {  # words of the refusal, and a conversion that it offers
    ("MM", "m"): ('unit = "mm" or unit = "Mm"', 1e-3, 0),
    ("mw", "W"): ('unit = "mW" or unit = "MW"', 1e6, 0),
    ("MPA", "Pa"): ('unit = "mPa" or unit = "MPa"', 1e6, 0),
    ("mpa", "Pa"): ('unit = "MPa"', 1e6, 0),
    ("MHZ", "Hz"): ('unit = "mHz" or unit = "MHz"', 1e6, 0),
    ("MBAR", "Pa"): ('unit = "mbar" or unit = "Mbar"', 100, 0),
    ("MS", "s"): ('unit = "ms"', 1e-3, 0),
    ("mS", "s"): ('unit = "ms"', 1e-3, 0),
    ("pA", "Pa"): ('unit = "Pa"', 1, 0),
    ("Pa", "A"): ('unit = "pA"', 1e-12, 0),
    ("PF", "F"): ('unit = "pF"', 1e-12, 0),
    ("kn", "N"): ('unit = "kN"', 1e3, 0),
    ("nm", "N m"): ('unit = "Nm"', 1, 0),
    ("M", "m"): ('unit = "m"', 1, 0),
    ("M3/h", "m3/s"): ('did you mean unit = "m3/h"', 1 / H, 0),
    ("MT/h", "kg/s"): ('unit = "t/h" or unit = "Mt/h"', 1000 / H, 0),
    ("mt/h", "kg/s"): ('unit = "t/h" or unit = "Mt/h"', 1000 / H, 0),
    ("KN-M", "N m"): ('did you mean unit = "kN-m"', 1e3, 0),
    ("NM3/H", "m3/s"): ("counts a gas", NORMAL * AT / H, 0),
    ("DB", "1"): ("a logarithm", 1, 0),
    ("PH", "1"): ("a logarithm", 1, 0),
    ("degC", "delta_degC"): ("does not convert", 1, 0),
    ("ton/h", "kg/s"): ('unit = "t/h", unit = "short_ton/h" or unit = "long_ton/h"', 2000 * POUND / H, 0),
    ("Tons", "kg"): ('unit = "t"', 1000, 0),
    ("tons", "W"): ('unit = "TR"', 12000 * BTU / H, 0),
    ("MBtu/h", "W"): ('unit = "kBtu/h" or unit = "MMBtu/h"', 1e6 * BTU / H, 0),
    ("Mlb/h", "kg/s"): ('unit = "klb/h" or unit = "MMlb/h"', 1000 * POUND / H, 0),
    ("ms-1", "m/s"): ('unit = "m/s"', 1, 0),
    ("kg", "N"): ('unit = "kgf"', KGF, 0),
    ("lb", "N"): ('unit = "lbf"', LBF, 0),
    ("degX", "K"): ('unit = "degC", unit = "K" or unit = "degF"', 1, 273.15),
    ("kg", "K"): ('unit = "degC", unit = "K" or unit = "degF"', 1, 273.15),
    ("%", "K"): ('unit = "degC" and as scale a hundredth of the span, scale = 0.04', 0.04, 273.15),
    ("%", "m"): ('unit = "m" and as scale a hundredth of the span, scale = 0.04', 0.04, 0),
    ("barq", "Pa"): ('unit = "bar(g)"', 1e5, ATM),
    ("furlong/", "m"): ("it is no known unit", 1e-3, 0),
    ("m#m", "m"): ("it is no known unit", 1e-3, 0),
    ("3 m", "m"): ("it is no known unit", 1, 0),
    ("rpm", "1"): ("scale = 0.001 for 1000 rpm", 1e-3, 0),
    ("Hz", "rad/s"): ("one of them states an angle", TURN, 0),
    ("1/min", "rad/s"): ("one of them states an angle", TURN / 60, 0),
    ("min-1", "rad/s"): ("for revolutions", TURN / 60, 0),
    ("rpm", "Hz"): ("for revolutions", 1 / 60, 0),
    ("rad", "1"): ("for radians", 1, 0),
    ("deg", "1"): ("for radians", DEGREE, 0),
    ("dB", "1"): ("a logarithm, which no factor converts", 1, 0),
    ("dBm", "W"): ("a logarithm", 1, 0),
    ("dB(A)", "Pa"): ("a logarithm", 1, 0),
    ("pH", "1"): ("10\\*\\*\\(-x\\) for pH", 1, 0),
    ("W", "dBm"): ("a logarithm", 1, 0),
    ("Nm3/h", "m3/s"): ("reference conditions, usually 0 degC and 101325 Pa", NORMAL * AT / H, 0),
    ("Sm3/h", "m3/s"): ("reference conditions, usually 15 degC", STANDARD * AT / H, 0),
    ("nm3/h", "m3/s"): ("reference conditions", NORMAL * AT / H, 0),
    ("MMSCFD", "m3/s"): ("reference conditions, usually 15.56 degC", 1e6 * SCF * AT / D, 0),
    ("SCFM", "m3/h"): ("reference conditions", 60 * SCF * AT, 0),
    ("Nm3/h", "kg/s"): ("for dry air", NORMAL * AIR / H, 0),
    ("Nm3/h", "mol/s"): ("reference conditions", NORMAL / H, 0),
    ("slpm", "l/min"): ("reference conditions", NORMAL * AT, 0),
    ("m3/h", "Nm3/h"): ("reference conditions", 1 / (NORMAL * AT), 0),
    ("kg/h", "Nm3/h"): ("for dry air", 1 / (NORMAL * AIR), 0),
    ("Sm3/h", "Nm3/h"): ("15 degC and 101325 Pa and 0 degC", STANDARD / NORMAL, 0),
    ("bar", "bananas"): ("no known unit", 1, 0),
    ("mA", "m"): ("of what is proportional to it", 1e-3, 0),
}


def offered(message: str, target: str) -> Iterator[Conversion]:
    """The conversions that a refusal names, as a map would state them: each unit with the scales up to the next unit."""
    parts = re.split(r'unit = "([^"]+)"', message)
    for unit, text in zip(parts[1::2], parts[2::2], strict=True):
        scales = [float(x) for x in re.findall(r"scale = ([-+.\de]*\d)", text)]
        yield from (conversion(unit, target, scale) for scale in scales or [1.0])


@pytest.mark.parametrize(("unit", "target"), REFUSED)
def test_what_a_refusal_says_to_state_is_right(unit: str, target: str) -> None:
    words, factor, offset = REFUSED[unit, target]
    with pytest.raises(ValueError, match=words.replace("(g)", "\\(g\\)")) as caught:
        conversion(unit, target)
    found = [*offered(str(caught.value), target)]  # none of them is refused
    assert any(c == pytest.approx((factor, offset), rel=1e-5) for c in found)


def test_what_measures_a_temperature_has_no_scale_as_its_cure() -> None:
    """Of a column in degrees that a map takes as K with a scale, all readings are 273 too low."""
    for unit in ("degX", "kg", "mV", "Temp", "C/F"):
        with pytest.raises(ValueError) as caught:
            conversion(unit, "K")
        assert "scale" not in str(caught.value)


def test_equal_units_leave_the_bits() -> None:
    assert conversion("furlong per fortnight", "furlong per fortnight")(0.1) == 0.1
    assert conversion("", "K", 0.1)(30.0) == 30.0 * 0.1
    assert conversion("mm", "m", 0.1)(12000.0) == pytest.approx(1.2, rel=1e-15)
    assert conversion("m³/s", "m3/s") == (1.0, 0.0)
    assert conversion("Bananas", "Bananas ") == (1.0, 0.0)


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.sampled_from([*"mMkgKCs/ -23^().a%°hNµ", "bar", "dB"]), max_size=6),
    st.sampled_from(["m", "K", "Pa", "1", "m3/s", "N m", "rad/s"]),
)
def test_any_text_converts_with_a_finite_factor_or_is_refused(parts: list[str], target: str) -> None:
    try:
        factor, offset = conversion("".join(parts), target)
    except ValueError as error:
        assert "does not convert" in str(error)
        return
    assert factor > 0
    assert math.isfinite(factor) and math.isfinite(offset)


@pytest.mark.parametrize("unit", ["M222", "m-222", "km333"])
def test_a_factor_beyond_all_numbers_is_refused(unit: str) -> None:
    with pytest.raises(ValueError, match="does not convert"):
        conversion(unit, "m")


@pytest.mark.parametrize("unit", ["in2 decibel", "decibel", "neper/m", "decade", "m octaves"])
def test_logarithms_of_pint_are_no_units_in_a_product_either(unit: str) -> None:
    for target in ("m2", "1", "Nm3/h"):
        with pytest.raises(ValueError, match="does not convert"):
            conversion(unit, target)


def test_a_long_text_is_no_unit() -> None:
    for text in ("C " * 29, "C " * 1000, "m" * 10**6, "(" * 50, "bar g " * 9):
        with pytest.raises(ValueError, match="it is no known unit"):
            conversion(text, "m")
