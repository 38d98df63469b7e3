"""Tyre property files against the published equations, written out here once more."""

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.cars.tyre_fit import lateral_force

# Besselink, Schmeitz, Pacejka 2010 (Pacejka, Tire and Vehicle Dynamics, 3rd ed., appendix 3): 205/60 R15 91V
BOOK = {
    "PCY1": 1.337, "PDY1": 0.8785, "PDY2": -0.06452, "PEY1": -0.8057, "PEY2": -0.6046, "PEY3": 0.09854,
    "PKY1": -15.324, "PKY2": 1.715, "PKY3": 0.3695, "PKY4": 2.0005, "PHY1": -0.001806, "PHY2": 0.00352,
    "PVY1": -0.00661, "PVY2": 0.03592,
}  # fmt: skip
# MSC Adams/Tire, example file of PAC2002, 235/60 R16
PAC = {
    "PCY1": 1.3507, "PDY1": 1.0489, "PDY2": -0.18033, "PEY1": -0.0074722, "PEY2": -0.0063208, "PKY1": -21.92,
    "PKY2": 2.0012, "PTY1": 2.1439, "PTY2": 1.9829,
}  # fmt: skip


def tir(path, coefficients, *, model="FITTYP = 61", nominal=4000.0, **changes):
    """A file; changes: sections by name, None leaves one out."""
    sections = {
        "MDI_HEADER": "FILE_TYPE = 'tir'\n! a comment = 3",
        "UNITS": "LENGTH = 'meter'\nFORCE = 'newton'\nANGLE = 'radians'\nMASS = 'kg'",
        "MODEL": f"{model}\nTYRESIDE = 'LEFT'",
        "DIMENSION": "UNLOADED_RADIUS = 0.3135   $free radius",
        "VERTICAL": f"FNOMIN = {nominal}",
        "LATERAL_COEFFICIENTS": "\n".join(f"{key} = {value} $x" for key, value in coefficients.items()),
    } | changes
    text = "\n".join(f"[{name}]\n{body}" for name, body in sections.items() if body is not None)
    path.write_text(text, encoding="latin-1")
    return path


def published(p, slip, load, nominal, lfz=1.0, lky=1.0, lmuy=1.0, lcy=1.0, ley=1.0):
    """F_y (N) of eqs. (4.E19)-(4.E30), without shifts: ISO axes, a positive slip gives a negative force."""
    fz0 = lfz * nominal
    dfz = (load - fz0) / fz0
    K = p["PKY1"] * fz0 * math.sin(p.get("PKY4", 2.0) * math.atan(load / (p["PKY2"] * fz0))) * lky
    D = (p["PDY1"] + p.get("PDY2", 0.0) * dfz) * lmuy * load
    C = p["PCY1"] * lcy
    E = (p.get("PEY1", 0.0) + p.get("PEY2", 0.0) * dfz) * ley
    B = K / (C * D)
    return D * math.sin(C * math.atan(B * slip - E * (B * slip - math.atan(B * slip))))


GRID = [(slip, load) for slip in (-0.15, 0.005, 0.03, 0.08, 0.2) for load in (1500.0, 4000.0, 6200.0)]


@pytest.mark.parametrize(("model", "p"), [("FITTYP = 61", BOOK), ("FITTYP = 62", BOOK), ("FITTYP = 6", PAC),
                                          ("PROPERTY_FILE_FORMAT = 'PAC2002'", PAC)])  # fmt: skip
def test_the_force_is_that_of_the_published_equations_turned_to_the_left(tmp_path, model, p):
    scaled = "LFZO = 0.9\nLKY = 1.2\nLMUY = 0.85\nLCY = 1.05\nLEY = 0.7"
    for factors in ({}, {"lfz": 0.9, "lky": 1.2, "lmuy": 0.85, "lcy": 1.05, "ley": 0.7}):
        sections = {"SCALING_COEFFICIENTS": scaled} if factors else {}
        tyre = at.read_tyre_file(tir(tmp_path / "a.tir", p, model=model, **sections))
        for slip, load in GRID:
            assert tyre.force(slip, load) == pytest.approx(-published(p, slip, load, 4000.0, **factors), rel=1e-12)
            small = 1e-7
            slope = -published(p, small, load, 4000.0, **factors) / small
            assert tyre.stiffness(load) == pytest.approx(slope, rel=1e-5)


def test_units_other_than_si_give_the_same_tyre(tmp_path):
    plain = at.read_tyre_file(tir(tmp_path / "a.tir", BOOK, STRUCTURAL="LATERAL_STIFFNESS = 1e5"))
    per_degree = BOOK | {"PKY1": math.radians(BOOK["PKY1"]), "PHY1": math.degrees(BOOK["PHY1"])}
    path = tir(
        tmp_path / "b.tir", per_degree, nominal=4.0, STRUCTURAL="LATERAL_STIFFNESS = 0.1",
        UNITS="LENGTH = 'mm'\nFORCE = 'kN'\nANGLE = 'degrees'", DIMENSION="UNLOADED_RADIUS = 313.5",
    )  # fmt: skip
    other = at.read_tyre_file(path)
    assert other.nominal_load == pytest.approx(4000.0)
    assert other.radius == pytest.approx(0.3135)
    for slip, load in GRID:
        assert other.force(slip, load) == pytest.approx(plain.force(slip, load), rel=1e-12)
    assert other.relaxation_length(4000.0) == pytest.approx(plain.relaxation_length(4000.0))


