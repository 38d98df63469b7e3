"""Tyre property files (.tir): the lateral force in pure slip of MF 5.2, MF 6.1, MF 6.2 and PAC2002.

Without camber and at the nominal pressure all four are one formula (Pacejka, *Tire and Vehicle Dynamics*, 3rd ed., eqs.
(4.E19)-(4.E30); Besselink, Schmeitz, Pacejka, *Vehicle System Dynamics* 48, 2010; for PAC2002 the manual of MSC
Adams/Tire). With F_z0' = LFZO FNOMIN and df = F_z/F_z0' - 1:

    C = PCY1 LCY,   D = (PDY1 + PDY2 df) LMUY F_z,   E = (PEY1 + PEY2 df) LEY <= 1,
    K = PKY1 F_z0' sin(PKY4 atan(F_z/(PKY2 F_z0'))) LKY,   PKY4 = 2 before MF 6,   B = K/(C D),
    F_y = D sin(C atan(B a - E (B a - atan(B a)))).

Relaxation length: before MF 6, PTY1 sin(2 atan(F_z/(PTY2 F_z0'))) R_0 LFZO LSGAL; from MF 6 on |K| over the lateral
stiffness of the tyre, LATERAL_STIFFNESS (1 + PCFY1 df + PCFY2 df^2).
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import checked
from adaptrack.base.errors import ConfigError, did_you_mean
from adaptrack.base.files import printable, read_bytes
from adaptrack.cars.tyre_fit import Samples, TyreFit, fit_law, judged
from adaptrack.cars.vehicle import Tyre

Array = NDArray[np.float64]

UNITS = {
    "LENGTH": {"meter": 1.0, "m": 1.0, "mm": 1e-3, "millimeter": 1e-3, "cm": 0.01, "centimeter": 0.01, "km": 1e3,
               "kilometer": 1e3, "inch": 0.0254, "foot": 0.3048},
    "FORCE": {"newton": 1.0, "n": 1.0, "knewton": 1e3, "kn": 1e3, "kilonewton": 1e3, "kilogram_force": 9.80665,
              "pound_force": 4.4482216152605, "lbf": 4.4482216152605},
    "ANGLE": {"radians": 1.0, "radian": 1.0, "rad": 1.0, "degrees": math.pi / 180.0, "degree": math.pi / 180.0,
              "deg": math.pi / 180.0},
}  # fmt: skip
"""Units that a file may be in, as factors to SI."""
SCALINGS = ("LFZO", "LCY", "LMUY", "LEY", "LKY", "LSGAL")
REQUIRED = ("PCY1", "PDY1", "PKY1", "PKY2")
OPTIONAL = ("PDY2", "PEY1", "PEY2", "PEY3", "PHY1", "PHY2", "PVY1", "PVY2")
CAMBER = ("PDY3", "PEY4", "PEY5", "PKY3", "PKY5", "PKY6", "PKY7", "PHY3", "PVY3", "PVY4")
"""Lateral coefficients of the camber angle, which the plant's wheels do not have."""
OTHERS = {
    "LONGITUDINAL_COEFFICIENTS": "longitudinal slip", "ALIGNING_COEFFICIENTS": "aligning moment",
    "OVERTURNING_COEFFICIENTS": "overturning moment", "ROLLING_COEFFICIENTS": "rolling resistance",
    "TURNSLIP_COEFFICIENTS": "turn slip",
}  # fmt: skip
"""Sections that have no use here."""
STEEPEST = 0.21
"""rad (12 degrees), largest slip that is fitted."""
LIGHTEST, HEAVIEST = 0.3, 1.6
"""Loads that are fitted, over the nominal one, as far as the file's own range goes."""


class _Value(NamedTuple):
    """The value of a key."""

    text: str
    line: int


