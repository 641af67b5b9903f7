"""Test design files: round trips, and error messages of one line."""

import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import probedesign
from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.design import Design, check_design, load_design, parse_design
from probedesign.design.catalog import RESINS, ROBOT_FLANGES
from probedesign.design.io import default_tip_d_mm, new, notes_of, render_design, sensor_keys, write_design
from probedesign.design.sensor_catalog import SENSORS

DESIGNS = Path(__file__).parents[2] / "designs"
LARGE = (DESIGNS / "large.toml").read_text(encoding="utf-8")


def plain(text: str) -> str:
    """Return a design file without comments, so that a test can replace a value in its text."""
    return "\n".join(line.split("#")[0].rstrip() for line in text.splitlines()) + "\n"


PLAIN = plain(LARGE)


def one_line(error: pytest.ExceptionInfo[InputError]) -> str:
    message = str(error.value)
    assert message.isprintable() and message
    return message


def problem(old: str, new: str) -> str:
    assert old in PLAIN
    with pytest.raises(InputError) as error:
        parse_design(PLAIN.replace(old, new, 1), "large.toml")
    return one_line(error)


# The shipped designs


@pytest.mark.parametrize(
    ("name", "length", "assumed"),
    [
        ("large", 150.0, ("tip_d_mm",)),
        ("medium", 100.0, ("base_d_mm", "tip_d_mm")),
        ("small", 50.0, ("base_d_mm", "tip_d_mm")),
    ],
)
def test_the_papers_probes(name, length, assumed):
    """Lengths from Table I; E and G from its section IV; what it only draws is marked."""
    design = load_design(DESIGNS / f"{name}.toml")
    assert (design.name, design.probe.length_mm, design.probe.assumed) == (name, length, assumed)
    assert design.youngs_modulus.value == pytest.approx(2.32e6, rel=1e-15)  # one conversion of units
    assert design.shear_modulus.value == pytest.approx(7.61e5, rel=1e-15)
    assert design.youngs_modulus.provenance == design.shear_modulus.provenance == "identified"
    assert design.density.provenance == "datasheet"
    assert design.assumptions == (
        *(f"probe.{key}" for key in assumed), "mount.root_rigid_radii", "contact.friction",
        "contact.object_compliance_m_N",
    )  # fmt: skip
    assert design.friction.value == 0.6
    assert design.probe.cross_section.full_round and parse_design(render_design(design)) == design


@pytest.mark.parametrize("value", ['"2026-13-40"', '"soon"', "2026-01-31", "5"])
def test_a_bad_date_names_its_key_once_and_its_line(value: str) -> None:
    text = f'schema = 1\nname = "x"\ndate = {value}\n[probe]\nlength_mm = 100.0\nbase_d_mm = 12.0\ntip_d_mm = 2.0\n'
    with pytest.raises(InputError, match=r"^design:3: date = ") as error:
        parse_design(text)
    assert value.strip('"') in str(error.value) and "\n" not in str(error.value)


def test_a_named_resin_fills_what_is_not_given():
    table = {"schema": 1, "name": "r", "probe": {"shape": "cylinder", "length_mm": 80, "base_d_mm": 6}}
    design = check_design(table)
    assert design.youngs_modulus == RESINS["elastic-50a"].youngs_modulus
    assert "material.youngs_modulus_mpa" in design.assumptions
    given = check_design({**table, "material": {"youngs_modulus_mpa": 3.1}})
    assert given.youngs_modulus.value == pytest.approx(3.1e6, rel=1e-15)


@pytest.mark.parametrize(("root", "assumed"), [(0.12, True), (-0.3, True), (0.0, False)])
def test_a_root_is_assumed_unless_there_is_none(root, assumed):
    document = {"schema": 1, "name": "r", "probe": {"shape": "cylinder", "length_mm": 80, "base_d_mm": 6}}
    design = check_design(document | {"mount": {"root_rigid_radii": root}})
    assert ("mount.root_rigid_radii" in design.assumptions) == assumed


#: Design file of a version without friction.
WITHOUT_CONTACT = PLAIN[: PLAIN.index("[contact]")] + PLAIN[PLAIN.index("[print]") :]