def test_other_signs_of_slip_and_force_give_the_same_tyre(tmp_path):
    """The sign of the slip is in PKY1 and is said; some files carry that of the force in PDY1."""
    turned = {"PDY1": -BOOK["PDY1"], "PDY2": -BOOK["PDY2"]}
    iso, sae, other = (
        at.read_tyre_file(tir(tmp_path / "a.tir", BOOK | changes)) for changes in ({}, {"PKY1": 15.324}, turned)
    )
    slip, load = np.array(GRID).T
    np.testing.assert_array_equal(iso.force(slip, load), sae.force(slip, load))
    np.testing.assert_allclose(iso.force(slip, load), other.force(slip, load), rtol=1e-12)
    assert any("ISO" in note and "turned round" in note for note in iso.notes)
    assert any("adapted SAE" in note and "negative stiffness" in note for note in sae.notes)


def test_the_relaxation_length_is_the_published_one(tmp_path):
    pac = at.read_tyre_file(
        tir(tmp_path / "a.tir", PAC, model="FITTYP = 6", nominal=4850.0, DIMENSION="UNLOADED_RADIUS = 0.344")
    )
    assert pac.relaxation_length(2400.0) == pytest.approx(0.35, abs=0.005)  # as the page of the tyres says
    assert pac.relaxation_length(4850.0) == pytest.approx(0.59, abs=0.005)
    assert at.load_tyre("passenger-car").relaxation_length == pytest.approx(pac.relaxation_length(3300.0), rel=0.01)
    book = at.read_tyre_file(tir(tmp_path / "b.tir", BOOK, STRUCTURAL="LATERAL_STIFFNESS = 1e5\nPCFY1 = 0.2"))
    assert book.relaxation_length(4000.0) == pytest.approx(book.stiffness(4000.0) / 1e5)
    assert book.relaxation_length(6000.0) == pytest.approx(book.stiffness(6000.0) / 1.1e5)
    none = at.read_tyre_file(tir(tmp_path / "c.tir", BOOK)).to_tyre()
    assert none.tyre.relaxation_length == 0.0
    assert any("No relaxation length" in note for note in none.notes)


@pytest.mark.parametrize(("model", "p", "most"), [("FITTYP = 61", BOOK, 0.02), ("FITTYP = 6", PAC, 0.01)])
def test_the_fitted_tyre_is_as_near_as_it_says_and_near(tmp_path, model, p, most):
    """Largest deviation of the force over slip and load, against the published equations."""
    fit = at.read_tyre_file(tir(tmp_path / "a.tir", p, model=model)).to_tyre("mine")
    assert isinstance(fit.tyre, at.Tyre)
    assert fit.tyre.name == "mine"
    worst = 0.0
    for slip in np.linspace(0.0, fit.slips[1], 40):
        for load in np.linspace(*fit.loads, 15):
            peak = abs(p["PDY1"] + p["PDY2"] * (load / 4000.0 - 1.0)) * load
            off = float(lateral_force(fit.tyre, slip, load, fit.friction)) + published(p, slip, load, 4000.0)
            worst = max(worst, abs(off) / peak)
    assert worst <= 1.03 * fit.deviation + 1e-4
    assert fit.deviation <= most
    assert f"{100 * fit.deviation:.1f} %" in str(fit)


def test_the_shipped_tyres_are_what_their_published_sets_give(tmp_path):
    for name, p, nominal in (("small-car", BOOK, 4000.0), ("passenger-car", PAC, 4850.0)):
        shipped = at.load_tyre(name)
        assert shipped.friction_load_sensitivity == pytest.approx(-p["PDY2"] / p["PDY1"], rel=0.02)
        file = at.read_tyre_file(tir(tmp_path / "a.tir", p, nominal=nominal, model="FITTYP = 61"))
        loads = np.linspace(0.4, 1.4, 11) * nominal
        for load in loads:
            assert shipped.stiffness_at(load, load)[0] == pytest.approx(float(file.stiffness(load)), rel=1e-3)
            slips = np.linspace(0.005, 0.2, 40)
            ours = lateral_force(shipped, slips, load, abs(p["PDY1"]))
            assert np.abs(ours - file.force(slips, load)).max() <= 0.06 * abs(p["PDY1"]) * load