@dataclass(frozen=True)
class TyreFile:
    """A tyre property file, read and in SI units; `force`, `stiffness` and `relaxation_length` evaluate it."""

    name: str
    model: str
    """"MF 5.2", "MF 6.1", "MF 6.2" or "PAC2002"""
    coefficients: dict[str, float]
    """PCY1 ... PTY2 in SI, those that are not in the file 0 (PKY4: 2)"""
    scaling: dict[str, float]
    """-, LFZO ... LSGAL, 1 where the file says nothing"""
    nominal_load: float
    """N, FNOMIN"""
    slips: float
    """rad, largest slip that the file allows"""
    loads: tuple[float, float]
    """N, lowest and highest load that the file allows"""
    radius: float | None
    """m, UNLOADED_RADIUS"""
    lateral_stiffness: float | None
    """N/m, LATERAL_STIFFNESS, from MF 6 on"""
    notes: tuple[str, ...]
    """Sentences on the parts of the file that are not used."""

    @property
    def scaled_load(self) -> float:
        """F_z0' (N)."""
        return self.nominal_load * self.scaling["LFZO"]

    def stiffness(self, load: ArrayLike) -> Array:
        """Cornering stiffness |K| (N/rad) at a load (N)."""
        p, q = self.coefficients, np.asarray(load, dtype=float) / self.scaled_load
        sine = np.sin(p["PKY4"] * np.arctan(q / p["PKY2"]))
        return np.asarray(abs(p["PKY1"]) * self.scaled_load * sine * self.scaling["LKY"])

    def friction(self, load: ArrayLike) -> Array:
        """Peak friction |D|/F_z (-) at a load (N)."""
        df = np.asarray(load, dtype=float) / self.scaled_load - 1.0
        p = self.coefficients
        return np.asarray((p["PDY1"] + p["PDY2"] * df) * math.copysign(1.0, p["PDY1"]) * self.scaling["LMUY"])

    def force(self, slip: ArrayLike, load: ArrayLike) -> Array:
        """Lateral force (N) at a slip angle (rad), both positive to the left, and a load (N); no shifts, no camber."""
        slip, load = np.asarray(slip, dtype=float), np.asarray(load, dtype=float)
        p, df = self.coefficients, load / self.scaled_load - 1.0
        shape, peak = p["PCY1"] * self.scaling["LCY"], self.friction(load) * load
        curvature = np.minimum((p["PEY1"] + p["PEY2"] * df) * self.scaling["LEY"], 1.0)
        b = self.stiffness(load) / (shape * peak) * slip
        return np.asarray(peak * np.sin(shape * np.arctan(b - curvature * (b - np.arctan(b)))))

    def relaxation_length(self, load: ArrayLike) -> Array | None:
        """m at a load (N); None where the file does not say it."""
        p, q = self.coefficients, np.asarray(load, dtype=float) / self.scaled_load
        if self.model.startswith("MF 6"):
            if self.lateral_stiffness is None:
                return None
            df = q - 1.0
            return np.asarray(
                self.stiffness(load) / (self.lateral_stiffness * (1.0 + p["PCFY1"] * df + p["PCFY2"] * df**2))
            )
        if not (p["PTY1"] and p["PTY2"] and self.radius):
            return None
        reach = self.radius * self.scaling["LFZO"] * self.scaling["LSGAL"]
        return np.asarray(np.abs(p["PTY1"]) * np.sin(2.0 * np.arctan(q / np.abs(p["PTY2"]))) * reach)

    def to_tyre(self, name: str | None = None) -> TyreFit:
        """The tyre of the plant that is nearest in force over slip and load, both axles alike, and how near.

        Its stiffness is that of the file where PKY4 = 2, else fitted; its friction is the road's, see `TyreFit`.
        """
        low = max(self.loads[0], LIGHTEST * self.scaled_load)
        high = min(self.loads[1], HEAVIEST * self.scaled_load)
        loads = np.linspace(low, high, 25)
        slips = np.linspace(0.0, min(self.slips, STEEPEST), 61)[1:]
        slip, load = (each.ravel() for each in np.meshgrid(slips, loads))
        samples = Samples(slip, load, self.force(slip, load), np.zeros(slip.size, bool))
        stiffness, ratio = self._digressive(loads)
        reaches = self.relaxation_length(self.scaled_load)
        start = Tyre(
            name=name or self.name, description=f"{self.model} file {self.name}, lateral pure slip",
            kind="magic-formula", stiffness_front=stiffness, stiffness_rear=stiffness, nominal_load=self.scaled_load,
            stiffness_load="digressive", digressive_load_ratio=ratio,
            relaxation_length=0.0 if reaches is None else float(f"{float(reaches):.3g}"),
        )  # fmt: skip
        tyre, friction, _ = fit_law(start, samples, float(self.friction(self.scaled_load)), ["load sensitivity"])
        return judged(tyre, samples, friction, (*self.notes, *self._said(loads, reaches)))

    def _digressive(self, loads: Array) -> tuple[float, float]:
        """Stiffness (N/rad) at the nominal load and the load ratio p of C sin(2 atan(q/p))."""
        p = self.coefficients
        if p["PKY4"] == 2.0:
            return float(f"{float(self.stiffness(self.scaled_load)):.5g}"), p["PKY2"]
        from scipy.optimize import least_squares

        q, target = loads / self.scaled_load, self.stiffness(loads)

        def residual(x: Array) -> Array:
            return np.asarray(x[0] * (1.0 + x[1] ** -2) * q / (1.0 + (q / x[1]) ** 2) / target - 1.0)

        start = np.clip([self.stiffness(self.scaled_load) / 1e5, p["PKY2"]], [1e-9, 0.11], [1e3, 99.0])
        found = least_squares(lambda x: residual(x * [1e5, 1.0]), start, bounds=([0.0, 0.1], [1e3, 100.0]))
        return float(f"{1e5 * found.x[0]:.5g}"), float(f"{found.x[1]:.5g}")

    def _said(self, loads: Array, reaches: Array | None) -> list[str]:
        """Return the note on the relaxation length."""
        if reaches is None:
            return ["No relaxation length in the file: forces build up at once."]
        ends = self.relaxation_length(loads[[0, -1]])
        assert ends is not None
        return [
            f"The relaxation length, {ends[0]:.2f} m at {loads[0]:.0f} N and {ends[1]:.2f} m at {loads[-1]:.0f} N, is "
            f"taken at the nominal load: {float(reaches):.2f} m."
        ]


