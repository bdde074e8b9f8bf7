"""Units as people and programs write them, read as units of pint: "m s-1", "degrees C", "kg/cm2(g)", "GPM", "in. w.c.".

A text is split into names of units, each is looked up in the tables below, and what they do not have in pint, where pint
is exact: its own reading also finds attometres per second in "amps" and millipascals in "mPas". A name may have several
meanings, C is coulomb and degree Celsius: `readings` returns all, and the unit on the other side of a conversion decides.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from functools import cache, lru_cache, reduce
from itertools import product
from operator import mul
from typing import Any, NamedTuple

ATMOSPHERE = 101325.0  # Pa
TEXTS = 1000  # that are remembered
LONGEST, FACTORS = 60, 6  # characters and factors of a unit
DIMENSIONLESS = ("", "1", "-", "--", "—", "none", "unitless", "dimensionless", "ratio", "fraction", "frac", "p.u.", "pu")

PREFIXES = {
    "f": "femto", "p": "pico", "n": "nano", "u": "micro", "m": "milli", "c": "centi", "d": "deci", "h": "hecto", "k": "kilo",
    "M": "mega", "G": "giga", "T": "tera",
}  # fmt: skip
SI = "pnumkMGT"
METRIC = {  # symbol: unit of pint, and the prefixes that it is seen with
    "m": ("meter", "fpnumcdkM"), "g": ("gram", "pnumckM"), "s": ("second", "fpnumkM"), "A": ("ampere", "fpnumkM"),
    "K": ("kelvin", "umk"), "mol": ("mole", "pnumkM"), "cd": ("candela", "m"), "N": ("newton", "nmuckMG"),
    "Pa": ("pascal", "umhkMG"), "J": ("joule", SI), "W": ("watt", SI), "C": ("coulomb", "pnumk"), "V": ("volt", "pnumkM"),
    "F": ("farad", "pnum"), "ohm": ("ohm", "umkMG"), "Ohm": ("ohm", "umkMG"), "S": ("siemens", "pnumkM"), "Wb": ("weber", "um"),
    "T": ("tesla", "pnumk"), "H": ("henry", "pnum"), "Hz": ("hertz", "umkMGT"), "l": ("liter", "pnumcdhkM"),
    "L": ("liter", "pnumcdhkM"), "bar": ("bar", "umdkM"), "Wh": ("watt_hour", "mkMGT"), "Whr": ("watt_hour", "kMG"),
    "VA": ("volt_ampere", "mkMG"), "var": ("watt", "mkMG"), "VAr": ("watt", "mkMG"), "VAR": ("watt", "mkMG"),
    "Ah": ("ampere_hour", "mk"), "eV": ("electron_volt", "mkMG"), "t": ("metric_ton", "kMG"), "cal": ("calorie", "kMG"),
    "rad": ("radian", "um"), "P": ("poise", "mc"), "St": ("stokes", "mc"), "Torr": ("torr", "um"), "torr": ("torr", "um"),
    "lx": ("lux", "mk"), "lm": ("lumen", "mk"), "Bq": ("becquerel", "kMGT"), "Sv": ("sievert", "num"), "Gy": ("gray", "num"),
    "kat": ("katal", "num"), "Nm": ("newton * meter", "umckM"), "Pas": ("pascal * second", "um"), "Ws": ("joule", "mkM"),
    "As": ("coulomb", "mk"), "Vs": ("volt * second", "um"),
}  # fmt: skip
NAMES: dict[str, tuple[str, ...]] = {  # what is written so and no other way, with all its meanings
    "C": ("coulomb", "degree_Celsius"), "F": ("farad", "degree_Fahrenheit"), "R": ("degree_Rankine",),
    "g": ("gram", "standard_gravity"), "mg": ("milligram", "millistandard_gravity"), "G": ("standard_gravity", "flux_gauss"),
    "gn": ("standard_gravity",), "T": ("tesla", "metric_ton"), "D": ("debye", "day"),
    "H": ("henry", "hour"), "S": ("siemens", "second"), "U": ("revolution", "enzyme_unit"), "r": ("revolution",),
    "a": ("year",), "h": ("hour",), "d": ("day",), "M": ("molar",), "mb": ("millibar",),
    "kn": ("knot",), "kt": ("knot", "kilometric_ton"),
    "NM": ("nautical_mile", "newton * meter"), "ln": ("normal_liter",), "mln": ("millinormal_liter",),
    "PS": ("metric_horsepower",), "CV": ("metric_horsepower",), "ch": ("metric_horsepower",), "at": ("technical_atmosphere",),
    "cp": ("centipoise",), "cps": ("centipoise", "1 / second"), "Nmm": ("newton * millimeter",), "kp": ("kilogram_force",),
    "y": ("year",), "mK": ("millikelvin", "meter * kelvin"), "daNm": ("decanewton * meter",), "Å": ("angstrom",),
    "mD": ("millidarcy",), "TR": ("refrigeration_ton",), "RT": ("refrigeration_ton",), "kgm": ("kilogram_force * meter",),
    "°": ("degree",), "%": ("percent",), "‰": ("permille",), "daN": ("decanewton",), "ha": ("hectare",), "u": ("dalton",),
    "pH": ("picohenry",), "Np": (), "dB": (), "te": ("metric_ton",), "kgK": ("kilogram * kelvin",),
    "ata": ("technical_atmosphere",),
}  # fmt: skip
WORDS: dict[str, tuple[str, ...]] = {  # the same in upper and lower case
    "sec": ("second",), "secs": ("second",), "msec": ("millisecond",), "usec": ("microsecond",), "mins": ("minute",),
    "min": ("minute",), "hr": ("hour",), "hrs": ("hour",), "day": ("day",), "days": ("day",), "wk": ("week",), "yr": ("year",),
    "in": ("inch",), "ins": ("inch",), "inch": ("inch",), "inches": ("inch",), "ft": ("foot",), "feet": ("foot",),
    "yd": ("yard",), "mi": ("mile",), "nmi": ("nautical_mile",), "mil": ("thou",), "mils": ("thou",), "thou": ("thou",),
    "micron": ("micrometer",), "microns": ("micrometer",), "knot": ("knot",), "knots": ("knot",), "kts": ("knot",),
    "kph": ("kilometer / hour",), "kmh": ("kilometer / hour",), "kmph": ("kilometer / hour",), "mph": ("mile / hour",),
    "mps": ("meter / second",), "fps": ("foot / second",), "fpm": ("foot / minute",), "ips": ("inch / second",),
    "lb": ("pound",), "lbs": ("pound",), "lbm": ("pound",), "lbf": ("force_pound",), "lbmol": ("pound_mole",), "oz": ("ounce",),
    "kgf": ("kilogram_force",), "gf": ("force_gram",), "kip": ("kip",), "kips": ("kip",), "gr": ("grain",),
    "gal": ("gallon",), "gals": ("gallon",), "qt": ("quart",), "pt": ("pint",), "cc": ("centimeter ** 3",),
    "ccm": ("centimeter ** 3", "centimeter ** 3 / minute"), "cbm": ("meter ** 3",), "cum": ("meter ** 3",),
    "cf": ("foot ** 3",), "cuft": ("foot ** 3",), "sqft": ("foot ** 2",), "sqm": ("meter ** 2",),
    "ltr": ("liter",), "ltrs": ("liter",), "lit": ("liter",), "litre": ("liter",), "litres": ("liter",),
    "bbl": ("oil_bbl",), "bbls": ("oil_bbl",), "stb": ("oil_bbl",), "bpd": ("oil_bbl / day",), "bopd": ("oil_bbl / day",),
    "bwpd": ("oil_bbl / day",), "blpd": ("oil_bbl / day",), "kbbl": ("kilooil_bbl",), "kbd": ("kilooil_bbl / day",),
    "gpm": ("gallon / minute",), "usgpm": ("gallon / minute",), "gph": ("gallon / hour",), "gpd": ("gallon / day",),
    "mgd": ("megagallon / day",), "igpm": ("imperial_gallon / minute",), "lpm": ("liter / minute",), "lph": ("liter / hour",),
    "lps": ("liter / second",), "cfm": ("foot ** 3 / minute",), "acfm": ("foot ** 3 / minute",), "cfs": ("foot ** 3 / second",),
    "cfh": ("foot ** 3 / hour",), "acfh": ("foot ** 3 / hour",), "cfd": ("foot ** 3 / day",), "cmh": ("meter ** 3 / hour",),
    "cumec": ("meter ** 3 / second",), "cumecs": ("meter ** 3 / second",), "tph": ("metric_ton / hour",),
    "tpd": ("metric_ton / day",), "pph": ("pound / hour",), "kpph": ("kilopound / hour",), "klb": ("kilopound",),
    "rpm": ("revolution / minute",), "upm": ("revolution / minute",), "rps": ("revolution / second",),
    "rev": ("revolution",), "revs": ("revolution",), "tr": ("revolution",), "deg": ("degree",), "degs": ("degree",),
    "degree": ("degree",), "degrees": ("degree",), "celsius": ("degree_Celsius",), "celcius": ("degree_Celsius",),
    "centigrade": ("degree_Celsius",), "cel": ("degree_Celsius",), "fahrenheit": ("degree_Fahrenheit",),
    "degc": ("degree_Celsius",), "degf": ("degree_Fahrenheit",), "degr": ("degree_Rankine",), "degk": ("kelvin",),
    "psi": ("psi",), "psf": ("force_pound / foot ** 2",), "pcf": ("pound / foot ** 3",),
    "ksc": ("kilogram_force / centimeter ** 2",),
    "bar": ("bar",), "atm": ("atmosphere",), "hp": ("horsepower",), "bhp": ("horsepower",), "shp": ("horsepower",),
    "btu": ("Btu",), "btuh": ("Btu / hour",), "mbh": ("kiloBtu / hour",), "kbtu": ("kiloBtu",),
    "amp": ("ampere",), "amps": ("ampere",), "ohm": ("ohm",), "ohms": ("ohm",), "var": ("watt",), "kvar": ("kilowatt",),
    "pct": ("percent",), "percent": ("percent",), "ppm": ("ppm",), "ppb": ("parts_per_billion",), "mho": ("siemens",),
    "mhos": ("siemens",), "umhos": ("microsiemens",), "gauss": ("flux_gauss",), "m3ph": ("meter ** 3 / hour",),
    "klph": ("kiloliter / hour",), "mld": ("megaliter / day",), "bph": ("oil_bbl / hour",), "kbpd": ("kilooil_bbl / day",),
    "mmbtuh": ("megaBtu / hour",), "kscfd": ("kilostandard_cubic_foot / day",), "kscfh": ("kilostandard_cubic_foot / hour",),
    "scmd": ("standard_cubic_meter / day",), "ncmd": ("normal_cubic_meter / day",), "imperial_gallon": ("imperial_gallon",),
    "umho": ("microsiemens",), "mmho": ("millisiemens",), "dbar": ("decibar",),
    "delta_degc": ("delta_degree_Celsius",),
    "delta_degf": ("delta_degree_Fahrenheit",), "delta_k": ("kelvin",),
    "ncm": ("normal_cubic_meter",), "scm": ("standard_cubic_meter",), "ncmh": ("normal_cubic_meter / hour",),
    "scmh": ("standard_cubic_meter / hour",), "scf": ("standard_cubic_foot",), "scfm": ("standard_cubic_foot / minute",),
    "scfh": ("standard_cubic_foot / hour",), "scfd": ("standard_cubic_foot / day",),
    "mscf": ("kilostandard_cubic_foot",), "mscfd": ("kilostandard_cubic_foot / day",), "kscf": ("kilostandard_cubic_foot",),
    "mscfh": ("kilostandard_cubic_foot / hour",), "mmscf": ("megastandard_cubic_foot",),
    "mmscfd": ("megastandard_cubic_foot / day",), "mmscfh": ("megastandard_cubic_foot / hour",),
    "slpm": ("standard_liter / minute",), "slm": ("standard_liter / minute",), "slph": ("standard_liter / hour",),
    "sccm": ("millistandard_liter / minute",), "scc": ("millistandard_liter",), "nlpm": ("normal_liter / minute",),
    "nlm": ("normal_liter / minute",), "normal_cubic_meter": ("normal_cubic_meter",),
    "standard_cubic_meter": ("standard_cubic_meter",),
}  # fmt: skip
NAMES |= {"Nl": ("normal_liter",), "NL": ("normal_liter",), "sl": ("standard_liter",), "sL": ("standard_liter",)}
LENGTHS = {"mm": "millimeter", "cm": "centimeter", "m": "meter", "in": "inch", "inch": "inch", "inches": "inch", "ft": "foot"}
LIQUID_COLUMN = re.compile(
    r"(mm|cm|m|inches|inch|in|i|ft)[\s.]*(?:of[\s.]*)?(?:(hg|mercury)|h2o|water|w[\s.]*[cgs]|aq|ce|ca)(?:[\s.]*col(?:umn|\.)?)?[\s.]*",
    re.I,
)
FORCES = {
    "kilogram": "kilogram_force",
    "gram": "force_gram",
    "pound": "force_pound",
    "ounce": "ounce_force",
    "metric_ton": "force_metric_ton",
}
CUSTOMARY = {"btu": "Btu", "cf": "cubic_foot", "lb": "pound", "bbl": "oil_bbl", "stb": "oil_bbl", "gal": "gallon"}
MANY = re.compile(rf"(k|mm|MM)({'|'.join(CUSTOMARY)})s?", re.I)  # of these M alone is a thousand to one and a million to others
DELTAS = {"degree_Celsius": "delta_degree_Celsius", "degree_Fahrenheit": "delta_degree_Fahrenheit"}
SEVERAL: dict[str, tuple[str, ...]] = {  # what one name is used for, and which names are clear
    **dict.fromkeys(("ton", "Ton", "TON", "tons", "Tons", "TONS"), ("t", "short_ton", "long_ton", "TR")),
    **{f"M{c}": (f"k{c}", f"MM{c}") for c in ("Btu", "BTU", "btu", "lb", "lbs", "bbl", "stb", "gal", "cf")},
    **dict.fromkeys(("MT", "mt"), ("t", "Mt")), "Cal": ("cal", "kcal"),
}  # fmt: skip

SUPERSCRIPTS = str.maketrans("⁺⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "+-0123456789")
SIGNS = str.maketrans(
    dict.fromkeys("·⋅∙•×*∗", "*") | dict.fromkeys("‐‑‒−", "-") | dict.fromkeys("∕⁄÷", "/") | dict.fromkeys("˚∘", "°")
    | {"∆": "Δ", "–": "-"}
)  # fmt: skip
TEMPERATURE = re.compile(
    r"(?:°|(?<![^\W\d_])(?:degrees?|degs?|grad))[\s._]*(celsius|celcius|centigrade|fahrenheit|kelvin|rankine|[cfkr])(?![^\W\d_])"
    r"|(?<![^\W\d_])([cf])\s*°|(?<![^\W\d_])(?-i:o([CF]))(?![^\W\d_])",
    re.I,
)
CUBED, ALONE, END = r"\s*(?:\^|\*\*)?\s*3", r"(?<![^\W_])(k|K|MM?)?", r"(?![\w^-])"
NORMAL = (
    (re.compile(rf"{ALONE}(?:[Nn](?i:m)|norm(?:al)?[\s._]*m){CUBED}(?!\d)"), "normal_cubic_meter"),
    (re.compile(rf"{ALONE}(?:[Ss](?i:m)|(?:std|standard|st)[\s._]*m){CUBED}(?!\d)"), "standard_cubic_meter"),
    (re.compile(rf"{ALONE}(?:m_?[Nn]{CUBED}|m{CUBED}[_ ]?(?:[Nn]|\([Nn]\)|\[[Nn]\])){END}"), "normal_cubic_meter"),
    (re.compile(rf"{ALONE}m{CUBED}[_ ]?(?:S|std|\((?:[Ss]|std)\)){END}"), "standard_cubic_meter"),
)
GAS_PREFIXES = {None: "", "k": "kilo", "K": "kilo", "M": "mega", "MM": "mega"}
ROOMS = (  # areas and volumes in words
    (re.compile(r"(?<![^\W_])(?:cubic|cu)[\s._]+([^\W\d]+)\.?", re.I), r"\1^3"),
    (re.compile(r"(?<![^\W_])(?:square|sq)[\s._]+([^\W\d]+)\.?", re.I), r"\1^2"),
    (re.compile(r"(?<![^\W_])imp(?:erial)?[\s._]*gal(?:lons?)?(?![^\W_])", re.I), "imperial_gallon"),
    (re.compile(r"(?<![^\W_])U\.?S\.?[\s._]*(?=g(?:al|p[mhd]))", re.I), ""),
)
SHARES = r"r\.?h\.?|rel\.? ?hum\.?|vol\.?|v|w|wt|mass|mol|v/v|w/w|m/m|o2|co2|co|ch4|h2|lel|open|opening|dry|wet|of span|span|fs"
QUALIFIED = re.compile(  # "%RH", "vol%", "ppmv": what the share is of does not change the number
    r"(?:(?:vol|wt|mol|mass|rh|m|v|w)[\s.-]*)?(%|pct|percent|per cent|ppm|ppb|‰)[\s.-]*\(?"
    rf"(?:{SHARES})?\)?",
    re.I,
)
ELECTRIC = re.compile(r"\b([pnumkM]?[VA])[\s_]*\(?(?i:ac|dc|rms)\)?(?![^\W_])")
LOGARITHM = re.compile(r"dB(?:\(?[A-Za-z]{0,4}\)?)?|DB|db|Np|(?i:ph)|pKa", re.ASCII)
LOGARITHMIC = ("decibel", "bel", "neper", "octave", "decade")  # units of pint
GAUGE = re.compile(r"(.*?[^\s._(\[-])[\s._-]*[(\[]?(gauge|gage|g|absolute|abs|a|differential|diff|d)[)\]]?", re.I)
TOKEN = re.compile(r"\s*(\d+(?:\.\d+)?|\*\*|[*/^()-]|[^\W\d]+|[°%‰])")


class UnitMeaning(NamedTuple):
    """A unit of pint, and of a gauge pressure the pressure (Pa) above which it counts."""

    unit: Any
    above: float = 0.0


@cache
def registry() -> Any:
    """The units of pint, and those that it does not have."""
    import pint

    found = pint.UnitRegistry(cache_folder=None)
    for line in (
        "pound_mole = 453.59237 * mole",  # NIST SP 811, B.8: the pound is 0.45359237 kg
        "flux_gauss = 1e-4 * tesla",
        "parts_per_billion = 1e-9",
        "meter_of_water = 9806.65 * pascal",  # conventional, as in NIST SP 811: 1000 kg/m3 at standard gravity
        "meter_of_mercury = 133322.387415 * pascal",  # 13595.1 kg/m3
        "normal_cubic_meter = [normal_volume]",  # gases: no volume without a pressure and a temperature
        "normal_liter = 1e-3 * normal_cubic_meter",
        "standard_cubic_meter = [standard_volume]",
        "standard_liter = [standard_liter_volume]",
        "standard_cubic_foot = [standard_foot_volume]",
    ):
        found.define(line)
    return found


def is_unknown(text: str) -> bool:
    """Whether a text is no unit that `readings` knows."""
    return not readings(text)


@lru_cache(TEXTS)
def readings(text: str) -> tuple[UnitMeaning, ...]:
    """All meanings of a text as a unit, the most usual first; none of a text that is no unit."""
    return tuple(dict.fromkeys(reading for reading, _ in spellings(text)))


@lru_cache(TEXTS)
def spellings(text: str, case: str = "") -> tuple[tuple[UnitMeaning, str], ...]:
    """The meanings of a text, each with the text in the upper and lower case in which its names are known.

    case: "unknown" to try other cases of names that are unknown as they stand, KW as kW; "any" to try them of all names.
    """
    plain = plain_text(text)
    if plain.casefold() in DIMENSIONLESS:
        return ((UnitMeaning(registry().Unit("")), plain),)
    if len(plain) > LONGEST or (is_logarithm(plain) and plain != "pH"):  # which is picohenry, too
        return ()
    if match := QUALIFIED.fullmatch(plain):
        plain = match[1].replace("per cent", "percent")
    found = list(_products(plain, case))
    if match := LIQUID_COLUMN.fullmatch(plain):
        length, liquid = LENGTHS.get(match[1].casefold(), "inch"), "mercury" if match[2] else "water"
        found.append((UnitMeaning(registry().parse_units(f"{length} / meter * meter_of_{liquid}")), plain))
    if match := GAUGE.fullmatch(plain):
        above, pressure = ATMOSPHERE if match[2][0] in "gG" else 0.0, registry().Unit("pascal").dimensionality
        found += [
            (UnitMeaning(r.unit, above), spelled + plain[len(match[1]) :])
            for r, spelled in spellings(match[1], case)
            if r.unit.dimensionality == pressure and not r.above
        ]
    return tuple(found)


@lru_cache(TEXTS)
def plain_text(text: str) -> str:
    """A text in ASCII where it is a unit: m³ as m^3, µ as u, full-width letters, no-break spaces, brackets around it."""
    plain = "".join(c for c in text if unicodedata.category(c) != "Cf")
    plain = re.sub("[⁺⁻⁰¹²³⁴-⁹]+", lambda m: "^" + m[0].translate(SUPERSCRIPTS), plain).translate(SIGNS)
    plain = unicodedata.normalize("NFKC", plain).translate(SIGNS).replace("μ", "u").replace("Ω", "ohm")
    plain = " ".join(plain.split())
    while len(plain) > 1 and (plain[0], plain[-1]) in (("[", "]"), ("(", ")")) and not re.search(r"[\[\]()]", plain[1:-1]):
        plain = plain[1:-1].strip()
    return plain


def is_logarithm(text: str) -> bool:
    """Whether a text is the unit of a logarithm, such as dB, dBm and pH, and of nothing else."""
    return LOGARITHM.fullmatch(plain_text(text).replace(" ", "")) is not None


def clear_names(text: str) -> list[str]:
    """The text with each clear name for one that is used for several units: t/h, short_ton/h and long_ton/h of ton/h."""
    plain = plain_text(text)
    for name, clear in SEVERAL.items():
        if re.search(rf"(?<![^\W_]){name}(?![^\W_])", plain):
            return [re.sub(rf"(?<![^\W_]){name}(?![^\W_])", c, plain) for c in clear]
    return []


def has_angle(unit: Any) -> bool:
    """Whether a unit states an angle, which dimensions do not tell: 1 Hz is 2 pi rad/s."""
    names = ("radian", "degree", "revolution", "turn", "grade", "arcminute", "arcsecond", "steradian")
    return any(angle in name for name in unit._units for angle in names if "degree_" not in name)


def _products(plain: str, case: str) -> Iterator[tuple[UnitMeaning, str]]:
    """The readings of a product of powers; behind one slash either a factor alone or all are divided by, as in W/m2 K."""
    text = re.sub(r"Δ\s*", "delta_", TEMPERATURE.sub(_temperature, plain))
    for pattern, power in ROOMS:
        text = pattern.sub(power, text)
    for pattern, name in NORMAL:
        text = pattern.sub(lambda m, gas=name: f"{GAS_PREFIXES[m[1]]}{gas}", text)  # type: ignore[misc]
    text = re.sub(r"(?<![^\W_])per(?![^\W_])", "/", ELECTRIC.sub(r"\1", text))
    text = re.sub(r"\.(?=$|[\s/)])", " ", text)  # of an abbreviation
    text = re.sub(r"\.(?=[^\W\d]|\()", "*", text)
    text = re.sub(r"\^\s*\(\s*([+-]?\d+)\s*\)", r"^\1", text).replace("^+", "^")
    tokens = TOKEN.findall(text)
    if "".join(tokens) != re.sub(r"\s", "", text):
        return
    for all_below in (False, True):
        try:
            factors = _factors(list(tokens), all_below)
        except (ValueError, IndexError):
            return
        if len(factors) > FACTORS:
            return
        alone = len(factors) == 1 and factors[0][1] == 1
        for chosen in product(*(_meanings(name, case, alone) for name, _ in factors)):
            powers = (registry().parse_units(m) ** e for (m, _), (_, e) in zip(chosen, factors, strict=True))
            spelled = plain
            for (name, _), (_, symbol) in zip(factors, chosen, strict=True):
                spelled = re.sub(rf"(?<![^\W_]){re.escape(name)}(?![^\W\d_])", symbol, spelled)
            yield UnitMeaning(reduce(mul, powers, registry().Unit(""))), spelled


def _temperature(match: re.Match[str]) -> str:
    letter = next(g for g in match.groups() if g)[0].upper()
    return "kelvin" if letter == "K" else f"deg{letter}"


def _factors(tokens: list[str], all_below: bool) -> list[tuple[str, float]]:
    """Names and powers of a product, taken from the tokens up to its end; ValueError for what is none."""
    found: list[tuple[str, float]] = []
    below, operand = False, False
    while tokens and tokens[0] != ")":
        token = tokens.pop(0)
        if token in ("*", "-", "/"):
            if not operand and token != "/":
                raise ValueError("no factor before the operator")
            below, operand = token == "/" or (below and all_below), False
            if not tokens:
                raise ValueError("no factor behind the operator")
            continue
        if token == "(":
            inner = _factors(tokens, all_below)
            tokens.pop(0)  # ")"
        elif token[0].isdigit():
            if token != "1":
                raise ValueError("a number")
            inner = []
        elif token in ("^", "**"):
            raise ValueError("no factor before the power")
        else:
            inner = [(token, 1.0)]
        power = _power(tokens)
        found += [(name, (-1 if below else 1) * power * e) for name, e in inner]
        below, operand = below and all_below, True
    if not operand:
        raise ValueError("no factor")
    return found


def _power(tokens: list[str]) -> float:
    """The power that follows a factor, taken from the tokens: 2, -2, ^2, **-2; 1 where none does."""
    marked = bool(tokens) and tokens[0] in ("^", "**")
    if marked:
        tokens.pop(0)
    sign = 1.0
    if len(tokens) > 1 and tokens[0] == "-" and tokens[1][0].isdigit():
        sign = -1.0
        tokens.pop(0)
    if tokens and tokens[0][0].isdigit():
        if power := float(tokens.pop(0)):
            return sign * power
        raise ValueError("a power of 0")
    if marked:
        raise ValueError("no number behind the power")
    return 1.0


@lru_cache(TEXTS)
def _meanings(name: str, case: str, alone: bool) -> tuple[tuple[str, str], ...]:
    """What a name of a unit means, as expressions of pint, each with the symbol; in a product a mass is also a force."""
    found = [(m, name) for m in _exact(name)]
    if case == "any" or (case and not found):
        found += [(m, symbol) for symbol in _in_other_case(name, case) for m in _exact(symbol)]
    if not alone:
        found = [(DELTAS.get(m, m), s) for m, s in found if "gravity" not in m]  # g is gram
        found += [(FORCES[m], s) for m, s in found if m in FORCES]
    return tuple(found)


@lru_cache(TEXTS)
def _exact(name: str) -> tuple[str, ...]:
    """What a name means as it is written."""
    if name in SEVERAL:
        return ()
    if match := MANY.fullmatch(name):
        return (f"{'kilo' if match[1] in 'kK' else 'mega'}{CUSTOMARY[match[2].casefold()]}",)
    found = [*NAMES.get(name, ())]
    for k in (0, 1):
        symbol = METRIC.get(name[k:])
        if symbol and (k == 0 or name[0] in symbol[1]):
            unit = symbol[0] if k == 0 else f"{PREFIXES[name[0]]}{symbol[0]}"
            found += [unit] if unit not in found else []
    if not found:
        found = [*WORDS.get(name.casefold(), ())]
    if not found and len(name) > 2:
        found = [*_of_pint(name)] or [*_of_pint(name.casefold())]
    return tuple(found)


def _of_pint(name: str) -> tuple[str, ...]:
    """A unit that pint knows by this name, without a prefix or with one in full."""
    for prefix, unit, suffix in registry().parse_unit_name(name):
        if name.startswith(prefix) and not (suffix and len(name) < 4) and not unit.startswith(LOGARITHMIC):
            return (f"{prefix}{unit}",)
    return ()


def _in_other_case(name: str, case: str) -> list[str]:
    """The symbols that differ from a name by upper and lower case alone; m, the metre, is not M, molar and a million."""
    if name in SEVERAL or (name in ("m", "M") and case != "any"):
        return []
    return [symbol for symbol in _symbols().get(name.casefold(), ()) if symbol != name]


@cache
def _symbols() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for symbol in (*METRIC, *(p + symbol for symbol, (_, prefixes) in METRIC.items() for p in prefixes), *NAMES):
        if symbol not in found.setdefault(symbol.casefold(), []):
            found[symbol.casefold()].append(symbol)
    return found
