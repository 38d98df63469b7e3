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
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import checked
from adaptrack.base.errors import ConfigError, did_you_mean
from adaptrack.base.files import finite_number, printable, read_bytes
from adaptrack.cars.tyre_fit import TyreFit, TyreSamples, assess_fit, fit_law
from adaptrack.cars.vehicle import Tyre
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array

TYRE_FILE_UNITS = {
    "LENGTH": {"meter": 1.0, "m": 1.0, "mm": 1e-3, "millimeter": 1e-3, "cm": 0.01, "centimeter": 0.01, "km": 1e3,
               "kilometer": 1e3, "inch": 0.0254, "foot": 0.3048},
    "FORCE": {"newton": 1.0, "n": 1.0, "knewton": 1e3, "kn": 1e3, "kilonewton": 1e3, "kilogram_force": 9.80665,
              "pound_force": 4.4482216152605, "lbf": 4.4482216152605},
    "ANGLE": {"radians": 1.0, "radian": 1.0, "rad": 1.0, "degrees": math.pi / 180.0, "degree": math.pi / 180.0,
              "deg": math.pi / 180.0},
}  # fmt: skip
"""Units that a file may be in, as factors to SI."""
OPTIONAL_COEFFICIENTS = ("PDY2", "PEY1", "PEY2", "PEY3", "PHY1", "PHY2", "PVY1", "PVY2", "PTY1", "PTY2")
CAMBER = ("PDY3", "PEY4", "PEY5", "PKY3", "PKY5", "PKY6", "PKY7", "PHY3", "PVY3", "PVY4")
"""Lateral coefficients of the camber angle, which the plant's wheels do not have."""
SCALING_SECTIONS = ("SCALING_FACTORS", "SCALING_COEFFICIENTS")
SCALINGS = ("LFZO", "LCY", "LMUY", "LEY", "LKY", "LSGAL")
UNUSED_SECTIONS = {
    "LONGITUDINAL_COEFFICIENTS": "longitudinal slip", "ALIGNING_COEFFICIENTS": "aligning moment",
    "OVERTURNING_COEFFICIENTS": "overturning moment", "ROLLING_COEFFICIENTS": "rolling resistance",
    "TURNSLIP_COEFFICIENTS": "turn slip",
}  # fmt: skip
"""Sections that have no use here, in words."""
REMEDIES = {
    "MODEL": "it says which tyre model the file is of (FITTYP or PROPERTY_FILE_FORMAT)",
    "UNITS": "write LENGTH = 'meter', FORCE = 'newton', ANGLE = 'radians' if it is in SI",
    "VERTICAL": "it holds FNOMIN",
    "LATERAL_COEFFICIENTS": "the lateral force is what this reads",
}
"""Sections that must be there."""
TYRE_MODELS = {
    **dict.fromkeys(("5", "6", "21", "51", "52", "MF-TYRE", "MF_TYRE", "MFTYRE", "MF_05", "MF52"), "MF 5.2"),
    "60": "MF 6.1", "61": "MF 6.1", "62": "MF 6.2", "PAC2002": "PAC2002",
}  # fmt: skip
"""Formulas by FITTYP or PROPERTY_FILE_FORMAT."""
COEFFICIENT_BOUNDS = {
    "PCY1": (0.5, 2.5, "the shape factor of a tyre"),
    "PDY1": (0.1, 4.0, "the friction of a tyre"),
    "PKY1": (1.5, 100.0, "the stiffness of a tyre per radian (or per degree, as [UNITS] say) over its nominal load"),
    "PKY2": (1e-6, 1e6, "the load over the nominal one at which a tyre is stiffest"),
}
"""Sizes of the required coefficients, in SI, that tyres have."""
MAX_FITTED_SLIP = 0.21
"""rad (12 degrees), largest slip that is fitted."""
LIGHTEST, HEAVIEST = 0.3, 1.6
"""Loads that are fitted, over the nominal one, as far as the file's own range goes."""