@pytest.mark.parametrize("resin", sorted(RESINS))
def test_a_design_without_contact_has_the_friction_of_its_resin_and_its_provenance(resin):
    design = parse_design(WITHOUT_CONTACT.replace('"elastic-50a"', f'"{resin}"'))
    assert design.contact.friction is None
    assert design.friction == RESINS[resin].friction
    assert (design.friction.value, design.friction.provenance) == (0.6, "assumed")
    assert "contact.friction" in design.assumptions


@pytest.mark.parametrize(
    ("friction", "provenance", "assumed"),
    [
        ("0.3", None, True),
        ("0.3", "assumed", True),
        ("0.3", "identified", False),
        ("0", None, True),  # frictionless is an assumption too
        ("inf", None, False),  # any direction: no number is assumed
    ],
)
def test_a_given_friction_overrides_the_resin(friction, provenance, assumed):
    table = f"[contact]\nfriction = {friction}\n"
    table += f'[contact.provenance]\nfriction = "{provenance}"\n' if provenance else ""
    design = parse_design(WITHOUT_CONTACT + table)
    assert design.friction.value == float(friction)
    assert design.friction.provenance == (provenance or "assumed")
    assert ("contact.friction" in design.assumptions) == assumed
    assert parse_design(render_design(design)) == design


@pytest.mark.parametrize("value", ["nan", "-nan", "-inf", "-0.1", "true", '"0.6"', "[0.6]"])
def test_a_friction_that_is_none_names_key_and_line(value):
    line = PLAIN[: PLAIN.index("friction = 0.6")].count("\n") + 1
    message = problem("friction = 0.6", f"friction = {value}")
    assert message.startswith(f"large.toml:{line}: contact.friction = ")
    assert '"' in value or "[" in value or value == "true" or "allowed is 0 ... inf" in message


# What is wrong


@pytest.mark.parametrize(
    "key", ["length_mm = 150.0", "base_d_mm = 12.0", "tip_d_mm = 2.0", "youngs_modulus_mpa = 2.32"]
)
@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "-3.0", "0.0", "1e9", "true", '"150"', "[1.0]", "1979-05-27"])
def test_a_bad_number_names_key_and_line(key, value):
    name = key.split(" = ")[0]
    line = PLAIN[: PLAIN.index(key)].count("\n") + 1
    assert problem(key, f"{name} = {value}").startswith(f"large.toml:{line}: ")
    assert name in problem(key, f"{name} = {value}")