@checked
def read_tyre_file(path: str | os.PathLike[str]) -> TyreFile:
    """Read a .tir file.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When a section, a key or a unit is missing or impossible, or the file is of another tyre model; the message
        names the key, and its line where there is one.
    """
    where = os.fspath(path)
    return _Reader(printable(where), _sections(where)).read(Path(path).stem)


def _sections(where: str) -> dict[str, dict[str, _Value]]:
    """Values by section and key, both in capitals, without empty values, comments ($ or !) and tables without keys."""
    text = read_bytes(where).decode("latin-1").lstrip("\ufeff").removeprefix("ï»¿")
    found: dict[str, dict[str, _Value]] = {}
    section = ""
    for number, line in enumerate(text.splitlines(), 1):
        bare = re.split(r"[$!]", line, maxsplit=1)[0].strip()
        if heading := re.fullmatch(r"\[([^\]]*)\]", bare):
            section = heading[1].strip().upper()
            found.setdefault(section, {})
        elif "=" in bare:
            key, _, value = (part.strip(" \t'\"") for part in bare.partition("="))
            key, values = key.upper(), found.setdefault(section, {})
            if key in values and value not in ("", values[key].text):
                raise ConfigError(
                    f"{printable(where)}, line {number}: {key} stands in line {values[key].line} with another value: "
                    "keep one."
                )
            if value:
                values[key] = _Value(value, number)
    return found