def test_what_is_left_out_is_said(tmp_path):
    file = tir(
        tmp_path / "a.tir", BOOK, OPERATING_CONDITIONS="INFLPRES = 200000\nNOMPRES = 220000",
        ALIGNING_COEFFICIENTS="QBZ1 = 12", LONGITUDINAL_COEFFICIENTS="PCX1 = 1.6",
    )  # fmt: skip
    notes = " ".join(at.read_tyre_file(file).notes)
    assert "Ply steer and conicity, measured as a left tyre" in notes
    assert "nominal (220000), not as it is (200000)" in notes
    assert all(words in notes for words in ("Camber", "aligning moment", "longitudinal slip"))


@pytest.mark.parametrize(("changes", "message"), [
    ({"LATERAL_COEFFICIENTS": None}, r"no section \[LATERAL_COEFFICIENTS\]"),
    ({"UNITS": None}, r"no section \[UNITS\]: write LENGTH"),
    ({"VERTICAL": "X = 1"}, r"has no FNOMIN"),
    ({"UNITS": "LENGTH = 'furlong'\nFORCE = 'newton'\nANGLE = 'rad'"}, r"line 5: LENGTH = 'furlong': unknown unit"),
    ({"UNITS": "LENGTH = 'meter'\nFORCE = 'kN'\nANGLE = 'rad'"}, r"FNOMIN = 4000 is 4e\+06 N, .* wrong \[UNITS\]"),
    ({"UNITS": "LENGTH = 'meter'\nFORCE = 'newton'\nANGLE = 'degrees'"}, r"PKY1 = -15.324.*per degree"),
    ({"MODEL": "PROPERTY_FILE_FORMAT = 'FTIRE'"}, r"line 10: tyre model 'FTIRE' cannot be read"),
    ({"MODEL": "FITTYP = 7"}, r"tyre model '7' cannot be read"),
    ({"MODEL": "LONGVL = 16"}, r"has no FITTYP and no PROPERTY_FILE_FORMAT"),
    ({"DIMENSION": "UNLOADED_RADIUS = 313.5"}, r"line 13: UNLOADED_RADIUS = 313.5 is 313.5 m"),
    ({"SCALING_COEFFICIENTS": "LKY = -1"}, r"LKY = -1: a scaling factor must be positive"),
    ({"VERTICAL_FORCE_RANGE": "FZMIN = 9000\nFZMAX = 9500"}, r"holds no load near FNOMIN"),
    ({"LATERAL_COEFFICIENTS": "PCY1 = 1.3\nPKY1 = -15\nPKY2 = 1.7"}, r"has no PDY1"),
    ({"PDY1": "nan"}, r"line \d+: PDY1 = 'nan': must be a finite number"),
    ({"PKY2": "much"}, r"line \d+: PKY2 = 'much': must be a finite number"),
    ({"PKY2": -1.7}, r"PKY2 = -1.7: the load .* is from 1e-06"),
    ({"PDY2": -3.0}, r"the friction is not positive at \d+ N"),
    ({"PKY4": 5.0}, r"the cornering stiffness is not positive at \d+ N"),
    ({"PDY1": "1\nPDY1 = 1\nPDY1 = 1.4"}, r"line \d+: PDY1 stands in line \d+ with another value"),
])  # fmt: skip
def test_what_is_missing_or_impossible_is_named_with_its_line(tmp_path, changes, message):
    """changes: sections, or coefficients."""
    coefficients = BOOK | {key: value for key, value in changes.items() if key in BOOK}
    sections = {key: value for key, value in changes.items() if key not in BOOK}
    with pytest.raises(at.ConfigError, match=message):
        at.read_tyre_file(tir(tmp_path / "a.tir", coefficients, **sections))
    with pytest.raises(at.StorageError):
        at.read_tyre_file(tmp_path / "none.tir")


@pytest.mark.parametrize("blank", ["", "''", "   $ not measured"])
def test_an_empty_value_counts_as_not_there(tmp_path, blank):
    plain = at.read_tyre_file(tir(tmp_path / "a.tir", PAC, model="PROPERTY_FILE_FORMAT = 'PAC2002'"))
    empty = {"STRUCTURAL": "LATERAL_STIFFNESS", "VERTICAL_FORCE_RANGE": "FZMIN", "SCALING_COEFFICIENTS": "LMUY"}
    sections = {section: f"{key} = {blank}" for section, key in empty.items()}
    sections["STRUCTURAL"] += "\nPCFY1 = 0\nLATERAL_STIFFNESS = n/a"  # PAC2002 has no use for it
    assert (
        at.read_tyre_file(tir(tmp_path / "a.tir", PAC, model="PROPERTY_FILE_FORMAT = 'PAC2002'", **sections)) == plain
    )
    path = tir(tmp_path / "a.tir", PAC)
    path.write_text(path.read_text().replace("PDY1 = 1.0489", f"PDY1 = {blank}"))
    with pytest.raises(at.ConfigError, match=r"\[LATERAL_COEFFICIENTS\] has no PDY1"):
        at.read_tyre_file(path)