@pytest.mark.parametrize("digits", [400, 5000])
def test_an_endless_integer(digits):
    assert "large.toml" in problem("length_mm = 150.0", f"length_mm = {'9' * digits}")
    assert "large.toml" in problem("[9.81, 0.0, 0.0]", f"[{'9' * digits}, 0, 0]")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("tip_d_mm = 2.0", "tip_mm = 2.0", "did you mean 'probe.tip_d_mm'"),
        ("length_mm", "lenght_mm", "did you mean 'probe.length_mm'"),
        ("friction = 0.6", "fricton = 0.6", ": unknown key 'contact.fricton'; did you mean 'contact.friction'?"),
        ("[mount]", "[mout]", "did you mean 'mount'"),
        ("[print]", "[colour]\nred = 1\n[print]", "unknown key 'colour'"),
        ("printer", "printr", "did you mean 'print.printer'"),
        ("[contact]", "[contacts]", "did you mean 'contact'"),
        ("[print]", "[tolerances]\nroot_radius = 0.1\n[print]", "did you mean 'tolerances.root_radii'"),
        ("[print]", "[tolerances]\nroot_radii = 1.1\n[print]", "tolerances.root_radii = 1.1 is out of range"),
        ("[print]", "[tolerances]\ngain = 0.6\n[print]", "tolerances.gain = 0.6 is out of range; allowed is 0 ... 0.5"),
        ("[print]", "[tolerances]\nstiffness_scatter = -0.1\n[print]", "tolerances.stiffness_scatter = -0.1"),
        ("[print]", "[tolerances]\ncreep = nan\n[print]", "tolerances.creep = nan"),
        ("150.0", "1500.0", "probe.length_mm = 1500.0 is out of range; allowed is 5 ... 400"),
        ("tip_d_mm = 2.0", "tip_d_mm = 14.0", "tip_d_mm = 14.0 is wider than base_d_mm = 12.0"),
        ("tip_d_mm = 2.0", "", "probe.tip_d_mm is missing; a cone needs its tip diameter"),
        ('shape = "cone"', 'shape = "cylinder"', "probe.tip_d_mm = 2.0 differs from base_d_mm"),
        ('shape = "cone"', 'shape = "profile"', "probe.profile_mm needs 2 to 64 pairs"),
        ('shape = "cone"', 'shape = "ball"', "'cone', 'cylinder' or 'profile'"),
        ("tip_d_mm = 2.0", "tip_d_mm = 2.0\nprofile_mm = [[0, 12], [150, 2]]", "is only for shape"),
        ('["tip_d_mm"]', '["tip"]', "'tip' is not a dimension"),
        ("assumed", 'section = "square"\nassumed', "'round', 'hollow' or 'elliptic'"),
        ("assumed", 'section = "hollow"\nassumed', "probe.bore_ratio is missing; a hollow section needs"),
        ("assumed", 'section = "elliptic"\nassumed', "probe.flatness is missing; an elliptic section needs"),
        ("assumed", "bore_ratio = 0.5\nassumed", 'bore_ratio is only for section = "hollow"'),
        ("assumed", 'section = "hollow"\nbore_ratio = 0.5\nflatness = 0.5\nassumed', "flatness is only for"),
        ("assumed", 'section = "hollow"\nbore_ratio = 0.95\nassumed', "allowed is 0.05 ... 0.9"),
        ("assumed", 'section = "hollow"\nbore_ratio = nan\nassumed', "bore_ratio = nan is not a finite"),
        ("assumed", 'section = "elliptic"\nflatness = 1.5\nassumed', "allowed is 0.2 ... 1"),
        ("assumed", 'section = "elliptic"\nflatnes = 0.5\nassumed', "did you mean 'probe.flatness'"),
        ('"elastic-50a"', '"elastic-50b"', "known: elastic-50a"),
        ('"identified"', '"guessed"', "'assumed', 'datasheet' or 'identified'"),
        ('"nano17"', '"nano43"', "known: gamma, mini40, nano17"),
        ('"si-12-0.12"', '"si-12"', "known: si-12-0.12"),
        ('"form-3"', '"form-5"', "did you mean 'form-"),
        ('"form-3"', '"Form 3"', "print.printer: unknown 'Form 3'; did you mean 'form-3'?"),
        ('"form-3"', '"form_4l"', "did you mean 'form-4l'?"),
        ('"form-3"', '"\\u001b[2Jprusa"', "unknown '\\x1b[2Jprusa'; known: form-2"),
        ('"elastic-50a"', '"Elastic50A"', "did you mean 'elastic-50a'?"),
        ('"form-3"', '"Form 3L"', "did you mean 'form-3l'? known: form-2"),
        ('"iso-9409-1-50-4-m6"', '"iso-50"', "did you mean 'iso-9409-1-50-4-m6'? known: iso-9409-1-100-6-m8"),
        ('"iso-9409-1-50-4-m6"', '"own"', "mount.flange is missing beside robot_flange = 'own'"),
        ("[print]", '[mount.flange]\nbolt = "M7"\n[print]', "mount.flange.bolt = 'M7' is not one of"),
        ("assumed", 'tip = "round"\nassumed', "probe.tip = 'round' is not one of 'blunt' or 'rounded'"),
        ("assumed", 'tip = "rounded"\nsection = "hollow"\nbore_ratio = 0.5\nassumed', "would close the bore"),
        ("[9.81, 0.0, 0.0]", "[9810.0, 0.0, 0.0]", "longer than 30 m/s²"),
        ("[9.81, 0.0, 0.0]", "[9.81, 0.0]", "mount.gravity_base_m_s2, item 3 is missing"),
        ("[9.81, 0.0, 0.0]", "[9.81, 0.0, nan]", "mount.gravity_base_m_s2, item 3 = nan"),
        ("[9.81, 0.0, 0.0]", "9.81", "expected a list"),
        ("averaging_samples = 36", "averaging_samples = 1.5", "expected a whole number"),
        ("schema = 1", "schema = 2", "schema = 2 is not one of 1"),
        ("schema = 1", "", "schema is missing"),
        ("[probe]", "[probe", "not valid TOML"),
        ("tip_d_mm = 2.0", "tip_d_mm = 2.0\ntip_d_mm = 3.0", "not valid TOML"),
        ("[print]", f"[{'.'.join('a' * 3000)}]\n[print]", "a key has more than 32 parts"),
    ],
)
def test_inconsistent_tables_are_refused(old, new, message):
    assert message in problem(old, new)


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        ("[[0, 12], [50, 6], [50, 5], [150, 2]]", "pair 3: s = 50.0 does not increase"),
        ("[[0, 12], [90, 6], [60, 5], [150, 2]]", "pair 3: s = 60.0 does not increase"),
        ("[[0, 12], [50, nan], [150, 2]]", "item 2, item 2 = nan"),
        ("[[0, 12], [50, -6.0], [150, 2]]", "pair 2: diameter -6.0 is outside"),
        ("[[1, 12], [150, 2]]", "s of the first pair is 1.0"),
        ("[[0, 12], [140, 2]]", "it must equal length_mm = 150.0"),
        ("[[0, 11], [150, 2]]", "it must equal base_d_mm = 12.0"),
        ("[[0, 12], [150, 3]]", "it must equal tip_d_mm = 2.0"),
        ("[[0, 12]]", "needs 2 to 64 pairs"),
        ("[[0, 12, 1], [150, 2]]", "too many items"),
        ("[0, 12]", "expected a list"),
    ],
)
def test_invalid_profiles_are_refused(profile, message):
    assert message in problem('shape = "cone"', f'shape = "profile"\nprofile_mm = {profile}')