class _Reader:
    """A file in the making; every refusal names file, line and key."""

    def __init__(self, where: str, sections: dict[str, dict[str, _Value]]) -> None:
        self.where, self.sections = where, sections

    def fail(self, text: str, line: int | None = None) -> ConfigError:
        return ConfigError(f"{self.where}{'' if line is None else f', line {line}'}: {text}")

    def section(self, name: str, remedy: str) -> dict[str, _Value]:
        if name not in self.sections:
            raise self.fail(f"there is no section [{name}]: {remedy}.")
        return self.sections[name]

    def number(self, section: str, key: str, default: float | None = None) -> float | None:
        """A finite number; the default where there is no such key."""
        value = self.sections.get(section, {}).get(key)
        if value is None:
            return default
        try:
            found = float(re.sub("[dD]", "e", value.text))
        except ValueError:
            raise self.fail(f"{key} = {printable(value.text)[:40]!r}: must be a number.", value.line) from None
        if not math.isfinite(found):
            raise self.fail(f"{key} = {value.text}: must be a finite number.", value.line)
        return found

    def line(self, section: str, key: str) -> int | None:
        value = self.sections.get(section, {}).get(key)
        return None if value is None else value.line

    def read(self, name: str) -> TyreFile:
        model, angle = self.model(), self.unit("ANGLE")
        force, length = self.unit("FORCE"), self.unit("LENGTH")
        p, scaling = self.coefficients(model, angle), self.scaling()
        nominal = self.positive("VERTICAL", "FNOMIN", force, (1.0, 2e5), "N")
        radius = None
        if self.line("DIMENSION", "UNLOADED_RADIUS") is not None:
            radius = self.positive("DIMENSION", "UNLOADED_RADIUS", length, (0.01, 3.0), "m")
        stiffness = None
        if model.startswith("MF 6"):
            stiffness = self.number("STRUCTURAL", "LATERAL_STIFFNESS") or self.number("VERTICAL", "LATERAL_STIFFNESS")
        low = (self.number("VERTICAL_FORCE_RANGE", "FZMIN", 0.0) or 0.0) * force
        high = (self.number("VERTICAL_FORCE_RANGE", "FZMAX", math.inf) or math.inf) * force
        steepest = abs(self.number("SLIP_ANGLE_RANGE", "ALPMAX", 1.5 / angle) or 1.5 / angle) * angle
        made = TyreFile(
            name, model, p, scaling, nominal, steepest, (low, high), radius,
            None if stiffness is None else stiffness * force / length, tuple(self.left_out(model, p, scaling, nominal)),
        )  # fmt: skip
        self.check_range(made)
        return made

    def model(self) -> str:
        """Which formula the file is of."""
        section = self.section("MODEL", "it says which tyre model the file is of (FITTYP or PROPERTY_FILE_FORMAT)")
        kind = section.get("PROPERTY_FILE_FORMAT", _Value("", 0))
        fit = section.get("FITTYP")
        if kind.text.upper() == "PAC2002":
            return "PAC2002"
        if fit is not None:
            models = {"5": "MF 5.2", "6": "MF 5.2", "21": "MF 5.2", "51": "MF 5.2", "52": "MF 5.2", "60": "MF 6.1",
                      "61": "MF 6.1", "62": "MF 6.2"}  # fmt: skip
            number = re.sub(r"\.0*$", "", fit.text)
            if number not in models:
                raise self.fail(
                    f"FITTYP = {printable(fit.text)}: is none of MF 5.2 (5, 6, 21, 51, 52), MF 6.1 (60, 61), MF 6.2 "
                    "(62).", fit.line,
                )  # fmt: skip
            return models[number]
        if kind.text.upper() in ("MF-TYRE", "MF_TYRE", "MFTYRE", "MF_05", "MF52"):
            return "MF 5.2"
        if kind.text:
            raise self.fail(
                f"PROPERTY_FILE_FORMAT = {printable(kind.text)!r}: this model cannot be read; known: MF 5.2, MF 6.1, "
                "MF 6.2, PAC2002.", kind.line,
            )  # fmt: skip
        raise self.fail("section [MODEL] has neither FITTYP nor PROPERTY_FILE_FORMAT: the model is not known.")

    def unit(self, what: str) -> float:
        """Factor to SI."""
        section = self.section("UNITS", "write LENGTH = 'meter', FORCE = 'newton', ANGLE = 'radians' if it is in SI")
        value = section.get(what)
        if value is None:
            raise self.fail(f"section [UNITS] has no {what}; known: {', '.join(map(repr, UNITS[what]))}.")
        factor = UNITS[what].get(value.text.lower())
        if factor is None:
            hint = did_you_mean(value.text.lower(), UNITS[what])
            raise self.fail(f"{what} = {printable(value.text)!r}: unknown unit. {hint}", value.line)
        return factor

    def positive(self, section: str, key: str, unit: float, span: tuple[float, float], si: str) -> float:
        """A positive number in SI that is within what tyres have: else the unit is wrong."""
        self.section(section, f"it holds {key}")
        value = self.number(section, key)
        if value is None:
            raise self.fail(f"section [{section}] has no {key} ({si}).")
        if not span[0] <= value * unit <= span[1]:
            raise self.fail(
                f"{key} = {value:g} is {value * unit:g} {si}, which no tyre has ({span[0]:g} to {span[1]:g}): wrong "
                "value, or wrong [UNITS].", self.line(section, key),
            )  # fmt: skip
        return value * unit

    def coefficients(self, model: str, angle: float) -> dict[str, float]:
        """The lateral coefficients in SI: angles in them follow [UNITS]."""
        name = "LATERAL_COEFFICIENTS"
        self.section(name, "the lateral force is what this reads")
        found = {key: self.number(name, key) for key in REQUIRED}
        missing = [key for key, value in found.items() if value is None]
        if missing:
            raise self.fail(f"section [{name}] has no {', '.join(missing)}.")
        p = {key: value for key, value in found.items() if value is not None}
        p |= {key: self.number(name, key, 0.0) or 0.0 for key in (*OPTIONAL, *CAMBER, "PTY1", "PTY2")}
        p["PKY4"] = (self.number(name, "PKY4", 2.0) or 2.0) if model.startswith("MF 6") else 2.0
        p |= {key: self.number("STRUCTURAL", key, 0.0) or 0.0 for key in ("PCFY1", "PCFY2")}
        p["PKY1"] /= angle
        for key in ("PHY1", "PHY2"):
            p[key] *= angle
        rules = (
            ("PCY1", 0.5 <= p["PCY1"] <= 2.5, "must be from 0.5 to 2.5"),
            ("PDY1", 0.1 <= abs(p["PDY1"]) <= 4.0, "must be from 0.1 to 4 in size: a friction"),
            ("PKY1", p["PKY1"] != 0.0, "must not be 0: the tyre would have no cornering stiffness"),
            ("PKY2", p["PKY2"] > 0.0, "must be positive: else the cornering stiffness is negative at every load"),
        )
        for key, fit, clause in rules:
            if not fit:
                raise self.fail(f"{key} = {found[key]:g}: {clause}.", self.line(name, key))
        if not 1.5 <= abs(p["PKY1"]) <= 100.0:
            raise self.fail(
                f"PKY1 = {found['PKY1']:g}: a stiffness of {abs(p['PKY1']):.3g} nominal loads a radian is none of a "
                "tyre (1.5 to 100): per degree, with ANGLE = 'radians' in [UNITS], or the other way round?",
                self.line(name, "PKY1"),
            )
        return p

    def scaling(self) -> dict[str, float]:
        """The scaling factors that concern the lateral force."""
        names = [name for name in ("SCALING_COEFFICIENTS", "SCALING_FACTORS") if name in self.sections]
        found = {}
        for key in SCALINGS:
            found[key] = 1.0
            for name in names:
                value = self.number(name, key, 1.0)
                if not (value or 0.0) > 0.0 and key != "LEY":
                    raise self.fail(f"{key} = {value:g}: a scaling factor must be positive.", self.line(name, key))
                found[key] = 1.0 if value is None else value
        return found

    def check_range(self, tyre: TyreFile) -> None:
        """Stiffness and friction must be positive wherever the tyre is fitted."""
        low, high = max(tyre.loads[0], LIGHTEST * tyre.scaled_load), min(tyre.loads[1], HEAVIEST * tyre.scaled_load)
        if not low < high:
            raise self.fail(
                f"FZMIN to FZMAX, {tyre.loads[0]:g} to {tyre.loads[1]:g} N, holds no load near FNOMIN = "
                f"{tyre.nominal_load:g} N.", self.line("VERTICAL_FORCE_RANGE", "FZMAX"),
            )  # fmt: skip
        if tyre.slips < 0.02:
            raise self.fail(f"ALPMAX is {tyre.slips:g} rad: no slip range.", self.line("SLIP_ANGLE_RANGE", "ALPMAX"))
        loads = np.linspace(low, high, 50)
        for what, values, key in (
            ("cornering stiffness", tyre.stiffness(loads), "PKY2"), ("friction", tyre.friction(loads), "PDY2"),
        ):  # fmt: skip
            if not (values > 0.0).all():
                at = loads[int(np.argmin(values > 0.0))]
                raise self.fail(
                    f"the {what} is not positive at {at:.0f} N, within the range of loads.",
                    self.line("LATERAL_COEFFICIENTS", key),
                )

    def left_out(self, model: str, p: dict[str, float], scaling: dict[str, float], nominal: float) -> list[str]:
        """Return the notes on unused parts of the file and on its sign convention."""
        said = [
            "PKY1 < 0: slip with the sign of ISO, where a positive one pushes to the right; turned round."
            if p["PKY1"] < 0.0
            else "PKY1 > 0: slip with the sign of adapted SAE, where a positive one pushes to the positive side; in a "
            "file with the sign of ISO this would be a negative stiffness."
        ]
        side = self.sections["MODEL"].get("TYRESIDE")
        shift = p["PHY1"] * scaling.get("LHY", 1.0), p["PVY1"] * nominal
        if p["PHY1"] or p["PVY1"] or p["PEY3"]:
            measured = f", measured as a {side.text.lower()} tyre," if side is not None else ""
            said.append(
                f"Ply steer and conicity{measured} are left out (at the nominal load a slip of {shift[0]:.4f} rad and "
                f"{shift[1]:.0f} N): left and right tyres are mirror images."
            )
        if any(p[key] for key in CAMBER):
            said.append("Camber is left out: the plant's wheels stand upright.")
        if model.startswith("MF 6"):
            now, usual = (self.number("OPERATING_CONDITIONS", key) for key in ("INFLPRES", "NOMPRES"))
            said.append("The inflation pressure is taken as nominal.")
            if now is not None and usual is not None and now != usual:
                said[-1] = f"The inflation pressure is taken as nominal ({usual:g}), not as it is ({now:g})."
        others = [words for name, words in OTHERS.items() if name in self.sections]
        if others:
            said.append(f"Not read: {', '.join(others)}.")
        return said