@dataclass(frozen=True)
class TyreFile:
    """A tyre property file, read and in SI units; `force`, `stiffness` and `relaxation_length` evaluate it."""

    name: str
    model: str
    """"MF 5.2", "MF 6.1", "MF 6.2" or "PAC2002"""
    coefficients: dict[str, float]
    """PCY1 ... PTY2 in SI, those that are not in the file 0 (PKY4: 2); scaling factors LFZO ... LSGAL, else 1"""
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
        return self.nominal_load * self.coefficients["LFZO"]

    @property
    def fitted_loads(self) -> tuple[float, float]:
        """Lowest and highest load (N) that is fitted, see `LIGHTEST` and `HEAVIEST`."""
        low, high = self.loads
        return max(low, LIGHTEST * self.scaled_load), min(high, HEAVIEST * self.scaled_load)

    def stiffness(self, load: ArrayLike) -> Array:
        """Cornering stiffness |K| (N/rad) at a load (N)."""
        p, q = self.coefficients, np.asarray(load, dtype=float) / self.scaled_load
        sine = portable.sin(p["PKY4"] * portable.atan(q / p["PKY2"]))
        return np.asarray(abs(p["PKY1"]) * self.scaled_load * sine * p["LKY"])

    def friction(self, load: ArrayLike) -> Array:
        """Peak friction |D|/F_z (-) at a load (N)."""
        df = np.asarray(load, dtype=float) / self.scaled_load - 1.0
        p = self.coefficients
        return np.asarray((p["PDY1"] + p["PDY2"] * df) * math.copysign(1.0, p["PDY1"]) * p["LMUY"])

    def force(self, slip: ArrayLike, load: ArrayLike) -> Array:
        """Lateral force (N) at a slip angle (rad), both positive to the left, and a load (N); no shifts, no camber."""
        slip, load = np.asarray(slip, dtype=float), np.asarray(load, dtype=float)
        p, df = self.coefficients, load / self.scaled_load - 1.0
        shape, peak = p["PCY1"] * p["LCY"], self.friction(load) * load
        curvature = np.minimum((p["PEY1"] + p["PEY2"] * df) * p["LEY"], 1.0)
        b = self.stiffness(load) / (shape * peak) * slip
        return np.asarray(peak * portable.sin(shape * portable.atan(b - curvature * (b - portable.atan(b)))))

    def relaxation_length(self, load: ArrayLike) -> Array | None:
        """m at a load (N); None where the file does not say it."""
        p, q = self.coefficients, np.asarray(load, dtype=float) / self.scaled_load
        if self.model.startswith("MF 6"):
            if self.lateral_stiffness is None:
                return None
            df = q - 1.0
            return np.asarray(
                self.stiffness(load) / (self.lateral_stiffness * (1.0 + p["PCFY1"] * df + p["PCFY2"] * (df * df)))
            )
        if not (p["PTY1"] and p["PTY2"] and self.radius):
            return None
        reach = self.radius * p["LFZO"] * p["LSGAL"]
        return np.asarray(np.abs(p["PTY1"]) * portable.sin(2.0 * portable.atan(q / np.abs(p["PTY2"]))) * reach)

    def to_tyre(self, name: str | None = None) -> TyreFit:
        """The tyre of the plant that is nearest in force over slip and load, both axles alike, and how near.

        Its stiffness is that of the file where PKY4 = 2, else fitted; its friction is the road's, see `TyreFit`.
        """
        loads = np.linspace(*self.fitted_loads, 25)
        slips = np.linspace(0.0, min(self.slips, MAX_FITTED_SLIP), 61)[1:]
        slip, load = (grid.ravel() for grid in np.meshgrid(slips, loads))
        samples = TyreSamples(slip, load, self.force(slip, load), np.zeros(slip.size, bool))
        stiffness, ratio = self._digressive(loads)
        reaches = self.relaxation_length(self.scaled_load)
        start = Tyre(
            name=name or self.name, description=f"{self.model} file {self.name}, lateral pure slip",
            kind="magic-formula", stiffness_front=stiffness, stiffness_rear=stiffness, nominal_load=self.scaled_load,
            stiffness_load="digressive", digressive_load_ratio=ratio,
            relaxation_length=0.0 if reaches is None else float(f"{float(reaches):.3g}"),
        )  # fmt: skip
        tyre, friction, _ = fit_law(start, samples, float(self.friction(self.scaled_load)), ["load sensitivity"])
        return assess_fit(tyre, samples, friction, (*self.notes, self._relaxation_note(loads[[0, -1]], reaches)))

    def _digressive(self, loads: Array) -> tuple[float, float]:
        """Stiffness (N/rad) at the nominal load and the load ratio p of C sin(2 atan(q/p))."""
        p = self.coefficients
        if p["PKY4"] == 2.0:
            return float(f"{float(self.stiffness(self.scaled_load)):.5g}"), p["PKY2"]
        from scipy.optimize import least_squares

        q, target = loads / self.scaled_load, self.stiffness(loads)

        def residual(x: Array) -> Array:
            return np.asarray(x[0] * (1.0 + 1.0 / (x[1] * x[1])) * q / (1.0 + portable.square(q / x[1])) / target - 1.0)

        start = np.clip([self.stiffness(self.scaled_load) / 1e5, p["PKY2"]], [1e-9, 0.11], [1e3, 99.0])
        solution = least_squares(lambda x: residual(x * [1e5, 1.0]), start, bounds=([0.0, 0.1], [1e3, 100.0]))
        return float(f"{1e5 * solution.x[0]:.5g}"), float(f"{solution.x[1]:.5g}")

    def _relaxation_note(self, ends: Array, nominal: Array | None) -> str:
        """Return the note on the relaxation length; ends: N, loads; nominal: m, at the nominal load."""
        reaches = self.relaxation_length(ends)
        if nominal is None or reaches is None:
            return "No relaxation length in the file: forces build up at once."
        low, high = (f"{reach:.2f} m at {load:.0f} N" for reach, load in zip(reaches, ends, strict=True))
        return f"The relaxation length, {low} and {high}, is taken at the nominal load: {float(nominal):.2f} m."


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
    return _Reader(os.fspath(path)).read(Path(path).stem)