@pytest.mark.parametrize(
    "name", ["../up", "a/b", "a\\\\b", "/abs", "", ".", "..", ".hidden", "a b", "x.toml", "é", "a" * 65]
)
def test_a_name_that_is_no_plain_file_name(name):
    assert "is not a plain name" in problem('"large"', f'"{name}"')


def test_what_cannot_be_read(tmp_path):
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00schema")
    for path, message in [
        (tmp_path / "none.toml", "no such design file"),
        (tmp_path, "cannot be read"),
        (binary, "UTF-8"),
        ("a\0b.toml", "cannot be read"),
    ]:
        with pytest.raises(InputError, match=message) as error:
            load_design(path)
        one_line(error)


def test_a_byte_order_mark_is_no_error(tmp_path):
    path = tmp_path / "windows.toml"
    path.write_bytes(b"\xef\xbb\xbf" + LARGE.replace("\n", "\r\n").encode())
    assert load_design(path) == parse_design(LARGE)


# Any content of the file gives a design or one line


def assert_design_or_one_line(text: str) -> None:
    try:
        assert isinstance(parse_design(text), Design)
    except InputError as error:
        assert str(error).isprintable()


@given(st.text())
def test_any_text(text):
    assert_design_or_one_line(text)


TOKENS = st.sampled_from(
    ["nan", "-1", "[]", "[[]]", "{}", "true", "''", '"\\u001b"', "[probe]", "[[mount]]", "=", "\n", "#",
     "1e999", "0x10", "12:00:00", "a.b.c", "[[0, 1], [2, 3]]", "profile_mm = ",
     'shape = "profile"\n', "'", '"""']
)  # fmt: skip


@given(st.data())
def test_any_mutation_of_a_design_file(data):
    text = data.draw(st.sampled_from([PLAIN, LARGE]))
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text)))
        end = start + data.draw(st.integers(0, 30))
        text = text[:start] + data.draw(TOKENS | st.text(max_size=5)) + text[end:]
    assert_design_or_one_line(text)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9) | st.dates(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@given(st.data())
def test_any_value_of_any_key(data):
    document = tomllib.loads(PLAIN)
    table = data.draw(st.sampled_from([document, *(t for t in document.values() if isinstance(t, dict))]))
    table[data.draw(st.sampled_from([*table, "profile_mm", "extra"]))] = data.draw(VALUES)
    try:
        assert check_design(document).name
    except InputError as error:
        assert str(error).isprintable()


# Writing


def write_new(path: Path, **changes: object) -> Design:
    design = new(None, **({"shape": "cone", "length_mm": 150.0, "base_d_mm": 12.0} | changes))
    write_design(render_design(design, notes_of(design)), path)
    return design


def optional(**keys: st.SearchStrategy[object]) -> st.SearchStrategy[dict[str, object]]:
    return st.fixed_dictionaries({}, optional=keys)


PROVENANCE = st.sampled_from(["assumed", "datasheet", "identified"])
SMALL, ANGLE = st.floats(0.0, 0.5), st.floats(0.0, 10.0)
FLANGE_SIZES = ("bolt_circle_d_mm", "max_bolt_entry_mm", "bolt_length_mm", "face_d_mm")
TABLES = optional(
    material=optional(
        resin=st.sampled_from(sorted(RESINS)),
        youngs_modulus_mpa=st.floats(0.01, 1e5),
        density_kg_m3=st.floats(100, 2e4),
        stiffness_spread=SMALL,
        creep_spread=SMALL,
        provenance=optional(youngs_modulus_mpa=PROVENANCE, shear_modulus_mpa=PROVENANCE),
    ),
    sensor=optional(averaging_samples=st.integers(1, 70000)),
    mount=optional(
        root_rigid_radii=st.floats(-1.0, 2.0), gravity_base_m_s2=st.lists(st.floats(-9, 9), min_size=3, max_size=3)
    )
    | st.fixed_dictionaries(
        {
            "robot_flange": st.just("own"),
            "flange": st.fixed_dictionaries(
                {"bolt": st.sampled_from(["M4", "M8"]), "bolt_azimuths_deg": st.just([10.0, 200.0])}
                | dict.fromkeys(FLANGE_SIZES, st.floats(0.1, 300.0)),
                optional={"spigot_mm": st.just([10.0, 2.0])},
            ),
        }
    ),
    contact=optional(friction=st.floats(0.0, 10.0) | st.just(float("inf")), provenance=optional(friction=PROVENANCE)),
    print=optional(scale_xy=st.floats(0.9, 1.1), rigid_scale_z=st.floats(0.9, 1.1)),
    tolerances=optional(
        tared=st.booleans(),
        drift_steps=st.floats(0.0, 100.0),
        youngs_modulus=SMALL,
        tilt_deg=ANGLE,
        gain=SMALL,
        youngs_modulus_by_diameter=st.floats(-20.0, 20.0),
        length_mm=st.floats(0.0, 5.0),
        robot_mm=st.floats(0.0, 5.0),
    ),
)


@given(TABLES)
def test_any_valid_design_reads_back(tables):
    probe = {"length_mm": 150.0, "base_d_mm": 12.0, "tip_d_mm": 2.0, "assumed": ["tip_d_mm"]}
    design = check_design({"schema": 1, "name": "any", "probe": probe, **tables})
    assert parse_design(render_design(design)) == design


@given(
    shape=st.sampled_from(["cone", "cylinder"]),
    length=st.floats(5.0, 400.0),
    base=st.floats(0.3, 60.0),
    taper=st.none() | st.floats(0.0, 1.0),
    resin=st.sampled_from(sorted(RESINS)),
    sensor=st.sampled_from(["nano17", *(c.name for c in SENSORS["nano17"].calibrations)]),
    robot_flange=st.sampled_from(sorted(ROBOT_FLANGES)),
)
def test_any_valid_parameters_read_back(shape, length, base, taper, resin, sensor, robot_flange):
    tip = None if taper is None or shape == "cylinder" else 0.3 + taper * (base - 0.3)
    design = new(
        None, shape=shape, length_mm=length, base_d_mm=base, tip_d_mm=tip,
        resin=resin, sensor=sensor, robot_flange=robot_flange,
    )  # fmt: skip
    assert parse_design(render_design(design, notes_of(design))) == design
    assert (design.probe.length_mm, design.probe.base_d_mm) == (length, base)
    assert tip is None or design.probe.tip_d_mm == tip


@given(
    section=st.sampled_from([("hollow", "bore_ratio", 0.05, 0.9), ("elliptic", "flatness", 0.2, 1.0)]),
    share=st.floats(0.0, 1.0),
)
def test_any_section_reads_back(section, share):
    kind, key, low, high = section
    ratio = min(high, low + share * (high - low))
    design = new(None, shape="cone", length_mm=150.0, base_d_mm=12.0, section=kind, **{key: ratio})
    assert parse_design(render_design(design, notes_of(design))) == design
    assert getattr(design.probe.cross_section, key) == ratio
    assert kind in design.name  # so that it does not take the round probe's name


@given(st.lists(st.tuples(st.floats(0.01, 0.99), st.floats(0.3, 60.0)), max_size=6, unique_by=lambda p: p[0]))
def test_any_profile_reads_back(inner):
    profile = [[0.0, 12.0], *([150.0 * f, d] for f, d in sorted(inner)), [150.0, 2.0]]
    probe = {"shape": "profile", "length_mm": 150.0, "base_d_mm": 12.0, "profile_mm": profile}
    design = check_design({"schema": 1, "name": "p", "probe": probe})
    assert parse_design(render_design(design)) == design


def test_a_new_design_has_the_sources_of_its_numbers(tmp_path):
    design = write_new(tmp_path / "new.toml")
    text = (tmp_path / "new.toml").read_text(encoding="utf-8")
    assert design.assumptions == (
        "material.youngs_modulus_mpa",
        "material.shear_modulus_mpa",
        "mount.root_rigid_radii",
        "contact.friction",
        "contact.object_compliance_m_N",
    )
    assert "until measured" in next(line for line in text.splitlines() if line.startswith("friction = 0.6"))
    assert "not on yours" in next(line for line in text.splitlines() if line.startswith("youngs_modulus_mpa"))
    assert "by default" in next(line for line in text.splitlines() if line.startswith("tip_d_mm"))


def test_only_a_whole_design_is_put_in_place_of_a_file_and_only_by_force(tmp_path):
    path, link = tmp_path / "deep" / "mine.toml", tmp_path / "link.toml"
    write_new(path)
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"mine\.toml: exists already; --force") as error:
        write_new(path, length_mm=50.0)
    one_line(error)
    for force in (False, True):
        with pytest.raises(InputError, match=r"mine\.toml"):
            write_design(LARGE.replace("150.0", "nan"), path, force)
    assert path.read_bytes() == before
    write_design(LARGE, path, force=True)
    assert load_design(path).name == "large"
    assert [p.name for p in path.parent.iterdir()] == ["mine.toml"]  # no draft is left
    link.symlink_to(tmp_path / "elsewhere.toml")
    with pytest.raises(InputError, match="exists already"):
        write_design(LARGE, link)
    assert not (tmp_path / "elsewhere.toml").exists()