class _Entry(NamedTuple):
    """The value of a key, and its line."""

    text: str
    line: int


class _Reader:
    """The entries of a file by section and key, both in capitals; every refusal names file, line and key."""

    def __init__(self, where: str) -> None:
        """Read a file, without empty values, comments ($ or !) and tables without keys."""
        self.where = printable(where)
        self.sections: dict[str, dict[str, _Entry]] = {}
        section, text = "", read_bytes(where).decode("latin-1").lstrip("\ufeff").removeprefix("ï»¿")
        for number, line in enumerate(text.splitlines(), 1):
            bare = re.split(r"[$!]", line, maxsplit=1)[0].strip()
            if heading := re.fullmatch(r"\[([^\]]*)\]", bare):
                section = heading[1].strip().upper()
                self.sections.setdefault(section, {})
                continue
            key, _, value = (part.strip(" \t'\"") for part in bare.partition("="))
            if value:
                entry = _Entry(value, number)
                first = self.sections.setdefault(section, {}).setdefault(key.upper(), entry)
                if first.text != value:
                    text = f"{key.upper()} stands in line {first.line} with another value: keep one."
                    raise self.refusal(text, entry)

    def read(self, name: str) -> TyreFile:
        """Return the tyre of the file, checked over the loads at which it is fitted."""
        model = self.model()
        angle, force, length = (self.unit(quantity) for quantity in ("ANGLE", "FORCE", "LENGTH"))
        p = self.coefficients(model, angle)
        nominal, radius, stiffness = self.size("VERTICAL", "FNOMIN", force, (1.0, 2e5), "N"), None, None
        if self.entry("DIMENSION", "UNLOADED_RADIUS"):
            radius = self.size("DIMENSION", "UNLOADED_RADIUS", length, (0.01, 3.0), "m")
        if model.startswith("MF 6"):
            numbers = [self.number(section, "LATERAL_STIFFNESS", 0.0) for section in ("STRUCTURAL", "VERTICAL")]
            stiffness = next((number * force / length for number in numbers if number), None)
        low, high = (self.number("VERTICAL_FORCE_RANGE", key, 0.0) for key in ("FZMIN", "FZMAX"))
        loads = low * force, (high or math.inf) * force
        steepest = abs(self.number("SLIP_ANGLE_RANGE", "ALPMAX", 0.0) * angle) or 1.5
        notes = tuple(self.notes(model, p, nominal))
        tyre = TyreFile(name, model, p, nominal, steepest, loads, radius, stiffness, notes)
        self.check_range(tyre)
        return tyre

    def refusal(self, text: str, entry: _Entry | None = None) -> ConfigError:
        return ConfigError(f"{self.where}{'' if entry is None else f', line {entry.line}'}: {text}")

    def entry(self, section: str, key: str) -> _Entry | None:
        return self.sections.get(section, {}).get(key)

    def required(self, section: str, key: str) -> _Entry:
        if section not in self.sections:
            raise self.refusal(f"there is no section [{section}]: {REMEDIES[section]}.")
        entry = self.entry(section, key)
        if entry is None:
            raise self.refusal(f"section [{section}] has no {key}.")
        return entry

    def number(self, section: str, key: str, default: float | None = None) -> float:
        """A finite number; without a default it must be there."""
        if default is not None and self.entry(section, key) is None:
            return default
        entry = self.required(section, key)
        number = finite_number(re.sub("[dD]", "e", entry.text))
        if number is None:
            raise self.refusal(f"{key} = {printable(entry.text)[:40]!r}: must be a finite number.", entry)
        return number

    def size(self, section: str, key: str, factor: float, span: tuple[float, float], unit: str) -> float:
        """A number in SI that is within what tyres have: else the unit is wrong."""
        number = self.number(section, key)
        if not span[0] <= number * factor <= span[1]:
            raise self.refusal(
                f"{key} = {number:g} is {number * factor:g} {unit}, which no tyre has ({span[0]:g} to {span[1]:g}): "
                "wrong value, or wrong [UNITS].", self.entry(section, key),
            )  # fmt: skip
        return number * factor

    def unit(self, quantity: str) -> float:
        """The factor to SI of a quantity."""
        entry, units = self.required("UNITS", quantity), TYRE_FILE_UNITS[quantity]
        if (name := entry.text.lower()) not in units:
            text = f"{quantity} = {printable(entry.text)!r}: unknown unit. {did_you_mean(name, units)}"
            raise self.refusal(text, entry)
        return units[name]

    def model(self) -> str:
        """The formula that the file is of: a PAC2002 file may have a FITTYP as well."""
        kind, fit = self.entry("MODEL", "PROPERTY_FILE_FORMAT"), self.entry("MODEL", "FITTYP")
        entry = kind if kind is not None and (fit is None or kind.text.upper() == "PAC2002") else fit
        entry = entry or self.required("MODEL", "FITTYP and no PROPERTY_FILE_FORMAT")
        model = TYRE_MODELS.get(re.sub(r"\.0*$", "", entry.text.upper()))
        if model is None:
            raise self.refusal(
                f"tyre model {printable(entry.text)!r} cannot be read; known: MF 5.2 (FITTYP 5, 6, 21, 51, 52), MF 6.1 "
                "(60, 61), MF 6.2 (62) and PAC2002.", entry,
            )  # fmt: skip
        return model

    def coefficients(self, model: str, angle: float) -> dict[str, float]:
        """The lateral coefficients in SI, in which angles follow [UNITS], and their scaling factors."""
        section = "LATERAL_COEFFICIENTS"
        p = {key: self.number(section, key) for key in COEFFICIENT_BOUNDS}
        p |= {key: self.number(section, key, 0.0) for key in (*OPTIONAL_COEFFICIENTS, *CAMBER)}
        p["PKY4"] = (self.number(section, "PKY4", 0.0) or 2.0) if model.startswith("MF 6") else 2.0
        p |= {key: self.number("STRUCTURAL", key, 0.0) for key in ("PCFY1", "PCFY2")}
        p |= {"PKY1": p["PKY1"] / angle, "PHY1": p["PHY1"] * angle, "PHY2": p["PHY2"] * angle}
        for key, (low, high, meaning) in COEFFICIENT_BOUNDS.items():
            if not low <= (abs(p[key]) if key in ("PDY1", "PKY1") else p[key]) <= high:
                entry = self.required(section, key)
                raise self.refusal(f"{key} = {entry.text}: {meaning} is from {low:g} to {high:g} in size.", entry)
        scaling = next((name for name in SCALING_SECTIONS if name in self.sections), "")
        for key in SCALINGS:
            p[key] = self.number(scaling, key, 1.0)
            if not p[key] > 0.0 and key != "LEY":
                text = f"{key} = {p[key]:g}: a scaling factor must be positive."
                raise self.refusal(text, self.entry(scaling, key))
        return p

    def check_range(self, tyre: TyreFile) -> None:
        """Stiffness and friction must be positive wherever the tyre is fitted."""
        low, high = tyre.fitted_loads
        if not low < high:
            raise self.refusal(
                f"FZMIN to FZMAX, {tyre.loads[0]:g} to {tyre.loads[1]:g} N, holds no load near FNOMIN = "
                f"{tyre.nominal_load:g} N.", self.entry("VERTICAL_FORCE_RANGE", "FZMAX"),
            )  # fmt: skip
        if tyre.slips < 0.02:
            entry = self.entry("SLIP_ANGLE_RANGE", "ALPMAX")
            raise self.refusal(f"ALPMAX is {tyre.slips:g} rad: no slip range.", entry)
        loads = np.linspace(low, high, 50)
        quantities = (("cornering stiffness", tyre.stiffness, "PKY2"), ("friction", tyre.friction, "PDY2"))
        for name, law, key in quantities:
            for load in loads[~(law(loads) > 0.0)][:1]:
                entry = self.entry("LATERAL_COEFFICIENTS", key)
                raise self.refusal(f"the {name} is not positive at {load:.0f} N, within the range of loads.", entry)

    def notes(self, model: str, p: dict[str, float], nominal: float) -> Iterator[str]:
        """Yield the notes on unused parts of the file and on its sign convention."""
        if p["PKY1"] < 0.0:
            yield "PKY1 < 0: slip with the sign of ISO, where a positive one pushes to the right; turned round."
        else:
            yield (
                "PKY1 > 0: slip with the sign of adapted SAE, where a positive one pushes to the positive side; in a "
                "file with the sign of ISO this would be a negative stiffness."
            )
        if p["PHY1"] or p["PVY1"] or p["PEY3"]:
            side = self.entry("MODEL", "TYRESIDE")
            measured = f", measured as a {side.text.lower()} tyre," if side is not None else ""
            yield (
                f"Ply steer and conicity{measured} are left out (at the nominal load a slip of {p['PHY1']:.4f} rad and "
                f"{p['PVY1'] * nominal:.0f} N): left and right tyres are mirror images."
            )
        if any(p[key] for key in CAMBER):
            yield "Camber is left out: the plant's wheels stand upright."
        if model.startswith("MF 6"):
            actual, nominal = (self.number("OPERATING_CONDITIONS", key, 0.0) for key in ("INFLPRES", "NOMPRES"))
            differs = f" ({nominal:g}), not as it is ({actual:g})" if actual and nominal and actual != nominal else ""
            yield f"The inflation pressure is taken as nominal{differs}."
        unused_sections = [words for name, words in UNUSED_SECTIONS.items() if name in self.sections]
        if unused_sections:
            yield f"Not read: {', '.join(unused_sections)}."