@pytest.mark.parametrize(
    ("base", "tip"), [(12.0, 2.0), (30.0, 5.0), (8.0, 2.0), (5.0, 2.0), (1.57, 1.57), (12.34, 2.1)]
)
def test_default_tip(base, tip):
    """A sixth of the base to 0.1 mm, at least 2 mm, never wider than the base."""
    assert default_tip_d_mm(base) == tip


def test_default_names_carry_the_parameters():
    assert new(length_mm=150.0, base_d_mm=12.0).name == "cone-150x12x2"
    assert new(shape="cylinder", length_mm=80.5, base_d_mm=6.0).name == "cylinder-80.5x6"
    hollow = new(length_mm=150.0, base_d_mm=12.0, tip_d_mm=4.0, section="hollow", bore_ratio=0.5)
    assert hollow.name == "cone-150x12x4-hollow-0.5"
    bent = new(length_mm=60.0, base_d_mm=8.0, tip="rounded", axis="arc", axis_bend_deg=60.0)
    assert bent.name == "cone-60x8x2-rounded-arc-60"


def test_a_sensor_by_model_or_calibration():
    assert sensor_keys("nano17") == {"model": "nano17", "calibration": "si-12-0.12"}
    assert sensor_keys("si-25-0.25") == {"model": "nano17", "calibration": "si-25-0.25"}
    assert sensor_keys("mini40") == {"model": "mini40", "calibration": "si-20-1"}
    with pytest.raises(InputError, match=r"si-12-0\.12"):
        sensor_keys("nano43")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# only words\n", "x.toml: is empty; it needs schema, name, probe"),
        ("schema = 1\n", "x.toml: name is missing (also wrong: probe)"),
    ],
)
def test_a_file_without_required_keys_is_refused_with_their_names(text, message):
    with pytest.raises(InputError) as error:
        parse_design(text, "x.toml")
    assert str(error.value) == message


def test_a_new_design_is_the_one_that_the_command_writes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run(["new", "w", "--length", "120", "--base-d", "10", "--axis", "arc", "--bend-deg", "60"]) == 0
    assert probedesign.new("w", length_mm=120.0, base_d_mm=10.0, axis="arc", axis_bend_deg=60.0) == load_design(
        Path("designs/w.toml")
    )

    with pytest.raises(InputError, match="length_mm"):
        probedesign.new(length_mm=-120.0, base_d_mm=10.0)
